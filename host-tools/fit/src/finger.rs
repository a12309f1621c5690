//! From a finger's recordings to its calibration record.
//!
//! What a recording is for is found in it: where exactly one MEMS sensor answers to the load while the
//! others stay within their noise, the reference force is the force on that sensor (a bench recording:
//! S and b are fitted). Where none or several answer, it is the force on the finger (the net is
//! fitted). Reference columns `s0_fx_n` … fit their sensor wherever they are.

use std::sync::atomic::AtomicBool;

use taxel::calibration::{Calibration, Range, SensorCalibration, TaxelCalibration};
use taxel::condition::{Bias, Signals};
use taxel::estimate::gate::Gate;
use taxel::estimate::net::{ForceNet, MAX_HIDDEN};
use taxel::estimate::sensitivity::Sensitivity;
use taxel::estimate::slip::Slip;
use taxel::scan::{SENSORS, TAXELS};

use crate::array;
use crate::auto::Chosen;
use crate::checks;
use crate::error::FitError;
use crate::least_squares;
use crate::limit_surface;
use crate::model::{Family, Training};
use crate::network::{Net, NetOptions, Progress};
use crate::prepared::Prepared;
use crate::range::trained_range;
use crate::recording::Recording;
use crate::scaling::Inputs;
use crate::skin::{self, Skin};

/// A shear below this share of the normal force is none: the recordings are of normal presses.
const NO_SHEAR: f64 = 0.01;
/// Signal to noise of S's weakest direction below which the fit warns: 1/20² is 0.25 % of S.
const WEAK: f64 = 20.0;

/// Friction of rubber before any is known.
const USUAL_FRICTION: f32 = 0.6;
/// Exponent of Hertz's pressure in 003's power law.
const HERTZ: f64 = 2.0;

/// What the recordings are for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Subject {
    /// Find out from each recording.
    #[default]
    Found,
    /// The reference is the force on this sensor.
    Sensor(usize),
    /// The reference is the force on the finger.
    Finger,
}

/// How to fit a finger.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitOptions {
    /// What the recordings are for.
    pub subject: Subject,
    /// The family of the finger's model.
    pub family: Family,
    /// Hidden units; as 002 by default: 16 with shear, 12 without. `auto` finds its own.
    pub hidden: Option<usize>,
    /// Outputs: 3 with shear, 1 (f_z) without; found in the recordings by default.
    pub outputs: Option<usize>,
    /// Training of the net.
    pub net: NetOptions,
    /// Leave out the model of the skin and the sensors' array, which need contact points: the net alone
    /// as in 002.
    pub net_only: bool,
    /// Serial number for the record.
    pub serial: heapless::String<32>,
    /// Date for the record, seconds since 1970-01-01 UTC.
    pub date: u64,
}

/// A finger's calibration and how it came about.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// The record.
    pub calibration: Calibration,
    /// What the user should look at, in full sentences.
    pub warnings: Vec<String>,
    /// What was fitted.
    pub parts: Vec<Part>,
}

/// One fitted part.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// `s0`, or `net 16-16-3`.
    pub name: String,
    /// Rows of the recordings it was fitted to, before thinning.
    pub rows: usize,
    /// Rows left out because a channel was saturated, dead or faulty.
    pub faulty: usize,
    /// Condition number of a sensor's signals.
    pub condition: Option<f64>,
    /// How a model was chosen.
    pub chosen: Option<Chosen>,
    /// Of a net's parameters, how many the data determine.
    pub effective: Option<f64>,
    /// RMS error of the fit per reference component, newtons.
    pub residual: Vec<f64>,
}

/// Fits all that the recordings hold. When `stop` becomes true the best so far is returned.
///
/// # Errors
/// What the recordings lack, and how to mend it.
pub fn fit(
    recordings: &[Recording],
    options: &FitOptions,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Fitted, FitError> {
    if recordings.is_empty() {
        return Err(FitError::NoRecording);
    }
    if let Subject::Sensor(sensor) = options.subject
        && sensor >= SENSORS
    {
        let problem = format!("a finger has sensors s0 … s{}", SENSORS - 1);
        return Err(FitError::Shape { part: format!("s{sensor}"), problem });
    }
    let recordings: Vec<Prepared<'_>> =
        recordings.iter().map(Prepared::new).collect::<Result<_, _>>()?;
    let subjects: Vec<Subject> = recordings
        .iter()
        .map(|recording| match options.subject {
            Subject::Found => recording.subject(),
            subject => subject,
        })
        .collect();
    let mut fitted = Fitted {
        calibration: Calibration {
            serial: options.serial.clone(),
            date: options.date,
            ..Calibration::default()
        },
        warnings: Vec::new(),
        parts: Vec::new(),
    };
    for sensor in 0..SENSORS {
        let own: Vec<(&Prepared<'_>, bool)> = recordings
            .iter()
            .zip(&subjects)
            .filter_map(|(recording, subject)| {
                let bench = *subject == Subject::Sensor(sensor);
                // A bench recording says nothing of the other sensors: nothing presses on them.
                let all = *subject == Subject::Finger && recording.loads(sensor);
                (bench || all).then_some((recording, bench))
            })
            .collect();
        if !own.is_empty() {
            fit_sensor(&mut fitted, sensor, &own)?;
        }
    }
    let fingers: Vec<&Prepared<'_>> = recordings
        .iter()
        .zip(&subjects)
        .filter(|(recording, subject)| {
            // With references of single sensors and no optical matrix there is nothing left to fit.
            **subject == Subject::Finger
                && (recording.bias.taxels.is_some() || fitted.parts.is_empty())
        })
        .map(|(recording, _)| recording)
        .collect();
    if !fingers.is_empty() {
        fit_net(&mut fitted, &fingers, options, progress, stop)?;
        if !options.net_only {
            fit_skin(&mut fitted, &fingers, progress, stop)?;
        }
    }
    if !options.net_only {
        fit_array(&mut fitted, &recordings, &subjects);
    }
    fitted.calibration.validate().map_err(FitError::Record)?;
    Ok(fitted)
}

/// Takes out rows of a sensor that stand alone; how many.
fn drop_outliers(
    fitted: &mut Fitted,
    name: &str,
    signals: &mut Vec<[f64; 3]>,
    forces: &mut Vec<[f64; 3]>,
) -> usize {
    let lists = |rows: &[[f64; 3]]| rows.iter().map(|row| row.to_vec()).collect::<Vec<_>>();
    let mut recorded = [(lists(signals), lists(forces))];
    let outliers = checks::remove_outliers(&mut recorded);
    if outliers > 0 {
        warn_of_outliers(fitted, name, outliers, signals.len());
        let arrays = |rows: &[Vec<f64>]| rows.iter().map(|r| [r[0], r[1], r[2]]).collect();
        let [(x, y)] = &recorded;
        (*signals, *forces) = (arrays(x), arrays(y));
    }
    outliers
}

fn warn_of_outliers(fitted: &mut Fitted, name: &str, outliers: usize, rows: usize) {
    fitted.warnings.push(format!(
        "{name}: {outliers} of {rows} rows stand far out of the rows before and after them and were left out; \
         look for a loose contact"
    ));
}

/// All three components, if all are known.
fn known(force: [Option<f64>; 3]) -> Option<[f64; 3]> {
    let [x, y, z] = force;
    Some([x?, y?, z?])
}

fn fit_sensor(
    fitted: &mut Fitted,
    sensor: usize,
    recordings: &[(&Prepared<'_>, bool)],
) -> Result<(), FitError> {
    let name = format!("s{sensor}");
    let (mut signals, mut forces, mut faulty) = (Vec::new(), Vec::new(), 0);
    let mut first_bias = None;
    for (recording, bench) in recordings {
        let missing = |missing: String, mend: &str| FitError::Missing {
            recording: recording.recording.name.clone(),
            missing,
            mend: mend.into(),
        };
        let bias = recording.bias.bridges[sensor].ok_or_else(|| {
            missing(
                format!("columns bridge_{name}_a … bridge_{name}_d"),
                "record that sensor, or choose another",
            )
        })?;
        first_bias.get_or_insert(bias);
        for (sample, signal) in recording.recording.samples.iter().zip(&recording.signals) {
            let truth = known(sample.truth.sensors[sensor])
                .or_else(|| bench.then(|| known(sample.truth.force)).flatten());
            let (Some(force), Some(u)) = (truth, signal.bridges[sensor]) else { continue };
            if signal.health.bridge_faults >> sensor & 1 == 1 {
                faulty += 1;
                continue;
            }
            signals.push(u.map(f64::from));
            forces.push(force);
        }
        if signals.is_empty() && faulty == 0 {
            return Err(missing(
                "reference columns fx_n, fy_n, fz_n".into(),
                "record a three-axis reference along with the sensor",
            ));
        }
    }
    let Some(bias) = first_bias else { return Err(FitError::NoRecording) };
    faulty += drop_outliers(fitted, &name, &mut signals, &mut forces);
    let fit = least_squares::fit(&name, &signals, &forces, f64::from(bias.noise))?;
    if fit.ratio < WEAK {
        fitted.warnings.push(format!(
            "{name}: in one direction the signals stand only {:.0} times out of their noise; load it \
             more evenly in x, y and z for a surer matrix",
            fit.ratio
        ));
    }
    if fit.s[2][2] < 0.0 {
        fitted.warnings.push(format!(
            "{name}: f_z falls as u_z rises; a force into the skin is positive: look at the reference's sign"
        ));
    }
    let columns = |j: usize| signals.iter().map(move |u| u[j] as f32);
    fitted.calibration.sensors[sensor] = Some(SensorCalibration {
        bias,
        sensitivity: Sensitivity(fit.s.map(|row| row.map(|s| s as f32))),
        range: std::array::from_fn(|j| trained_range(columns(j), bias.noise)),
        residual: fit.rms.map(|rms| rms as f32),
    });
    fitted.parts.push(Part {
        name,
        rows: signals.len(),
        faulty,
        condition: Some(fit.condition),
        chosen: None,
        effective: None,
        residual: fit.rms.to_vec(),
    });
    Ok(())
}

fn fit_net(
    fitted: &mut Fitted,
    recordings: &[&Prepared<'_>],
    options: &FitOptions,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<(), FitError> {
    let outputs = match options.outputs {
        None => outputs_of(recordings),
        Some(outputs) => outputs,
    };
    let usual = if outputs == 1 { 12 } else { 16 };
    let name = "net".to_owned();
    if !matches!(outputs, 1 | 3) || options.hidden.is_some_and(|hidden| hidden > MAX_HIDDEN) {
        let problem =
            format!("a record holds 1 or 3 outputs and at most {MAX_HIDDEN} hidden units");
        return Err(FitError::Shape { part: name, problem });
    }
    let held = matches!(
        options.family,
        Family::Auto | Family::Mlp | Family::Skip | Family::Ridge | Family::LeastSquares
    );
    if !held {
        let problem = format!(
            "the record of a finger holds nets and linear models, none that is {}; choose auto, mlp, \
             skip, ridge or least-squares",
            options.family
        );
        return Err(FitError::Shape { part: name, problem });
    }
    let (mut rows, mut faulty) = (Vec::new(), 0);
    let mut first_bias = None;
    for recording in recordings {
        let missing = |missing: &str, mend: &str| FitError::Missing {
            recording: recording.recording.name.clone(),
            missing: missing.into(),
            mend: mend.into(),
        };
        let bias = recording.bias.taxels.ok_or_else(|| {
            missing("columns lit_r0c0 … dark_c3", "the net needs the optical matrix")
        })?;
        first_bias.get_or_insert(bias);
        let (mut x, mut y, before) = (Vec::new(), Vec::new(), faulty);
        let own = Bias { taxels: Some(bias), ..Bias::default() };
        let gate = Gate::default();
        for (sample, signals) in recording.recording.samples.iter().zip(&recording.signals) {
            let [fx, fy, fz] = sample.truth.force;
            let target = if outputs == 1 {
                fz.map(|z| vec![z])
            } else {
                known([fx, fy, fz]).map(|force| force.to_vec())
            };
            let (Some(target), Some(c)) = (target, signals.taxels) else { continue };
            // What the net never sees on the chip must not shape it: rows below the gate.
            let alone = Signals { taxels: Some(c), ..Signals::default() };
            if signals.health.dead != 0 || signals.health.saturated != 0 {
                faulty += 1;
            } else if own.activity(&alone) > gate.off * gate.off {
                x.push(c.map(f64::from).to_vec());
                y.push(target);
            }
        }
        if x.is_empty() && faulty == before {
            let no_reference =
                recording.recording.samples.iter().all(|s| s.truth.force[2].is_none());
            return Err(match (no_reference, outputs) {
                (true, _) => missing("reference column fz_n", "record a reference along with it"),
                (false, 3)
                    if recording.recording.samples.iter().all(|s| s.truth.force[0].is_none()) =>
                {
                    missing(
                        "reference columns fx_n, fy_n",
                        "add them, or fit fz_n alone (1 output)",
                    )
                }
                _ => FitError::NoLoad { part: format!("{name}: {}", recording.recording.name) },
            });
        }
        rows.push((x, y));
    }
    let Some(bias) = first_bias else { return Err(FitError::NoRecording) };
    for (recording, (_, y)) in recordings.iter().zip(&rows) {
        if y.iter().map(|y| y[outputs - 1]).sum::<f64>() < 0.0 {
            return Err(FitError::Mismatch {
                recording: recording.recording.name.clone(),
                problem: "fz_n is negative where something presses".into(),
                mend: "a force into the skin is positive: turn its sign".into(),
            });
        }
    }
    let total: usize = rows.iter().map(|(x, _)| x.len()).sum();
    let outliers = checks::remove_outliers(&mut rows);
    if outliers > 0 {
        warn_of_outliers(fitted, &name, outliers, total);
    }
    let training = Training {
        part: &name,
        family: options.family,
        recordings: &rows,
        inputs: Inputs::Alike,
        hidden: options.hidden,
        usual,
        most: MAX_HIDDEN,
        options: options.net,
    };
    let (net, chosen) = training.run(progress, stop)?;
    let (x, y): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
    let (x, y) = (x.concat(), y.concat());
    let name = net.name(TAXELS);
    warn_of_faults(fitted, &name, faulty, x.len(), &x);
    let residual = residual(&net, &x, &y);
    fitted.parts.push(Part {
        name,
        rows: x.len(),
        faulty,
        condition: None,
        chosen,
        effective: Some(net.effective),
        residual: residual.clone(),
    });
    fitted.calibration.taxels = Some(TaxelCalibration {
        bias,
        range: ranges(&x, bias.noise),
        residual: std::array::from_fn(|k| residual.get(k).map_or(0.0, |r| *r as f32)),
    });
    fitted.calibration.force = Some(ForceNet {
        hidden: net.hidden.iter().copied().collect(),
        hidden_bias: net.hidden_bias.iter().copied().collect(),
        output: net.output.iter().copied().collect(),
        skip: net.skip.iter().copied().collect(),
        output_bias: net.output_bias.iter().copied().collect(),
    });
    Ok(())
}

/// The model of the skin, where the recordings tell contact points and it is better than the net.
fn fit_skin(
    fitted: &mut Fitted,
    recordings: &[&Prepared<'_>],
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<(), FitError> {
    let Some(taxels) = &fitted.calibration.taxels else { return Ok(()) };
    let skin = match skin::fit(recordings, taxels.bias.noise, progress, stop) {
        // Fewer rows than a model needs, or no time for one, leave the net.
        Err(FitError::TooFewRows { .. } | FitError::Stopped) => return Ok(()),
        skin => skin?,
    };
    let Some(Skin { model, rows, residual }) = skin else { return Ok(()) };
    let of = |errors: &mut dyn Iterator<Item = f64>| errors.map(|e| e * e).sum::<f64>();
    let components = fitted.calibration.force.as_ref().map_or(1, |net| net.output_bias.len());
    let from = 3 - components.min(3);
    let nets = of(&mut taxels.residual.iter().take(components).map(|e| f64::from(*e)));
    if of(&mut residual.iter().skip(from).copied()) >= nets {
        fitted.warnings.push(
            "the model of the skin meets the recordings less well than the net and is left out"
                .into(),
        );
        return Ok(());
    }
    fitted.calibration.slip = Some(slip(model.shear.then_some(model.friction)));
    fitted.calibration.model = Some(model);
    fitted.parts.push(Part {
        name: "model of the skin".into(),
        rows,
        faulty: 0,
        condition: None,
        chosen: None,
        effective: None,
        residual: residual[from..].to_vec(),
    });
    Ok(())
}

/// The sensors' array, where all of them are calibrated and a recording tells contact points.
fn fit_array(fitted: &mut Fitted, recordings: &[Prepared<'_>], subjects: &[Subject]) {
    let fingers: Vec<&Prepared<'_>> = recordings
        .iter()
        .zip(subjects)
        .filter_map(|(recording, subject)| (*subject == Subject::Finger).then_some(recording))
        .collect();
    let Some((array, rows)) = array::fit(&fingers, &fitted.calibration.sensors) else { return };
    fitted.parts.push(Part {
        name: "array of sensors".into(),
        rows,
        faulty: 0,
        condition: None,
        chosen: None,
        effective: None,
        residual: array.residual.iter().map(|r| f64::from(*r)).collect(),
    });
    fitted.calibration.array = Some(array);
    fitted.calibration.slip.get_or_insert_with(|| slip(None));
}

/// What a contact holds: Hertz's pressure swept over the centres of rotation.
fn slip(friction: Option<f32>) -> Slip {
    let usual = Slip::usual(friction.unwrap_or(USUAL_FRICTION));
    let [c, gamma] = usual.surface.radius.map(f64::from);
    Slip { surface: limit_surface::power_law(HERTZ, c, gamma), ..usual }
}

fn ranges(x: &[Vec<f64>], noise: f32) -> [Range; TAXELS] {
    std::array::from_fn(|k| trained_range(x.iter().map(|row| row[k] as f32), noise))
}

/// RMS error per output, by the arithmetic of the chip.
fn residual(net: &Net, x: &[Vec<f64>], y: &[Vec<f64>]) -> Vec<f64> {
    let mut squares = vec![0.0; net.output_bias.len()];
    for (x, y) in x.iter().zip(y) {
        let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
        for ((sum, found), wanted) in squares.iter_mut().zip(net.outputs(&x)).zip(y) {
            *sum += (f64::from(found) - wanted).powi(2);
        }
    }
    squares.iter().map(|sum| (sum / x.len().max(1) as f64).sqrt()).collect()
}

/// Three outputs where any recording holds shear, else one.
fn outputs_of(recordings: &[&Prepared<'_>]) -> usize {
    let peak = |axes: &[usize]| {
        let samples = recordings.iter().flat_map(|r| &r.recording.samples);
        samples
            .flat_map(|s| axes.iter().filter_map(|axis| s.truth.force[*axis]))
            .fold(0.0, |peak: f64, f| peak.max(f.abs()))
    };
    if peak(&[0, 1]) > NO_SHEAR * peak(&[2]) { 3 } else { 1 }
}

fn warn_of_faults(fitted: &mut Fitted, name: &str, faulty: usize, rows: usize, x: &[Vec<f64>]) {
    if faulty > 0 {
        fitted.warnings.push(format!(
            "{name}: {faulty} of {} loaded or faulty rows have a saturated or dead taxel and were left \
             out; lower the light or mend the taxel",
            faulty + rows
        ));
    }
    for k in 0..TAXELS {
        let same = x.first().is_some_and(|first| x.iter().all(|row| row[k] == first[k]));
        if same {
            fitted.warnings.push(format!(
                "{name}: taxel r{}c{} reads the same in every row and is ignored; is it connected?",
                k / 4,
                k % 4
            ));
        }
    }
}

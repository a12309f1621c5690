//! Fit of the net from the optical matrix to the force ([DeMaria2011]).

use std::collections::HashSet;
use std::sync::atomic::AtomicBool;

use taxel::calibration::{Range, TaxelCalibration};
use taxel::condition::{Bias, Signals, TaxelBias};
use taxel::estimate::net::{ForceNet, MAX_HIDDEN};
use taxel::estimate::quantised::Net as RecordNet;
use taxel::scan::{COLS, TAXELS};

use super::{FitOptions, Fitted, Part, known, warn_of_stuck};
use crate::augment;
use crate::prepared::Prepared;
use crate::skin::{Skin, TOUCHED};
use taxel_regress::duplicate_channels::{self, Conditioning};
use taxel_regress::error::FitError;
use taxel_regress::model::Family;
use taxel_regress::network::{Build, Net, NetOptions, Progress};
use taxel_regress::outliers::Outliers;
use taxel_regress::range::trained_range;
use taxel_regress::scaling::Inputs;
use taxel_regress::shear::{FORCES, NO_SHEAR};
use taxel_regress::sign_check;
use taxel_regress::training::{Chosen, Recorded, Teacher, Training};

/// Rows of each recording in which the chip would run the net.
pub(super) struct Loads {
    bias: TaxelBias,
    targets: Vec<String>,
    rows: Vec<Recorded>,
    /// Number of rows left out because a taxel was saturated or dead.
    faulty: usize,
    /// Indices of the wrong samples of each recording.
    pub wrong: Vec<HashSet<usize>>,
}

/// Name of the part before its shape is known.
const NAME: &str = "net";

/// Gathers the rows of the recordings of the finger.
///
/// # Errors
///
/// Options that the record cannot hold, missing columns or loads, and inconsistent
/// references.
pub(super) fn loads(
    fitted: &mut Fitted,
    recordings: &[&Prepared<'_>],
    options: &FitOptions,
) -> Result<Loads, FitError> {
    let outputs = match options.outputs {
        None => outputs_of(recordings),
        Some(outputs) => outputs,
    };
    let name = NAME.to_owned();
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
            "the record of a finger holds nets and linear models, not {}; choose auto, mlp, \
             skip, ridge or least-squares",
            options.family
        );
        return Err(FitError::Shape { part: name, problem });
    }
    let (mut rows, mut places, mut faulty) = (Vec::new(), Vec::new(), 0);
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
        warn_of_stuck(fitted, recording, &recording.stuck_taxels());
        let (mut x, mut y, mut at, before) = (Vec::new(), Vec::new(), Vec::new(), faulty);
        let own = Bias { taxels: Some(bias), ..Bias::default() };
        let samples = recording.recording.samples.iter().zip(&recording.signals);
        for (row, (sample, signals)) in samples.enumerate() {
            let [fx, fy, fz] = sample.truth.force;
            let target = if outputs == 1 {
                fz.map(|z| vec![z])
            } else {
                known([fx, fy, fz]).map(|force| force.to_vec())
            };
            let (Some(target), Some(c)) = (target, signals.taxels) else { continue };
            // Rows without a touch must not shape the net, because it never runs on them.
            let alone = Signals { taxels: Some(c), ..Signals::default() };
            if signals.health.dead != 0 || signals.health.saturated != 0 {
                faulty += 1;
            } else if own.exceeded(&alone, TOUCHED * TOUCHED) {
                x.push(c.map(f64::from).to_vec());
                y.push(target);
                at.push(row);
            }
        }
        if x.is_empty() && faulty == before {
            let no_reference =
                recording.recording.samples.iter().all(|s| s.truth.force[2].is_none());
            return Err(match (no_reference, outputs) {
                (true, _) => missing(
                    "reference column fz_n",
                    "record a reference along with it, or give one with --reference",
                ),
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
        places.push(at);
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
    if total == 0 {
        return Err(FitError::Shape {
            part: name,
            problem: format!(
                "of {faulty} rows with a load none is without a dead or saturated taxel; `taxel self-test` names it"
            ),
        });
    }
    let names: Vec<String> = recordings.iter().map(|r| r.recording.name.clone()).collect();
    let targets: Vec<String> = FORCES[3 - outputs..].iter().map(|f| (*f).to_owned()).collect();
    sign_check::same_sign(&rows, &names, &targets)?;
    let outliers = Outliers::find(&rows, &names, None)?;
    outliers.remove_from(&mut rows);
    let wrong = places.iter().zip(&outliers.wrong).map(|(at, wrong)| {
        at.iter().zip(wrong).filter(|(_, wrong)| **wrong).map(|(row, _)| *row).collect()
    });
    let wrong = wrong.collect();
    fitted.warnings.extend(outliers.told);
    Ok(Loads { bias, targets, rows, faulty, wrong })
}

/// A trained net with its choice.
pub(super) struct Trained {
    net: Net,
    chosen: Option<Chosen>,
    /// RMS error of each output on rows left out of the fit, if a net alone is not all.
    held_out: Option<Vec<f64>>,
    /// Warning about the choice.
    told: Option<String>,
}

/// Trains the net; the skin model may teach it.
///
/// # Errors
///
/// Too few rows, a target that never changes, or stopped before the first step.
pub(super) fn train(
    loads: &Loads,
    (options, skin): (&FitOptions, Option<&Skin>),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Trained, FitError> {
    let outputs = loads.targets.len();
    let usual = if outputs == 1 { 12 } else { 16 };
    let teach = skin.map(|skin| {
        move |part: &str,
              (build, net): (Build, NetOptions),
              progress: &mut dyn FnMut(Progress),
              stop: &AtomicBool| {
            augment::fit(part, skin, (outputs, build, net), progress, stop)
        }
    });
    let training = Training {
        part: NAME,
        targets: &loads.targets,
        family: options.family,
        recordings: &loads.rows,
        inputs: Inputs::Alike,
        hidden: options.hidden,
        usual,
        most: MAX_HIDDEN,
        options: options.net,
        teacher: skin.zip(teach.as_ref()).map(|(skin, teach)| Teacher {
            residual: &skin.residual,
            hidden: usual,
            teach,
        }),
    };
    let (net, chosen) = training.run(progress, stop)?;
    let build = Build { hidden: net.hidden_bias.len(), skip: !net.skip.is_empty() };
    // A net alone states the error of its fit, as [DeMaria2011] does.
    let held_out = if options.net_only { None } else { training.held_out(build, progress, stop) };
    let told = training.told(chosen.as_ref());
    Ok(Trained { net, chosen, held_out, told })
}

/// Keeps the trained net in the record.
///
/// # Errors
///
/// The training's; without a net the record keeps what the model of the skin needs.
pub(super) fn keep(
    fitted: &mut Fitted,
    Loads { bias, targets: _, rows, faulty, wrong }: Loads,
    trained: Result<Trained, FitError>,
    skin: Option<&Skin>,
) -> Result<(), FitError> {
    if let Some(found) = duplicate_channels::conditioning(&rows).filter(Conditioning::is_collinear)
    {
        let taxels = found.weakest.iter().map(|k| format!("r{}c{}", k / COLS, k % COLS));
        fitted.warnings.push(format!(
            "{NAME}: taxels {} are linearly dependent (condition number {:.0e}); look for \
             channels that are joined",
            taxels.collect::<Vec<_>>().join(", "),
            found.number
        ));
    }
    if let (Err(FitError::Stopped), Some(skin)) = (&trained, skin) {
        // The model of the skin needs the taxels' bias and ranges, and no net.
        let x: Vec<Vec<f64>> = rows.into_iter().flat_map(|(x, _)| x).collect();
        fitted.calibration.taxels = Some(TaxelCalibration {
            bias,
            range: ranges(&x, bias.noise),
            residual: skin.residual.map(|r| r as f32),
        });
        return Ok(());
    }
    let Trained { net, chosen, held_out, told } = trained?;
    fitted.warnings.extend(told);
    let (x, y): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
    let (x, y) = (x.concat(), y.concat());
    let name = net.name(TAXELS);
    warn_of_faults(fitted, &name, faulty, x.len());
    let residual = residual(&net, &x, &y);
    fitted.parts.push(Part {
        name,
        rows: x.len(),
        left_out: faulty + wrong.iter().map(HashSet::len).sum::<usize>(),
        condition: None,
        chosen,
        effective: Some(net.effective),
        residual: residual.clone(),
        held_out: false,
    });
    fitted.calibration.taxels = Some(TaxelCalibration {
        bias,
        range: ranges(&x, bias.noise),
        residual: std::array::from_fn(|k| {
            let held_out = held_out.as_ref().unwrap_or(&residual);
            held_out.get(k).map_or(0.0, |r| *r as f32)
        }),
    });
    let net = ForceNet::new(&net.layers()).map_err(|list| FitError::Shape {
        part: NAME.into(),
        problem: format!("its {list} does not have a finger's shape"),
    })?;
    fitted.calibration.net = Some(RecordNet::Float(net));
    Ok(())
}

fn ranges(x: &[Vec<f64>], noise: f32) -> [Range; TAXELS] {
    std::array::from_fn(|k| trained_range(x.iter().map(|row| row[k] as f32), noise))
}

/// RMS error of each output, by the arithmetic of the chip.
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

/// Number of outputs: three if any recording contains shear, otherwise one.
fn outputs_of(recordings: &[&Prepared<'_>]) -> usize {
    let peak = |axes: &[usize]| {
        let samples = recordings.iter().flat_map(|r| &r.recording.samples);
        samples
            .flat_map(|s| axes.iter().filter_map(|axis| s.truth.force[*axis]))
            .fold(0.0, |peak: f64, f| peak.max(f.abs()))
    };
    if peak(&[0, 1]) > NO_SHEAR * peak(&[2]) { 3 } else { 1 }
}

fn warn_of_faults(fitted: &mut Fitted, name: &str, faulty: usize, rows: usize) {
    if faulty > 0 {
        fitted.warnings.push(format!(
            "{name}: {faulty} of {} loaded or faulty rows have a saturated or dead taxel and were left \
             out; lower the light or mend the taxel",
            faulty + rows
        ));
    }
}

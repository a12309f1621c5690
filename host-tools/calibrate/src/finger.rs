//! Fit of a finger: from its recordings to its calibration record.
//!
//! Each recording's purpose is found from its signals. If exactly one MEMS sensor responds to the
//! load while the others stay within their noise, the reference is the force on that sensor. Such a
//! bench recording fits S and b. Otherwise the reference is the force on the finger and fits the
//! net. Reference columns `s0_fx_n` … fit their sensor in any recording.

mod bench;
mod channels;
mod choice;
mod matrix;
mod net;
mod sensors;

use std::sync::atomic::AtomicBool;
use std::sync::mpsc;
use std::thread;

use taxel::calibration::Calibration;
use taxel::condition::DriftCompensation;
use taxel::scan::SENSORS;

use crate::lag;
use crate::prepared::Prepared;
pub use crate::prepared::Subject;
use crate::quantise::Form;
use crate::recording::Recording;
use crate::shear;
use crate::skin::Skin;
use crate::warmth;
pub use channels::Channel;
pub(crate) use channels::{Columns, List, SUPPLY};
use taxel_regress::error::FitError;
use taxel_regress::model::Family;
use taxel_regress::network::{NetOptions, Progress};
use taxel_regress::training::Chosen;

/// Largest common share of the light that is taken for a drift: 10 K of LEDs.
const MOST_DRIFT: f32 = 0.05;

/// Options of the fit of a finger.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitOptions {
    /// Body on which the reference force acts.
    pub subject: Subject,
    /// Family of the finger's model.
    pub family: Family,
    /// Hidden units; by default as in [DeMaria2011], 16 with shear and 12 without.
    ///
    /// With three recordings or more of one kind, left out one after the other, a width that does
    /// better is chosen. `auto` finds its own width.
    pub hidden: Option<usize>,
    /// Number of outputs: 3 with shear, 1 (f_z) without; found in the recordings by default.
    pub outputs: Option<usize>,
    /// Training options of the net.
    pub net: NetOptions,
    /// Whether to fit the net alone, as in [DeMaria2011].
    ///
    /// The record then lacks the skin model and the sensors' array.
    pub net_only: bool,
    /// Standard deviation of the reference's forces in newtons, at least that where nothing is
    /// touched; by default that.
    pub reference_noise: Option<f64>,
    /// Whether an alignment of the reference's clock may hide the lag: then none is fitted.
    pub clock_hides_lag: bool,
    /// Number format of the net in the record.
    pub form: Form,
    /// Serial number for the record.
    pub serial: heapless::String<32>,
    /// Date for the record, seconds since 1970-01-01 UTC.
    pub date: u64,
}

/// A fitted calibration with its warnings and parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// Calibration record.
    pub calibration: Calibration,
    /// Warnings for the user, in full sentences.
    pub warnings: Vec<String>,
    /// Fitted parts.
    pub parts: Vec<Part>,
    /// Use of every recorded channel.
    pub channels: Vec<Channel>,
    /// Choice of the estimator of each quantity, a line each: over what, by which errors.
    pub choices: Vec<String>,
}

/// One fitted part.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Name, such as `s0` or `net 16-16-3`.
    pub name: String,
    /// Number of rows of the recordings before thinning.
    pub rows: usize,
    /// Number of rows left out: saturated, dead or faulty channels, and outliers.
    pub left_out: usize,
    /// Condition number of a sensor's signals.
    pub condition: Option<f64>,
    /// Choice of the model, if it was chosen.
    pub chosen: Option<Chosen>,
    /// Number of a net's parameters that the data determine.
    pub effective: Option<f64>,
    /// RMS error for each reference component, newtons.
    pub residual: Vec<f64>,
    /// Whether that is the error on rows left out of the fit; otherwise that of the fit.
    pub held_out: bool,
}

/// Fits every part that the recordings determine. When `stop` becomes true the best so far is
/// returned.
///
/// # Errors
///
/// Data that the recordings lack, and how to provide them.
pub fn fit(
    all: &[Recording],
    options: &FitOptions,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Fitted, FitError> {
    fit_keeping(all, options, progress, &mut |_| {}, stop)
}

/// Fits as [`fit`], and gives `keep` a valid calibration after each stage that adds to it.
///
/// # Errors
///
/// As [`fit`].
pub fn fit_keeping(
    all: &[Recording],
    options: &FitOptions,
    progress: &mut dyn FnMut(Progress),
    keep: &mut dyn FnMut(&Fitted),
    stop: &AtomicBool,
) -> Result<Fitted, FitError> {
    let mut stage = |part: &str| {
        progress(Progress { part: part.into(), step: 0, of: 1, error: 0.0 });
    };
    stage("signals and clocks");
    if all.is_empty() {
        return Err(FitError::NoRecording);
    }
    if let Subject::Sensor(sensor) = options.subject
        && sensor >= SENSORS
    {
        let problem = format!("a finger has sensors s0 … s{}", SENSORS - 1);
        return Err(FitError::Shape { part: format!("s{sensor}"), problem });
    }
    let warmth = warmth::fit(all);
    let warnings = all.iter().filter(|r| warmth.is_none() && warmth::is_warm_up(r)).map(|r| {
        format!(
            "{}: left out, because the recordings with loads lack the thermometer column (aux_temp)",
            r.name
        )
    });
    let mut warnings: Vec<String> = warnings.collect();
    let prepared = all
        .iter()
        .filter(|recording| !warmth::is_warm_up(recording))
        .map(|recording| Prepared::new(recording, warmth.as_ref()));
    let (mut recordings, off): (Vec<Prepared<'_>>, Vec<Option<String>>) =
        prepared.collect::<Result<Vec<_>, _>>()?.into_iter().unzip();
    warnings.extend(off.into_iter().flatten());
    if recordings.is_empty() {
        return Err(FitError::NoLoad { part: "finger".into() });
    }
    let subjects: Vec<Subject> = recordings
        .iter()
        .map(|recording| match options.subject {
            Subject::Found => recording.subject(),
            subject => subject,
        })
        .collect();
    let mut compensation = Calibration { warmth, ..Calibration::default() };
    let lit = recordings.iter().any(|recording| recording.bias.taxels.is_some());
    if !options.net_only {
        if lit {
            compensation.drift = Some(DriftCompensation { most: MOST_DRIFT });
            recordings.iter_mut().for_each(|recording| recording.compensate(&compensation));
        }
        if !options.clock_hides_lag {
            compensation.lag = lag::fit(&recordings, &subjects);
        }
        if compensation.lag.is_some() {
            recordings.iter_mut().for_each(|recording| recording.compensate(&compensation));
        }
    }
    let told = compensation.lag.map(lag::told);
    let late = compensation.lag.unwrap_or_default();
    let by_sensors = lag::followed(&recordings, late.sensors);
    let mut fitted = Fitted {
        calibration: Calibration {
            serial: options.serial.clone(),
            date: options.date,
            ..compensation
        },
        warnings,
        parts: Vec::new(),
        channels: Vec::new(),
        choices: told.into_iter().collect(),
    };
    stage("force sensors");
    for sensor in 0..SENSORS {
        sensors::fit(&mut fitted, sensor, &by_sensors, &subjects)?;
    }
    let own = fitted.calibration.sensors.clone();
    let mut reasons = sensors::array(&mut fitted, &by_sensors, &subjects, options.net_only);
    drop(by_sensors);
    let by_taxels = lag::followed(&recordings, late.taxels);
    if !fitted.parts.is_empty() && fitted.calibration.validate().is_ok() {
        keep(&fitted);
    }
    let fingers: Vec<&Prepared<'_>> = by_taxels
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
        stage("outliers and signs");
        let loads = net::loads(&mut fitted, &fingers, options)?;
        let skin = !options.net_only || options.family == Family::Auto;
        let noise = skin
            .then(|| matrix::noise_of_reference(&mut fitted, &fingers, options.reference_noise));
        let array = fitted.calibration.array.is_some();
        let (skin, trained) = models((&fingers, noise), (&loads, array), options, progress, stop)?;
        match net::keep(&mut fitted, loads, trained, skin.as_ref()) {
            // Stopped before the net's first step: what was fitted before is kept.
            Err(FitError::Stopped) if !fitted.parts.is_empty() => {}
            kept => kept?,
        }
        if let Some(skin) = skin.filter(|_| !options.net_only) {
            matrix::keep_skin(&mut fitted, skin);
        }
    }
    if fitted.calibration.array.is_some()
        && fitted.calibration.taxels.is_some()
        && reasons.iter().any(Option::is_some)
    {
        let helped = choice::Helped::of(&fitted.calibration, &fingers);
        fitted.choices.push(helped.told());
        if !helped.keeps() {
            (fitted.calibration.array, fitted.calibration.sensors) = (None, own);
            fitted.parts.retain(|part| !part.name.starts_with("array"));
            for reason in &mut reasons {
                reason
                    .get_or_insert_with(|| "the force is better from the matrix alone".to_owned());
            }
        }
    }
    if options.form == Form::Q15 {
        matrix::quantised(&mut fitted, &fingers, options.net_only)?;
    }
    let read = recordings.iter().map(|prepared| &*prepared.recording);
    fitted.warnings.extend(shear::of_finger(&fitted.calibration, read));
    fitted.calibration.validate().map_err(FitError::Record)?;
    fitted.channels = channels::channels(&fitted, all, &reasons);
    Ok(fitted)
}

/// Fits the model of the skin and trains the net, both at once unless the one decides on the other.
///
/// Without the noise of the reference there is no model of the skin. With one, or an `array`, beside
/// it the usual net suffices.
fn models(
    (fingers, noise): (&[&Prepared<'_>], Option<[f64; 3]>),
    (loads, array): (&net::Loads, bool),
    options: &FitOptions,
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<(Option<Skin>, Result<net::Trained, FitError>), FitError> {
    let auto = options.family == Family::Auto;
    let skin = |progress: &mut dyn FnMut(Progress)| match noise {
        Some(noise) => matrix::skin(fingers, (&loads.wrong, noise), progress, stop),
        None => Ok(None),
    };
    let usual = FitOptions { family: Family::Mlp, ..options.clone() };
    let beside = |better: bool| if auto && better && !options.net_only { &usual } else { options };
    if auto && !array {
        let skin = skin(&mut *progress)?;
        let options = beside(skin.is_some());
        let trained = net::train(loads, (options, skin.as_ref()), progress, stop);
        return Ok((skin, trained));
    }
    thread::scope(|scope| {
        let (send, receive) = mpsc::channel();
        let net = scope.spawn(move || {
            let mut tell = |progress| drop(send.send(progress));
            net::train(loads, (beside(array), None), &mut tell, stop)
        });
        let skin = skin(&mut *progress);
        // Ends with the net's thread.
        receive.into_iter().for_each(progress);
        let trained = net.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok((skin?, trained))
    })
}

fn warn_of_stuck(fitted: &mut Fitted, prepared: &Prepared<'_>, columns: &[String]) {
    if !columns.is_empty() {
        fitted.warnings.push(format!(
            "{}: {} the same in every row; look for a channel that is not connected",
            prepared.recording.name,
            match columns {
                [only] => format!("{only} reads"),
                _ => format!("{} read", columns.join(", ")),
            }
        ));
    }
}

/// Returns all three components, if all are known.
fn known(force: [Option<f64>; 3]) -> Option<[f64; 3]> {
    let [x, y, z] = force;
    Some([x?, y?, z?])
}

//! Fit of one force sensor: S and b of f = S(u − b), by least squares.
//!
//! [Ospina2017] eqs (1.22)–(1.24).

use taxel::calibration::SensorCalibration;
use taxel::estimate::sensitivity::Sensitivity;

use super::{Fitted, Part, known, warn_of_stuck};
use crate::prepared::Prepared;
use taxel_regress::error::FitError;
use taxel_regress::least_squares;
use taxel_regress::outliers::{Outliers, keep_sound};
use taxel_regress::range::trained_range;
use taxel_regress::shear::{FORCES, NO_SHEAR};
use taxel_regress::sign_check;
use taxel_regress::training::Recorded;

/// Signal-to-noise ratio of S's weakest direction below which the fit warns.
///
/// At this ratio noise changes S by 1/20², 0.25 %.
const WEAK: f64 = 20.0;

/// Condition number of a sensor's signals above which the fit warns.
///
/// Errors of the reference may grow by this factor in the least-loaded direction. Loads as in
/// [Ospina2017] (±0.35 N, 0–1 N) have about 5.
const EVEN: f64 = 20.0;

/// Fits a sensor to the recordings that load it; those with `true` load nothing else.
pub(super) fn fit(
    fitted: &mut Fitted,
    sensor: usize,
    recordings: &[(&Prepared<'_>, bool)],
) -> Result<(), FitError> {
    let name = format!("s{sensor}");
    let (mut signals, mut forces, mut left_out) = (Vec::new(), Vec::new(), 0);
    let (mut first_bias, mut each) = (None, Vec::new());
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
        warn_of_stuck(fitted, recording, &recording.stuck_midpoints(sensor));
        let before = signals.len();
        for (sample, signal) in recording.recording.samples.iter().zip(&recording.signals) {
            let truth = known(sample.truth.sensors[sensor])
                .or_else(|| bench.then(|| known(sample.truth.force)).flatten());
            let (Some(force), Some(u)) = (truth, signal.bridges[sensor]) else { continue };
            if signal.health.bridge_faults >> sensor & 1 == 1 {
                left_out += 1;
                continue;
            }
            signals.push(u.map(f64::from));
            forces.push(force);
        }
        each.push(recorded(&signals[before..], &forces[before..]));
        if signals.is_empty() && left_out == 0 {
            return Err(missing(
                "reference columns fx_n, fy_n, fz_n".into(),
                "record a three-axis reference along with the sensor, or give one with --reference",
            ));
        }
    }
    let Some(bias) = first_bias else { return Err(FitError::NoRecording) };
    let names: Vec<String> = recordings.iter().map(|(r, _)| r.recording.name.clone()).collect();
    sign_check::same_sign(&each, &names, &FORCES.map(String::from))?;
    let outliers = Outliers::find(&each, &names, None)?;
    let found = signals.len();
    keep_sound(&mut signals, outliers.wrong.iter().flatten());
    keep_sound(&mut forces, outliers.wrong.iter().flatten());
    left_out += found - signals.len();
    fitted.warnings.extend(outliers.told);
    let fit = least_squares::fit(&name, &signals, &forces, f64::from(bias.noise))
        .map_err(|error| never_loaded(&name, &forces).unwrap_or(error))?;
    if fit.ratio < WEAK {
        fitted.warnings.push(format!(
            "{name}: in one direction the signals stand only {:.0} times out of their noise; load it \
             more evenly in x, y and z for a surer matrix",
            fit.ratio
        ));
    }
    if fit.condition > EVEN {
        fitted.warnings.push(format!(
            "{name}: condition number {:.0} of the signals: errors of the reference grow by as much in the \
             direction that was loaded least; load it more evenly in x, y and z",
            fit.condition
        ));
    }
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        if fit.s[k][k] < 0.0 {
            fitted.warnings.push(format!(
                "{name}: f_{axis} falls as u_{axis} rises: look at the reference's sign (a force into the skin is \
                 positive)"
            ));
        }
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
        left_out,
        condition: Some(fit.condition),
        chosen: None,
        effective: None,
        residual: fit.rms.to_vec(),
        held_out: false,
    });
    Ok(())
}

/// Error with the names of the unloaded axes; `None` if every axis is loaded, or none is.
fn never_loaded(part: &str, forces: &[[f64; 3]]) -> Option<FitError> {
    let largest = |axis: usize| forces.iter().fold(0.0, |most: f64, f| most.max(f[axis].abs()));
    let largest = [0, 1, 2].map(largest);
    let least = NO_SHEAR * largest.iter().copied().fold(0.0, f64::max);
    let resting: Vec<&str> = (0..3).filter(|k| largest[*k] < least).map(|k| FORCES[k]).collect();
    (!resting.is_empty())
        .then(|| FitError::NeverLoaded { part: part.into(), columns: resting.join(", ") })
}

fn recorded(signals: &[[f64; 3]], forces: &[[f64; 3]]) -> Recorded {
    let lists = |rows: &[[f64; 3]]| rows.iter().map(|row| row.to_vec()).collect();
    (lists(signals), lists(forces))
}

//! Fit of the force sensors: each one's matrix, and the array of all that respond to the finger's loads.

use super::matrix::slip;
use super::{Fitted, Part, Subject, bench, channels, known};
use crate::prepared::{Loads, Prepared};
use taxel_regress::error::FitError;

/// Reason for leaving out the array where only the normal force is known.
///
/// The record's array gives three components or none, so that its shear would read 0 N.
const NORMAL_ALONE: &str = "the reference has no fx_n and fy_n, without which force sensors would give a \
     shear of 0 N: log a load cell of three axes";

/// Fits S of a sensor to the recordings with a known force on it.
///
/// A sensor that recordings of the finger do not determine is left out with a warning.
pub(super) fn fit(
    fitted: &mut Fitted,
    sensor: usize,
    recordings: &[Prepared<'_>],
    subjects: &[Subject],
) -> Result<(), FitError> {
    let (mut own, mut unfit) = (Vec::new(), Vec::new());
    for (recording, subject) in recordings.iter().zip(subjects) {
        match (*subject, recording.loads(sensor)) {
            (Subject::Sensor(of), _) if of == sensor => own.push((recording, true)),
            (Subject::Finger, Loads::Known) => own.push((recording, false)),
            (Subject::Finger, Loads::Unfit(why)) => unfit.push(why),
            // A bench recording does not load the other sensors.
            _ => {}
        }
    }
    let not_fitted = |why: &str| format!("s{sensor}: its matrix S was not fitted: {why}");
    if own.is_empty() {
        if !unfit.is_empty() {
            fitted.warnings.push(not_fitted(&unfit.join("; ")));
        }
        return Ok(());
    }
    let bench = own.iter().any(|(_, bench)| *bench);
    match bench::fit(fitted, sensor, &own) {
        Err(why) if !bench => {
            fitted.warnings.push(not_fitted(&why.to_string()));
            Ok(())
        }
        fit => fit,
    }
}

/// Fits the array of all force sensors that respond to the finger's loads.
///
/// Returns the reason for each sensor that is left out.
pub(super) fn array(
    fitted: &mut Fitted,
    recordings: &[Prepared<'_>],
    subjects: &[Subject],
    net_only: bool,
) -> channels::Reasons {
    let fingers: Vec<&Prepared<'_>> = recordings
        .iter()
        .zip(subjects)
        .filter(|(recording, subject)| {
            let known = |s: &taxel_files::trace::Sample| known(s.truth.force).is_some();
            **subject == Subject::Finger && recording.recording.samples.iter().any(known)
        })
        .map(|(recording, _)| recording)
        .collect();
    let mut of_fingers = recordings.iter().zip(subjects).filter(|(_, s)| **s == Subject::Finger);
    let normal = of_fingers.any(|(recording, _)| {
        recording.recording.samples.iter().any(|s| s.truth.force[2].is_some())
    });
    let mut reasons: channels::Reasons = std::array::from_fn(|i| {
        let why = if net_only {
            "--net-only was given"
        } else if fingers.is_empty() && normal {
            NORMAL_ALONE
        } else if fingers.is_empty() {
            "no recording of the finger has all of fx_n, fy_n, fz_n"
        } else if fingers.iter().any(|r| r.bias.bridges[i].is_none()) {
            "a recording of the finger lacks its channels"
        } else if !fingers.iter().any(|r| r.responds(i)) {
            "it does not respond to the loads: look at its connection"
        } else {
            return None;
        };
        Some(why.to_owned())
    });
    let live = reasons.each_ref().map(Option::is_none);
    if !live.contains(&true) {
        return reasons;
    }
    let Some(array) = crate::array::fit(&fingers, live, &fitted.calibration.sensors) else {
        let few = "too few loaded rows with sound bridges";
        reasons.iter_mut().for_each(|reason| {
            reason.get_or_insert_with(|| few.to_owned());
        });
        return reasons;
    };
    fitted.warnings.extend(array.turned);
    fitted.parts.push(Part {
        name: array.name,
        rows: array.rows,
        left_out: 0,
        condition: None,
        chosen: None,
        effective: None,
        residual: array.held_out.map(f64::from).to_vec(),
        held_out: true,
    });
    for (sensor, of_total) in fitted.calibration.sensors.iter_mut().zip(array.sensors) {
        *sensor = sensor.take().or(of_total);
    }
    fitted.calibration.array = Some(array.array);
    fitted.calibration.slip.get_or_insert_with(|| slip(None));
    reasons
}

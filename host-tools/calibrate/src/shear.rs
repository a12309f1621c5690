//! Warnings about the shear in a finger's recordings.

use taxel::calibration::Calibration;
use taxel_regress::shear::of_forces;

use crate::recording::Recording;

/// Warnings about the forces of a calibration's fit, in full sentences.
///
/// Empty if the calibration estimates no shear.
pub fn of_finger<'r>(
    calibration: &Calibration,
    recordings: impl IntoIterator<Item = &'r Recording>,
) -> Vec<String> {
    let three = calibration.net.as_ref().is_some_and(|net| net.outputs() == 3)
        || calibration.sensors.iter().any(Option::is_some);
    let rows = recordings.into_iter().flat_map(|recording| &recording.samples);
    if three { of_forces(rows.map(|sample| sample.truth.force)) } else { Vec::new() }
}

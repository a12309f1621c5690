//! Output while nothing touches the finger (most scans): zero forces, and reasons.
//!
//! No estimator runs, and no estimate is built only to be dropped.

use super::fusion::no_array;
use super::{Estimate, SensorForces, missing};
use crate::calibration::Calibration;
use crate::condition::{Health, Signals};
use crate::estimate::Force;
use crate::measured::{Measured, NoValue};
use crate::scan::Codes;
use crate::units::Newtons;

/// Capabilities of the matrix, or of the force sensors together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Capability {
    /// Whether it can estimate both shear components, and the normal force.
    shear: Measured<()>,
    normal: Measured<()>,
    /// Reason for its missing contact point.
    place: NoValue,
}

impl Capability {
    const fn nothing(reason: NoValue) -> Self {
        Self { shear: Err(reason), normal: Err(reason), place: reason }
    }

    fn optical(record: Option<&Calibration>, signals: &Signals, codes: &Codes) -> Self {
        if signals.taxels.is_none() {
            return Self::nothing(missing(codes.taxels.is_some()));
        }
        let net = record.and_then(|record| record.net.as_ref()).map(|net| net.outputs() == 3);
        let sheared = record.and_then(Calibration::model).map(|model| model.shear);
        if net.is_none() && sheared.is_none() {
            return Self { place: NoValue::NoContact, ..Self::nothing(NoValue::Uncalibrated) };
        }
        // A force that cannot be measured is not reported as zero either.
        if let Some(reason) = faulty(&signals.health) {
            return Self { place: NoValue::NoContact, ..Self::nothing(reason) };
        }
        let shear = net == Some(true) || sheared == Some(true);
        let shear = if shear { Ok(()) } else { Err(NoValue::NotEstimated) };
        Self { shear, normal: Ok(()), place: NoValue::NoContact }
    }

    fn array(record: Option<&Calibration>, signals: &Signals, sensors: &SensorForces) -> Self {
        if record.and_then(Calibration::array).is_none() {
            return Self::nothing(no_array(signals));
        }
        match sensors {
            Err(reason) => Self::nothing(*reason),
            Ok(_) => Self { shear: Ok(()), normal: Ok(()), place: NoValue::NoContact },
        }
    }
}

/// Returns the reason why the matrix gives no force if one of its taxels is faulty.
pub(super) fn faulty(health: &Health) -> Option<NoValue> {
    if health.dead != 0 {
        Some(NoValue::DeadChannel)
    } else if health.saturated != 0 {
        Some(NoValue::Saturated)
    } else {
        None
    }
}

/// Writes the estimates of an untouched finger. Signals and sensors must be those of this scan.
#[inline(never)]
pub(super) fn no_contact(
    record: Option<&Calibration>,
    codes: &Codes,
    sensors: &SensorForces,
    no_slip: Option<NoValue>,
    estimate: &mut Estimate,
) {
    let optical = Capability::optical(record, &estimate.signals, codes);
    let array = Capability::array(record, &estimate.signals, sensors);
    let shear = none(optical.shear, array.shear);
    estimate.force = Force { x: shear, y: shear, z: none(optical.normal, array.normal) };
    estimate.point =
        Err(if optical.place == NoValue::Absent { array.place } else { optical.place });
    estimate.slip = Err(no_slip.unwrap_or(NoValue::NoContact));
    estimate.torsion = Err(array.place);
    estimate.contacts = Err(optical.place);
    estimate.uncertainty = Err(NoValue::NoContact);
}

/// Returns zero if one of the parts can measure it. If both lack it, the reason comes from the part
/// that this finger has.
fn none(optical: Measured<()>, array: Measured<()>) -> Measured<Newtons> {
    match (optical, array) {
        (Ok(()), _) | (_, Ok(())) => Ok(Newtons(0.0)),
        (Err(NoValue::Absent), Err(reason)) | (Err(reason), Err(_)) => Err(reason),
    }
}

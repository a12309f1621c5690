//! Fusion of optical matrix and sensor array: one force and one contact position.

use super::SensorForces;
use super::matrix::OpticalEstimate;
use crate::calibration::Calibration;
use crate::condition::Signals;
use crate::estimate::fusion::{Gaussian, fuse};
use crate::estimate::{ContactPoint, Force, Uncertainty};
use crate::finger::Estimate;
use crate::frame::{Fields, Status};
use crate::measured::{Measured, NoValue};
use crate::units::{Millimetres, NewtonMillimetres, Newtons};

/// Relative uncertainty of the force sensors' sensitivities, in addition to calibration's residual.
const GAIN_ERROR: f32 = 0.005;

/// Estimate of the force sensors together, as one array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ArrayEstimate {
    pub force: Measured<[Gaussian; 3]>,
    pub point: Measured<[Gaussian; 2]>,
    pub torsion: Measured<NewtonMillimetres>,
}

impl ArrayEstimate {
    const fn nothing(reason: NoValue) -> Self {
        Self { force: Err(reason), point: Err(reason), torsion: Err(reason) }
    }

    /// Estimates from the forces on the calibrated sensors; none if any of them has no force.
    pub(super) fn of(
        record: Option<&Calibration>,
        signals: &Signals,
        sensors: &SensorForces,
        status: &mut Status,
    ) -> Self {
        let Some(array) = record.and_then(Calibration::array) else {
            return Self::nothing(no_array(signals));
        };
        let forces = match sensors {
            Ok(forces) => forces,
            Err(reason) => return Self::nothing(*reason),
        };
        status.insert(Status::RAN_ARRAY);
        let wrench = array.wrench(&signals.bridges, forces);
        let ([x, y, z], [sx, sy, sz]) = (wrench.force, array.residual);
        let of = |value: f32, sigma| Gaussian { value, sigma: sigma + GAIN_ERROR * value.abs() };
        // A record of huge matrices may overflow: a value that is not finite is no force.
        let finite = x.abs() + y.abs() + z.abs() < f32::MAX;
        let force = if finite {
            Ok([of(x, sx), of(y, sy), of(z, sz)])
        } else {
            Err(NoValue::IllConditioned)
        };
        let contact = array.contact(&wrench);
        Self {
            force,
            point: contact.map(|(contact, sigma)| {
                let [x, y, _] = contact.place;
                [x, y].map(|value| Gaussian { value, sigma })
            }),
            torsion: contact.map(|(contact, _)| contact.torsion),
        }
    }
}

/// Returns the reason for a missing array estimate if the record has no array.
pub(super) fn no_array(signals: &Signals) -> NoValue {
    let absent = signals.bridges.iter().all(Option::is_none);
    if absent { NoValue::Absent } else { without(cfg!(feature = "array")) }
}

/// Returns the reason for a missing estimate if the record has no section for its estimator.
pub(super) const fn without(built: bool) -> NoValue {
    if built { NoValue::Uncalibrated } else { NoValue::NotEstimated }
}

/// Force and contact point, fused from matrix and array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fused {
    pub force: [Measured<Gaussian>; 3],
    pub point: Measured<[Gaussian; 2]>,
}

impl Fused {
    /// Weighs both by their uncertainties. If one is missing, the result is the other; if both are,
    /// the reason comes from the part that this finger has.
    pub(super) fn of(
        optical: &OpticalEstimate,
        array: &ArrayEstimate,
        status: &mut Status,
    ) -> Self {
        let mut fused = Self { force: optical.force, point: optical.point };
        let mut agree = true;
        let mut join = |optical: &mut Gaussian, array: &Gaussian| {
            let alike;
            (*optical, alike) = fuse(*optical, *array);
            agree &= alike;
        };
        match &array.force {
            Ok(array) => fused.force.iter_mut().zip(array).for_each(|(force, array)| match force {
                Ok(force) => join(force, array),
                Err(_) => *force = Ok(*array),
            }),
            Err(reason) => fused.force.iter_mut().for_each(|force| or_reason(force, *reason)),
        }
        match (&mut fused.point, &array.point) {
            (Ok(point), Ok(array)) => {
                point.iter_mut().zip(array).for_each(|(point, array)| join(point, array));
            }
            (point @ Err(_), Ok(array)) => *point = Ok(*array),
            (point, Err(reason)) => or_reason(point, *reason),
        }
        if !agree {
            status.insert(Status::DISAGREE);
        }
        fused
    }

    /// Writes force and point, and their standard deviations with the `misfit` of the skin model if
    /// they are among the `fields`.
    pub(super) fn write(&self, estimate: &mut Estimate, misfit: Measured<f32>, fields: Fields) {
        let value = |of: &Gaussian| of.value;
        (estimate.force, estimate.point) = (self.components(value), self.place(value));
        if fields.contains(Fields::UNCERTAINTY) {
            let sigma = |of: &Gaussian| of.sigma;
            let (force, point) = (self.components(sigma), self.place(sigma));
            estimate.uncertainty = Ok(Uncertainty { force, point, misfit });
        }
    }

    #[inline(always)]
    fn components(&self, of: impl Fn(&Gaussian) -> f32) -> Force {
        let [x, y, z] = self.force.each_ref().map(|force| match force {
            Ok(force) => Ok(Newtons(of(force))),
            Err(reason) => Err(*reason),
        });
        Force { x, y, z }
    }

    #[inline(always)]
    fn place(&self, of: impl Fn(&Gaussian) -> f32) -> Measured<ContactPoint> {
        match &self.point {
            Ok([x, y]) => Ok(ContactPoint { x: Millimetres(of(x)), y: Millimetres(of(y)) }),
            Err(reason) => Err(*reason),
        }
    }
}

/// Replaces the reason of a part that this finger lacks.
fn or_reason<T>(optical: &mut Measured<T>, reason: NoValue) {
    if matches!(optical, Err(NoValue::Absent)) {
        *optical = Err(reason);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_estimate_is_replaced_by_the_other() {
        let one = Gaussian { value: 1.0, sigma: 0.01 };
        let fused = |optical: Measured<Gaussian>, array: Measured<Gaussian>| {
            let nothing = OpticalEstimate::nothing(NoValue::NotEstimated);
            let point = optical.map(|of| [of; 2]);
            let optical = OpticalEstimate { force: [optical; 3], point, ..nothing };
            let (force, point) = (array.map(|of| [of; 3]), array.map(|of| [of; 2]));
            let array = ArrayEstimate { force, point, torsion: Err(NoValue::NotEstimated) };
            let fused = Fused::of(&optical, &array, &mut Status::default());
            assert!(fused.force.iter().all(|force| *force == fused.force[0]));
            assert_eq!(fused.point, fused.force[0].map(|of| [of; 2]));
            fused.force[0]
        };
        assert_eq!(fused(Ok(one), Err(NoValue::DeadChannel)), Ok(one));
        assert_eq!(fused(Err(NoValue::Saturated), Ok(one)), Ok(one));
        let neither = |optical, array| fused(Err(optical), Err(array));
        assert_eq!(neither(NoValue::Saturated, NoValue::Absent), Err(NoValue::Saturated));
        assert_eq!(neither(NoValue::Absent, NoValue::DeadChannel), Err(NoValue::DeadChannel));
    }
}

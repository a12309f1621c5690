//! Fusion of optical matrix and sensor array: one force and one contact position.

use super::matrix::OpticalEstimate;
use crate::calibration::Calibration;
use crate::condition::Signals;
use crate::estimate::array::Array;
use crate::estimate::fusion::{Uncertain, fuse};
use crate::estimate::{ContactPoint, Force, Uncertainty};
use crate::frame::Status;
use crate::measured::{Measured, NoValue};
use crate::scan::SENSORS;
use crate::units::{Millimetres, NewtonMillimetres, Newtons};

/// Relative uncertainty of the force sensors' sensitivities, in addition to calibration's residual.
const GAIN_ERROR: f32 = 0.005;

/// Estimate of the force sensors together, as one array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ArrayEstimate {
    pub force: [Measured<Uncertain>; 3],
    pub point: Measured<[Uncertain; 2]>,
    pub torsion: Measured<NewtonMillimetres>,
}

impl ArrayEstimate {
    const fn nothing(reason: NoValue) -> Self {
        Self { force: [Err(reason); 3], point: Err(reason), torsion: Err(reason) }
    }

    /// Estimates from the forces on the calibrated sensors; none if any of them has no force.
    pub(super) fn of(
        record: Option<&Calibration>,
        signals: &Signals,
        sensors: &[Force; SENSORS],
        status: &mut Status,
    ) -> Self {
        let Some((record, array)) = record.and_then(|r| Some((r, r.array()?))) else {
            return Self::nothing(no_array(signals));
        };
        match newtons(record, sensors) {
            Err(reason) => Self::nothing(reason),
            Ok(forces) => {
                status.insert(Status::RAN_ARRAY);
                Self::under(array, signals, &forces)
            }
        }
    }

    fn under(array: &Array, signals: &Signals, forces: &[[f32; 3]; SENSORS]) -> Self {
        let u = signals.bridges.map(Option::unwrap_or_default);
        let wrench = array.wrench(&u, forces);
        let contact = array.contact(&wrench);
        let [x, y, z] = wrench.force;
        let [sx, sy, sz] = array.residual;
        let of = |value: f32, sigma: f32| {
            let gain = GAIN_ERROR * value.abs();
            // A record of huge matrices may overflow: a value that is not finite is no force.
            if value.abs() < f32::MAX {
                Ok(Uncertain { value, sigma: sigma + gain })
            } else {
                Err(NoValue::IllConditioned)
            }
        };
        Self {
            force: [of(x, sx), of(y, sy), of(z, sz)],
            point: contact.map(|(contact, sigma)| {
                let [x, y, _] = contact.place;
                [x, y].map(|value| Uncertain { value, sigma })
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

/// Returns every calibrated sensor's force in newtons, or the first reason for a missing one. A
/// sensor without calibration has no part in the array.
fn newtons(record: &Calibration, sensors: &[Force; SENSORS]) -> Measured<[[f32; 3]; SENSORS]> {
    let mut forces = [[0.0; 3]; SENSORS];
    for ((newtons, force), own) in forces.iter_mut().zip(sensors).zip(&record.sensors) {
        if own.is_some() {
            *newtons = [force.x?.0, force.y?.0, force.z?.0];
        }
    }
    Ok(forces)
}

/// Force and contact point, fused from matrix and array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fused {
    pub force: Force,
    pub point: Measured<ContactPoint>,
    /// Standard deviations of `force`, in newtons, and of `point`, in millimetres.
    pub(super) force_sigma: Force,
    pub(super) point_sigma: Measured<ContactPoint>,
}

impl Fused {
    pub(super) fn of(
        optical: &OpticalEstimate,
        array: &ArrayEstimate,
        status: &mut Status,
    ) -> Self {
        let mut fuse_into =
            |optical: &mut _, array: &_| *optical = fuse_or_fallback(*optical, *array, status);
        let mut force = optical.force;
        force.iter_mut().zip(&array.force).for_each(|(optical, array)| fuse_into(optical, array));
        let [mut place, along] = [axes(&optical.point), axes(&array.point)];
        place.iter_mut().zip(&along).for_each(|(optical, array)| fuse_into(optical, array));
        let value = |of: Uncertain| of.value;
        let sigma = |of: Uncertain| of.sigma;
        Self {
            force: components(&force, value),
            point: point(&place, value),
            force_sigma: components(&force, sigma),
            point_sigma: point(&place, sigma),
        }
    }

    /// Returns the standard deviations together with the misfit of the skin model.
    pub(super) fn uncertainty(&self, misfit: Measured<f32>) -> Uncertainty {
        Uncertainty { force: self.force_sigma, point: self.point_sigma, misfit }
    }

    /// Returns the larger standard deviation of the two shear components, in newtons.
    pub(super) fn shear_sigma(&self) -> f32 {
        let Force { x, y, .. } = self.force_sigma;
        [x, y].into_iter().flatten().fold(0.0, |most, sigma| most.max(sigma.0))
    }
}

/// Fuses both estimates; returns the matrix's own if the array has none.
#[inline(always)]
fn fuse_or_fallback(
    optical: Measured<Uncertain>,
    array: Measured<Uncertain>,
    status: &mut Status,
) -> Measured<Uncertain> {
    if array.is_ok() || optical == Err(NoValue::Absent) {
        fuse_measured(optical, array, status)
    } else {
        optical
    }
}

#[inline(never)]
fn fuse_measured(
    optical: Measured<Uncertain>,
    array: Measured<Uncertain>,
    status: &mut Status,
) -> Measured<Uncertain> {
    match (optical, array) {
        (Ok(one), Ok(other)) => {
            let (one, agree) = fuse(one, other);
            if !agree {
                status.insert(Status::DISAGREE);
            }
            Ok(one)
        }
        // If both are missing, the reason comes from the part that this finger has.
        (Err(_), Ok(_)) | (Err(NoValue::Absent), Err(_)) => array,
        (_, Err(_)) => optical,
    }
}

#[inline(always)]
fn components(force: &[Measured<Uncertain>; 3], of: impl Fn(Uncertain) -> f32) -> Force {
    let [x, y, z] = force.map(|force| force.map(|force| Newtons(of(force))));
    Force { x, y, z }
}

#[inline(always)]
fn point(
    place: &[Measured<Uncertain>; 2],
    of: impl Fn(Uncertain) -> f32,
) -> Measured<ContactPoint> {
    let [x, y] = place.map(|along| along.map(|along| Millimetres(of(along))));
    x.and_then(|x| y.map(|y| ContactPoint { x, y }))
}

fn axes(point: &Measured<[Uncertain; 2]>) -> [Measured<Uncertain>; 2] {
    match point {
        Ok(point) => point.map(Ok),
        Err(reason) => [Err(*reason); 2],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_estimate_is_replaced_by_the_other() {
        let one = Ok(Uncertain { value: 1.0, sigma: 0.01 });
        let fused = |optical, array| fuse_or_fallback(optical, array, &mut Status::default());
        assert_eq!(fused(one, Err(NoValue::DeadChannel)), one);
        assert_eq!(fused(Err(NoValue::Saturated), one), one);
        let neither = |optical, array| fused(Err(optical), Err(array));
        assert_eq!(neither(NoValue::Saturated, NoValue::Absent), Err(NoValue::Saturated));
        assert_eq!(neither(NoValue::Absent, NoValue::DeadChannel), Err(NoValue::DeadChannel));
    }
}

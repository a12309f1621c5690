//! Matrix and array together: what each is sure of, one force and one place of it; and whether it slips.

use super::matrix::Seen;
use crate::calibration::Calibration;
use crate::condition::Signals;
use crate::estimate::array::Array;
use crate::estimate::fusion::{Uncertain, fuse};
use crate::estimate::slide::SlideState;
use crate::estimate::slip::{Slip, SlipState, Traction, Verdict};
use crate::estimate::vibration::Listener;
use crate::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use crate::frame::Status;
use crate::measured::{Measured, NoValue};
use crate::roots::sqrt;
use crate::scan::SENSORS;
use crate::units::{Micros, Millimetres, NewtonMillimetres, Newtons};

/// Sensitivities of the force sensors are known to this share, however small calibration's residual.
const GAIN_ERROR: f32 = 0.005;

/// Torsion below this many standard deviations of a moment is none.
const TORSION_DOUBT: f32 = 3.0;

/// What the array of force sensors feels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Felt {
    pub force: [Measured<Uncertain>; 3],
    pub point: Measured<[Uncertain; 2]>,
    pub torsion: Measured<NewtonMillimetres>,
}

impl Felt {
    const fn nothing(reason: NoValue) -> Self {
        Self { force: [Err(reason); 3], point: Err(reason), torsion: Err(reason) }
    }

    /// The array under the forces on its sensors. Where one of them has none, none is felt.
    pub(super) fn of(
        record: Option<&Calibration>,
        signals: &Signals,
        sensors: &[Force; SENSORS],
        status: &mut Status,
    ) -> Self {
        let Some(array) = record.and_then(Calibration::array) else {
            return Self::nothing(unfelt(signals));
        };
        match newtons(sensors) {
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
            // A record of huge matrices may overflow; what is not finite is no force.
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

/// Why nothing is felt where the record has no array.
pub(super) fn unfelt(signals: &Signals) -> NoValue {
    let absent = signals.bridges.iter().all(Option::is_none);
    if absent { NoValue::Absent } else { without(cfg!(feature = "array")) }
}

/// Why there is nothing from an estimator for which the record holds nothing.
const fn without(built: bool) -> NoValue {
    if built { NoValue::Uncalibrated } else { NoValue::NotEstimated }
}

/// Every sensor's force in newtons, or why one has none.
fn newtons(sensors: &[Force; SENSORS]) -> Measured<[[f32; 3]; SENSORS]> {
    let mut forces = [[0.0; 3]; SENSORS];
    for (newtons, force) in forces.iter_mut().zip(sensors) {
        *newtons = [force.x?.0, force.y?.0, force.z?.0];
    }
    Ok(forces)
}

/// Force and point out of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fused {
    pub force: Force,
    pub point: Measured<ContactPoint>,
    /// Standard deviations of both.
    force_sigma: Force,
    point_sigma: Measured<ContactPoint>,
}

impl Fused {
    pub(super) fn of(seen: &Seen, felt: &Felt, status: &mut Status) -> Self {
        let mut join = |seen: &mut _, felt: &_| *seen = join(*seen, *felt, status);
        let mut force = seen.force;
        force.iter_mut().zip(&felt.force).for_each(|(seen, felt)| join(seen, felt));
        let [mut place, along] = [axes(&seen.point), axes(&felt.point)];
        place.iter_mut().zip(&along).for_each(|(seen, felt)| join(seen, felt));
        let value = |of: Uncertain| of.value;
        let sigma = |of: Uncertain| of.sigma;
        Self {
            force: components(&force, value),
            point: point(&place, value),
            force_sigma: components(&force, sigma),
            point_sigma: point(&place, sigma),
        }
    }

    /// With what the model of the skin leaves, over what it should.
    pub(super) fn uncertainty(&self, misfit: Measured<f32>) -> Uncertainty {
        Uncertainty { force: self.force_sigma, point: self.point_sigma, misfit }
    }

    /// Standard deviation of the less sure of the shear's components.
    fn shear_sigma(&self) -> f32 {
        let Force { x, y, .. } = self.force_sigma;
        [x, y].into_iter().flatten().fold(0.0, |most, sigma| most.max(sigma.0))
    }
}

/// What matrix and array say together: where the array says nothing, what the matrix does.
#[inline(always)]
fn join(
    seen: Measured<Uncertain>,
    felt: Measured<Uncertain>,
    status: &mut Status,
) -> Measured<Uncertain> {
    if felt.is_ok() || seen == Err(NoValue::Absent) { meet(seen, felt, status) } else { seen }
}

#[inline(never)]
fn meet(
    seen: Measured<Uncertain>,
    felt: Measured<Uncertain>,
    status: &mut Status,
) -> Measured<Uncertain> {
    match (seen, felt) {
        (Ok(one), Ok(other)) => {
            let (one, agree) = fuse(one, other);
            if !agree {
                status.insert(Status::DISAGREE);
            }
            Ok(one)
        }
        // Of two reasons, that of the part which this finger has.
        (Err(_), Ok(_)) | (Err(NoValue::Absent), Err(_)) => felt,
        (_, Err(_)) => seen,
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

/// What is remembered of slip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct GripState {
    slip: SlipState,
    slide: SlideState,
    ear: Listener,
    touched: bool,
}

/// What slip is judged by.
pub(super) struct Grip<'s> {
    pub time: Micros,
    pub fused: &'s Fused,
    pub torsion: Measured<NewtonMillimetres>,
    pub seen: &'s Seen,
    /// It can be heard that it rubs.
    pub rubs: bool,
}

impl GripState {
    /// One scan of the ear; by what slip is judged, if it is.
    pub(super) fn listen<'r>(
        &mut self,
        record: Option<&'r Calibration>,
        time: Micros,
        signals: &Signals,
    ) -> Measured<(&'r Slip, bool)> {
        let slip = record.and_then(Calibration::slip).ok_or(without(cfg!(feature = "slip")))?;
        Ok((slip, self.ear.hear(time, signals)))
    }

    /// Nothing touches the finger.
    pub(super) fn release(&mut self) {
        if self.touched {
            self.slip.release();
            self.slide = SlideState::default();
        }
        self.touched = false;
    }
}

impl Grip<'_> {
    pub(super) fn judge(
        &self,
        record: Option<&Calibration>,
        slip: &Slip,
        state: &mut GripState,
        status: &mut Status,
    ) -> Measured<Verdict> {
        state.touched = true;
        let Fused { force, point, .. } = *self.fused;
        let (fx, fy, fz) = (force.x?.0, force.y?.0, force.z?.0);
        let torsion = self.torsion.map_or(0.0, |torsion| torsion.0);
        let array = record.and_then(Calibration::array);
        let moment_sigma = array.map_or(0.0, |array| array.moment_residual);
        let mut traction = Traction {
            shear: [fx, fy],
            normal: fz,
            torsion,
            arm: arm(&self.seen.contacts),
            doubt: [self.fused.shear_sigma(), TORSION_DOUBT * moment_sigma],
            ring: self.seen.ring,
            rubs: self.rubs,
            slides: false,
        };
        // The middle of two contacts wanders when they share their load otherwise: that is no slide.
        let place = point.map(|point| [point.x.0, point.y.0]).ok().filter(|_| traction.arm == 0.0);
        traction.slides =
            place.is_some_and(|place| state.slide.update(self.time, place, &traction));
        status.insert(Status::RAN_SLIP);
        let verdict = slip.judge(&mut state.slip, &traction)?;
        if traction.slides || traction.rubs {
            status.insert(Status::SLIDES);
        }
        if slip.warns(&mut state.slip, &verdict) {
            status.insert(Status::SLIP_WARNING);
        }
        Ok(verdict)
    }
}

/// By which two contacts hold torsion, in mm; 0 where there are not two.
fn arm(contacts: &Measured<[NormalContact; 2]>) -> f32 {
    let Ok([a, b]) = contacts else { return 0.0 };
    // Each is as far from the middle as the other is heavy.
    let (x, y) = (a.point.x.0 - b.point.x.0, a.point.y.0 - b.point.y.0);
    let sum = (a.normal.0 + b.normal.0).max(f32::MIN_POSITIVE);
    2.0 * (a.normal.0 / sum) * (b.normal.0 / sum) * sqrt(x * x + y * y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_contacts_hold_torsion_by_their_mean_distance_from_their_middle() {
        // The middle is 1 mm right: 3 mm from the one, 1 mm from the other.
        let two = [(1.0, [-2.0, 0.5]), (3.0, [2.0, 0.5])].map(NormalContact::new);
        assert!((arm(&Ok(two)) - (1.0 * 3.0 + 3.0 * 1.0) / 4.0).abs() < 1e-6);
        assert_eq!(arm(&Err(NoValue::NotEstimated)), 0.0);
    }

    #[test]
    fn torsion_within_the_noise_of_a_moment_uses_no_friction() {
        let array = Array { moment_residual: 0.1, ..Array::default() };
        let record = Calibration { array: Some(array), ..Calibration::EMPTY };
        let seen = Seen::nothing(NoValue::Absent);
        let point = Err(NoValue::NotEstimated);
        let force = Force::known(0.0, 0.0, 1.0);
        let fused = Fused { force, point, force_sigma: force, point_sigma: point };
        let margin = |torsion: f32| {
            let grip = Grip {
                time: Micros(0),
                fused: &fused,
                torsion: Ok(NewtonMillimetres(torsion)),
                seen: &seen,
                rubs: false,
            };
            let (mut state, mut status) = (GripState::default(), Status::default());
            grip.judge(Some(&record), &Slip::usual(0.8), &mut state, &mut status).unwrap().margin
        };
        assert_eq!(margin(0.25), 1.0, "two and a half standard deviations");
        assert!(margin(1.0) < 0.9, "{}", margin(1.0));
    }

    #[test]
    fn where_one_is_missing_the_other_stands_for_both() {
        let one = Ok(Uncertain { value: 1.0, sigma: 0.01 });
        let joined = |seen, felt| join(seen, felt, &mut Status::default());
        assert_eq!(joined(one, Err(NoValue::DeadChannel)), one);
        assert_eq!(joined(Err(NoValue::Saturated), one), one);
        let neither = |seen, felt| joined(Err(seen), Err(felt));
        assert_eq!(neither(NoValue::Saturated, NoValue::Absent), Err(NoValue::Saturated));
        assert_eq!(neither(NoValue::Absent, NoValue::DeadChannel), Err(NoValue::DeadChannel));
    }
}

//! Bounds of what a fingertip can measure. Absurd coefficients in a record lead beyond them.

use super::{Course, Estimate, FingerState, GripState};
use crate::estimate::{ContactPoint, Force};
use crate::frame::Status;
use crate::measured::NoValue;

/// Largest force that a frame gives, in newtons; no skin of this size withstands it.
const FORCE: f32 = 200.0;
/// Farthest contact point that a frame gives, in millimetres from the middle of the pad.
const PLACE: f32 = 20.0;

/// Returns whether a sensor can measure this force. NaN is never within.
#[inline(always)]
pub(super) fn force_possible([x, y, z]: [f32; 3]) -> bool {
    x.abs() + y.abs() + z.abs() <= FORCE
}

/// Returns whether all numbers of a contact are finite, forces and places within what a fingertip
/// can measure.
#[inline(never)]
pub(super) fn possible(estimate: &Estimate) -> bool {
    let Estimate { force, point, slip, torsion, contacts, uncertainty, .. } = estimate;
    let place = |point: &ContactPoint| place_within(point, PLACE);
    force_within(force, FORCE)
        && point.as_ref().map_or(true, place)
        && torsion.map_or(true, |torsion| torsion.0.abs() <= FORCE * PLACE)
        && contacts.as_ref().map_or(true, |pair| {
            pair.iter().all(|one| place(&one.point) && one.normal.0.abs() <= FORCE)
        })
        && slip.as_ref().map_or(true, |verdict| {
            // A sum of two numbers is finite only if each is.
            (verdict.margin + verdict.friction).is_finite() && verdict.grip.0.abs() <= FORCE
        })
        && uncertainty.as_ref().map_or(true, |sigma| {
            force_within(&sigma.force, f32::MAX)
                && sigma.point.as_ref().map_or(true, |point| place_within(point, f32::MAX))
                && sigma.misfit.map_or(true, f32::is_finite)
        })
}

/// Withholds all estimates of a contact and forgets what the estimators remember, which is as
/// doubtful.
#[cold]
#[inline(never)]
pub(super) fn withhold(estimate: &mut Estimate, state: &mut FingerState) {
    const REASON: NoValue = NoValue::OutOfTrainedRange;
    estimate.force = Force::none(REASON);
    estimate.point = Err(REASON);
    estimate.slip = Err(REASON);
    estimate.torsion = Err(REASON);
    estimate.contacts = Err(REASON);
    estimate.uncertainty = Err(REASON);
    estimate.status.insert(Status::OUT_OF_RANGE);
    state.matrix.clear();
    state.course = Course::default();
    state.grip = GripState::default();
}

/// A comparison with NaN is false, so that NaN is never within.
#[inline(never)]
fn force_within(Force { x, y, z }: &Force, most: f32) -> bool {
    [x, y, z].into_iter().flatten().all(|newtons| newtons.0.abs() <= most)
}

#[inline(never)]
fn place_within(ContactPoint { x, y }: &ContactPoint, most: f32) -> bool {
    x.0.abs() <= most && y.0.abs() <= most
}

//! Slip of the finger: inputs of the slip estimator, and its state during a contact.

use crate::calibration::Calibration;
use crate::condition::Signals;
use crate::estimate::NormalContact;
use crate::estimate::slide::GrossSlipDetector;
use crate::estimate::slip::{FRICTION, Slip, SlipState, Traction, Verdict};
use crate::estimate::vibration::VibrationDetector;
use crate::finger::fusion::{Fused, without};
use crate::finger::matrix::OpticalEstimate;
use crate::frame::Status;
use crate::math::{at_least, at_most, sqrt};
use crate::measured::Measured;
use crate::units::{Micros, NewtonMillimetres};

/// Torsion below this many standard deviations of a moment counts as none.
const TORSION_SIGMAS: f32 = 3.0;
/// Time after an estimate in microseconds at which the next one is due even if no frame is.
const TURN_US: u32 = 1_400;
/// Time in microseconds after which friction learns again from the friction utilisation. That needs
/// a new linearisation of the skin's model in most scans, for which faster ones leave no time.
const LEARN_US: u32 = 900;
/// Longest time between two estimates in seconds: friction learns nothing from a gap.
const LONGEST: f32 = 0.01;

/// State of the slip estimators.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct GripState {
    slip: SlipState,
    slide: GrossSlipDetector,
    vibration: VibrationDetector,
    /// Time of the last estimate, or of the beginning of the contact.
    judged: Micros,
    /// Time of the last estimate that learned from the matrix.
    learned: Micros,
    /// Whether the last estimate found gross slip.
    slides: bool,
}

/// Inputs of the slip estimator for one scan.
pub(super) struct Grip<'s> {
    pub time: Micros,
    pub fused: &'s Fused,
    pub torsion: Measured<NewtonMillimetres>,
    pub optical: &'s OpticalEstimate,
    /// Whether the vibration detector reports rubbing.
    pub rubs: bool,
}

impl GripState {
    /// Feeds the vibration detector; returns the slip coefficients and whether it reports rubbing.
    pub(super) fn listen<'r>(
        &mut self,
        record: Option<&'r Calibration>,
        time: Micros,
        signals: &Signals,
    ) -> Measured<(&'r Slip, bool)> {
        let slip = record.and_then(Calibration::slip).ok_or(without(cfg!(feature = "slip")))?;
        Ok((slip, self.vibration.update(time, signals)))
    }

    /// Prepares for a contact that begins now.
    pub(super) fn begin(&mut self, now: Micros) {
        // The clock may have begun again.
        (self.judged, self.learned) = (now, Micros(0));
    }

    /// Returns whether slip must be estimated even if no frame is due: in contact, about once in a
    /// millisecond.
    pub(super) fn is_due(&self, now: Micros) -> bool {
        now.since(self.judged) >= TURN_US
    }

    /// Returns whether friction learns from the friction utilisation that the matrix sees now.
    pub(super) fn learns(&self, now: Micros) -> bool {
        now.since(self.learned) >= LEARN_US
    }

    /// Returns whether the last estimate found gross slip, which shakes every sensor.
    pub(super) fn slides(&self) -> bool {
        self.slides
    }

    /// Resets slip and gross slip when contact ends.
    pub(super) fn release(&mut self) {
        self.slides = false;
        self.slip.release();
        self.slide = GrossSlipDetector::default();
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
        let elapsed = at_most(1e-6 * self.time.since(state.judged) as f32, LONGEST);
        state.judged = self.time;
        if self.optical.ring.is_some() {
            state.learned = self.time;
        }
        state.slides = false;
        let [x, y, z] = self.fused.force;
        let (x, y, z) = (x?, y?, z?);
        let torsion = self.torsion.map_or(0.0, |torsion| torsion.0);
        let array = record.and_then(Calibration::array);
        let (shear2, least) = (x.value * x.value + y.value * y.value, FRICTION[0] * z.value);
        let torsion_sigma = TORSION_SIGMAS * array.map_or(0.0, |array| array.moment_residual);
        let mut traction = Traction {
            shear: [x.value, y.value],
            normal: z.value,
            torsion,
            arm: arm(&self.optical.contacts),
            sigma: [at_least(x.sigma, y.sigma), torsion_sigma],
            ring: self.optical.ring,
            // Without the shear or torsion of any gross slip it was a knock.
            rubs: self.rubs && (shear2 > least * least || torsion.abs() > torsion_sigma),
            ..Traction::default()
        };
        // The middle of two contacts wanders when their load share changes; that is no gross slip.
        if let Ok([x, y]) = &self.fused.point
            && traction.arm == 0.0
        {
            traction.place_sigma = at_least(x.sigma, y.sigma);
            traction.slides = state.slide.update(self.time, [x.value, y.value], &traction);
        }
        status.insert(Status::RAN_SLIP);
        let verdict = slip.judge(&mut state.slip, &traction, elapsed)?;
        state.slides = traction.slides || traction.rubs;
        if state.slides {
            status.insert(Status::SLIDES);
        }
        if slip.warns(&mut state.slip, &verdict) {
            status.insert(Status::SLIP_WARNING);
        }
        Ok(verdict)
    }
}

/// Returns the lever arm of two contacts against torsion, in mm; 0 for a single one.
fn arm(contacts: &Measured<[NormalContact; 2]>) -> f32 {
    let Ok([a, b]) = contacts else { return 0.0 };
    // The middle divides their distance in the inverse ratio of their forces.
    let (x, y) = (a.point.x.0 - b.point.x.0, a.point.y.0 - b.point.y.0);
    let sum = at_least(a.normal.0 + b.normal.0, f32::MIN_POSITIVE);
    2.0 * (a.normal.0 / sum) * (b.normal.0 / sum) * sqrt(x * x + y * y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::array::Array;
    use crate::estimate::fusion::Gaussian;
    use crate::measured::NoValue;

    #[test]
    fn arm_is_mean_distance_from_the_middle() {
        // The middle is 1 mm right: 3 mm from the one, 1 mm from the other.
        let two = [(1.0, [-2.0, 0.5]), (3.0, [2.0, 0.5])].map(NormalContact::new);
        assert!((arm(&Ok(two)) - (1.0 * 3.0 + 3.0 * 1.0) / 4.0).abs() < 1e-6);
        assert_eq!(arm(&Err(NoValue::NotEstimated)), 0.0);
    }

    #[test]
    fn torsion_within_noise_uses_no_friction() {
        let array = Array { moment_residual: 0.1, ..Array::default() };
        let record = Calibration { array: Some(array), ..Calibration::EMPTY };
        let optical = OpticalEstimate::nothing(NoValue::Absent);
        let known = |value: f32| Ok(Gaussian { value, sigma: 0.0 });
        let force = [known(0.0), known(0.0), known(1.0)];
        let fused = Fused { force, point: Err(NoValue::NotEstimated) };
        let margin = |torsion: f32| {
            let grip = Grip {
                time: Micros(1000),
                fused: &fused,
                torsion: Ok(NewtonMillimetres(torsion)),
                optical: &optical,
                rubs: false,
            };
            let (mut state, mut status) = (GripState::default(), Status::default());
            grip.judge(Some(&record), &Slip::usual(0.8), &mut state, &mut status).unwrap().margin
        };
        assert_eq!(margin(0.25), 1.0, "two and a half standard deviations");
        assert!(margin(1.0) < 0.9, "{}", margin(1.0));
    }

    #[test]
    fn knock_without_shear_or_torsion_is_no_gross_slip() {
        let array = Array { moment_residual: 0.1, ..Array::default() };
        let record = Calibration { array: Some(array), ..Calibration::EMPTY };
        let optical = OpticalEstimate::nothing(NoValue::Absent);
        let slides = |shear: f32, torsion: f32| {
            let force = [shear, 0.0, 1.0].map(|value| Ok(Gaussian { value, sigma: 0.0 }));
            let fused = Fused { force, point: Err(NoValue::NotEstimated) };
            let grip = Grip {
                time: Micros(1000),
                fused: &fused,
                torsion: Ok(NewtonMillimetres(torsion)),
                optical: &optical,
                rubs: true,
            };
            let (mut state, mut status) = (GripState::default(), Status::default());
            grip.judge(Some(&record), &Slip::usual(0.8), &mut state, &mut status).unwrap();
            assert_eq!(status.contains(Status::SLIDES), state.slides());
            state.slides()
        };
        assert!(!slides(0.04, 0.0));
        assert!(slides(-0.06, 0.0));
        assert!(!slides(0.0, -0.29));
        assert!(slides(0.0, -0.31));
    }

    #[test]
    fn slip_is_due_one_to_two_ms_after_the_last() {
        let mut state = GripState::default();
        for begun in [0, 5_000_000] {
            state.begin(Micros(begun));
            assert!(!state.is_due(Micros(begun + 1_000)));
            assert!(state.is_due(Micros(begun + 2_000)));
        }
    }
}

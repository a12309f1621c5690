//! Compensation of drift: LEDs that warm, age, or are fed a little more, and whatever else moves
//! the zero of a channel slowly.
//!
//! All LEDs of a finger share their supply and nearly their temperature. Their light therefore
//! drifts by one common share s, c = s·b with the unloaded levels b, whereas a touch dents a few
//! taxels. The contact gate looks at what is left of the signals without that share. While it is
//! closed, a gain follows the share; in contact the gain is frozen, so that a sustained grasp keeps
//! its force. Each channel's bias follows what remains, more slowly. A force sensor must exceed, in
//! contact, what it may have drifted meanwhile.

use serde::{Deserialize, Serialize};

use super::{TaxelBias, TaxelLevels};
use crate::math::{at_least, at_most};
use crate::scan::{COLS, ROWS, TAXELS};

/// Time over which shares are averaged, in microseconds.
const WINDOW: u32 = 20_000;
/// Part of a window's mean that the gain follows.
const FOLLOWS: f32 = 0.35;

/// Largest change of the light in all, as a share: LEDs warm by 40 K, or age for years.
const FARTHEST: f32 = 0.2;
/// Fastest drift of the light in contact, as a share a second: an LED that warms by 0.4 K/s.
const FASTEST: f32 = 0.002;
/// Fastest drift of a force sensor in contact, as a part of full scale a second, and the most.
const FASTEST_SENSOR: f32 = 1e-4;
const MOST_SENSOR: f32 = 4e-3;
/// Squared part of the gate's threshold that the common share alone may reach.
const MARGIN: f32 = 0.8;

/// Drift of the light that is compensated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DriftCompensation {
    /// Largest common share of the light that is taken for a drift.
    pub most: f32,
}

/// Gain that restores the light at which the bias was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    gain: f32,
    /// Sums over the first rows of a share that is being taken.
    taken: Dots,
    /// Sum of share times time in the present window, and its time.
    sum: f32,
    time: u32,
    /// Mean of the last complete window since a contact. The gain follows it when the next one is
    /// complete, too, because a touch begins below the gate's threshold.
    mean: Option<f32>,
    /// Microseconds since the contact began; zero without one.
    lasted: u32,
    /// Drift that a force sensor may have had in an earlier contact, as a part of full scale, and
    /// that its bias has not followed yet.
    unfollowed: f32,
}

impl Default for Drift {
    fn default() -> Self {
        Self {
            gain: 1.0,
            taken: Dots::default(),
            sum: 0.0,
            time: 0,
            mean: None,
            lasted: 0,
            unfollowed: 0.0,
        }
    }
}

/// Products of signals with unloaded levels, and of these with themselves, summed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Dots {
    along: f32,
    squares: f32,
}

impl Dots {
    fn add(&mut self, c: &[f32], levels: &[f32]) {
        for (c, b) in c.iter().zip(levels) {
            self.along += c * b;
            self.squares += b * b;
        }
    }

    fn share(self) -> f32 {
        // Without light there is none.
        self.along / (self.squares + f32::MIN_POSITIVE)
    }
}

impl DriftCompensation {
    /// Returns whether the share is a drift's: at most a fifth.
    pub(crate) fn fits(&self) -> bool {
        (0.0..=FARTHEST).contains(&self.most)
    }

    /// Returns the largest common share that is taken for a drift of the light at a time.
    ///
    /// If the force sensors `deny` a touch, any share may be a drift. Otherwise that is, while
    /// nothing touches, at most the share of the last window, which the gain has not followed yet:
    /// more that comes at once is a touch. In contact the light can only have drifted for as long
    /// as that lasts.
    pub(crate) fn most(&self, drift: &Drift, deny: bool) -> f32 {
        let of_light = |mean: f32| mean.abs() + 1e-6 * FASTEST * drift.lasted as f32;
        drift.mean.filter(|_| !deny).map_or(self.most, of_light)
    }

    /// Takes a drift of `most` a share that alone may exceed the noise of `bias` by a `factor`,
    /// given squared, off the signals. Returns false if the common share is too large for a drift.
    #[inline(never)]
    pub(crate) fn remove(
        &self,
        c: &mut TaxelLevels,
        bias: &TaxelBias,
        factor2: f32,
        most: f32,
    ) -> bool {
        let seen2 = MARGIN * factor2 * bias.noise * bias.noise;
        // No level exceeds 1.
        if most * most <= seen2 {
            return true;
        }
        let mut dots = Dots::default();
        dots.add(c, &bias.level);
        let share = dots.share();
        // Not so for a share that is no number.
        let possible = share.abs() <= self.most;
        let share = at_least(at_most(share, most), -most);
        if possible && share * share * dots.squares > TAXELS as f32 * seen2 {
            c.iter_mut().zip(&bias.level).for_each(|(c, b)| *c -= share * b);
        }
        possible
    }

    /// Follows the common share while nothing touches, a `row` of taxels a call. The last row
    /// completes the share of the last `passed` microseconds.
    pub(crate) fn follow(
        &self,
        drift: &mut Drift,
        row: usize,
        c: &TaxelLevels,
        bias: &TaxelBias,
        passed: u32,
    ) {
        let of = |levels: &TaxelLevels| levels.as_chunks::<COLS>().0.get(row).copied();
        if let (Some(c), Some(b)) = (of(c), of(&bias.level)) {
            drift.taken.add(&c, &b);
        }
        if row == ROWS - 1 {
            self.follow_share(drift, passed);
        }
    }

    #[cold]
    #[inline(never)]
    fn follow_share(&self, drift: &mut Drift, passed: u32) {
        let share = core::mem::take(&mut drift.taken).share();
        let passed = passed.min(WINDOW);
        // Not so for a share that is no number.
        if share.abs() <= self.most {
            drift.sum += share * passed as f32;
            drift.time += passed;
        }
        if drift.time >= WINDOW {
            if let Some(mean) = drift.mean {
                let gain = drift.gain * (1.0 + FOLLOWS * mean);
                drift.gain = gain.clamp(1.0 - FARTHEST, 1.0 + FARTHEST);
            }
            drift.mean = Some(drift.sum / drift.time as f32);
            (drift.sum, drift.time) = (0.0, 0);
        }
    }
}

impl Drift {
    /// Returns the factor of all levels of light.
    #[must_use]
    pub fn gain(&self) -> f32 {
        self.gain
    }

    /// Returns how far a force sensor may have drifted in this contact or an earlier one, whichever
    /// lasted longer, as a part of full scale.
    ///
    /// Their sum would be a high threshold after many short touches.
    #[inline(never)]
    pub(crate) fn of_sensors(&self) -> f32 {
        let now = 1e-6 * FASTEST_SENSOR * self.lasted as f32;
        at_most(at_least(now, self.unfollowed), MOST_SENSOR)
    }

    /// Tells that the biases of the force sensors have followed a `share` of their drift.
    pub(crate) fn followed(&mut self, share: f32) {
        self.unfollowed -= share * self.unfollowed;
    }

    /// Freezes the gain in a contact that begins.
    pub(crate) fn freeze(&mut self) {
        (self.taken, self.sum, self.time, self.lasted) = Default::default();
    }

    /// Tells that a contact goes on, `passed` microseconds after the last scan.
    pub(crate) fn hold(&mut self, passed: u32) {
        self.lasted = self.lasted.saturating_add(passed);
    }

    /// Forgets the shares when the contact ends.
    pub(crate) fn release(&mut self) {
        self.unfollowed = self.of_sensors();
        self.mean = None;
        self.freeze();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BIAS: TaxelBias = {
        let mut level = [0.3; TAXELS];
        level[3] = 0.2;
        TaxelBias { level, noise: 1e-4 }
    };
    const MOST: f32 = 0.05;
    const DRIFTS: DriftCompensation = DriftCompensation { most: MOST };
    /// Squared factor of the contact gate's threshold.
    const GATE: f32 = 16.0;
    fn new() -> Drift {
        Drift::default()
    }

    /// Follows whole scans, `passed` microseconds apart.
    fn follow(drift: &mut Drift, c: &TaxelLevels, passed: u32) {
        (0..ROWS).for_each(|row| DRIFTS.follow(drift, row, c, &BIAS, passed));
    }

    #[test]
    fn common_share_is_removed_from_a_touch() {
        let drifted = BIAS.level.map(|b| 0.01 * b);
        let mut c = drifted;
        assert!(DRIFTS.remove(&mut c, &BIAS, GATE, MOST));
        assert!(c.iter().all(|c| c.abs() < 1e-8), "{c:?}");
        let mut touched = drifted;
        touched[5] -= 0.02;
        assert!(DRIFTS.remove(&mut touched, &BIAS, GATE, MOST));
        assert!((-0.02..-0.018).contains(&touched[5]), "{touched:?}");
    }

    #[test]
    fn light_touch_stays_whole_and_large_share_is_no_drift() {
        let mut light = [0.0; TAXELS];
        light[5] = -1e-3;
        let whole = light;
        assert!(DRIFTS.remove(&mut light, &BIAS, GATE, MOST));
        assert_eq!(light, whole);
        assert!(!DRIFTS.remove(&mut BIAS.level.map(|b| 0.06 * b), &BIAS, GATE, MOST));
        assert!(!DRIFTS.remove(&mut [f32::NAN; TAXELS], &BIAS, GATE, MOST));
    }

    #[test]
    fn share_that_comes_at_once_is_a_touch_unless_force_sensors_deny_it() {
        let settled = Drift { mean: Some(1e-4), ..new() };
        let mut wide = BIAS.level.map(|b| -0.004 * b);
        let whole = wide;
        let most = |deny: bool| DRIFTS.most(&settled, deny);
        assert!(DRIFTS.remove(&mut wide, &BIAS, GATE, most(false)));
        assert_eq!(wide, whole);
        assert!(DRIFTS.remove(&mut wide, &BIAS, GATE, most(true)));
        assert!(wide.iter().all(|c| c.abs() < 1e-8), "force sensors deny a touch: {wide:?}");
    }

    #[test]
    fn share_in_contact_is_bounded_by_how_long_that_lasts() {
        let left = |drift: &Drift| {
            let mut wide = BIAS.level.map(|b| -0.01 * b);
            assert!(DRIFTS.remove(&mut wide, &BIAS, GATE, DRIFTS.most(drift, false)));
            wide[0] / BIAS.level[0]
        };
        let mut touched = Drift { mean: Some(0.0), ..new() };
        touched.freeze();
        let shares = [0, 2, 2, 96].map(|seconds| {
            touched.hold(1_000_000 * seconds);
            left(&touched)
        });
        let expected = [-0.01, -0.006, -0.002, 0.0];
        assert!(shares.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{shares:?}");
        touched.release();
        let after = left(&touched);
        assert!(after.abs() < 1e-6, "what drifted in contact is no touch after it: {after}");
    }

    #[test]
    fn gain_restores_light_and_is_bounded() {
        for passed in [3000, 24_000, 100_000] {
            let mut drift = Drift::default();
            let signals = |drift: &Drift| BIAS.level.map(|b| b - 0.98 * b * drift.gain());
            for _ in 0..3_000_000 / passed {
                let c = signals(&drift);
                follow(&mut drift, &c, passed);
            }
            assert!(signals(&drift).iter().all(|c| c.abs() < 3e-5), "{passed}: {drift:?}");
        }
        let mut drift = Drift::default();
        (0..100_000).for_each(|_| follow(&mut drift, &BIAS.level.map(|b| 0.05 * b), 100_000));
        assert_eq!(drift.gain(), 1.2);
    }

    #[test]
    fn share_that_is_too_large_or_no_number_is_not_followed() {
        for c in [BIAS.level, [f32::NAN; TAXELS], [f32::MAX; TAXELS]] {
            let mut drift = Drift::default();
            (0..1000).for_each(|_| follow(&mut drift, &c, 3000));
            assert_eq!(drift.gain(), 1.0);
        }
    }

    #[test]
    fn contact_freezes_the_gain_and_its_end_forgets_the_last_share() {
        let mut drift = Drift::default();
        (0..100).for_each(|_| follow(&mut drift, &BIAS.level.map(|b| 0.01 * b), 3000));
        let gain = drift.gain();
        assert!(gain > 1.0);
        let mean = drift.mean;
        drift.freeze();
        assert_eq!(drift, Drift { gain, mean, ..new() });
        drift.release();
        assert_eq!(drift, Drift { gain, ..new() });
    }

    #[test]
    fn drift_of_sensors_grows_in_contact_and_is_followed_after_it() {
        const SECOND: u32 = 1_000_000;
        let near = |drift: &Drift, seconds: f32| {
            (drift.of_sensors() / FASTEST_SENSOR - seconds).abs() < 1e-5
        };
        let mut drift = Drift::default();
        let touch = |drift: &mut Drift, seconds: u32| {
            drift.freeze();
            drift.hold(seconds * SECOND);
        };
        assert!(near(&drift, 0.0));
        touch(&mut drift, 2);
        assert!(near(&drift, 2.0));
        drift.release();
        touch(&mut drift, 1);
        assert!(near(&drift, 2.0), "the longer of two contacts counts");
        drift.hold(2 * SECOND);
        assert!(near(&drift, 3.0));
        drift.release();
        drift.followed(0.25);
        assert!(near(&drift, 2.25));
        touch(&mut drift, 1000);
        assert_eq!(drift.of_sensors(), MOST_SENSOR);
    }
}

//! Compensation of a drift of the light: LEDs that warm, age, or are fed a little more.
//!
//! All LEDs of a finger share their supply and nearly their temperature. Their light therefore
//! drifts by one common share s, c = s·b with the unloaded levels b, whereas a touch dents a few
//! taxels. The contact gate looks at what is left of the signals without that share. While it is
//! closed, a gain follows the share; in contact the gain is frozen, so that a sustained grasp keeps
//! its force.

use serde::{Deserialize, Serialize};

use super::{TaxelBias, TaxelLevels};
use crate::scan::TAXELS;

/// Time over which shares are averaged, in microseconds.
const WINDOW: u32 = 20_000;
/// Part of a window's mean that the gain follows.
const FOLLOWS: f32 = 0.35;

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
    /// Sum of share times time in the present window, and its time.
    sum: f32,
    time: u32,
    /// Mean of the last complete window since a contact. The gain follows it when the next one is
    /// complete, too, because a touch begins below the gate's threshold.
    mean: Option<f32>,
}

impl Default for Drift {
    fn default() -> Self {
        Self { gain: 1.0, sum: 0.0, time: 0, mean: None }
    }
}

impl DriftCompensation {
    /// Returns whether the share is a drift's: at most a fifth.
    pub(crate) fn fits(&self) -> bool {
        (0.0..=0.2).contains(&self.most)
    }

    /// Returns the common share of the signals; `None` if it is too large for a drift.
    ///
    /// `c` keeps what is left without a drift that alone may exceed the noise of `bias` by a
    /// `factor`, given squared. While the finger is untouched that is the share of the last window:
    /// a share that comes at once is a touch. Else it is the present share.
    #[inline(never)]
    pub(crate) fn split(
        &self,
        drift: &Drift,
        c: &mut TaxelLevels,
        bias: &TaxelBias,
        factor2: f32,
    ) -> Option<f32> {
        let (mut along, mut squares) = (0.0, f32::MIN_POSITIVE);
        for (c, b) in c.iter().zip(&bias.level) {
            along += c * b;
            squares += b * b;
        }
        let share = along / squares;
        // Not so for a share that is no number.
        let possible = share.abs() <= self.most;
        if !possible {
            return None;
        }
        let slow = drift.mean.unwrap_or(share);
        let noise2 = TAXELS as f32 * bias.noise * bias.noise;
        if slow * slow * squares > MARGIN * factor2 * noise2 {
            c.iter_mut().zip(&bias.level).for_each(|(c, b)| *c -= slow * b);
        }
        Some(share)
    }

    /// Follows the common share of a scan, `passed` microseconds after the last one. In contact the
    /// gain is frozen, and the shares just before it are forgotten.
    #[inline(never)]
    pub(crate) fn follow(&self, drift: &mut Drift, share: f32, passed: u32, contact: bool) {
        if contact {
            (drift.sum, drift.time, drift.mean) = (0.0, 0, None);
            return;
        }
        let passed = passed.min(WINDOW);
        drift.sum += share * passed as f32;
        drift.time += passed;
        if drift.time >= WINDOW {
            if let Some(mean) = drift.mean {
                let gain = drift.gain * (1.0 + FOLLOWS * mean);
                // `clamp` would panic on a bad record.
                drift.gain = gain.max(1.0 - self.most).min(1.0 + self.most);
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
}

#[cfg(test)]
mod tests {
    use super::*;

    const BIAS: TaxelBias = {
        let mut level = [0.3; TAXELS];
        level[3] = 0.2;
        TaxelBias { level, noise: 1e-4 }
    };
    const DRIFTS: DriftCompensation = DriftCompensation { most: 0.05 };
    /// Squared factor of the contact gate's threshold.
    const GATE: f32 = 16.0;
    const NEW: Drift = Drift { gain: 1.0, sum: 0.0, time: 0, mean: None };

    #[test]
    fn common_share_is_split_from_a_touch() {
        let drifted = BIAS.level.map(|b| 0.01 * b);
        let mut c = drifted;
        let share = DRIFTS.split(&NEW, &mut c, &BIAS, GATE).unwrap();
        assert!((share - 0.01).abs() < 1e-7 && c.iter().all(|c| c.abs() < 1e-8), "{c:?}");
        let mut touched = drifted;
        touched[5] -= 0.02;
        DRIFTS.split(&NEW, &mut touched, &BIAS, GATE).unwrap();
        assert!((-0.02..-0.018).contains(&touched[5]), "{touched:?}");
    }

    #[test]
    fn light_touch_stays_whole_and_large_share_is_no_drift() {
        let mut light = [0.0; TAXELS];
        light[5] = -1e-3;
        let whole = light;
        assert!(DRIFTS.split(&NEW, &mut light, &BIAS, GATE).is_some());
        assert_eq!(light, whole);
        assert_eq!(DRIFTS.split(&NEW, &mut BIAS.level.map(|b| 0.06 * b), &BIAS, GATE), None);
        assert_eq!(DRIFTS.split(&NEW, &mut [f32::NAN; TAXELS], &BIAS, GATE), None);
    }

    #[test]
    fn share_that_comes_at_once_is_a_touch() {
        let settled = Drift { mean: Some(1e-4), ..NEW };
        let mut wide = BIAS.level.map(|b| -0.004 * b);
        let whole = wide;
        assert!(DRIFTS.split(&settled, &mut wide, &BIAS, GATE).is_some());
        assert_eq!(wide, whole);
    }

    #[test]
    fn gain_restores_light_and_is_bounded() {
        for passed in [250, 2000, 100_000] {
            let mut drift = Drift::default();
            let signals = |drift: &Drift| BIAS.level.map(|b| b - 0.98 * b * drift.gain());
            for _ in 0..3_000_000 / passed {
                let share = DRIFTS.split(&drift, &mut signals(&drift), &BIAS, GATE).unwrap();
                DRIFTS.follow(&mut drift, share, passed, false);
            }
            assert!(signals(&drift).iter().all(|c| c.abs() < 3e-5), "{passed}: {drift:?}");
        }
        let mut drift = Drift::default();
        (0..100_000).for_each(|_| DRIFTS.follow(&mut drift, 0.05, 100_000, false));
        assert_eq!(drift.gain(), 1.05);
    }
}

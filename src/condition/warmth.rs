//! Compensation of the channels' temperature drift, and the range in which it is calibrated.
//!
//! An LED loses some 0.5 % of its light with each kelvin. A bridge's offset drifts with the
//! mismatch of its resistors: 2 K shift a bare force sensor by seven times its noise. Light and
//! offset are proportional to the change of temperature. The thermometer that every board reads in
//! each scan gives their correction.
//!
//! Levels are corrected **before** the bias is subtracted, so that a bias taken on a warm finger is
//! valid on a cold one.

use serde::{Deserialize, Serialize};

use super::Signals;
use super::levels::{BridgeLevels, Levels};
use crate::scan::{Codes, SENSORS};

/// Thermometer level of STM32 chips per kelvin: 2.5 mV of 3.3 V (DS12589 table 79, DS10314 table
/// 71).
pub const PER_KELVIN: f32 = 2.5e-3 / 3.3;

/// Weight of a new reading in the smoothed temperature. The thermometer is slow, and its single
/// readings are accurate to a third of a kelvin.
const NEW: f32 = 1.0 / 64.0;

/// Largest compensated change of the level: 60 K. The linear correction is clamped beyond it.
const FARTHEST: f32 = 60.0 * PER_KELVIN;

/// Coefficients of the channels' drift over the thermometer's level, a fraction of full scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureCompensation {
    /// Level to which all channels are corrected.
    pub reference: f32,
    /// Lowest and highest calibrated level.
    pub range: [f32; 2],
    /// Relative change of a taxel's light per level.
    pub light: f32,
    /// Relative change of the force sensors' sensitivity per level.
    pub sensitivity: f32,
    /// Change of u_x, u_y, u_z of each sensor per level.
    pub offset: [BridgeLevels; SENSORS],
}

/// Compensation, and the thermometer's present level.
pub type Warm<'c> = (&'c TemperatureCompensation, f32);

impl TemperatureCompensation {
    /// Checks that light and sensitivity change by less than half over [`FARTHEST`].
    pub(crate) fn shares_fit(shares: &[f32; 2]) -> bool {
        shares.iter().all(|share| (share * FARTHEST).abs() < 0.5)
    }

    /// Returns whether `level` lies outside the calibrated range.
    #[must_use]
    pub fn unknown(&self, level: f32) -> bool {
        let [low, high] = self.range;
        !(low..=high).contains(&level)
    }

    pub(super) fn change(&self, level: f32) -> f32 {
        (level - self.reference).clamp(-FARTHEST, FARTHEST)
    }

    /// Corrects levels to the reference: light by its relative change, bridge outputs by their
    /// offsets. `gain` is a further factor of the light.
    pub fn correct(&self, levels: &mut Levels, level: f32, gain: f32) {
        let change = self.change(level);
        if let Some(taxels) = &mut levels.taxels {
            let brighter = self.brighter(change) * gain;
            taxels.iter_mut().for_each(|level| *level *= brighter);
        }
        for (bridge, offset) in levels.bridges.iter_mut().zip(&self.offset) {
            if let Some(bridge) = bridge {
                bridge.iter_mut().zip(offset).for_each(|(u, offset)| *u -= offset * change);
            }
        }
    }

    /// Returns the correction factor of light.
    pub(super) fn brighter(&self, change: f32) -> f32 {
        1.0 / (1.0 + self.light * change)
    }

    /// Returns the correction factor of the force sensors' signals.
    #[must_use]
    pub fn gain(&self, level: f32) -> f32 {
        self.gain_after(self.change(level))
    }

    pub(super) fn gain_after(&self, change: f32) -> f32 {
        1.0 / (1.0 + self.sensitivity * change)
    }

    /// Corrects the signals of the force sensors.
    #[cold]
    #[inline(never)]
    pub(crate) fn scale(&self, signals: &mut Signals, level: f32) {
        let gain = self.gain(level);
        signals.bridges.iter_mut().flatten().flatten().for_each(|u| *u *= gain);
    }
}

/// Smoothed level of the thermometer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Thermometer {
    level: Option<f32>,
}

impl Thermometer {
    /// Processes one scan; returns `None` if the finger has no thermometer.
    pub fn read(&mut self, codes: &Codes) -> Option<f32> {
        let now = f32::from(codes.temperature?.0) * codes.full_scale.step().0;
        let level = self.level.get_or_insert(now);
        *level += NEW * (now - *level);
        Some(*level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::Bias;
    use crate::units::{Code, FullScale};
    use proptest::prelude::*;

    const WARMTH: TemperatureCompensation = TemperatureCompensation {
        reference: 0.23,
        range: [0.22, 0.24],
        light: -6.6,
        sensitivity: -4.4,
        offset: [[0.3, -0.2, 0.5]; SENSORS],
    };

    fn at(kelvin: f32) -> f32 {
        WARMTH.reference + kelvin * PER_KELVIN
    }

    #[test]
    fn correction_restores_levels_of_calibration() {
        let cold = Levels {
            taxels: Some([0.4; 16]),
            bridges: [Some([0.01, 0.02, -0.03]); SENSORS],
            ..Levels::default()
        };
        let change = 8.0 * PER_KELVIN;
        let mut warm = cold;
        for level in warm.taxels.iter_mut().flatten() {
            *level *= 1.0 + WARMTH.light * change;
        }
        for bridge in warm.bridges.iter_mut().flatten() {
            bridge.iter_mut().zip([0.3, -0.2, 0.5]).for_each(|(u, offset)| *u += offset * change);
        }
        WARMTH.correct(&mut warm, at(8.0), 1.0);
        let bias = Bias::default();
        assert_eq!(bias.apply(&warm, None).health, bias.apply(&cold, None).health);
        let pairs = warm.taxels.unwrap().into_iter().zip(cold.taxels.unwrap());
        pairs.for_each(|(warm, cold)| assert!((warm - cold).abs() < 1e-6, "{warm} {cold}"));
        for (warm, cold) in warm.bridges.iter().flatten().zip(cold.bridges.iter().flatten()) {
            warm.iter().zip(cold).for_each(|(w, c)| assert!((w - c).abs() < 1e-6, "{w} {c}"));
        }
        assert!((WARMTH.gain(at(8.0)) * (1.0 + WARMTH.sensitivity * change) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn temperature_outside_range_is_unknown() {
        assert!(!WARMTH.unknown(at(0.0)) && WARMTH.unknown(at(20.0)) && WARMTH.unknown(at(-20.0)));
    }

    #[test]
    fn thermometer_is_smoothed_or_absent() {
        let mut codes = Codes {
            full_scale: FullScale::BITS_12,
            taxels: None,
            bridges: [None; SENSORS],
            reference: None,
            temperature: None,
        };
        let mut thermometer = Thermometer::default();
        assert_eq!(thermometer.read(&codes), None);
        let levels: std::vec::Vec<f32> = (0..1000)
            .map(|i| {
                codes.temperature = Some(Code(930 + i % 2));
                thermometer.read(&codes).unwrap()
            })
            .collect();
        let middle = 930.5 * codes.full_scale.step().0;
        assert!(levels[500..].iter().all(|l| (l - middle).abs() < 0.02 * PER_KELVIN));
    }

    proptest! {
        #[test]
        fn corrected_levels_are_finite(
            level in -1.0f32..2.0, light in -6.0f32..6.0, offset in -1e3f32..1e3,
        ) {
            let warmth = TemperatureCompensation { light, offset: [[offset; 3]; SENSORS], ..WARMTH };
            prop_assume!(TemperatureCompensation::shares_fit(&[warmth.light, warmth.sensitivity]));
            let mut levels = Levels { taxels: Some([1.0; 16]), ..Levels::default() };
            levels.bridges = [Some([1.0; 3]); SENSORS];
            warmth.correct(&mut levels, level, 1.0);
            prop_assert!(levels.taxels.iter().flatten().all(|l| l.is_finite()));
            prop_assert!(levels.bridges.iter().flatten().flatten().all(|u| u.is_finite()));
            prop_assert!(warmth.gain(level).is_finite());
        }
    }
}

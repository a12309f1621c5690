//! Table `[electronics]` of a scene: the path from a photocurrent or a bridge to its code.

use serde::{Deserialize, Deserializer};
use toml::Spanned;

use super::{Bits, Effect, Scene};
use crate::ranges;

/// `[electronics]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Electronics {
    /// Load that turns the photocurrent of a column into a voltage, in ohms.
    #[serde(deserialize_with = "ranges::load")]
    pub load_ohm: f64,
    /// Amplifier between load and converter.
    pub pga_gain: PgaGain,
    /// Reading of a column in darkness: voltage of its amplifier's other input.
    #[serde(deserialize_with = "ranges::ratio")]
    pub reference_ratio: f64,
    /// Key of [`Scene::time_constant_us`].
    #[serde(deserialize_with = "given_time_constant")]
    time_constant_us: Option<f64>,
    /// Key of [`Scene::oversampling`].
    pub(super) oversampling: Option<Spanned<Oversampling>>,
    /// Gain of the amplifiers of the bridges' midpoints about half the supply.
    #[serde(deserialize_with = "ranges::bridge_gain")]
    pub bridge_gain: f64,
    /// Whether the converter's reference is the supply of bridges and LEDs.
    ///
    /// Otherwise the reference is a voltage of its own that does not follow the supply.
    pub ratiometric: bool,
    /// Amplitude of the supply's ripple as a share of the supply; with the effect `supply-ripple`.
    #[serde(deserialize_with = "ranges::swing")]
    pub ripple_ratio: f64,
    /// Frequency of the ripple in hertz.
    #[serde(deserialize_with = "ranges::ripple")]
    pub ripple_hz: f64,
}

impl Default for Electronics {
    fn default() -> Self {
        Self {
            // Load of the SFH 3010's data sheet.
            load_ohm: 1000.0,
            // With this gain, the 60 µA of a pair at rest are a third of the range.
            pga_gain: PgaGain(16),
            reference_ratio: 0.0,
            time_constant_us: None,
            oversampling: None,
            // At gain 1, a newton would move a 12-bit code by 17 steps only. At gain 16, 2 N
            // anywhere on the pad still stay within a quarter of the supply (tested).
            bridge_gain: 16.0,
            ratiometric: true,
            // A linear regulator behind a rectifier leaves some millivolts of 5 V.
            ripple_ratio: 0.001,
            ripple_hz: 100.0,
        }
    }
}

/// Gain of a microcontroller's built-in amplifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PgaGain(u16);

impl PgaGain {
    /// Voltage gain as a number.
    #[must_use]
    pub fn times(self) -> f64 {
        f64::from(self.0)
    }
}

impl<'de> Deserialize<'de> for PgaGain {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        // STM32G431 data sheet: a follower, or 2 to 64.
        ranges::one_of(from, &[1, 2, 4, 8, 16, 32, 64]).map(Self)
    }
}

/// Number of conversions per reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Oversampling(u16);

impl<'de> Deserialize<'de> for Oversampling {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        ranges::one_of(from, &[1, 2, 4, 8, 16, 32, 64, 128, 256]).map(Self)
    }
}

/// Reads an optional key and checks its range.
fn given_time_constant<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    ranges::time_constant(from).map(Some)
}

impl Scene {
    /// Rise and fall time of the SFH 3010 in microseconds, from 10 % to 90 %.
    ///
    /// The data sheet gives it at 1 mA, 5 V and 1 kΩ. The value is assumed to hold at the smaller
    /// current here, for which the sheet has no figure.
    const RISE_US: f64 = 7.0;
    /// Duration of one conversion of the STM32G431 in microseconds: 15 clocks (2.5 + 12.5) at 60
    /// MHz.
    const CONVERSION_US: f64 = 0.25;

    /// Time constant of a phototransistor on its load in microseconds.
    ///
    /// The constant is the base capacitance times the load as the base sees it, so that it grows
    /// with the load.
    #[must_use]
    pub fn time_constant_us(&self) -> f64 {
        let of_load = || Self::RISE_US / 9f64.ln() * self.electronics.load_ohm / 1000.0;
        self.electronics.time_constant_us.unwrap_or_else(of_load)
    }

    /// Number of conversions per reading; by default 1 for 12 bits and 16 for 16.
    #[must_use]
    pub fn oversampling(&self) -> u16 {
        let usual = match self.device.bits {
            Bits::Twelve => 1,
            Bits::Sixteen => 16,
        };
        self.electronics.oversampling.as_ref().map_or(usual, |ratio| ratio.get_ref().0)
    }

    /// Duration of a reading's conversions in microseconds; they come at the end of its step.
    #[must_use]
    pub fn sampling_us(&self) -> f64 {
        Self::CONVERSION_US * f64::from(self.oversampling())
    }

    /// Amplitude of the supply's ripple as a share of nominal; 0 without the effect.
    #[must_use]
    pub fn ripple(&self) -> f64 {
        if self.has(Effect::SupplyRipple) { self.electronics.ripple_ratio } else { 0.0 }
    }
}

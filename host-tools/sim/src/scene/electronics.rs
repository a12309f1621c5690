//! The table of a scene that says what stands between a photocurrent or a bridge and its code.

use serde::{Deserialize, Deserializer};
use toml::Spanned;

use super::{Bits, Effect, Scene};
use crate::ranges;

/// `[electronics]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Electronics {
    /// What turns the photocurrent of a column into a voltage, in ohms.
    #[serde(deserialize_with = "ranges::load")]
    pub load_ohm: f64,
    /// Amplifier between load and converter.
    pub pga_gain: PgaGain,
    /// [`Scene::time_constant_us`].
    #[serde(deserialize_with = "given_time_constant")]
    time_constant_us: Option<f64>,
    /// [`Scene::oversampling`].
    pub(super) oversampling: Option<Spanned<Oversampling>>,
    /// Gain of the amplifiers of the bridges' midpoints about half the supply.
    #[serde(deserialize_with = "ranges::bridge_gain")]
    pub bridge_gain: f64,
    /// The converter's reference is the supply of bridges and LEDs; otherwise it is a voltage of its own
    /// that does not follow the supply.
    pub ratiometric: bool,
    /// Amplitude of the supply's swing as a share of it; with the effect `supply-ripple`.
    #[serde(deserialize_with = "ranges::swing")]
    pub ripple_ratio: f64,
    /// Frequency of the swing.
    #[serde(deserialize_with = "ranges::ripple")]
    pub ripple_hz: f64,
}

impl Default for Electronics {
    fn default() -> Self {
        Self {
            // The load of the SFH 3010's data sheet.
            load_ohm: 1000.0,
            // What 60 µA of a pair at rest need to be a third of the range.
            pga_gain: PgaGain(16),
            time_constant_us: None,
            oversampling: None,
            // Bare, a newton would move a 12-bit code by 17 steps only; sixteenfold, 2 N anywhere on
            // the pad still stay within a quarter of the supply (tested).
            bridge_gain: 16.0,
            ratiometric: true,
            // A linear regulator behind a rectifier leaves some millivolts of 5 V.
            ripple_ratio: 0.001,
            ripple_hz: 100.0,
        }
    }
}

/// Gain of an amplifier that a microcontroller has on its chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PgaGain(u16);

impl PgaGain {
    /// How many times the voltage.
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

/// How many conversions make a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Oversampling(u16);

impl<'de> Deserialize<'de> for Oversampling {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        ranges::one_of(from, &[1, 2, 4, 8, 16, 32, 64, 128, 256]).map(Self)
    }
}

/// A key that may be left out keeps its range when it is there.
fn given_time_constant<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    ranges::time_constant(from).map(Some)
}

impl Scene {
    /// Rise and fall of the SFH 3010 at 1 mA, 5 V and 1 kΩ: 7 µs from 10 % to 90 % (its data sheet); taken
    /// to hold at the smaller current here, for which the sheet has no figure.
    const RISE_US: f64 = 7.0;
    /// STM32G431: one conversion at 60 MHz, 2.5 + 12.5 clocks.
    const CONVERSION_US: f64 = 0.25;

    /// Time constant of a phototransistor on its load in microseconds. It is the base capacitance times
    /// the load as the base sees it, so that it grows with the load.
    #[must_use]
    pub fn time_constant_us(&self) -> f64 {
        let of_load = || Self::RISE_US / 9f64.ln() * self.electronics.load_ohm / 1000.0;
        self.electronics.time_constant_us.unwrap_or_else(of_load)
    }

    /// How many conversions make a reading: what the scene says, or else 1 for 12 bits and 16 for 16.
    #[must_use]
    pub fn oversampling(&self) -> u16 {
        let usual = match self.device.bits {
            Bits::Twelve => 1,
            Bits::Sixteen => 16,
        };
        self.electronics.oversampling.as_ref().map_or(usual, |ratio| ratio.get_ref().0)
    }

    /// How long a reading's conversions take; they come at the end of its step.
    #[must_use]
    pub fn sampling_us(&self) -> f64 {
        Self::CONVERSION_US * f64::from(self.oversampling())
    }

    /// Share of nominal by which the supply swings.
    #[must_use]
    pub fn ripple(&self) -> f64 {
        if self.has(Effect::SupplyRipple) { self.electronics.ripple_ratio } else { 0.0 }
    }
}

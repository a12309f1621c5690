//! Conditioning of codes into signals: dark subtraction, normalisation, bias and channel health.
//!
//! ```text
//! Codes ──Levels::read, TemperatureCompensation::correct──▶ Levels ──Bias::apply──▶ Signals
//! ```
//! [`Levels`] are absolute fractions of full scale and need no calibration. [`Signals`] are changes
//! against the unloaded finger and need a [`Bias`]. [`DriftCompensation`] and [`LagCompensation`]
//! serve records that have them, and the low-pass filter runs only if the host has asked for it.
//! [`Bias::direct`] converts codes to signals in one pass and serves most scans.

mod bias;
mod direct;
mod drift;
mod jump;
mod lag;
mod levels;
mod low_pass;
mod noise;
mod ragged;
#[cfg(test)]
pub(crate) mod random;
mod stuck;
mod warmth;

pub(crate) use bias::NOISE_LIMIT;
pub use bias::{Bias, BiasRefusal, BiasTaker, BridgeBias, NOISE_FLOOR, Taken, TaxelBias};
pub use drift::{Drift, DriftCompensation};
pub use jump::JumpWatch;
pub(crate) use lag::LAG_PARTS;
pub use lag::{LagCompensation, LagState};
pub use levels::{BridgeLevels, DEAD_LEVEL, Levels, MIDPOINT_MARGIN, TaxelLevels};
pub use low_pass::{LowPass, LowPassState};
pub use noise::NoiseWatch;
pub use stuck::StuckWatch;
pub use warmth::{PER_KELVIN, TemperatureCompensation, Thermometer, Warm};

use serde::{Deserialize, Serialize};

use crate::scan::{SENSORS, TAXELS};

/// Changes of every channel against the unloaded finger, as fractions of full scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Signals {
    /// Signals c_k of [DeMaria2011]: **negative when the facet came nearer**, positive when it
    /// moved away.
    pub taxels: Option<[f32; TAXELS]>,
    /// Signals u − b of [Ospina2017] of each sensor: x, y, z.
    pub bridges: [Option<[f32; 3]>; SENSORS],
    /// Faulty channels.
    pub health: Health,
}

impl Signals {
    /// Signals of a finger without channels.
    pub(crate) const NOTHING: Self =
        Self { taxels: None, bridges: [None; SENSORS], health: Health::SOUND };
}

/// Channel faults of one scan, one bit per channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Health {
    /// Bit k: taxel k is clipped, lit or dark.
    pub saturated: u16,
    /// Bit k: taxel k sees (almost) none of its LED's light, or its code is stuck, or
    /// jumps or is noisy alone.
    pub dead: u16,
    /// Bit i: the bridge of sensor i is faulty. A midpoint is too near a rail, a code is stuck, or
    /// jumps or is noisy alone, or the mean of the four is not about half the supply.
    pub bridge_faults: u8,
}

impl Health {
    /// No channel is faulty.
    pub const SOUND: Self = Self { saturated: 0, dead: 0, bridge_faults: 0 };
}

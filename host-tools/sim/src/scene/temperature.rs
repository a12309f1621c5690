//! Table `[temperature]` of a scene: the temperature of the finger over time.

use serde::Deserialize;

use crate::ranges;

/// Reference temperature in °C: every property has its listed value, and `[temperature]` left out
/// means this.
pub const REFERENCE_C: f64 = 25.0;
/// 0 °C in kelvin.
pub const ZERO_C: f64 = 273.15;

/// `[temperature]`: one value, a straight ramp, another value; with the effect `temperature`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Temperature {
    /// First temperature in °C.
    #[serde(deserialize_with = "ranges::celsius")]
    pub start_c: f64,
    /// Last temperature in °C.
    #[serde(deserialize_with = "ranges::celsius")]
    pub end_c: f64,
    /// Start of the ramp in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub from_s: f64,
    /// Duration of the ramp in seconds; a short one is a step.
    #[serde(deserialize_with = "ranges::seconds")]
    pub ramp_s: f64,
}

impl Default for Temperature {
    fn default() -> Self {
        Self { start_c: REFERENCE_C, end_c: REFERENCE_C, from_s: 0.0, ramp_s: 1.0 }
    }
}

impl Temperature {
    /// Temperature at `time` seconds, in °C.
    #[must_use]
    pub fn at(&self, time: f64) -> f64 {
        let done = ((time - self.from_s) / self.ramp_s).clamp(0.0, 1.0);
        self.start_c + (self.end_c - self.start_c) * done
    }
}

/// Displacement at `celsius` over the displacement at the reference temperature, under the same
/// force.
///
/// The ratio falls with temperature because the stiffness of a rubber grows with its absolute
/// temperature.
#[must_use]
pub fn softness(celsius: f64) -> f64 {
    (REFERENCE_C + ZERO_C) / (celsius + ZERO_C)
}

//! Table `[light]` of a scene: the light of the room.

use serde::Deserialize;

use crate::ranges;

/// `[light]`, as fractions of the converter's range at each column.
///
/// The fractions hold on a load of 1 kΩ amplified sixteenfold.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Light {
    /// Steady part; with the effect `ambient`.
    #[serde(deserialize_with = "ranges::ratio")]
    pub ambient_ratio: f64,
    /// Light of the lamps, with the effect `flicker`: mean and amplitude of its swing.
    #[serde(deserialize_with = "ranges::ratio")]
    pub flicker_ratio: f64,
    /// Frequency of the lamps in hertz: twice the mains frequency.
    #[serde(deserialize_with = "ranges::lamps")]
    pub flicker_hz: f64,
    /// Light of the sun; with the effect `sun`.
    #[serde(deserialize_with = "ranges::ratio")]
    pub sun_ratio: f64,
    /// Time at which the sun comes out, in seconds.
    #[serde(deserialize_with = "ranges::moment")]
    pub sun_at_s: f64,
}

impl Default for Light {
    fn default() -> Self {
        // The black rubber lets little light in, and the light through its rim swings by a tenth.
        // The sun is ten times as bright as a room, with much infrared.
        Self {
            ambient_ratio: 0.02,
            flicker_ratio: 0.002,
            flicker_hz: 100.0,
            sun_ratio: 0.2,
            sun_at_s: 0.0,
        }
    }
}

//! The table of a scene that says which finger it is.

use serde::Deserialize;
use taxel::scan::SENSORS;

use crate::response::Coating;

/// `[device]`
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Device {
    /// Which individual: its gains, offsets and mismatches follow from this number.
    pub seed: u64,
    /// Resolution of the codes.
    pub bits: Bits,
    /// The optical matrix is there.
    pub taxels: bool,
    /// Which force sensors are there.
    pub bridges: [bool; SENSORS],
    /// What covers the force sensors; with the effect `response`.
    pub coating: Coating,
}

impl Default for Device {
    fn default() -> Self {
        Self {
            seed: 1,
            bits: Bits::Sixteen,
            taxels: true,
            bridges: [true; SENSORS],
            coating: Coating::Bare,
        }
    }
}

/// Resolution of the codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "u8")]
pub enum Bits {
    /// Single conversions.
    Twelve,
    /// Means of sixteen conversions, scaled to 65535.
    Sixteen,
}

impl TryFrom<u8> for Bits {
    type Error = String;

    fn try_from(bits: u8) -> Result<Self, String> {
        match bits {
            12 => Ok(Self::Twelve),
            16 => Ok(Self::Sixteen),
            _ => Err(format!("{bits} bits; allowed are 12 and 16")),
        }
    }
}

//! The table of a scene that says which finger it is.

use serde::Deserialize;
use taxel::scan::{COLS, ROWS, SENSORS, TAXELS};

use crate::response::Coating;

/// `[device]`
#[derive(Clone, Debug, Deserialize)]
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
    /// Pairs assembled so near to their facets that they work on the wrong side of their light curve.
    pub wrong_side: Vec<Taxel>,
}

impl Default for Device {
    fn default() -> Self {
        Self {
            seed: 1,
            bits: Bits::Sixteen,
            taxels: true,
            bridges: [true; SENSORS],
            coating: Coating::Bare,
            wrong_side: Vec::new(),
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

/// A taxel by its row and column, `r0c0` to `r3c3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct Taxel(usize);

impl Taxel {
    /// Its number in row-major order.
    #[must_use]
    pub fn index(self) -> usize {
        self.0
    }
}

impl TryFrom<String> for Taxel {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        (0..TAXELS).find(|k| name == format!("r{}c{}", k / COLS, k % COLS)).map(Self).ok_or_else(
            || format!("no taxel `{name}`; allowed are r0c0 to r{}c{}", ROWS - 1, COLS - 1),
        )
    }
}

//! What the host loads into the board's PSRAM, and the board plays back as if its ADC had read it: a
//! [`Header`], then the scans, all in postcard.
//!
//! Both sides compile this one file (the host's is `taxel-link`), so that they cannot disagree.

use serde::{Deserialize, Serialize};
use taxel::units::FullScale;

/// Where the PSRAM begins.
pub const ADDRESS: usize = 0x2100_0000;
/// How much the PSRAM holds.
pub const CAPACITY: usize = 16 << 20;

/// What every image starts with. An emulator without one has zeros there.
pub const MAGIC: [u8; 4] = *b"TXLI";
/// Version of all that follows.
pub const VERSION: u8 = 1;

/// How to play the scans back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// [`MAGIC`].
    pub magic: [u8; 4],
    /// [`VERSION`].
    pub version: u8,
    /// As fast as the link takes them, instead of at their own times.
    pub lossless: bool,
    /// Scans a second, as they were taken.
    pub scan_hz: u16,
    /// What the codes are fractions of.
    pub full_scale: FullScale,
    /// How many scans follow.
    pub scans: u32,
}

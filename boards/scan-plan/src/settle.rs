//! How long a step must wait before its columns are read.

/// 10–90 % rise time of an SFH3010 on a load of 1 kΩ, in nanoseconds (data sheet).
pub const RISE_NS: u32 = 7_000;

/// Nanoseconds until a first-order response with this 10–90 % rise time is within a step of a
/// converter of `bits` bits: τ = t_r / ln 9, wait τ · ln 2^bits.
///
/// The quotient ln 2 / ln 9 is 0.315465; it is rounded up.
#[must_use]
pub const fn settle_ns(rise_ns: u32, bits: u32) -> u32 {
    (rise_ns as u64 * bits as u64 * 315_465).div_ceil(1_000_000) as u32
}

/// The default: an SFH3010 settled to 12 bits, 26.5 µs.
pub const DEFAULT_NS: u32 = settle_ns(RISE_NS, 12);

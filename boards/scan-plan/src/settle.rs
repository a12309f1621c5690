//! Settle time of the columns in a step.

/// Rise time (10–90 %) of an SFH3010 on a load of 1 kΩ, in nanoseconds (data sheet).
pub const RISE_NS: u32 = 7_000;

/// Settle time in nanoseconds of a first-order response to one code of `bits` bits.
///
/// From the rise time (10–90 %): τ = t_r / ln 9, and the wait is τ · ln 2^bits. The quotient ln 2 /
/// ln 9 is rounded up to 0.315465.
#[must_use]
pub const fn settle_ns(rise_ns: u32, bits: u32) -> u32 {
    (rise_ns as u64 * bits as u64 * 315_465).div_ceil(1_000_000) as u32
}

/// Default settle time: an SFH3010 to 12 bits, 26.5 µs.
pub const DEFAULT_NS: u32 = settle_ns(RISE_NS, 12);

/// Load of a column on the boards, in ohms.
pub const LOAD_OHM: u32 = 680;

/// Settle time to 12 bits on the boards' load, 18.0 µs: the shortest for a fast scan.
///
/// The rise time is in proportion to the load here; the data sheet states it for 1 kΩ only.
pub const ON_LOAD_NS: u32 = settle_ns(RISE_NS / 1000 * LOAD_OHM, 12);

//! Settle time of the columns in a step.

use crate::finger::REFERENCE;

/// Default settle time: that of an SFH3010 on its data sheet's load, to 12 bits, 26.5 µs.
pub const DEFAULT_NS: u32 = REFERENCE.converter.settle_ns;

/// Settle time of the reference finger's columns to 12 bits: the shortest for a fast scan.
pub const ON_LOAD_NS: u32 = REFERENCE.settles_ns();

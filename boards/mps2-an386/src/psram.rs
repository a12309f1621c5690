//! The 16 MB PSRAM, which the host fills before reset.

use core::ptr::with_exposed_provenance;
use core::slice;

use crate::image::{ADDRESS, CAPACITY};

/// All of it: what the host loaded, then zeros.
pub fn contents() -> &'static [u8] {
    // SAFETY: memory.x keeps the linker out of this range, the loader writes it before reset, and
    // nothing in the firmware or the emulator writes it after.
    unsafe { slice::from_raw_parts(with_exposed_provenance(ADDRESS), CAPACITY) }
}

//! Memory in place of the flash pages that survive power-off.

use core::ptr::with_exposed_provenance_mut;
use core::slice;

use taxel::store::RamFlash;

/// Where memory.x ends the FLASH region: the last 12 KB of the board's first memory.
const ADDRESS: usize = 0x003F_D000;

/// Flash that is erased at power-up: here nothing survives it.
pub type Nor = RamFlash<&'static mut [u8]>;

/// The flash. Call it once.
pub fn erased() -> Nor {
    // SAFETY: memory.x keeps the linker out of this range and nothing else in the firmware names it; it is
    // called once, so that there is one reference.
    RamFlash::new(unsafe {
        slice::from_raw_parts_mut(with_exposed_provenance_mut(ADDRESS), RamFlash::SIZE)
    })
}

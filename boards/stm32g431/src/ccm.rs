//! Start-up copy of the CCM SRAM's contents.

use core::ptr;

unsafe extern "C" {
    static mut __sccm: u32;
    static __eccm: u32;
    static __siccm: u32;
}

/// Copies code from flash into the CCM SRAM (`ccm.x`).
///
/// Call it before any of that code runs, which includes all copying. The CCM keeps its contents
/// over a reset and holds anything after power-up.
pub fn load() {
    let (mut to, mut from) = (&raw mut __sccm, &raw const __siccm);
    // SAFETY: the linker has reserved as many words on both sides; nothing else uses them yet.
    // Volatile, so that the compiler does not call a copy function that is not there yet.
    unsafe {
        while to.cast_const() < &raw const __eccm {
            ptr::write_volatile(to, ptr::read_volatile(from));
            (to, from) = (to.add(1), from.add(1));
        }
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

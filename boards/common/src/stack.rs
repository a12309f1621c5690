//! How deep the stack has been.

use core::ptr;

unsafe extern "C" {
    /// End of the statics; the stack grows down towards it.
    static __sheap: u32;
    static _stack_start: u32;
}

/// The most bytes of stack in use at any time since reset, interrupts included.
#[must_use]
pub fn deepest() -> usize {
    let mut word = &raw const __sheap;
    let top = &raw const _stack_start;
    // SAFETY: cortex-m-rt has painted every word between the two symbols, and all of them lie in RAM.
    // Volatile, because the compiler knows nothing of what was written there.
    while word < top && unsafe { ptr::read_volatile(word) } == cortex_m_rt::STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    top.addr() - word.addr()
}

/// All the bytes that there are for the stack.
#[must_use]
pub fn size() -> usize {
    (&raw const _stack_start).addr() - (&raw const __sheap).addr()
}

//! Measurement of the stack's greatest depth.

use core::ptr;

unsafe extern "C" {
    /// Lowest address of the stack, which grows down towards it.
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Most bytes of stack in use at any time since reset, interrupts included.
#[must_use]
pub fn deepest() -> usize {
    let mut word = &raw const _stack_end;
    let top = &raw const _stack_start;
    // SAFETY: cortex-m-rt has painted every word between the two symbols, and all of them lie in
    // RAM. Volatile, because the compiler does not know what was written there.
    while word < top && unsafe { ptr::read_volatile(word) } == cortex_m_rt::STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    top.addr() - word.addr()
}

/// Size of the stack, bytes.
#[must_use]
pub fn size() -> usize {
    (&raw const _stack_start).addr() - (&raw const _stack_end).addr()
}

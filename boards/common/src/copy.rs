//! Copies of memory. Those that come with the compiler take a stack frame, three loops and, where an end is
//! not aligned, bytes: for a scan's 266 bytes as long as all else that its interrupt does.

use core::arch::naked_asm;

/// Copies `length` bytes, sixteen at a time. What is not aligned is copied by single loads and stores, which
/// on this core need not be (ARMv7-M ARM, A3.2.1).
///
/// `__aeabi_memcpy4` and `__aeabi_memcpy8` are its second and third name (RTABI §4.3.4): their places are
/// aligned.
///
/// # Safety
/// As for `memcpy`: both places are there, and apart.
#[unsafe(naked)]
#[unsafe(no_mangle)]
#[cfg_attr(feature = "ccm", unsafe(link_section = ".ccm.copy"))]
unsafe extern "C" fn __aeabi_memcpy(to: *mut u8, from: *const u8, length: usize) {
    naked_asm!(
        ".globl __aeabi_memcpy4",
        ".type __aeabi_memcpy4, %function",
        ".globl __aeabi_memcpy8",
        ".type __aeabi_memcpy8, %function",
        "orr r3, r0, r1",
        "lsls r3, r3, #30",
        "beq __aeabi_memcpy4",
        // Single loads and stores.
        "subs r2, r2, #16",
        "blo 3f",
        "2:",
        "ldr r3, [r1]",
        "ldr r12, [r1, #4]",
        "str r3, [r0]",
        "str r12, [r0, #4]",
        "ldr r3, [r1, #8]",
        "ldr r12, [r1, #12]",
        "str r3, [r0, #8]",
        "str r12, [r0, #12]",
        "adds r1, r1, #16",
        "adds r0, r0, #16",
        "subs r2, r2, #16",
        "bhs 2b",
        "b 3f",
        // Four words at once.
        "__aeabi_memcpy4:",
        "__aeabi_memcpy8:",
        "subs r2, r2, #16",
        "blo 3f",
        "push {{r4, r5}}",
        "2:",
        "ldmia r1!, {{r3, r4, r5, r12}}",
        "subs r2, r2, #16",
        "stmia r0!, {{r3, r4, r5, r12}}",
        "bhs 2b",
        "pop {{r4, r5}}",
        // What is left, by the bits of its length: eight and four, then two and one.
        "3:",
        "lsls r3, r2, #29",
        "itttt cs",
        "ldrcs r3, [r1], #4",
        "ldrcs r12, [r1], #4",
        "strcs r3, [r0], #4",
        "strcs r12, [r0], #4",
        "itt mi",
        "ldrmi r3, [r1], #4",
        "strmi r3, [r0], #4",
        "lsls r2, r2, #31",
        "itt cs",
        "ldrhcs r3, [r1], #2",
        "strhcs r3, [r0], #2",
        "itt mi",
        "ldrbmi r3, [r1]",
        "strbmi r3, [r0]",
        "bx lr",
    )
}

//! Memory copies and clears, faster and smaller than the compiler's.
//!
//! The compiler's versions take a stack frame, three loops and, at unaligned ends, single bytes. A
//! scan's interrupt would spend half of its time in them. They are also unrolled and take 2 KB of
//! flash; these take 250 bytes.

use core::arch::naked_asm;

/// Copies `length` bytes, sixteen at a time.
///
/// Unaligned data use single loads and stores, which this core allows (ARMv7-M ARM, A3.2.1).
/// `__aeabi_memcpy4` and `__aeabi_memcpy8` are entries for aligned addresses (RTABI §4.3.4).
///
/// # Safety
/// As for `memcpy`: both ranges exist and do not overlap.
#[unsafe(naked)]
#[unsafe(no_mangle)]
#[cfg_attr(feature = "ccm", unsafe(link_section = ".ccm.copy"))]
unsafe extern "C" fn __aeabi_memcpy(to: *mut u8, from: *const u8, length: usize) {
    naked_asm!(
        ".globl __aeabi_memcpy4",
        ".type __aeabi_memcpy4, %function",
        ".globl __aeabi_memcpy8",
        ".type __aeabi_memcpy8, %function",
        // The USB driver copies two bytes at a time.
        "cmp r2, #4",
        "blo 4f",
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
        // The rest, by the bits of its length: eight and four, then two and one.
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
        "4:",
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

/// Copies `length` bytes that may overlap.
///
/// Forward copies use [`__aeabi_memcpy`], which reads bytes before it overwrites them. Backward
/// copies, which are rare, go byte by byte.
///
/// # Safety
/// As for `memmove`: both ranges exist.
#[unsafe(naked)]
#[unsafe(no_mangle)]
#[cfg_attr(feature = "ccm", unsafe(link_section = ".ccm.copy"))]
unsafe extern "C" fn __aeabi_memmove(to: *mut u8, from: *const u8, length: usize) {
    naked_asm!(
        ".globl __aeabi_memmove4",
        ".type __aeabi_memmove4, %function",
        ".globl __aeabi_memmove8",
        ".type __aeabi_memmove8, %function",
        "__aeabi_memmove4:",
        "__aeabi_memmove8:",
        // The destination starts inside the source, or not.
        "subs r3, r0, r1",
        "cmp r3, r2",
        "bhs __aeabi_memcpy",
        "adds r0, r0, r2",
        "adds r1, r1, r2",
        "cbz r2, 3f",
        "2:",
        "ldrb r3, [r1, #-1]!",
        "subs r2, r2, #1",
        "strb r3, [r0, #-1]!",
        "bne 2b",
        "3:",
        "bx lr",
    )
}

/// Clears `length` bytes, sixteen at a time.
///
/// # Safety
/// The range exists.
#[unsafe(naked)]
#[unsafe(no_mangle)]
#[cfg_attr(feature = "ccm", unsafe(link_section = ".ccm.copy"))]
unsafe extern "C" fn __aeabi_memclr(to: *mut u8, length: usize) {
    naked_asm!(
        ".globl __aeabi_memclr4",
        ".type __aeabi_memclr4, %function",
        ".globl __aeabi_memclr8",
        ".type __aeabi_memclr8, %function",
        "__aeabi_memclr4:",
        "__aeabi_memclr8:",
        "movs r2, #0",
        "subs r1, r1, #16",
        "blo 3f",
        "2:",
        "str r2, [r0]",
        "str r2, [r0, #4]",
        "str r2, [r0, #8]",
        "str r2, [r0, #12]",
        "adds r0, r0, #16",
        "subs r1, r1, #16",
        "bhs 2b",
        "3:",
        "lsls r3, r1, #29",
        "itt cs",
        "strcs r2, [r0], #4",
        "strcs r2, [r0], #4",
        "it mi",
        "strmi r2, [r0], #4",
        "lsls r3, r1, #31",
        "it cs",
        "strhcs r2, [r0], #2",
        "it mi",
        "strbmi r2, [r0]",
        "bx lr",
    )
}

//! Steps of the net, and the square root, in Cortex-M4 instructions that Rust has no operation for.
//!
//! SMLAD adds two 16-bit products to a sum, VCVT clips to 16 bits, and VSQRT takes a root in 14
//! cycles, which `core` offers no stable function for. Results equal those of
//! `portable.rs` bit for bit: `cargo xtask cycles` compares them on an emulated core for ten
//! thousand inputs.
//!
//! This and the square root of x86-64 are all of the `unsafe` below the boards. It saves a third of
//! the net's time, and is written
//! as assembly because LLVM's own pass loads both factors of an SMLAD again for each product, which
//! costs more than it saves, and because the intrinsics are not stable. Each block reads the memory
//! of the references passed to it, word by word and each word once; one block also reads tanh's
//! table. It writes only the registers that it names: no memory, no stack. SMLAD may set Q and VCVT
//! the cumulative flags of the FPSCR, which no block claims to preserve and nothing reads.
#![allow(unsafe_code, reason = "inline assembly")]

use core::arch::asm;

use crate::tanh::TABLE;
use crate::{Group, Input, Lanes, OUTPUTS, Rows};

/// Multiplies four columns of four rows: r0–r3 weights; r4, r5, r8, r9 sums; r10, r11 two words of
/// x.
macro_rules! four_columns_of_group {
    () => {
        "ldrd r10, r11, [lr], #8
        ldmia r12!, {{r0-r3}}
        smlad r4, r0, r10, r4
        smlad r4, r1, r11, r4
        smlad r5, r2, r10, r5
        smlad r5, r3, r11, r5
        ldmia r12!, {{r0-r3}}
        smlad r8, r0, r10, r8
        smlad r8, r1, r11, r8
        smlad r9, r2, r10, r9
        smlad r9, r3, r11, r9"
    };
}

/// Computes tanh of a register's sum into its upper half, as `whole_tanh` does.
///
/// r10 is the shift, r11 the table, r12 the middle of a step.
#[rustfmt::skip]
macro_rules! bent {
    ($sum:literal) => {
        concat!(
            "asr ", $sum, ", ", $sum, ", r10\n",
            "ssat ", $sum, ", #22, ", $sum, "\n",
            "ubfx r0, ", $sum, ", #13, #9\n",
            "ldr r0, [r11, r0, lsl #2]\n",
            "eor ", $sum, ", r12, ", $sum, ", lsl #3\n",
            "smlabb ", $sum, ", r0, ", $sum, ", r0",
        )
    };
}

/// Activations h = tanh(W·x + a) of four hidden units.
#[inline(always)]
#[must_use]
pub fn activations(group: &Group, input: &Input) -> [u32; 2] {
    let (low, high);
    // SAFETY: reads the 16 bytes of the group's bias and the 128 of its weights behind it, the 32
    // of x and the shift behind it (`repr(C)` both), and the table at indices of nine bits, which
    // are its 512 words. All are words, and aligned as such. Writes only registers.
    unsafe {
        asm!(
            "ldmia r12!, {{r4, r5, r8, r9}}",
            four_columns_of_group!(),
            four_columns_of_group!(),
            four_columns_of_group!(),
            four_columns_of_group!(),
            "ldr r10, [lr]",
            "movw r11, #:lower16:{table}",
            "movt r11, #:upper16:{table}",
            "mov r12, #0x8000",
            bent!("r4"), bent!("r5"), bent!("r8"), bent!("r9"),
            "pkhtb r4, r5, r4, asr #16",
            "pkhtb r5, r9, r8, asr #16",
            table = sym TABLE,
            inout("r12") group => _,
            inout("lr") input => _,
            out("r4") low, out("r5") high,
            out("r0") _, out("r1") _, out("r2") _, out("r3") _,
            out("r8") _, out("r9") _, out("r10") _, out("r11") _,
            options(pure, readonly, nostack),
        );
    }
    [low, high]
}

/// Multiplies four columns of three rows: r0–r2 weights; r3, r4, r5 sums; r8, r9 two words of x.
macro_rules! four_columns_of_outputs {
    () => {
        "ldrd r8, r9, [lr], #8
        ldmia r12!, {{r0-r2}}
        smlad r3, r0, r8, r3
        smlad r3, r1, r9, r3
        smlad r4, r2, r8, r4
        ldmia r12!, {{r0-r2}}
        smlad r4, r0, r9, r4
        smlad r5, r1, r8, r5
        smlad r5, r2, r9, r5"
    };
}

/// Output sums plus V·h, or plus L·x.
#[inline(always)]
#[must_use]
pub fn sums_of_outputs(
    rows: &Rows<OUTPUTS>,
    h: &Lanes,
    [mut a, mut b, mut c]: [i32; OUTPUTS],
) -> [i32; OUTPUTS] {
    // SAFETY: reads the 96 bytes of the rows and the 32 of h; words, and aligned as such. Writes
    // only registers.
    unsafe {
        asm!(
            four_columns_of_outputs!(),
            four_columns_of_outputs!(),
            four_columns_of_outputs!(),
            four_columns_of_outputs!(),
            inout("r12") rows => _,
            inout("lr") h => _,
            inout("r3") a, inout("r4") b, inout("r5") c,
            out("r0") _, out("r1") _, out("r2") _, out("r8") _, out("r9") _,
            options(pure, readonly, nostack),
        );
    }
    [a, b, c]
}

/// Scales eight signals, rounds towards zero and clips to 16 bits; a NaN becomes 0.
#[inline(always)]
#[must_use]
pub fn narrowed(c: &[f32; 8], scale: f32) -> [[u32; 2]; 2] {
    let (first, second, third, fourth);
    // SAFETY: reads the 32 bytes of the signals; words, and aligned as such. Writes only registers.
    // The scale comes in a core register, because stable rustc takes no operand in one of the
    // floating-point unit's.
    unsafe {
        asm!(
            "vmov s8, {scale}",
            "vldmia {c}, {{s0-s7}}",
            "vmul.f32 s0, s0, s8
            vmul.f32 s1, s1, s8
            vmul.f32 s2, s2, s8
            vmul.f32 s3, s3, s8
            vmul.f32 s4, s4, s8
            vmul.f32 s5, s5, s8
            vmul.f32 s6, s6, s8
            vmul.f32 s7, s7, s8",
            "vcvt.s16.f32 s0, s0, #0
            vcvt.s16.f32 s1, s1, #0
            vcvt.s16.f32 s2, s2, #0
            vcvt.s16.f32 s3, s3, #0
            vcvt.s16.f32 s4, s4, #0
            vcvt.s16.f32 s5, s5, #0
            vcvt.s16.f32 s6, s6, #0
            vcvt.s16.f32 s7, s7, #0",
            "vmov {first}, {high}, s0, s1",
            "pkhbt {first}, {first}, {high}, lsl #16",
            "vmov {second}, {high}, s2, s3",
            "pkhbt {second}, {second}, {high}, lsl #16",
            "vmov {third}, {high}, s4, s5",
            "pkhbt {third}, {third}, {high}, lsl #16",
            "vmov {fourth}, {high}, s6, s7",
            "pkhbt {fourth}, {fourth}, {high}, lsl #16",
            c = in(reg) c,
            scale = in(reg) scale.to_bits(),
            first = out(reg) first, second = out(reg) second,
            third = out(reg) third, fourth = out(reg) fourth,
            high = out(reg) _,
            out("s0") _, out("s1") _, out("s2") _, out("s3") _, out("s4") _,
            out("s5") _, out("s6") _, out("s7") _, out("s8") _,
            options(pure, readonly, nostack),
        );
    }
    [[first, second], [third, fourth]]
}

/// Square root of a positive finite number, rounded to nearest.
#[inline(always)]
#[must_use]
pub fn sqrt(x: f32) -> f32 {
    let root;
    // SAFETY: reads and writes only registers.
    unsafe {
        asm!(
            "vmov s0, {x}",
            "vsqrt.f32 s0, s0",
            "vmov {x}, s0",
            x = inout(reg) x.to_bits() => root,
            out("s0") _,
            options(pure, nomem, nostack),
        );
    }
    f32::from_bits(root)
}

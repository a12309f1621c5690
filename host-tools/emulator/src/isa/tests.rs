//! Every class of instruction, as an assembler encodes it.

use super::Class::*;
use super::Flow::*;
use super::*;

fn decode(halves: &[u16]) -> Option<Instruction> {
    let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
    Instruction::decode(&code)
}

/// `llvm-mc --triple=thumbv7em-none-eabihf --show-encoding` gave the encodings; class and flow are
/// the manual's.
const ASSEMBLED: &[(&str, &[u16], Class, Flow)] = &[
    ("movs r0, #5", &[0x2005], Simple, Next),
    ("lsls r1, r2, #3", &[0x00d1], Simple, Next),
    ("muls r0, r1, r0", &[0x4348], Simple, Next),
    ("add r8, r9", &[0x44c8], Simple, Next),
    ("mov pc, lr", &[0x46f7], Simple, Elsewhere),
    ("bx lr", &[0x4770], Simple, Elsewhere),
    ("blx r3", &[0x4798], Simple, Elsewhere),
    ("cmp r0, r9", &[0x4548], Simple, Next),
    ("ldr r0, [pc, #8]", &[0x4802], Load, Next),
    ("ldr r0, [r1, r2]", &[0x5888], Load, Next),
    ("strh r0, [r1, r2]", &[0x5288], Store, Next),
    ("ldrsh r3, [r4, r5]", &[0x5f63], Load, Next),
    ("ldr r0, [r1, #4]", &[0x6848], Load, Next),
    ("strb r0, [r1, #4]", &[0x7108], Store, Next),
    ("ldrh r0, [r1, #4]", &[0x8888], Load, Next),
    ("str r0, [sp, #4]", &[0x9001], Store, Next),
    ("ldr r0, [sp, #4]", &[0x9801], Load, Next),
    ("add r0, sp, #8", &[0xa802], Simple, Next),
    ("sub sp, #16", &[0xb084], Simple, Next),
    ("cbz r0, #8", &[0xb120], Simple, Maybe),
    ("cbnz r0, #8", &[0xb920], Simple, Maybe),
    ("uxth r0, r1", &[0xb288], Simple, Next),
    ("push {r4, r5, lr}", &[0xb530], Words(3), Next),
    ("pop {r4, r5}", &[0xbc30], Words(2), Next),
    ("pop {r4, r5, pc}", &[0xbd30], Words(3), Elsewhere),
    ("cpsid i", &[0xb672], Special, Next),
    ("rev r0, r1", &[0xba08], Simple, Next),
    ("bkpt #171", &[0xbeab], Simple, Next),
    ("nop", &[0xbf00], Simple, Next),
    ("it eq", &[0xbf08], Simple, Next),
    ("moveq r0, r1", &[0x4608], Simple, Next),
    ("ittee ne", &[0xbf19], Simple, Next),
    ("movne r0, r1", &[0x4608], Simple, Next),
    ("stm r0!, {r1, r2, r3}", &[0xc00e], Words(3), Next),
    ("ldm r0!, {r1, r2}", &[0xc806], Words(2), Next),
    ("beq #8", &[0xd004], Simple, Maybe),
    ("b #16", &[0xe008], Simple, Elsewhere),
    ("stmdb r9!, {r1, r2, r8}", &[0xe929, 0x0106], Words(3), Next),
    ("ldm.w r9!, {r1, r2, r8, pc}", &[0xe8b9, 0x8106], Words(4), Elsewhere),
    ("ldm.w r9, {r1, r8}", &[0xe899, 0x0102], Words(2), Next),
    ("strd r0, r1, [r2, #8]", &[0xe9c2, 0x0102], Words(2), Next),
    ("ldrd r0, r1, [r2, #8]", &[0xe9d2, 0x0102], Words(2), Next),
    ("ldrex r0, [r1]", &[0xe851, 0x0f00], Load, Next),
    ("strex r0, r1, [r2]", &[0xe842, 0x1000], Store, Next),
    ("tbb [pc, r0]", &[0xe8df, 0xf000], TableBranch, Elsewhere),
    ("tbh [pc, r0, lsl #1]", &[0xe8df, 0xf010], TableBranch, Elsewhere),
    ("and.w r8, r9, r10, lsl #2", &[0xea09, 0x088a], Simple, Next),
    ("add.w r8, r9, #256", &[0xf509, 0x7880], Simple, Next),
    ("movw r8, #4660", &[0xf241, 0x2834], Simple, Next),
    ("ubfx r0, r1, #4, #8", &[0xf3c1, 0x1007], Simple, Next),
    ("bfi r0, r1, #4, #8", &[0xf361, 0x100b], Simple, Next),
    ("usat r0, #8, r1", &[0xf381, 0x0008], Simple, Next),
    ("beq.w #2000", &[0xf000, 0x83e8], Simple, Maybe),
    ("b.w #20000", &[0xf004, 0xbf10], Simple, Elsewhere),
    ("bl #20000", &[0xf004, 0xff10], Simple, Elsewhere),
    ("msr primask, r0", &[0xf380, 0x8810], Special, Next),
    ("mrs r0, primask", &[0xf3ef, 0x8010], Special, Next),
    ("dmb sy", &[0xf3bf, 0x8f5f], Simple, Next),
    ("isb sy", &[0xf3bf, 0x8f6f], Simple, Next),
    ("str.w r8, [r9, #4]", &[0xf8c9, 0x8004], Store, Next),
    ("strb.w r8, [r9, r10, lsl #2]", &[0xf809, 0x802a], Store, Next),
    ("ldr.w r8, [r9, #4]", &[0xf8d9, 0x8004], Load, Next),
    ("ldr.w r8, [r9, r10, lsl #2]", &[0xf859, 0x802a], Load, Next),
    ("ldr.w pc, [r9, #4]", &[0xf8d9, 0xf004], Load, Elsewhere),
    ("ldrsb.w r8, [r9, #1]", &[0xf999, 0x8001], Load, Next),
    ("ldrh.w r8, [r9, #2]", &[0xf8b9, 0x8002], Load, Next),
    ("ldr.w r8, [pc, #16]", &[0xf8df, 0x8010], Load, Next),
    ("pld [r9, #4]", &[0xf899, 0xf004], Simple, Next),
    ("lsl.w r8, r9, r10", &[0xfa09, 0xf80a], Simple, Next),
    ("clz r8, r9", &[0xfab9, 0xf889], Simple, Next),
    ("sadd16 r8, r9, r10", &[0xfa99, 0xf80a], Simple, Next),
    ("uxtab r8, r9, r10", &[0xfa59, 0xf88a], Simple, Next),
    ("mla r8, r9, r10, r11", &[0xfb09, 0xb80a], Simple, Next),
    ("smlabb r8, r9, r10, r11", &[0xfb19, 0xb80a], Simple, Next),
    ("smlad r8, r9, r10, r11", &[0xfb29, 0xb80a], Simple, Next),
    ("smull r8, r9, r10, r11", &[0xfb8a, 0x890b], Simple, Next),
    ("smlald r8, r9, r10, r11", &[0xfbca, 0x89cb], Simple, Next),
    ("umaal r8, r9, r10, r11", &[0xfbea, 0x896b], Simple, Next),
    ("sdiv r8, r9, r10", &[0xfb99, 0xf8fa], Divide, Next),
    ("udiv r8, r9, r10", &[0xfbb9, 0xf8fa], Divide, Next),
    ("vadd.f32 s1, s2, s3", &[0xee71, 0x0a21], Float, Next),
    ("vsub.f32 s1, s2, s3", &[0xee71, 0x0a61], Float, Next),
    ("vmul.f32 s1, s2, s3", &[0xee61, 0x0a21], Float, Next),
    ("vnmul.f32 s1, s2, s3", &[0xee61, 0x0a61], Float, Next),
    ("vmla.f32 s1, s2, s3", &[0xee41, 0x0a21], FloatMultiplyAdd, Next),
    ("vmls.f32 s1, s2, s3", &[0xee41, 0x0a61], FloatMultiplyAdd, Next),
    ("vnmla.f32 s1, s2, s3", &[0xee51, 0x0a61], FloatMultiplyAdd, Next),
    ("vnmls.f32 s1, s2, s3", &[0xee51, 0x0a21], FloatMultiplyAdd, Next),
    ("vfma.f32 s1, s2, s3", &[0xeee1, 0x0a21], FloatMultiplyAdd, Next),
    ("vfms.f32 s1, s2, s3", &[0xeee1, 0x0a61], FloatMultiplyAdd, Next),
    ("vfnma.f32 s1, s2, s3", &[0xeed1, 0x0a61], FloatMultiplyAdd, Next),
    ("vdiv.f32 s1, s2, s3", &[0xeec1, 0x0a21], FloatDivide, Next),
    ("vsqrt.f32 s1, s3", &[0xeef1, 0x0ae1], FloatDivide, Next),
    ("vabs.f32 s1, s3", &[0xeef0, 0x0ae1], Float, Next),
    ("vneg.f32 s1, s3", &[0xeef1, 0x0a61], Float, Next),
    ("vcmp.f32 s1, s3", &[0xeef4, 0x0a61], Float, Next),
    ("vcmp.f32 s1, #0", &[0xeef5, 0x0a40], Float, Next),
    ("vmrs APSR_nzcv, fpscr", &[0xeef1, 0xfa10], Float, Next),
    ("vmsr fpscr, r0", &[0xeee1, 0x0a10], Float, Next),
    ("vcvt.s32.f32 s1, s3", &[0xeefd, 0x0ae1], Float, Next),
    ("vcvt.f32.u32 s1, s3", &[0xeef8, 0x0a61], Float, Next),
    ("vcvt.f32.s32 s1, s1, #8", &[0xeefa, 0x0acc], Float, Next),
    ("vcvtb.f32.f16 s1, s3", &[0xeef2, 0x0a61], Float, Next),
    ("vmov.f32 s1, s3", &[0xeef0, 0x0a61], Float, Next),
    ("vmov.f32 s1, #1.000000e+00", &[0xeef7, 0x0a00], Float, Next),
    ("vmov s1, r0", &[0xee00, 0x0a90], Float, Next),
    ("vmov r0, s1", &[0xee10, 0x0a90], Float, Next),
    ("vmov s2, s3, r0, r1", &[0xec41, 0x0a11], MovePair, Next),
    ("vmov r0, r1, s2, s3", &[0xec51, 0x0a11], MovePair, Next),
    ("vmov d3, r0, r1", &[0xec41, 0x0b13], MovePair, Next),
    ("vmov.32 r0, d3[1]", &[0xee33, 0x0b10], Float, Next),
    ("vldr s1, [r0, #4]", &[0xedd0, 0x0a01], FloatLoad, Next),
    ("vldr d3, [r0, #8]", &[0xed90, 0x3b02], Words(2), Next),
    ("vstr s1, [r0, #4]", &[0xedc0, 0x0a01], FloatStore, Next),
    ("vstr d3, [r0, #8]", &[0xed80, 0x3b02], Words(2), Next),
    ("vldmia r0!, {s4, s5, s6, s7}", &[0xecb0, 0x2a04], Words(4), Next),
    ("vldmia r0, {d2, d3, d4}", &[0xec90, 0x2b06], Words(6), Next),
    ("vstmia r0!, {s4, s5, s6}", &[0xeca0, 0x2a03], Words(3), Next),
    ("vpush {d8, d9}", &[0xed2d, 0x8b04], Words(4), Next),
    ("vpop {d8, d9}", &[0xecbd, 0x8b04], Words(4), Next),
];

#[test]
fn each_class_is_decoded_from_its_encoding() {
    for (text, halves, class, flow) in ASSEMBLED {
        let instruction = decode(halves).unwrap_or_else(|| panic!("{text} is not known"));
        assert_eq!(usize::from(instruction.size), 2 * halves.len(), "{text}");
        assert_eq!((instruction.class, instruction.flow), (*class, *flow), "{text}");
    }
}

#[test]
fn registers_that_tie_instructions_are_found() {
    // vmul.f32 s1, s2, s3
    let multiply = decode(&[0xee61, 0x0a21]).unwrap();
    assert_eq!((multiply.float_result, multiply.float_uses), (1 << 1, 1 << 2 | 1 << 3));
    // vmla.f32 s1, s2, s3 adds to what s1 holds.
    assert_eq!(decode(&[0xee41, 0x0a21]).unwrap().float_uses, 1 << 1 | 1 << 2 | 1 << 3);
    // vcmp.f32 s1, s3 leaves flags, which vmrs APSR_nzcv, fpscr takes.
    let compare = decode(&[0xeef4, 0x0a61]).unwrap();
    assert_eq!(compare.float_uses, 1 << 1 | 1 << 3);
    assert_eq!(compare.float_result, decode(&[0xeef1, 0xfa10]).unwrap().float_uses);
    // vstr s1, [r0, #4]; vpush {d8, d9}; vmov r0, r1, s2, s3; vmov r0, s1
    assert_eq!(decode(&[0xedc0, 0x0a01]).unwrap().float_uses, 1 << 1);
    assert_eq!(decode(&[0xed2d, 0x8b04]).unwrap().float_uses, 0b1111 << 16);
    assert_eq!(decode(&[0xec51, 0x0a11]).unwrap().float_uses, 0b11 << 2);
    assert_eq!(decode(&[0xee10, 0x0a90]).unwrap().float_uses, 1 << 1);
    // vldr s1, [r0, #4] is no arithmetic, and neither is vmov.f32 s1, s3.
    assert_eq!(decode(&[0xedd0, 0x0a01]).unwrap().float_result, 0);
    assert_eq!(decode(&[0xeef0, 0x0a61]).unwrap().float_result, 0);
    // ldr r0, [r1, r2] and ldr.w r8, [r9, r10, lsl #2]
    let load = decode(&[0x5888]).unwrap();
    assert_eq!((load.loads, load.address), (1 << 0, 1 << 1 | 1 << 2));
    let load = decode(&[0xf859, 0x802a]).unwrap();
    assert_eq!((load.loads, load.address), (1 << 8, 1 << 9 | 1 << 10));
    // ldr.w r8, [pc, #16]
    assert_eq!(decode(&[0xf8df, 0x8010]).unwrap().address, 0);
}

#[test]
fn it_decodes_its_number_of_instructions() {
    // it eq; ittee ne
    assert_eq!(decode(&[0xbf08]).unwrap().it_length, 1);
    assert_eq!(decode(&[0xbf19]).unwrap().it_length, 4);
    // nop's encoding is next to it.
    assert_eq!(decode(&[0xbf00]).unwrap().it_length, 0);
}

#[test]
fn instructions_beyond_cortex_m4f_are_refused() {
    // vadd.f64 d0, d1, d2; vseleq.f32 s0, s1, s2; half an instruction; nothing
    for code in [&[0xee31, 0x0b02][..], &[0xfe00, 0x0a81], &[0xf000], &[]] {
        assert_eq!(decode(code), None, "{code:04x?}");
    }
}

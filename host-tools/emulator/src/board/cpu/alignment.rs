//! Addresses that must be multiples of four: those of LDM, LDRD, LDREX, VLDR and their stores.
//!
//! Other loads and stores may be unaligned (ARMv7-M Architecture Reference Manual, A3.2.1). unicorn
//! does not check either. Here the base registers are checked when control enters or leaves a block
//! of instructions, whichever comes closer to the access. A base that is loaded and lost again
//! within one block escapes, and so does an access that an IT makes conditional.

use unicorn_engine::{RegisterARM, Unicorn};

use super::Inside;
use crate::board::Outcome;
use crate::isa::Instruction;

const SP: u16 = 1 << 13;
const LR: u16 = 1 << 14;
const PC: u16 = 1 << 15;

/// Core registers that an aligned access may use as its base.
const REGISTERS: [RegisterARM; 15] = [
    RegisterARM::R0,
    RegisterARM::R1,
    RegisterARM::R2,
    RegisterARM::R3,
    RegisterARM::R4,
    RegisterARM::R5,
    RegisterARM::R6,
    RegisterARM::R7,
    RegisterARM::R8,
    RegisterARM::R9,
    RegisterARM::R10,
    RegisterARM::R11,
    RegisterARM::R12,
    RegisterARM::SP,
    RegisterARM::LR,
];

/// Base registers of a block's aligned accesses, one bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bases {
    /// Registers that hold the base when control enters the block.
    pub on_entry: u16,
    /// Registers that hold the base when control leaves the block.
    pub on_exit: u16,
}

impl Bases {
    /// Finds the bases of a block with its machine code.
    pub fn of(instructions: &[Instruction], code: &[u8]) -> Self {
        let (mut bases, mut changed, mut rest) = (Self::default(), 0, code);
        for instruction in instructions {
            let Some((now, later)) = rest.split_at_checked(usize::from(instruction.size)) else {
                break;
            };
            rest = later;
            let mut halves = [0; 2];
            for (half, bytes) in halves.iter_mut().zip(now.as_chunks::<2>().0) {
                *half = u16::from_le_bytes(*bytes);
            }
            // The stack pointer and the literals' base are always aligned.
            let base = base(halves).unwrap_or_default() & !(SP | PC);
            let lost = changes(halves);
            if !instruction.conditional {
                bases.on_entry |= base & !changed;
                bases.on_exit |= base & changed;
            }
            changed |= lost;
            bases.on_exit &= !lost;
        }
        bases
    }
}

/// Registers in a field of four bits.
const fn register(word: u16, from: u16) -> u16 {
    1 << (word >> from & 0xf)
}

/// Base of an aligned access.
const fn base([op, arg]: [u16; 2]) -> Option<u16> {
    if op < 0xe800 {
        // LDM, STM
        return if op & 0xf000 == 0xc000 { Some(1 << (op >> 8 & 7)) } else { None };
    }
    let its = Some(register(op, 0));
    if op & 0xfe40 == 0xe800 {
        return its;
    }
    if op & 0xfe40 == 0xe840 {
        // LDREXB, LDREXH, TBB and the like have operands of less than a word.
        return if op & 0xffe0 == 0xe8c0 { None } else { its };
    }
    // VLDR, VLDM and their stores, but not the moves of two registers.
    if op & 0xfe00 == 0xec00 && op & 0xffe0 != 0xec40 && arg & 0x0e00 == 0x0a00 {
        return its;
    }
    None
}

/// Registers that an instruction may write, except a base that moves by a multiple of four.
const fn changes([op, arg]: [u16; 2]) -> u16 {
    let (low, middle) = (1 << (op & 7), 1 << (op >> 8 & 7));
    match op {
        0x0000..0x2000 | 0x4000..0x4400 | 0x5000..0x9000 => low,
        0x2000..0x4000 | 0x4800..0x5000 | 0x9000..0xb000 => middle,
        // BLX
        0x4780..0x4800 => LR,
        0x4400..0x4800 => register(op & 7 | op >> 4 & 8, 0),
        // Hints and IT; PUSH; POP
        0xbf00..0xc000 => 0,
        0xb400..0xb600 => 0,
        0xbc00..0xbe00 => op & 0xff,
        0xb000..0xc000 => low,
        0xc800..0xd000 => op & 0xff,
        0xc000..0xe800 => 0,
        0xe800..0xea00 if op & 0x40 == 0 => {
            if op & 0x10 != 0 {
                arg
            } else {
                0
            }
        }
        // Exclusives of bytes and half words have their status in the lowest field.
        0xe8c0..0xe8e0 => register(arg, 12) | register(arg, 0),
        0xe800..0xea00 => register(arg, 12) | register(arg, 8),
        0xec40..0xec60 => register(arg, 12) | register(op, 0),
        0xec00..0xee00 => 0,
        0xee00..0xf000 => register(arg, 12),
        // BL
        0xf000..0xf800 if arg & 0xd000 == 0xd000 => LR,
        0xea00..0xf800 => register(arg, 8),
        0xf800..0xfa00 => {
            let moves = op & 0x80 == 0 && arg & 0x800 != 0;
            (if op & 0x10 != 0 { register(arg, 12) } else { 0 })
                | if moves { register(op, 0) } else { 0 }
        }
        0xfa00.. => register(arg, 12) | register(arg, 8),
    }
}

/// Fails if one of these registers, a bit each, holds no multiple of four.
pub fn check_bases(unicorn: &Unicorn<'_, Inside>, mut registers: u16) -> Outcome {
    while registers != 0 {
        let i = registers.trailing_zeros() as usize;
        registers &= registers - 1;
        let address = unicorn.reg_read(REGISTERS[i]).unwrap_or_default();
        if address & 3 != 0 {
            return Err(format!(
                "LDM, LDRD, VLDR or a store of theirs at {address:#010x}, which is no multiple of \
                 four (r{i}): a UsageFault"
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::Block;

    fn bases(halves: &[u16]) -> Bases {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        Bases::of(&Block::decode(0x0800_0000, &code).unwrap().instructions, &code)
    }

    #[test]
    fn base_is_checked_before_or_behind_the_block() {
        // ldrd r2, r3, [r1]; ldm r0!, {r4, r5}; ldm r0!, {r4}; vldr s0, [r6]; b
        let unchanged = [0xe9d1, 0x2300, 0xc830, 0xc810, 0xed96, 0x0a00, 0xe7fe];
        assert_eq!(bases(&unchanged), Bases { on_entry: 0b100_0011, on_exit: 0 });
        // ldr r1, [r0]; strd r2, r3, [r1]; b
        let loaded = [0x6801, 0xe9c1, 0x2300, 0xe7fe];
        assert_eq!(bases(&loaded), Bases { on_entry: 0, on_exit: 0b10 });
        // ldr r1, [r0]; ldrd r1, r3, [r1]; b: the base is lost, as is lr by a call.
        for lost in
            [[0x6801, 0xe9d1, 0x1300, 0xe7fe, 0xbf00], [0x468e, 0xe9de, 0x2300, 0xf000, 0xf800]]
        {
            assert_eq!(bases(&lost), Bases::default());
        }
    }

    #[test]
    fn other_accesses_may_be_unaligned() {
        // push {r4, lr}; vpush {d8}; ldr r2, [r1]; ldr.w r2, [r1, #1]; vmov r0, r1, d0;
        // tbb [r1, r2]
        let free = [0xb510, 0xed2d, 0x8b02, 0x680a, 0xf8d1, 0x2001, 0xec51, 0x0b10, 0xe8d1, 0xf002];
        assert_eq!(bases(&free), Bases::default());
        // it eq; ldmeq r0!, {r1, r2}
        assert_eq!(bases(&[0xbf08, 0xc806]), Bases::default());
    }
}

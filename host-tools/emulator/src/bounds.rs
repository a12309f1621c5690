//! Ends of what the manual's timing tables leave open, as a wider [`Band`] than theirs.
//!
//! [`crate::cost`] takes one figure for terms on which the manual and GCC's description of the
//! pipeline are less certain. The bounds take both ends of each:
//!
//! - a taken branch refills the pipeline in 1 to 3 cycles, by its target's place;
//! - VLDR and VSTR of one word overlap as LDR and STR do, or not;
//! - integer instructions behind VDIV, VSQRT and multiply-add run beside them, or wait;
//! - a multiply-add needs its addend a cycle later than its factors, or at once;
//! - an address that arithmetic has just computed costs a cycle, or none.
//!
//! Wide instructions that lie across two words may cost one cycle more for each three in a row; the
//! bounds leave that out. Only silicon decides where in the bounds a core is.

use crate::cost::{Band, cost};
use crate::isa::{Class, Instruction};

/// Cycles of the refill more or less than the table's.
const REFILL: u64 = 1;

/// Bounds of `instruction` right after `before`, if nothing runs beside it.
fn alone(before: Option<&Instruction>, instruction: &Instruction, taken: bool) -> Band {
    let mut band = cost(before, instruction, taken);
    match instruction.class {
        Class::FloatStore => band.low -= 1,
        Class::FloatDivide | Class::FloatMultiplyAdd => band.low -= beside(instruction),
        _ => {}
    }
    if let Some(before) = before {
        let load = |class| matches!(class, Class::Load | Class::FloatLoad);
        let overlaps = load(before.class) && before.loads & instruction.address == 0;
        if load(instruction.class) && overlaps && band.low == 2 {
            band.low = 1;
        }
        let early = instruction.float_uses & !instruction.addend;
        let late = before.float_result & instruction.float_uses != 0;
        if late && before.float_result & early == 0 {
            band.low -= 1;
        }
        if before.results & instruction.address != 0 {
            band.high += 1;
        }
    }
    if taken {
        band.low -= REFILL;
        band.high += REFILL;
    }
    band
}

/// Cycles that integer instructions may run beside this one.
fn beside(instruction: &Instruction) -> u64 {
    match instruction.class {
        Class::FloatDivide => 13,
        Class::FloatMultiplyAdd => 2,
        _ => 0,
    }
}

/// Bounds of a block's instructions, if nothing runs before them and no branch is taken.
pub fn sum(instructions: &[Instruction]) -> Band {
    let mut sum = Band::default();
    // Cycles for which the floating-point unit is still busy, at the lower end. What is left of
    // them at the end of the block may pass beside the next one.
    let mut busy = 0;
    for (i, instruction) in instructions.iter().enumerate() {
        let before = i.checked_sub(1).and_then(|i| instructions.get(i));
        let mut band = alone(before, instruction, false);
        if instruction.float {
            band.low += busy;
            busy = beside(instruction);
        } else {
            busy = busy.saturating_sub(band.low);
        }
        sum += band;
    }
    sum
}

/// Bounds that [`sum`] gives to `instructions`, after the instruction `before` and with the last
/// one's branch.
pub fn entered(
    sum: Band,
    instructions: &[Instruction],
    before: Option<&Instruction>,
    taken: bool,
) -> Band {
    let ([first, ..], [rest @ .., last]) = (instructions, instructions) else { return sum };
    let mut sum = sum;
    let mut replace = |old: Band, new: Band| {
        sum.low = sum.low + new.low - old.low;
        sum.high = sum.high + new.high - old.high;
    };
    match rest.last() {
        None => replace(alone(None, last, false), alone(before, last, taken)),
        inner => {
            replace(alone(None, first, false), alone(before, first, false));
            replace(alone(inner, last, false), alone(inner, last, taken));
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::block::Block;

    fn bounds(halves: &[u16], taken: bool) -> [u64; 2] {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        let Band { low, high } = Block::decode(0, &code).unwrap().bounds(None, taken);
        [low, high]
    }

    #[test]
    fn refill_takes_one_to_three_cycles() {
        // beq
        assert_eq!(bounds(&[0xd004], false), [1, 1]);
        assert_eq!(bounds(&[0xd004], true), [2, 4]);
    }

    #[test]
    fn float_loads_and_stores_may_overlap() {
        // vldr s1, [r0, #4] alone, and after ldr r0, [r1, #4], which it needs, or ldr r2, [r3, #4]
        assert_eq!(bounds(&[0xedd0, 0x0a01], false), [2, 2]);
        assert_eq!(bounds(&[0x6848, 0xedd0, 0x0a01], false), [4, 4]);
        assert_eq!(bounds(&[0x685a, 0xedd0, 0x0a01], false), [3, 4]);
        // vstr s1, [r0, #4]
        assert_eq!(bounds(&[0xedc0, 0x0a01], false), [1, 2]);
    }

    #[test]
    fn integers_may_run_beside_a_division() {
        // vdiv.f32 s1, s2, s3; movs r0, #5 (twice); vadd.f32 s4, s2, s3
        let program = [0xeec1, 0x0a21, 0x2005, 0x2005, 0xee31, 0x2a21];
        assert_eq!(bounds(&program, false), [1 + 1 + 1 + (13 - 2) + 1, 14 + 1 + 1 + 1]);
        // Nothing of the unit follows.
        assert_eq!(bounds(&program[..4], false), [1 + 1 + 1, 14 + 1 + 1]);
        // At once: the unit is busy.
        let program = [0xeec1, 0x0a21, 0xee31, 0x2a21];
        assert_eq!(bounds(&program, false), [14 + 1, 14 + 1]);
    }

    #[test]
    fn addend_may_be_late() {
        // vmul.f32 s1, s2, s3; vmla.f32 s1, s2, s3 (adds to s1); then vmla.f32 s2, s1, s3
        let adds = [0xee61, 0x0a21, 0xee41, 0x0a21, 0xbf00, 0xbf00];
        assert_eq!(bounds(&adds, false), [1 + 1 + 2, 1 + 4 + 2]);
        let multiplies = [0xee61, 0x0a21, 0xee00, 0x1aa1, 0xbf00, 0xbf00];
        assert_eq!(bounds(&multiplies, false), [1 + 2 + 2, 1 + 4 + 2]);
    }

    #[test]
    fn computed_address_may_cost_a_cycle() {
        // adds r1, #1; ldr r0, [r1, #4]; and ldr r0, [r2, #4], which does not need r1
        assert_eq!(bounds(&[0x3101, 0x6848], false), [3, 4]);
        assert_eq!(bounds(&[0x3101, 0x6850], false), [3, 3]);
        // cmp r1, #1 computes no address.
        assert_eq!(bounds(&[0x2901, 0x6848], false), [3, 3]);
    }

    #[test]
    fn bounds_hold_the_table_wherever_a_block_is_entered() {
        let load = Instruction::decode(&0x6848u16.to_le_bytes()).unwrap();
        // ldr r0, [r1, #4]; ldr r2, [r3, #4]; vmul s1, s2, s3; vadd s1, s1, s3; b
        let code = [0x6848u16, 0x685a, 0xee61, 0x0a21, 0xee70, 0x0aa1, 0xe008];
        let code: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        let block = Block::decode(0, &code).unwrap();
        for before in [None, Some(&load)] {
            for taken in [false, true] {
                let [band, bounds] = [block.cost(before, taken), block.bounds(before, taken)];
                assert!(bounds.low <= band.low && bounds.high >= band.high, "{bounds:?}");
            }
        }
    }
}

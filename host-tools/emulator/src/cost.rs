//! Cycles of the Cortex-M4 from its Technical Reference Manual, at zero wait states.
//!
//! The tables are 3-1 and 7-1 of DDI 0439. All cycles are **modelled**, never measured. A [`Band`]
//! holds what the tables leave open: whether neighbouring loads pipeline, whether a store waits for
//! the write buffer, how early a division ends, and whether an instruction under IT did anything.
//! For what is less certain than the tables say, [`crate::bounds`] has a wider band.

use std::ops::{Add, AddAssign, Sub};

use crate::isa::{Class, Instruction};

/// Cycles of a taken branch beyond its own cycle.
///
/// The manual gives 1 to 3, depending on the target's alignment and on how early its address is
/// known; the table takes 2.
const REFILL: Band = Band::exactly(2);

/// Range of cycles: at least `low`, at most `high`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Band {
    /// Cycles if everything that can overlap does.
    pub low: u64,
    /// Cycles if nothing overlaps.
    pub high: u64,
}

impl Band {
    /// Band of a cost that depends on nothing.
    pub const fn exactly(cycles: u64) -> Self {
        Self { low: cycles, high: cycles }
    }

    /// Cost of `count` repetitions.
    pub fn times(self, count: u64) -> Self {
        Self { low: self.low * count, high: self.high * count }
    }
}

impl Add for Band {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { low: self.low + other.low, high: self.high + other.high }
    }
}

impl AddAssign for Band {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Band {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { low: self.low - other.low, high: self.high - other.high }
    }
}

/// Cost of `instruction` right after `before`; `before` is `None` behind a taken branch.
pub fn cost(before: Option<&Instruction>, instruction: &Instruction, taken: bool) -> Band {
    let mut band = alone(instruction.class);
    if let Some(before) = before {
        let pipelined = before.class == Class::Load && before.loads & instruction.address == 0;
        if instruction.class == Class::Load && pipelined {
            band.low = 1;
        }
        if before.float_result & instruction.float_uses != 0 {
            band += Band::exactly(1);
        }
    }
    if taken {
        band += REFILL;
    } else if instruction.conditional {
        band.low = 1;
    }
    band
}

fn alone(class: Class) -> Band {
    match class {
        Class::Simple | Class::Float => Band::exactly(1),
        Class::Load | Class::MovePair | Class::TableBranch => Band::exactly(2),
        Class::FloatLoad | Class::FloatStore => Band::exactly(2),
        Class::Store | Class::Special => Band { low: 1, high: 2 },
        Class::Words(count) => Band::exactly(1 + u64::from(count)),
        Class::Divide => Band { low: 2, high: 12 },
        Class::FloatMultiplyAdd => Band::exactly(3),
        Class::FloatDivide => Band::exactly(14),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instruction(halves: &[u16]) -> Instruction {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        Instruction::decode(&code).unwrap()
    }

    fn band(low: u64, high: u64) -> Band {
        Band { low, high }
    }

    #[test]
    fn each_row_of_the_tables_has_its_cost() {
        let rows: [(&str, &[u16], Band); 16] = [
            ("movs r0, #5", &[0x2005], band(1, 1)),
            ("smlad r8, r9, r10, r11", &[0xfb29, 0xb80a], band(1, 1)),
            ("sdiv r8, r9, r10", &[0xfb99, 0xf8fa], band(2, 12)),
            ("ldr r0, [r1, #4]", &[0x6848], band(2, 2)),
            ("str r0, [sp, #4]", &[0x9001], band(1, 2)),
            ("push {r4, r5, lr}", &[0xb530], band(4, 4)),
            ("ldrd r0, r1, [r2, #8]", &[0xe9d2, 0x0102], band(3, 3)),
            ("vadd.f32 s1, s2, s3", &[0xee71, 0x0a21], band(1, 1)),
            ("vcmp.f32 s1, s3", &[0xeef4, 0x0a61], band(1, 1)),
            ("vmla.f32 s1, s2, s3", &[0xee41, 0x0a21], band(3, 3)),
            ("vfma.f32 s1, s2, s3", &[0xeee1, 0x0a21], band(3, 3)),
            ("vdiv.f32 s1, s2, s3", &[0xeec1, 0x0a21], band(14, 14)),
            ("vsqrt.f32 s1, s3", &[0xeef1, 0x0ae1], band(14, 14)),
            ("vldr s1, [r0, #4]", &[0xedd0, 0x0a01], band(2, 2)),
            ("vldm r0!, {s4-s7}", &[0xecb0, 0x2a04], band(5, 5)),
            ("mrs r0, primask", &[0xf3ef, 0x8010], band(1, 2)),
        ];
        for (text, halves, expected) in rows {
            assert_eq!(cost(None, &instruction(halves), false), expected, "{text}");
        }
    }

    #[test]
    fn branch_costs_more_when_taken() {
        let branch = instruction(&[0xd004]);
        assert_eq!(cost(None, &branch, false), band(1, 1));
        assert_eq!(cost(None, &branch, true), band(3, 3));
        // pop {r4, r5, pc}
        assert_eq!(cost(None, &instruction(&[0xbd30]), true), band(6, 6));
    }

    #[test]
    fn load_pipelines_after_independent_load() {
        // ldr r0, [r1, #4] and ldr r0, [sp, #4]; ldr r1, [r0, #4] needs what they load.
        let (first, second) = (instruction(&[0x6848]), instruction(&[0x9801]));
        assert_eq!(cost(Some(&first), &second, false), band(1, 2));
        assert_eq!(cost(Some(&second), &instruction(&[0x6841]), false), band(2, 2));
        assert_eq!(cost(Some(&instruction(&[0x2005])), &second, false), band(2, 2));
    }

    #[test]
    fn float_result_used_at_once_costs_a_cycle() {
        // vmul s1, s2, s3; vadd s1, s2, s3 (does not want s1); vstr s1, [r0, #4] (does).
        let multiply = instruction(&[0xee61, 0x0a21]);
        assert_eq!(cost(Some(&multiply), &instruction(&[0xee71, 0x0a21]), false), band(1, 1));
        assert_eq!(cost(Some(&multiply), &instruction(&[0xedc0, 0x0a01]), false), band(3, 3));
    }
}

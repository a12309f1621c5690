//! Basic blocks, decoded once: their instructions and their cost.

use crate::bounds;
use crate::cost::{Band, cost};
use crate::isa::{Flow, Instruction};

/// Hints of 16 bits (ARMv7-M Architecture Reference Manual, A5.2.5).
const WFE: u16 = 0xbf20;
const WFI: u16 = 0xbf30;
const SEV: u16 = 0xbf40;

/// Run of instructions that is entered only at its start.
#[derive(Debug)]
pub struct Block {
    /// Address of the first instruction.
    pub start: u32,
    /// Address behind the last instruction.
    pub end: u32,
    /// Instructions of the block; never empty.
    pub instructions: Box<[Instruction]>,
    /// Whether the block ends with WFE or WFI.
    pub waits: bool,
    /// Whether the block contains SEV.
    pub signals: bool,
    /// Whether the block uses the floating-point unit.
    pub floats: bool,
    /// Cost of all instructions but the last, if nothing runs before them.
    body: Band,
    /// Bounds of all instructions, if nothing runs before them and no branch is taken.
    bounds: Band,
}

/// Instruction without a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unknown {
    /// Address of the instruction.
    pub address: u32,
    /// Four bytes from that address on, little-endian.
    pub code: u32,
}

impl Block {
    /// Decodes the `code` at `start`.
    pub fn decode(start: u32, code: &[u8]) -> Result<Self, Unknown> {
        let mut instructions = Vec::new();
        let (mut at, mut conditional) = (0usize, 0u8);
        let (mut last, mut signals, mut floats) = (0, false, false);
        while at < code.len() {
            let rest = &code[at..];
            let mut word = [0; 4];
            word.iter_mut().zip(rest).for_each(|(word, byte)| *word = *byte);
            let unknown = Unknown { address: start + at as u32, code: u32::from_le_bytes(word) };
            let mut instruction = Instruction::decode(rest).ok_or(unknown)?;
            if conditional > 0 {
                conditional -= 1;
                instruction.conditional = true;
                if instruction.flow == Flow::Elsewhere {
                    instruction.flow = Flow::Maybe;
                }
            }
            if instruction.it_length > 0 {
                conditional = instruction.it_length;
            }
            at += usize::from(instruction.size);
            // The first half of a 32-bit instruction identifies it: coprocessor encodings are the
            // floating-point unit's.
            last = u16::from_le_bytes([word[0], word[1]]);
            signals |= instruction.size == 2 && last == SEV;
            floats |= instruction.size == 4 && last & 0xec00 == 0xec00;
            instructions.push(instruction);
        }
        let waits = [WFE, WFI].contains(&last)
            && instructions.last().is_some_and(|instruction| instruction.size == 2);
        let mut block = Self {
            start,
            end: start + at as u32,
            instructions: instructions.into(),
            waits,
            signals,
            floats,
            body: Band::default(),
            bounds: Band::default(),
        };
        block.bounds = bounds::sum(&block.instructions);
        block.body = (0..block.instructions.len().saturating_sub(1))
            .fold(Band::default(), |sum, i| sum + block.cost_of(i, false));
        Ok(block)
    }

    /// Cost of the block after the instruction `before`.
    ///
    /// `taken` is whether a taken branch ended the block.
    pub fn cost(&self, before: Option<&Instruction>, taken: bool) -> Band {
        let last = self.instructions.len().saturating_sub(1);
        let Some(first) = self.instructions.first() else { return Band::default() };
        if last == 0 {
            return cost(before, first, taken);
        }
        // Only the first instruction depends on one outside the block.
        let (alone, after) = (cost(None, first, false), cost(before, first, false));
        let mut band = self.body + self.cost_of(last, taken);
        band.low = band.low + after.low - alone.low;
        band.high = band.high + after.high - alone.high;
        band
    }

    /// Bounds of the block's cost, with the arguments of [`Self::cost`].
    pub fn bounds(&self, before: Option<&Instruction>, taken: bool) -> Band {
        bounds::entered(self.bounds, &self.instructions, before, taken)
    }

    /// Cost of instruction `i` within the block.
    pub fn cost_of(&self, i: usize, taken: bool) -> Band {
        let before = i.checked_sub(1).and_then(|i| self.instructions.get(i));
        self.instructions.get(i).map_or(Band::default(), |now| cost(before, now, taken))
    }

    /// Last instruction, if control always continues with the next one.
    pub fn runs_on(&self) -> Option<&Instruction> {
        self.instructions.last().filter(|last| last.flow == Flow::Next)
    }

    /// Whether control left the block by a branch; `next` is the address that ran after it.
    pub fn left_by_branch(&self, next: u32) -> bool {
        match self.instructions.last().map(|last| last.flow) {
            Some(Flow::Elsewhere) => true,
            Some(Flow::Maybe) => next != self.end,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(halves: &[u16]) -> Block {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        Block::decode(0x0800_0000, &code).unwrap()
    }

    #[test]
    fn block_cost_depends_on_order() {
        // ldr r0, [r1, #4]; ldr r2, [r3, #4]; vmul s1, s2, s3; vadd s1, s1, s3; b
        let block = block(&[0x6848, 0x685a, 0xee61, 0x0a21, 0xee70, 0x0aa1, 0xe008]);
        assert_eq!(block.instructions.len(), 5);
        assert_eq!(
            block.cost(None, true),
            Band { low: 2 + 1 + 1 + 2 + 3, high: 2 + 2 + 1 + 2 + 3 }
        );
        let load = Instruction::decode(&0x6848u16.to_le_bytes()).unwrap();
        assert_eq!(block.cost(Some(&load), true).low, 1 + 1 + 1 + 2 + 3);
    }

    #[test]
    fn skipped_instruction_under_it_costs_one_cycle() {
        // it eq; ldmeq r0!, {r1, r2}; mov
        let block = block(&[0xbf08, 0xc806, 0x4608]);
        assert_eq!(block.cost(None, false), Band { low: 3, high: 1 + 3 + 1 });
    }

    #[test]
    fn return_under_it_may_be_skipped() {
        // it eq; bxeq lr
        let block = block(&[0xbf08, 0x4770]);
        assert!(!block.left_by_branch(block.end));
        assert!(block.left_by_branch(0x0800_1000));
    }

    #[test]
    fn unknown_instruction_is_named() {
        // nop; vadd.f64 d0, d1, d2
        let code = [0x00, 0xbf, 0x31, 0xee, 0x02, 0x0b];
        let unknown = Block::decode(0x100, &code).unwrap_err();
        assert_eq!(unknown, Unknown { address: 0x102, code: 0x0b02_ee31 });
    }
}

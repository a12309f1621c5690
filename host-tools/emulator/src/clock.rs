//! Counts what the core executes: instructions exactly, cycles as modelled, all of it or only between
//! entering a function and returning from it.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Sub;

use crate::block::{Block, Unknown};
use crate::cost::Band;

/// What some stretch of execution took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Instructions, those under IT that did nothing included.
    pub instructions: u64,
    /// Cycles.
    pub cycles: Band,
}

impl Sub for Count {
    type Output = Self;
    fn sub(self, before: Self) -> Self {
        Self {
            instructions: self.instructions - before.instructions,
            cycles: Band {
                low: self.cycles.low - before.cycles.low,
                high: self.cycles.high - before.cycles.high,
            },
        }
    }
}

/// How often a block ran inside measured functions.
#[derive(Clone, Copy, Debug, Default)]
pub struct Visits {
    /// Times it was left by a branch.
    pub taken: u64,
    /// Times it was not.
    pub fell_through: u64,
}

/// A call that is to be measured.
#[derive(Clone, Copy, Debug)]
enum Call {
    /// Once control reaches this function.
    Awaited { function: u32 },
    /// Until control comes back to `back` with this stack pointer.
    Running { back: u32, stack: u32, since: Count },
}

/// Of addresses, once a block: the library's own hasher would be half of the emulator's time.
#[derive(Debug, Default)]
struct AddressHasher(u64);

impl Hasher for AddressHasher {
    fn finish(&self) -> u64 {
        // The table takes its buckets from the low bits and its tags from the high ones.
        self.0 ^ self.0 >> 32
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_u32(u32::from(*byte)));
    }

    fn write_u32(&mut self, word: u32) {
        // 2^64 over the golden ratio.
        self.0 = (self.0.rotate_left(5) ^ u64::from(word)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

/// The counts, and the blocks they are made of.
#[derive(Debug, Default)]
pub struct Clock {
    total: Count,
    blocks: Vec<(Block, Visits)>,
    /// By start and length: the translator may cut the same code differently.
    index: HashMap<(u32, u32), usize, BuildHasherDefault<AddressHasher>>,
    /// The block that control is in.
    current: Option<usize>,
    /// The one before, where control ran on from it into the current one.
    before: Option<usize>,
    call: Option<Call>,
    measured: Option<Count>,
    /// Visits of all blocks are counted, and not of measured calls alone.
    all: bool,
}

impl Clock {
    /// All since reset, but for the block that control is in.
    pub fn total(&self) -> Count {
        self.total
    }

    /// The next call of the function at `address` is measured.
    pub fn await_call(&mut self, address: u32) {
        self.call = Some(Call::Awaited { function: address & !1 });
        self.measured = None;
    }

    /// What the awaited call took, once it is over.
    pub fn take_measured(&mut self) -> Option<Count> {
        self.measured.take()
    }

    /// Every block that was seen, and how often it was run while that was counted.
    pub fn blocks(&self) -> &[(Block, Visits)] {
        &self.blocks
    }

    /// Counts how often blocks run from now on, whoever calls them.
    pub fn count_all(&mut self) {
        self.all = true;
        self.forget_visits();
    }

    /// Forgets how often blocks ran.
    pub fn forget_visits(&mut self) {
        self.blocks.iter_mut().for_each(|(_, visits)| *visits = Visits::default());
    }

    /// The block at `start` of `length` bytes is known.
    pub fn knows(&self, start: u32, length: u32) -> bool {
        self.index.contains_key(&(start, length))
    }

    /// Makes it known.
    pub fn learn(&mut self, start: u32, code: &[u8]) -> Result<(), Unknown> {
        let block = Block::decode(start, code)?;
        self.index.insert((start, code.len() as u32), self.blocks.len());
        self.blocks.push((block, Visits::default()));
        Ok(())
    }

    /// A measured call may begin or end at `start`.
    pub fn watches(&self, start: u32) -> bool {
        match self.call {
            Some(Call::Awaited { function }) => function == start,
            Some(Call::Running { back, .. }) => back == start,
            None => false,
        }
    }

    /// Control enters a known block. `link` and `stack` are read only where [`Self::watches`] says so.
    pub fn enter(&mut self, start: u32, length: u32, [link, stack]: [u32; 2]) {
        self.leave(start);
        self.current = self.index.get(&(start, length)).copied();
        match self.call {
            Some(Call::Awaited { function }) if function == start => {
                self.call = Some(Call::Running { back: link & !1, stack, since: self.total });
                self.before = None;
            }
            // Deeper down it is a recursion's return.
            Some(Call::Running { back, stack: before, since })
                if back == start && stack == before =>
            {
                self.call = None;
                self.measured = Some(self.total - since);
            }
            _ => {}
        }
    }

    /// The block that control is in.
    pub fn current(&self) -> Option<&Block> {
        self.current.and_then(|i| self.blocks.get(i)).map(|(block, _)| block)
    }

    /// Adds up the block that control was in, now that it is known where it went: to `next`.
    pub fn leave(&mut self, next: u32) {
        let Some(current) = self.current.take() else { return };
        let before = self.before.take();
        let runs_on =
            before.and_then(|i| self.blocks.get(i)).and_then(|(block, _)| block.runs_on());
        let Some((block, _)) = self.blocks.get(current) else { return };
        let taken = block.left_by_branch(next);
        self.total.cycles += block.cost(runs_on, taken);
        self.total.instructions += block.instructions.len() as u64;
        if !taken {
            self.before = Some(current);
        }
        if (self.all || matches!(self.call, Some(Call::Running { .. })))
            && let Some((_, visits)) = self.blocks.get_mut(current)
        {
            if taken {
                visits.taken += 1;
            } else {
                visits.fell_through += 1;
            }
        }
    }

    /// Control stops at the end of the current block and will go on at `next`.
    pub fn pause(&mut self, next: u32) {
        self.leave(next);
        self.before = None;
    }
}

//! Counter of executed instructions (exact), cycles and waits for the flash (both modelled).
//!
//! It counts everything, or only the blocks between entering a function and returning from it.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Sub;

use crate::block::{Block, Unknown};
use crate::cost::Band;
use crate::fetch::{Fetch, Reads};

/// Instructions and cycles of a stretch of execution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Instructions, including those that IT skipped.
    pub instructions: u64,
    /// Modelled cycles without wait states.
    pub cycles: Band,
    /// Bounds of these cycles, counted in measured calls only.
    pub bounds: Band,
    /// Modelled cycles of waiting for the flash.
    pub waits: u64,
}

impl Count {
    /// Cycles at the upper end of the band, and the waits.
    pub fn time(&self) -> u64 {
        self.cycles.high + self.waits
    }
}

impl Sub for Count {
    type Output = Self;
    fn sub(self, before: Self) -> Self {
        Self {
            instructions: self.instructions - before.instructions,
            cycles: self.cycles - before.cycles,
            bounds: self.bounds - before.bounds,
            waits: self.waits - before.waits,
        }
    }
}

/// Number of times a block ran while it was counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Visits {
    /// Runs that a branch ended.
    pub taken: u64,
    /// Runs that continued with the next instruction.
    pub fell_through: u64,
    /// Cycles of waiting for the flash.
    pub waits: u64,
}

/// State of the measured call.
#[derive(Clone, Copy, Debug)]
enum Call {
    /// Measuring starts when control reaches this function.
    Awaited { function: u32 },
    /// Measuring ends when control is at `back` with this stack pointer.
    Running { back: u32, stack: u32, since: Count },
}

/// Fast hash of block addresses, because the standard hasher would take half of the emulator's
/// time.
#[derive(Debug, Default)]
struct AddressHasher(u64);

impl Hasher for AddressHasher {
    fn finish(&self) -> u64 {
        // The hash table takes buckets from the low bits and tags from the high ones.
        self.0 ^ self.0 >> 32
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_u32(u32::from(*byte)));
    }

    fn write_u32(&mut self, word: u32) {
        // 2^64 divided by the golden ratio.
        self.0 = (self.0.rotate_left(5) ^ u64::from(word)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

/// Counts of instructions and cycles, and the decoded blocks.
#[derive(Debug, Default)]
pub struct Clock {
    total: Count,
    blocks: Vec<(Block, Visits)>,
    /// Reads of the flash that each of `blocks` makes.
    reads: Vec<Reads>,
    fetch: Fetch,
    /// Index into `blocks` by start and length, because the translator may cut the same code
    /// differently.
    index: HashMap<(u32, u32), usize, BuildHasherDefault<AddressHasher>>,
    /// Block that control is in.
    current: Option<usize>,
    /// Block before the current one, if control fell through into the current one.
    before: Option<usize>,
    call: Option<Call>,
    measured: Option<Count>,
    /// Whether visits count everywhere, not in measured calls alone.
    all: bool,
}

impl Clock {
    /// Count since reset, without the current block.
    pub fn total(&self) -> Count {
        self.total
    }

    /// Flash that the core fetches from.
    pub fn fetch(&mut self) -> &mut Fetch {
        &mut self.fetch
    }

    /// Builds a counter for a core with this flash.
    pub fn with(fetch: Fetch) -> Self {
        Self { fetch, ..Self::default() }
    }

    /// Measures the next call of the function at `address`, from empty caches.
    pub fn await_call(&mut self, address: u32) {
        self.call = Some(Call::Awaited { function: address & !1 });
        self.measured = None;
    }

    /// Returns the count of the awaited call once that call has ended.
    pub fn take_measured(&mut self) -> Option<Count> {
        self.measured.take()
    }

    /// All decoded blocks with their counted visits.
    pub fn blocks(&self) -> &[(Block, Visits)] {
        &self.blocks
    }

    /// Counts visits of blocks from now on, whoever calls them.
    pub fn count_all(&mut self) {
        self.all = true;
        self.forget_visits();
    }

    /// Sets the visits of all blocks to zero.
    pub fn forget_visits(&mut self) {
        self.blocks.iter_mut().for_each(|(_, visits)| *visits = Visits::default());
    }

    /// Index of the block at `start` of `length` bytes, if it is decoded.
    pub fn find(&self, start: u32, length: u32) -> Option<usize> {
        self.index.get(&(start, length)).copied()
    }

    /// Decodes the block at `start` and returns its index; fails on an instruction without a model.
    pub fn learn(&mut self, start: u32, code: &[u8]) -> Result<usize, Unknown> {
        let block = Block::decode(start, code)?;
        let index = self.blocks.len();
        self.index.insert((start, code.len() as u32), index);
        self.reads.push(self.fetch.reads(&block));
        self.blocks.push((block, Visits::default()));
        Ok(index)
    }

    /// Whether a measured call may begin or end at `start`.
    pub fn watches(&self, start: u32) -> bool {
        match self.call {
            Some(Call::Awaited { function }) => function == start,
            Some(Call::Running { back, .. }) => back == start,
            None => false,
        }
    }

    /// Records that control enters the decoded block with the index `block` at `start`.
    ///
    /// `link` and `stack` matter only where [`Self::watches`] is true.
    pub fn enter(&mut self, block: usize, start: u32, [link, stack]: [u32; 2]) {
        self.leave(start);
        self.current = Some(block);
        match self.call {
            Some(Call::Awaited { function }) if function == start => {
                self.call = Some(Call::Running { back: link & !1, stack, since: self.total });
                self.before = None;
                self.fetch.flush();
            }
            // With another stack pointer this is the return of a recursive call.
            Some(Call::Running { back, stack: before, since })
                if back == start && stack == before =>
            {
                self.call = None;
                self.measured = Some(self.total - since);
            }
            _ => {}
        }
        let Some(reads) = self.reads.get(block) else { return };
        let waits = self.fetch.waits(reads, self.total.cycles.high);
        self.total.waits += waits;
        if self.counts()
            && let Some((_, visits)) = self.blocks.get_mut(block)
        {
            visits.waits += waits;
        }
    }

    /// Whether visits of blocks count now.
    fn counts(&self) -> bool {
        self.all || matches!(self.call, Some(Call::Running { .. }))
    }

    /// Block that control is in.
    pub fn current(&self) -> Option<&Block> {
        self.current.and_then(|i| self.blocks.get(i)).map(|(block, _)| block)
    }

    /// Adds the cost of the current block, which control leaves for `next`.
    pub fn leave(&mut self, next: u32) {
        let Some(current) = self.current.take() else { return };
        let before = self.before.take();
        let runs_on =
            before.and_then(|i| self.blocks.get(i)).and_then(|(block, _)| block.runs_on());
        let Some((block, _)) = self.blocks.get(current) else { return };
        let taken = block.left_by_branch(next);
        self.total.cycles += block.cost(runs_on, taken);
        // Nothing else needs them, and they take time.
        if matches!(self.call, Some(Call::Running { .. })) {
            self.total.bounds += block.bounds(runs_on, taken);
        }
        self.total.instructions += block.instructions.len() as u64;
        if !taken {
            self.before = Some(current);
        }
        if self.counts()
            && let Some((_, visits)) = self.blocks.get_mut(current)
        {
            if taken {
                visits.taken += 1;
            } else {
                visits.fell_through += 1;
            }
        }
    }

    /// Records that control stops behind the current block and will continue at `next`.
    pub fn pause(&mut self, next: u32) {
        self.leave(next);
        self.before = None;
    }
}

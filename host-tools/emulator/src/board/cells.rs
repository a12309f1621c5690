//! Contents of a flash, whatever controls it: operations one after the other, in any of which the power may fail.

use std::collections::BTreeSet;

use super::Outcome;
use super::time::Tick;

/// The part of a flash that the program changes, with its controller.
pub trait Flash {
    /// Its contents.
    fn contents(&mut self) -> &mut FlashContents;
    /// Reads `size` bytes of it. True where that raises the NMI.
    fn fetch(&mut self, address: u32, size: u32) -> (u32, bool);
    /// Programs a word. How long the core stands still.
    fn program(&mut self, address: u32, size: u32, value: u32) -> Outcome<Tick>;
}

/// LOCK, of a controller's CR.
pub const LOCK: u32 = 1 << 31;
/// What KEYR wants, one after the other.
const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

/// What keeps a controller from being told to change anything: both chips have the same.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lock {
    /// Keys that have come.
    keys: usize,
}

impl Lock {
    /// One key more; the last opens CR.
    pub fn turn(&mut self, key: u32, cr: &mut u32) -> Outcome {
        if KEYS.get(self.keys) != Some(&key) {
            return Err("a wrong key, which locks the flash until the next reset".into());
        }
        self.keys += 1;
        if self.keys == KEYS.len() {
            (self.keys, *cr) = (0, *cr & !LOCK);
        }
        Ok(())
    }

    /// Whether CR stays as it is, whatever is written: nothing but the lock may be.
    pub fn holds(cr: u32, value: u32) -> Outcome<bool> {
        if cr & LOCK == 0 {
            Ok(false)
        } else if value & LOCK != 0 {
            Ok(true)
        } else {
            Err("written while it is locked".into())
        }
    }
}

/// What is programmed, and what a power cut tore.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cells {
    /// Byte by byte.
    pub data: Vec<u8>,
    /// Double words whose error correction finds two wrong bits, where there is one.
    pub torn: BTreeSet<u32>,
}

/// Contents of a flash, with the operations on them.
pub struct FlashContents {
    /// Where it begins.
    pub start: u32,
    /// Bytes as they are now.
    pub cells: Cells,
    /// Erasures and programmed words so far.
    operations: u64,
    /// The operation that the power does not outlast.
    cut: Option<u64>,
    /// What a cut in each operation would leave, if it is kept.
    cuts: Option<Vec<Cells>>,
}

impl FlashContents {
    /// Erased: `bytes` from `start` on.
    pub fn erased((start, bytes): (u32, u32)) -> Self {
        let cells = Cells { data: vec![0xff; bytes as usize], torn: BTreeSet::new() };
        Self { start, cells, operations: 0, cut: None, cuts: None }
    }

    /// The address behind it.
    pub fn end(&self) -> u32 {
        self.start + self.cells.data.len() as u32
    }

    /// Reads `size` bytes of it.
    pub fn fetch(&self, address: u32, size: u32) -> u32 {
        let at = (address - self.start) as usize;
        let mut word = [0; 4];
        word.iter_mut()
            .zip(self.cells.data.iter().skip(at).take(size as usize))
            .for_each(|(to, from)| *to = *from);
        u32::from_le_bytes(word)
    }

    /// The bytes from `address` on.
    pub fn bytes(&mut self, address: u32, length: u32) -> Outcome<&mut [u8]> {
        let range = address.checked_sub(self.start).map(|at| at as usize..(at + length) as usize);
        let bytes = range.and_then(|range| self.cells.data.get_mut(range));
        bytes.ok_or_else(|| format!("{address:#010x} is changed, which holds the program"))
    }

    /// Keeps from now on what a power cut in the middle of each operation would leave.
    pub fn keep_cuts(&mut self) {
        self.cuts = Some(Vec::new());
    }

    /// That, one after the other; it is kept no longer.
    pub fn take_cuts(&mut self) -> Vec<Cells> {
        self.cuts.take().unwrap_or_default()
    }

    /// Power fails in the middle of the operation after so many more.
    pub fn cut_power_after(&mut self, operations: Option<u64>) {
        self.cut = operations.map(|more| self.operations + more);
    }

    /// Whether the power failed in what was just done.
    pub fn has_lost_power(&self) -> bool {
        self.cut.is_some_and(|cut| self.operations > cut)
    }

    /// An operation is over, or is cut short: `tear` makes of what it leaves what is there then.
    pub fn finish(&mut self, tear: impl Fn(&mut Cells)) {
        self.operations += 1;
        if let Some(cuts) = &mut self.cuts {
            let mut cut = self.cells.clone();
            tear(&mut cut);
            cuts.push(cut);
        }
        if self.has_lost_power() {
            tear(&mut self.cells);
        }
    }
}

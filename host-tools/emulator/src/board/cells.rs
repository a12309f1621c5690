//! Contents of a flash, and the effect of a power cut in an operation.

use std::collections::BTreeSet;

use super::Outcome;
use super::time::Tick;

/// Data part of a flash, with its controller.
pub trait Flash {
    /// Contents of the data part.
    fn contents(&mut self) -> &mut FlashContents;
    /// Value of the access control register: wait states, prefetch and caches.
    fn access_control(&self) -> u32;
    /// Reads `size` bytes at `address`; the flag is true if the read raises the NMI.
    ///
    /// # Errors
    /// A cache that still holds older contents.
    fn fetch(&mut self, address: u32, size: u32) -> Outcome<(u32, bool)>;
    /// Programs a word at the time `now`.
    fn program(&mut self, address: u32, size: u32, value: u32, now: Tick) -> Outcome;
    /// End of the last operation, until which every read of the flash waits.
    fn busy_until(&self) -> Tick;
}

/// BSY bit of a controller's SR.
pub const BSY: u32 = 1 << 16;
/// LOCK bit of a controller's CR.
pub const LOCK: u32 = 1 << 31;
/// Unlock sequence of KEYR.
const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

/// Lock of a flash controller's CR, the same on both chips.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lock {
    /// Number of correct keys written so far.
    keys: usize,
    /// Whether a wrong key keeps CR locked until the next reset.
    jammed: bool,
}

impl Lock {
    /// Takes a key written to KEYR; the last one unlocks `cr`.
    pub fn turn(&mut self, key: u32, cr: &mut u32) -> Outcome {
        if self.jammed || KEYS.get(self.keys) != Some(&key) {
            self.jammed = true;
            return Err("a wrong key, which locks the flash until the next reset".into());
        }
        self.keys += 1;
        if self.keys == KEYS.len() {
            (self.keys, *cr) = (0, *cr & !LOCK);
        }
        Ok(())
    }

    /// Whether the lock keeps CR unchanged; an error if a locked CR is written without LOCK.
    pub fn holds(cr: u32, value: u32) -> Outcome<bool> {
        if cr & LOCK == 0 {
            Ok(false)
        } else if value & LOCK != 0 {
            Ok(true)
        } else {
            Err("written while CR is locked".into())
        }
    }
}

/// Programmed bytes, and the words that a power cut damaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cells {
    /// Bytes of the flash.
    pub data: Vec<u8>,
    /// Double words with two wrong bits for the error correction, on chips that have one.
    pub torn: BTreeSet<u32>,
}

/// Contents of a flash, with its operations and power cuts.
pub struct FlashContents {
    /// Address of the first byte.
    pub start: u32,
    /// Present bytes.
    pub cells: Cells,
    /// Number of erasures and programmed words so far.
    operations: u64,
    /// Number of the operation in which the power fails.
    cut: Option<u64>,
    /// Contents that a cut in each operation would leave, if kept.
    cuts: Option<Vec<Cells>>,
}

impl FlashContents {
    /// Erased contents of `bytes` bytes from `start` on.
    pub fn erased((start, bytes): (u32, u32)) -> Self {
        let cells = Cells { data: vec![0xff; bytes as usize], torn: BTreeSet::new() };
        Self { start, cells, operations: 0, cut: None, cuts: None }
    }

    /// Address behind the last byte.
    pub fn end(&self) -> u32 {
        self.start + self.cells.data.len() as u32
    }

    /// Reads `size` bytes at `address`, little-endian.
    pub fn fetch(&self, address: u32, size: u32) -> u32 {
        let at = (address - self.start) as usize;
        let mut word = [0; 4];
        word.iter_mut()
            .zip(self.cells.data.iter().skip(at).take(size as usize))
            .for_each(|(to, from)| *to = *from);
        u32::from_le_bytes(word)
    }

    /// Bytes from `address` on; an error outside the data part.
    pub fn bytes(&mut self, address: u32, length: u32) -> Outcome<&mut [u8]> {
        let range = address.checked_sub(self.start).map(|at| at as usize..(at + length) as usize);
        let bytes = range.and_then(|range| self.cells.data.get_mut(range));
        bytes.ok_or_else(|| {
            format!("{address:#010x}: erased or programmed, but it holds the program")
        })
    }

    /// Starts to keep the contents that a power cut in each operation would leave.
    pub fn keep_cuts(&mut self) {
        self.cuts = Some(Vec::new());
    }

    /// Returns the kept contents, one for each operation, and stops keeping them.
    pub fn take_cuts(&mut self) -> Vec<Cells> {
        self.cuts.take().unwrap_or_default()
    }

    /// Makes the power fail in the operation after `operations` more; `None` cancels that.
    pub fn cut_power_after(&mut self, operations: Option<u64>) {
        self.cut = operations.map(|more| self.operations + more);
    }

    /// Whether the power failed in the last operation.
    pub fn has_lost_power(&self) -> bool {
        self.cut.is_some_and(|cut| self.operations > cut)
    }

    /// Ends an operation; `tear` turns its result into the contents after a power cut.
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

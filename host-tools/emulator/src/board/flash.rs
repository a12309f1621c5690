//! The flash (RM0440 §3.3): wait states, erasing a page, programming 64 bits, what a power cut leaves.
//!
//! Only the pages behind the program can be erased and programmed: a firmware that changes its own code is
//! not modelled. While the flash is busy the core stands still, since it fetches from there.

use std::collections::BTreeSet;

use super::time::{Tick, micros};
use super::{Outcome, UNMODELLED};

/// Where the flash is.
pub const BASE: u32 = 0x0800_0000;
/// Its end.
pub const END: u32 = BASE + 0x2_0000;
const PAGE: u32 = 2048;

const ACR: u32 = 0x00;
const KEYR: u32 = 0x08;
const SR: u32 = 0x10;
const CR: u32 = 0x14;
const ECCR: u32 = 0x18;
const OPTR: u32 = 0x20;

const LOCK: u32 = 1 << 31;
const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

/// DS12589 table 44, typical.
const PROGRAM: Tick = micros(82);
const ERASE: Tick = micros(22_020);

/// The flash behind the program, and its controller.
pub struct Flash {
    /// Where the data begins.
    start: u32,
    data: Vec<u8>,
    /// Double words whose error correction finds two wrong bits.
    torn: BTreeSet<u32>,
    acr: u32,
    cr: u32,
    sr: u32,
    eccr: u32,
    keys: usize,
    /// The first half of a double word.
    half: Option<(u32, u32)>,
    /// Erasures and double words so far.
    operations: u64,
    /// The operation that the power does not outlast.
    cut: Option<u64>,
    /// What a cut in each operation would leave, if it is kept.
    cuts: Option<Vec<Cells>>,
}

/// What is programmed, and what a power cut tore.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cells {
    data: Vec<u8>,
    torn: BTreeSet<u32>,
}

impl Flash {
    /// Erased, from `start` on.
    pub fn new(start: u32) -> Self {
        Self {
            start,
            data: vec![0xff; (END - start) as usize],
            torn: BTreeSet::new(),
            acr: 0x600,
            cr: LOCK,
            sr: 0,
            eccr: 0,
            keys: 0,
            half: None,
            operations: 0,
            cut: None,
            cuts: None,
        }
    }

    /// Keeps from now on what a power cut in the middle of each operation would leave.
    pub fn keep_cuts(&mut self) {
        self.cuts = Some(Vec::new());
    }

    /// That, one after the other; it is kept no longer.
    pub fn take_cuts(&mut self) -> Vec<Cells> {
        self.cuts.take().unwrap_or_default()
    }

    /// What it holds.
    pub fn cells(&self) -> Cells {
        Cells { data: self.data.clone(), torn: self.torn.clone() }
    }

    /// Puts that there.
    pub fn put(&mut self, cells: Cells) {
        (self.data, self.torn) = (cells.data, cells.torn);
    }

    /// The controller is reset; what was programmed stays.
    pub fn reset(&mut self) {
        let blank = Self::new(END);
        let (data, torn) = (std::mem::take(&mut self.data), std::mem::take(&mut self.torn));
        *self = Self {
            start: self.start,
            data,
            torn,
            operations: self.operations,
            cut: self.cut,
            cuts: self.cuts.take(),
            ..blank
        };
    }

    /// Wait states.
    pub fn latency(&self) -> u32 {
        self.acr & 0xf
    }

    /// Where what can be changed begins.
    pub fn start(&self) -> u32 {
        self.start
    }

    /// Erasures and programmed double words since the flash was new.
    pub fn operations(&self) -> u64 {
        self.operations
    }

    /// Power fails in the middle of the operation after so many more.
    pub fn cut_power_after(&mut self, operations: Option<u64>) {
        self.cut = operations.map(|more| self.operations + more);
    }

    /// Reads `size` bytes of it. True where the error correction raises the NMI.
    pub fn fetch(&mut self, address: u32, size: u32) -> (u32, bool) {
        let at = (address - self.start) as usize;
        let mut word = [0; 4];
        word.iter_mut()
            .zip(self.data.iter().skip(at).take(size as usize))
            .for_each(|(to, from)| *to = *from);
        let torn = self.torn.contains(&(address & !7));
        if torn {
            // ECCD; the place is left out.
            self.eccr |= 1 << 31;
        }
        (u32::from_le_bytes(word), torn)
    }

    /// Programs a word: half of a double word. How long the core stands still.
    pub fn program(&mut self, address: u32, size: u32, value: u32) -> Outcome<Tick> {
        if self.cr & 1 == 0 || size != 4 {
            return Err("a write to the flash without PG, or not of 32 bits".into());
        }
        let Some((first, low)) = self.half.take() else {
            if address & 7 != 0 {
                return Err("the first word of a double word is not its lower one".into());
            }
            self.half = Some((address, value));
            return Ok(0);
        };
        if address != first + 4 {
            return Err("the second word does not follow the first".into());
        }
        let word = [low.to_le_bytes(), value.to_le_bytes()].concat();
        let at = (first - self.start) as usize;
        let place = &mut self.data[at..at + 8];
        let erased = place.iter().all(|byte| *byte == 0xff) && !self.torn.contains(&first);
        if !erased && word.iter().any(|byte| *byte != 0) {
            // PROGERR: the word is not changed.
            self.sr |= 1 << 3;
            return Ok(0);
        }
        place.copy_from_slice(&word);
        self.torn.remove(&first);
        self.finish(std::iter::once(first));
        Ok(PROGRAM)
    }

    /// Whether the power failed in what was just done.
    pub fn has_lost_power(&self) -> bool {
        self.cut.is_some_and(|cut| self.operations > cut)
    }

    /// An operation on these double words is over, or is cut short.
    fn finish(&mut self, words: impl Iterator<Item = u32> + Clone) {
        self.operations += 1;
        if self.cuts.is_some() {
            let mut cut = self.cells();
            cut.torn.extend(words.clone());
            self.cuts.iter_mut().for_each(|cuts| cuts.push(cut.clone()));
        }
        if self.has_lost_power() {
            self.torn.extend(words);
        }
    }

    fn erase(&mut self, page: u32) -> Outcome<Tick> {
        let address = BASE + page * PAGE;
        let Some(at) = address.checked_sub(self.start).filter(|_| address < END) else {
            return Err(format!("page {page} is erased, which holds the program"));
        };
        let at = at as usize;
        self.data[at..at + PAGE as usize].fill(0xff);
        self.torn.retain(|word| !(address..address + PAGE).contains(word));
        // Cut short, some cells are erased and some not: no word of it can be trusted.
        self.finish((address..address + PAGE).step_by(8));
        Ok(ERASE)
    }

    /// The register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        Ok(match offset {
            ACR => self.acr,
            SR => self.sr,
            CR => self.cr,
            ECCR => self.eccr,
            // The factory's; BOR, nBOOT0 and their kin are the firmware's business nowhere.
            OPTR => 0xffef_f8aa,
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes it. How long the core stands still.
    pub fn write(&mut self, offset: u32, value: u32) -> Outcome<Tick> {
        match offset {
            ACR => self.acr = value,
            KEYR if KEYS.get(self.keys) == Some(&value) => {
                self.keys += 1;
                if self.keys == KEYS.len() {
                    (self.keys, self.cr) = (0, self.cr & !LOCK);
                }
            }
            KEYR => return Err("a wrong key, which locks the flash until the next reset".into()),
            SR => self.sr &= !value,
            ECCR => self.eccr &= !(value & 0xc000_0000),
            CR => return self.control(value),
            _ => return Err(UNMODELLED.into()),
        }
        Ok(0)
    }

    fn control(&mut self, value: u32) -> Outcome<Tick> {
        if self.cr & LOCK != 0 {
            return if value & LOCK != 0 {
                Ok(0)
            } else {
                Err("written while it is locked".into())
            };
        }
        // PG, PER, PNB, STRT, LOCK
        if value & !(LOCK | 1 << 16 | 0x3fb) != 0 {
            return Err(UNMODELLED.into());
        }
        self.cr = value & !(1 << 16);
        if value >> 16 & 1 == 0 {
            return Ok(0);
        }
        if value & 3 != 2 {
            return Err("STRT without PER".into());
        }
        self.erase(value >> 3 & 0x7f)
    }
}

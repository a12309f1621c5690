//! The flash (RM0440 §3.3): wait states, erasing a page, programming 64 bits, what a power cut leaves.
//!
//! Only the pages that `memory.x` keeps from the program can be erased and programmed: a firmware that changes its own code is
//! not modelled. While the flash is busy the core stands still, since it fetches from there.

use crate::board::cells::{Cells, Flash as Changed, FlashContents, LOCK, Lock};
use crate::board::time::{Tick, micros};
use crate::board::{Outcome, UNMODELLED};

/// Where the flash is, and how many bytes.
pub const ALL: (u32, u32) = (0x0800_0000, 0x2_0000);
/// What survives power-off: the last six pages.
pub const DATA: (u32, u32) = (0x0801_d000, 0x3000);
const PAGE: u32 = 2048;

const ACR: u32 = 0x00;
const KEYR: u32 = 0x08;
const SR: u32 = 0x10;
const CR: u32 = 0x14;
const ECCR: u32 = 0x18;
const OPTR: u32 = 0x20;

/// DS12589 table 44, typical.
const PROGRAM: Tick = micros(82);
const ERASE: Tick = micros(22_020);

/// The flash's controller, and what it controls.
pub struct Flash {
    contents: FlashContents,
    acr: u32,
    cr: u32,
    sr: u32,
    eccr: u32,
    lock: Lock,
    /// The first half of a double word.
    half: Option<(u32, u32)>,
}

impl Default for Flash {
    /// Erased.
    fn default() -> Self {
        Self {
            contents: FlashContents::erased(DATA),
            acr: 0x600,
            cr: LOCK,
            sr: 0,
            eccr: 0,
            lock: Lock::default(),
            half: None,
        }
    }
}

impl Flash {
    /// The controller is reset; what was programmed stays.
    pub fn reset(&mut self) {
        let contents = std::mem::replace(&mut self.contents, FlashContents::erased((0, 0)));
        *self = Self { contents, ..Self::default() };
    }

    /// Wait states.
    pub fn latency(&self) -> u32 {
        self.acr & 0xf
    }

    fn erase(&mut self, page: u32) -> Outcome<Tick> {
        let address = ALL.0 + page * PAGE;
        self.contents.bytes(address, PAGE)?.fill(0xff);
        self.contents.cells.torn.retain(|word| !(address..address + PAGE).contains(word));
        // Cut short, some cells are erased and some not: no word of it can be trusted.
        self.contents.finish(|cells| tear(cells, address, PAGE));
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
            KEYR => self.lock.turn(value, &mut self.cr)?,
            SR => self.sr &= !value,
            ECCR => self.eccr &= !(value & 0xc000_0000),
            CR => return self.control(value),
            _ => return Err(UNMODELLED.into()),
        }
        Ok(0)
    }

    fn control(&mut self, value: u32) -> Outcome<Tick> {
        if Lock::holds(self.cr, value)? {
            return Ok(0);
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

/// The double words from `address` on are half done.
fn tear(cells: &mut Cells, address: u32, length: u32) {
    cells.torn.extend((address..address + length).step_by(8));
}

impl Changed for Flash {
    fn contents(&mut self) -> &mut FlashContents {
        &mut self.contents
    }

    fn fetch(&mut self, address: u32, size: u32) -> (u32, bool) {
        let torn = self.contents.cells.torn.contains(&(address & !7));
        if torn {
            // ECCD; the place is left out.
            self.eccr |= 1 << 31;
        }
        (self.contents.fetch(address, size), torn)
    }

    /// A word is half of a double word.
    fn program(&mut self, address: u32, size: u32, value: u32) -> Outcome<Tick> {
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
        let torn = self.contents.cells.torn.contains(&first);
        let place = self.contents.bytes(first, 8)?;
        let erased = place.iter().all(|byte| *byte == 0xff) && !torn;
        if !erased && word.iter().any(|byte| *byte != 0) {
            // PROGERR: the word is not changed.
            self.sr |= 1 << 3;
            return Ok(0);
        }
        place.copy_from_slice(&word);
        self.contents.cells.torn.remove(&first);
        self.contents.finish(|cells| tear(cells, first, 8));
        Ok(PROGRAM)
    }
}

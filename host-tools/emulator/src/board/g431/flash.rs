//! Flash of the STM32G431 (RM0440 §3.3): wait states, page erase, double-word programming, power
//! cuts.
//!
//! Only the pages that `memory.x` keeps from the program can be erased and programmed. Firmware
//! that changes its own code is not modelled. The core stalls while the flash is busy, unless it
//! runs from another memory.
//! On the STM32G473 it stalls too, although there a bank can be read while the other one is busy.

use crate::board::cells::{BSY, Cells, Flash as Changed, FlashContents, LOCK, Lock};
use crate::board::time::{Tick, micros};
use crate::board::{Outcome, UNMODELLED};

/// Whole flash: first address and number of bytes.
pub const ALL: (u32, u32) = (0x0800_0000, 0x2_0000);
/// Data part, which survives power-off: the last six pages.
pub const DATA: (u32, u32) = (0x0801_d000, 0x3000);
const PAGE: u32 = 2048;
/// Number of pages of a bank, which PNB counts in; a larger flash has two banks.
const BANK: u32 = 128;
/// Bank to erase in: BKER of CR.
const BKER: u32 = 1 << 11;

const ACR: u32 = 0x00;
const KEYR: u32 = 0x08;
const SR: u32 = 0x10;
const CR: u32 = 0x14;
const ECCR: u32 = 0x18;
const OPTR: u32 = 0x20;

/// Times to program 64 bits and to erase a page (DS12589 table 44, typical).
const PROGRAM: Tick = micros(82);
const ERASE: Tick = micros(22_020);

/// Errors in SR: OPERR, PROGERR, WRPERR, PGAERR, SIZERR, PGSERR, MISERR, FASTERR.
const ERRORS: u32 = 0x3fa;
const PROGERR: u32 = 1 << 3;
const PGSERR: u32 = 1 << 7;
/// Enable and reset bits of the data cache in ACR, and reset bit of the other cache.
const DCEN: u32 = 1 << 10;
const ICRST: u32 = 1 << 11;
const DCRST: u32 = 1 << 12;

/// Flash controller with the contents of the data part.
pub struct Flash {
    /// Whole flash: first address and number of bytes.
    all: (u32, u32),
    contents: FlashContents,
    acr: u32,
    cr: u32,
    sr: u32,
    eccr: u32,
    lock: Lock,
    /// Address and value of the first half of a double word.
    half: Option<(u32, u32)>,
    /// End of the last operation.
    busy: Tick,
    /// Whether the data cache may hold contents from before an erasure or a program.
    stale: bool,
}

impl Flash {
    /// Erased flash with this data part.
    pub fn new(all: (u32, u32), data: (u32, u32)) -> Self {
        Self {
            all,
            contents: FlashContents::erased(data),
            acr: 0x600,
            cr: LOCK,
            sr: 0,
            eccr: 0,
            lock: Lock::default(),
            half: None,
            busy: 0,
            stale: false,
        }
    }

    /// Resets the controller; contents stay.
    pub fn reset(&mut self) {
        let contents = std::mem::replace(&mut self.contents, FlashContents::erased((0, 0)));
        *self = Self { contents, ..Self::new(self.all, (0, 0)) };
    }

    /// Number of wait states.
    pub fn latency(&self) -> u32 {
        self.acr & 0xf
    }

    /// Starts an operation; false if an error of an earlier one stands, which is an error itself.
    fn begin(&mut self) -> bool {
        let clear = self.sr & ERRORS == 0;
        if !clear {
            self.sr |= PGSERR;
        }
        clear
    }

    fn erase(&mut self, page: u32, now: Tick) -> Outcome {
        if !self.begin() {
            return Ok(());
        }
        let address = self.all.0 + page * PAGE;
        self.contents.bytes(address, PAGE)?.fill(0xff);
        self.contents.cells.torn.retain(|word| !(address..address + PAGE).contains(word));
        // A power cut leaves some cells erased and some not: no word of the page can be trusted.
        self.contents.finish(|cells| tear(cells, address, PAGE));
        (self.busy, self.stale) = (now + ERASE, true);
        Ok(())
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32, now: Tick) -> Outcome<u32> {
        Ok(match offset {
            ACR => self.acr,
            SR if now < self.busy => self.sr | BSY,
            SR => self.sr,
            CR => self.cr,
            ECCR => self.eccr,
            // Factory value; the firmware does not use BOR, nBOOT0 and similar.
            OPTR => 0xffef_f8aa,
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick) -> Outcome {
        match offset {
            // The reset bits are two above the enable bits.
            ACR if value & (ICRST | DCRST) & (value << 2) != 0 => {
                return Err("a cache is reset while it is on".into());
            }
            ACR => {
                self.stale &= value & DCRST == 0;
                self.acr = value;
            }
            KEYR | CR if now < self.busy => {
                return Err("written while the flash is busy (SR.BSY)".into());
            }
            KEYR => self.lock.turn(value, &mut self.cr)?,
            SR => self.sr &= !value,
            ECCR => self.eccr &= !(value & 0xc000_0000),
            CR => return self.control(value, now),
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }

    fn control(&mut self, value: u32, now: Tick) -> Outcome {
        if Lock::holds(self.cr, value)? {
            return Ok(());
        }
        // PG, PER, PNB, STRT, LOCK, and BKER of a flash with two banks
        let banks = self.all.1 / PAGE / BANK;
        if value & !(LOCK | 1 << 16 | 0x3fb | if banks > 1 { BKER } else { 0 }) != 0 {
            return Err(UNMODELLED.into());
        }
        self.cr = value & !(1 << 16);
        if value >> 16 & 1 == 0 {
            return Ok(());
        }
        if value & 3 != 2 {
            return Err("STRT without PER".into());
        }
        self.erase((value >> 3 & 0x7f) + if value & BKER == 0 { 0 } else { BANK }, now)
    }
}

/// Marks the double words from `address` on as damaged.
fn tear(cells: &mut Cells, address: u32, length: u32) {
    cells.torn.extend((address..address + length).step_by(8));
}

impl Changed for Flash {
    fn contents(&mut self) -> &mut FlashContents {
        &mut self.contents
    }

    fn access_control(&self) -> u32 {
        self.acr
    }

    fn busy_until(&self) -> Tick {
        self.busy
    }

    fn fetch(&mut self, address: u32, size: u32) -> Outcome<(u32, bool)> {
        if self.stale && self.acr & DCEN != 0 {
            return Err("the data cache was not reset after an erasure or a program".into());
        }
        let torn = self.contents.cells.torn.contains(&(address & !7));
        if torn {
            // ECCD; the address is not modelled.
            self.eccr |= 1 << 31;
        }
        Ok((self.contents.fetch(address, size), torn))
    }

    /// Programs half of a double word.
    fn program(&mut self, address: u32, size: u32, value: u32, now: Tick) -> Outcome {
        if now < self.busy {
            return Err("a write to the flash while it is busy (SR.BSY)".into());
        }
        if self.cr & 1 == 0 || size != 4 {
            return Err("a write to the flash without PG, or not of 32 bits".into());
        }
        let Some((first, low)) = self.half.take() else {
            if address & 7 != 0 {
                return Err("the first word of a double word is not its lower one".into());
            }
            self.half = Some((address, value));
            return Ok(());
        };
        if address != first + 4 {
            return Err("the second word does not follow the first".into());
        }
        if !self.begin() {
            return Ok(());
        }
        let word = [low.to_le_bytes(), value.to_le_bytes()].concat();
        let torn = self.contents.cells.torn.contains(&first);
        let place = self.contents.bytes(first, 8)?;
        let erased = place.iter().all(|byte| *byte == 0xff) && !torn;
        if !erased && word.iter().any(|byte| *byte != 0) {
            // The double word stays as it was.
            self.sr |= PROGERR;
            return Ok(());
        }
        place.copy_from_slice(&word);
        self.contents.cells.torn.remove(&first);
        self.contents.finish(|cells| tear(cells, first, 8));
        (self.busy, self.stale) = (now + PROGRAM, true);
        Ok(())
    }
}

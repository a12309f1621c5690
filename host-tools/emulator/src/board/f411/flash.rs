//! Flash of the STM32F411 (RM0383 §3): wait states, sector erase, word programming, power cuts.
//!
//! Only the sectors that `memory.x` keeps from the program can be erased and programmed. Firmware
//! that changes its own code is not modelled. The core stalls while the flash is busy, unless it
//! runs from another memory. There is no error correction: cells that a power cut left half done
//! are read as they are.

use crate::board::cells::{BSY, Cells, Flash as Changed, FlashContents, LOCK, Lock};
use crate::board::time::{Tick, micros};
use crate::board::{Outcome, UNMODELLED};

/// Whole flash: first address and number of bytes.
pub const ALL: (u32, u32) = (0x0800_0000, 0x8_0000);
/// Data part, which survives power-off: sectors 1 to 4.
pub const DATA: (u32, u32) = (0x0800_4000, 0x1_c000);
/// Sectors of the data part, with their erase times.
///
/// The times are for 8, 16 and 32 bits at once (DS10314 table 47, typical).
const SECTORS: [(u32, u32, [Tick; 3]); 4] = [
    (0x0800_4000, 0x4000, SMALL),
    (0x0800_8000, 0x4000, SMALL),
    (0x0800_c000, 0x4000, SMALL),
    (0x0801_0000, 0x1_0000, [micros(1_200_000), micros(700_000), micros(550_000)]),
];
const SMALL: [Tick; 3] = [micros(400_000), micros(300_000), micros(250_000)];
/// Time to program a word.
const PROGRAM: Tick = micros(16);

const ACR: u32 = 0x00;
const KEYR: u32 = 0x04;
const SR: u32 = 0x0c;
const CR: u32 = 0x10;
const OPTCR: u32 = 0x14;

const STRT: u32 = 1 << 16;
const PG: u32 = 1;
const SER: u32 = 1 << 1;
/// Enable bit of the data cache in ACR, and reset bits of both caches two bits above theirs.
const DCEN: u32 = 1 << 10;
const ICRST: u32 = 1 << 11;
const DCRST: u32 = 1 << 12;
/// PSIZE for 32 bits at once.
const WORDS: usize = 2;

/// Bits of a byte that an interrupted operation has changed.
const HALF_DONE: u8 = 0b0101_0110;

/// Flash controller with the contents of the data part.
pub struct Flash {
    contents: FlashContents,
    acr: u32,
    cr: u32,
    sr: u32,
    lock: Lock,
    /// End of the last operation.
    busy: Tick,
    /// Whether the data cache may hold contents from before an erasure or a program.
    stale: bool,
}

impl Default for Flash {
    /// Erased flash.
    fn default() -> Self {
        Self {
            contents: FlashContents::erased(DATA),
            acr: 0,
            cr: LOCK,
            sr: 0,
            lock: Lock::default(),
            busy: 0,
            stale: false,
        }
    }
}

impl Flash {
    /// Resets the controller; contents stay.
    pub fn reset(&mut self) {
        let contents = std::mem::replace(&mut self.contents, FlashContents::erased((0, 0)));
        *self = Self { contents, ..Self::default() };
    }

    /// Number of wait states.
    pub fn latency(&self) -> u32 {
        self.acr & 0xf
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32, now: Tick) -> Outcome<u32> {
        Ok(match offset {
            ACR => self.acr,
            SR if now < self.busy => self.sr | BSY,
            SR => self.sr,
            CR => self.cr,
            // Factory value; the firmware does not use brown-out and write protection.
            OPTCR => 0x0fff_aaed,
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick) -> Outcome {
        match offset {
            // LATENCY, PRFTEN, ICEN, DCEN, ICRST, DCRST
            ACR if value & !0x1f0f != 0 => return Err(UNMODELLED.into()),
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
            CR => return self.control(value, now),
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }

    fn control(&mut self, value: u32, now: Tick) -> Outcome {
        if Lock::holds(self.cr, value)? {
            return Ok(());
        }
        // PG, SER, SNB, PSIZE, STRT, LOCK
        if value & !(LOCK | STRT | 0x37b) != 0 {
            return Err(UNMODELLED.into());
        }
        self.cr = value & !STRT;
        if value & STRT == 0 {
            return Ok(());
        }
        if value & (PG | SER) != SER {
            return Err("STRT without SER, or with PG".into());
        }
        self.erase(value >> 3 & 0xf, now)
    }

    /// PSIZE: the code of the number of bits at once.
    fn parallelism(&self) -> usize {
        (self.cr >> 8 & 3) as usize
    }

    fn erase(&mut self, number: u32, now: Tick) -> Outcome {
        let sector = (number as usize).checked_sub(1).and_then(|i| SECTORS.get(i)).copied();
        let sector = sector.ok_or_else(|| format!("sector {number}, which holds the program"));
        let (address, bytes, times) = sector?;
        // x64 needs a second supply voltage.
        let time = times.get(self.parallelism()).ok_or("PSIZE = x64")?;
        let cells = self.contents.bytes(address, bytes)?;
        let before = cells.to_vec();
        cells.fill(0xff);
        (self.busy, self.stale) = (now + time, true);
        // A power cut leaves some bits erased and some not.
        self.contents.finish(|cells| half_done(cells, address, &before));
        Ok(())
    }
}

/// Restores some bits from `address` on to `before`, as an interrupted operation leaves them.
fn half_done(cells: &mut Cells, address: u32, before: &[u8]) {
    let at = (address - DATA.0) as usize;
    for (cell, before) in cells.data.iter_mut().skip(at).zip(before) {
        *cell = *cell & HALF_DONE | before & !HALF_DONE;
    }
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
        Ok((self.contents.fetch(address, size), false))
    }

    fn program(&mut self, address: u32, size: u32, value: u32, now: Tick) -> Outcome {
        if now < self.busy {
            return Err("a write to the flash while it is busy (SR.BSY)".into());
        }
        if self.cr & PG == 0 {
            return Err("a write to the flash without PG".into());
        }
        if size != 4 || address & 3 != 0 || self.parallelism() != WORDS {
            return Err("a write to the flash that is no aligned word with PSIZE = x32".into());
        }
        let cells = self.contents.bytes(address, 4)?;
        let before = cells.to_vec();
        // Programming can only clear bits.
        cells.iter_mut().zip(value.to_le_bytes()).for_each(|(cell, byte)| *cell &= byte);
        (self.busy, self.stale) = (now + PROGRAM, true);
        self.contents.finish(|cells| half_done(cells, address, &before));
        Ok(())
    }
}

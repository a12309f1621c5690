//! Independent watchdog (RM0440 §43), on a clock of exactly 32 kHz.

use super::time::{self, Tick};
use super::{Outcome, UNMODELLED};

const LSI: Tick = time::HZ / 32_000;

/// Independent watchdog (IWDG).
pub struct Iwdg {
    unlocked: bool,
    prescaler: u32,
    reload: u32,
    fed: Option<Tick>,
    /// Longest time between two feedings.
    longest: Tick,
}

impl Default for Iwdg {
    fn default() -> Self {
        Self { unlocked: false, prescaler: 0, reload: 0xfff, fed: None, longest: 0 }
    }
}

impl Iwdg {
    /// Time from feeding the watchdog to its reset; `None` if it is off.
    pub fn patience(&self) -> Option<Tick> {
        let count = Tick::from(self.reload + 1) * (4 << self.prescaler.min(6));
        self.fed.map(|_| count * LSI)
    }

    /// Longest time that the watchdog was not fed since `now` was last given.
    pub fn longest(&mut self, now: Tick) -> Tick {
        let since = self.fed.map_or(0, |fed| now.saturating_sub(fed));
        std::mem::take(&mut self.longest).max(since)
    }

    /// Time at which the watchdog resets the chip.
    pub fn next(&self) -> Option<Tick> {
        Some(self.fed? + self.patience()?)
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        Ok(match offset {
            0x04 => self.prescaler,
            0x08 => self.reload,
            // SR: values take effect at once.
            0x0c => 0,
            0x10 => 0xfff,
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick) -> Outcome {
        match (offset, value) {
            (0x00, 0xaaaa) => {
                self.longest = self.longest.max(self.fed.map_or(0, |fed| now - fed));
                self.fed = self.fed.map(|_| now);
            }
            (0x00, 0xcccc) => self.fed = Some(now),
            (0x00, 0x5555) => self.unlocked = true,
            (0x00, 0x0000) => self.unlocked = false,
            (0x04 | 0x08, _) if !self.unlocked => {
                return Err("written without the key in KR".into());
            }
            (0x04, _) => self.prescaler = value & 7,
            (0x08, _) => self.reload = value & 0xfff,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }
}

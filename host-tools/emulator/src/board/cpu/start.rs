//! Starts of the core: power-up, reset, and the ROM bootloader's jump to the program.

use anyhow::{Result, anyhow};
use unicorn_engine::RegisterARM;

use super::memory::ROM;
use super::{Board, failed};
use crate::board::chip::Cause;
use crate::board::time::{Tick, micros};
use crate::fetch::Settings;

/// Registers of the core's own peripherals as the ROM's bootloader leaves them.
///
/// VTOR names the ROM's vectors, and SysTick interrupts every 10 000 cycles.
const INTERRUPTS_OF_ROM: [(u32, u32); 3] =
    [(0xe000_ed08, ROM.0), (0xe000_e014, 9_999), (0xe000_e010, 7)];

/// Time between the bootloader's writes, in which every oscillator starts.
const STARTED: Tick = micros(3_000);

impl Board {
    /// Cuts the power and restores it; the RAM loses its contents.
    pub fn power_cycle(&mut self) -> Result<()> {
        for (address, bytes) in self.chip().map().ram {
            // RAM holds anything after power-up; this pattern is no value that a program expects.
            self.unicorn
                .mem_write(u64::from(*address), &vec![0xa5; *bytes as usize])
                .map_err(failed("clearing the RAM"))?;
        }
        self.reset(Cause::Power)
    }

    pub(super) fn reset(&mut self, cause: Cause) -> Result<()> {
        let inside = self.unicorn.get_data_mut();
        let now = inside.now;
        (inside.event, inside.float, inside.stop) = (false, false, None);
        if let Some(chip) = &mut inside.chip {
            chip.reset(cause, now);
            inside.clock.fetch().set(Settings::of(chip.flash().access_control()));
        }
        self.begin()
    }

    /// Starts the program as the ROM's bootloader does when it leaves (`dfu-util …:leave`).
    ///
    /// Its clocks stay on, VTOR names its vectors, and its interrupts come.
    pub fn leave_bootloader(&mut self) -> Result<()> {
        let chip = self.chip();
        let registers = chip.left_by_bootloader().iter().chain(&INTERRUPTS_OF_ROM);
        for (address, value) in registers.copied().collect::<Vec<_>>() {
            self.unicorn.get_data_mut().now += STARTED;
            let now = (self.now(), 0);
            let written = self.chip().write(address, 4, value, now);
            written.map_err(|why| anyhow!("the bootloader: {why}"))?;
        }
        self.begin()
    }

    /// Jumps to the program's entry with interrupts on.
    fn begin(&mut self) -> Result<()> {
        self.handlers.clear();
        let [stack, entry] = self.vectors;
        self.set(RegisterARM::XPSR, 1 << 24)?;
        self.set(RegisterARM::PRIMASK, 0)?;
        self.set(RegisterARM::BASEPRI, 0)?;
        self.set(RegisterARM::SP, stack)?;
        self.set(RegisterARM::LR, u32::MAX)?;
        self.next = entry & !1;
        Ok(())
    }
}

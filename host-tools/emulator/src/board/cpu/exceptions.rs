//! Entry and return of exceptions (ARMv7-M Architecture Reference Manual, B1.5).

use anyhow::{Context, Result};
use unicorn_engine::RegisterARM;

use super::{Board, memory};
use crate::board::chip::PRIVATE;
use crate::board::system::HARD_FAULT;

/// Cycles of an exception's entry and return (Cortex-M4 TRM, 3.9).
const ENTRY: u64 = 12;
const EXIT: u64 = 12;
/// Bit 9 of a stacked xPSR: the frame was aligned by skipping a word.
const REALIGNED: u32 = 1 << 9;

const FRAME: [RegisterARM; 6] = [
    RegisterARM::R0,
    RegisterARM::R1,
    RegisterARM::R2,
    RegisterARM::R3,
    RegisterARM::R12,
    RegisterARM::LR,
];
const FLOATS: [RegisterARM; 16] = [
    RegisterARM::S0,
    RegisterARM::S1,
    RegisterARM::S2,
    RegisterARM::S3,
    RegisterARM::S4,
    RegisterARM::S5,
    RegisterARM::S6,
    RegisterARM::S7,
    RegisterARM::S8,
    RegisterARM::S9,
    RegisterARM::S10,
    RegisterARM::S11,
    RegisterARM::S12,
    RegisterARM::S13,
    RegisterARM::S14,
    RegisterARM::S15,
];

impl Board {
    /// Stacks the registers and jumps to the handler of `exception`.
    ///
    /// Floating-point registers are saved at once, with the cost of lazy stacking.
    pub(super) fn enter(&mut self, exception: usize) -> Result<()> {
        let float = self.unicorn.get_data().float;
        let (stack, xpsr) = (self.get(RegisterARM::SP)?, self.get(RegisterARM::XPSR)?);
        let bytes = if float { 0x68 } else { 0x20 };
        let realigned = stack & 4 != 0;
        let frame = (stack - bytes) & !7;
        let mut words = Vec::with_capacity(26);
        for register in FRAME {
            words.push(self.get(register)?);
        }
        words.extend([self.next, xpsr & !REALIGNED | if realigned { REALIGNED } else { 0 }]);
        if float {
            for register in FLOATS.into_iter().chain([RegisterARM::FPSCR]) {
                words.push(self.get(register)?);
            }
            words.push(0);
        }
        if let Err(why) = self.put(frame, &words) {
            if !memory::is_below_ram(&self.chip().map(), frame) {
                return Err(why);
            }
            // Stacking faults. The handler of that fault begins with its registers lost, too.
            if exception != HARD_FAULT {
                return self.enter(HARD_FAULT);
            }
        }
        let back = 0xffff_ffe1
            | if float { 0 } else { 0x10 }
            | if self.handlers.is_empty() { 8 } else { 0 };
        self.handlers.push((exception, back));
        self.set(RegisterARM::SP, frame)?;
        self.set(RegisterARM::LR, back)?;
        self.set(RegisterARM::XPSR, 1 << 24 | exception as u32)?;
        self.spend(ENTRY);
        let system = &mut self.chip().common_mut().system;
        system.enter(exception);
        let vector = system.vectors() + 4 * exception as u32;
        if vector < memory::CORE_MEMORY {
            let busy = self.chip().flash().busy_until();
            let inside = self.unicorn.get_data_mut();
            inside.now = inside.now.max(busy);
        }
        let handler = self.word(vector)?;
        if handler & 1 == 0 || handler >= PRIVATE {
            let why = format!("the vector at {vector:#010x} is {handler:#010x}, which is no code");
            return Err(self.fault(self.next, &why));
        }
        self.next = handler & !1;
        let inside = self.unicorn.get_data_mut();
        (inside.event, inside.float) = (true, false);
        Ok(())
    }

    /// Unstacks the registers and returns to the interrupted code.
    pub(super) fn leave(&mut self) -> Result<()> {
        let (exception, back) = self.handlers.pop().context("a return without an exception")?;
        let frame = self.get(RegisterARM::SP)?;
        let float = back & 0x10 == 0;
        for (register, at) in FRAME.into_iter().zip((frame..).step_by(4)) {
            let value = self.word(at)?;
            self.set(register, value)?;
        }
        let (next, xpsr) = (self.word(frame + 0x18)?, self.word(frame + 0x1c)?);
        if float {
            for (register, at) in
                FLOATS.into_iter().chain([RegisterARM::FPSCR]).zip((frame + 0x20..).step_by(4))
            {
                let value = self.word(at)?;
                self.set(register, value)?;
            }
        }
        let bytes = if float { 0x68 } else { 0x20 } + if xpsr & REALIGNED != 0 { 4 } else { 0 };
        self.set(RegisterARM::XPSR, xpsr & !REALIGNED | 1 << 24)?;
        self.set(RegisterARM::SP, frame + bytes)?;
        self.next = next & !1;
        self.spend(EXIT);
        self.chip().common_mut().system.leave(exception);
        let inside = self.unicorn.get_data_mut();
        (inside.event, inside.float) = (true, float);
        Ok(())
    }

    pub(super) fn spend(&mut self, cycles: u64) {
        let inside = self.unicorn.get_data_mut();
        inside.extra += cycles;
        inside.now += cycles * inside.chip.as_ref().map_or(0, |chip| chip.hclk());
    }
}

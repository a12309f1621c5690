//! Core peripherals outside unicorn: interrupt controller, system control, SysTick and cycle
//! counter.
//!
//! Source: ARMv7-M Architecture Reference Manual, B3.

use super::time::Tick;
use super::{Outcome, UNMODELLED};

/// Number of exceptions: 16 of the core, then the chip's interrupts.
const EXCEPTIONS: usize = 128;
/// Number of the non-maskable interrupt.
pub const NMI: usize = 2;
/// Number of the exception after a failed access.
pub const HARD_FAULT: usize = 3;
const SVCALL: usize = 11;
const PENDSV: usize = 14;
const SYSTICK: usize = 15;
/// Number of the chip's first interrupt.
pub const FIRST: usize = 16;

/// Priority of code outside exceptions, below all others.
const THREAD: i16 = 256;
/// Implemented bits of four priorities: the top four of each.
const PRIORITY_BITS: u32 = 0xf0f0_f0f0;

const DWT_CTRL: u32 = 0x1000;
const DWT_CYCCNT: u32 = 0x1004;
const SYST: u32 = 0xe010;
const ICSR: u32 = 0xed04;
const VTOR: u32 = 0xed08;
const AIRCR: u32 = 0xed0c;
const SCR: u32 = 0xed10;
const CPACR: u32 = 0xed88;
const FPCCR: u32 = 0xef34;

/// Exception masks that the core keeps itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct Masks {
    /// Masks everything except NMI and HardFault.
    pub primask: bool,
    /// Masks this priority and lower ones; zero masks nothing.
    pub basepri: u8,
}

/// Peripherals on the private peripheral bus.
pub struct System {
    pending: u128,
    enabled: u128,
    active: u128,
    /// Interrupts with an active line.
    lines: u128,
    priority: [u8; EXCEPTIONS],
    vtor: u32,
    aircr: u32,
    cpacr: u32,
    demcr: u32,
    dwt_ctrl: u32,
    /// Offset of CYCCNT from the cycles that the core has run.
    cyccnt_offset: u32,
    systick: SysTick,
    reset_requested: bool,
    /// Exceptions that were taken.
    taken: u128,
}

#[derive(Clone, Copy, Default)]
struct SysTick {
    csr: u32,
    reload: u32,
    /// Time at which the counter next reaches zero.
    zero: Tick,
    clock: Tick,
}

impl SysTick {
    fn period(&self) -> Tick {
        (Tick::from(self.reload) + 1) * self.clock
    }
}

impl Default for System {
    fn default() -> Self {
        Self {
            pending: 0,
            // The core's own exceptions are always enabled; fault exceptions are not modelled.
            enabled: 1 << NMI | 1 << SVCALL | 1 << PENDSV | 1 << SYSTICK,
            active: 0,
            lines: 0,
            priority: [0; EXCEPTIONS],
            vtor: 0x0800_0000,
            aircr: 0,
            cpacr: 0,
            demcr: 0,
            dwt_ctrl: 0x4000_0000,
            cyccnt_offset: 0,
            systick: SysTick::default(),
            reset_requested: false,
            taken: 0,
        }
    }
}

impl System {
    /// Address of the vector table.
    pub fn vectors(&self) -> u32 {
        self.vtor
    }

    /// Takes a pending reset request.
    pub fn take_reset(&mut self) -> bool {
        std::mem::take(&mut self.reset_requested)
    }

    /// Sets the line of an interrupt of the chip.
    pub fn set_line(&mut self, interrupt: usize, high: bool) {
        let bit = 1 << (FIRST + interrupt);
        if high && self.lines & bit == 0 {
            self.pending |= bit;
        }
        if high { self.lines |= bit } else { self.lines &= !bit }
    }

    /// Makes an exception pending.
    pub fn pend(&mut self, exception: usize) {
        self.pending |= 1 << exception;
    }

    /// Interrupts that were taken.
    pub fn taken(&self) -> impl Iterator<Item = usize> {
        Self::set_bits(self.taken >> FIRST)
    }

    /// Whether an enabled exception is pending, masked or not.
    pub fn is_waiting(&self) -> bool {
        self.pending & self.enabled != 0
    }

    fn priority(&self, exception: usize) -> i16 {
        match exception {
            NMI => -2,
            HARD_FAULT => -1,
            other => i16::from(self.priority[other]),
        }
    }

    fn set_bits(mut bits: u128) -> impl Iterator<Item = usize> {
        std::iter::from_fn(move || {
            let first = (bits != 0).then(|| bits.trailing_zeros() as usize)?;
            bits &= bits - 1;
            Some(first)
        })
    }

    /// Exception to take now.
    pub fn deliverable(&self, masks: Masks) -> Option<usize> {
        let waiting = self.pending & self.enabled;
        let first = Self::set_bits(waiting)
            .min_by_key(|exception| (self.priority(*exception), *exception))?;
        let mut running = Self::set_bits(self.active)
            .map(|exception| self.priority(exception))
            .min()
            .unwrap_or(THREAD);
        if masks.basepri != 0 {
            running = running.min(i16::from(masks.basepri));
        }
        if masks.primask {
            running = running.min(0);
        }
        (self.priority(first) < running).then_some(first)
    }

    /// Records that the handler of an exception begins.
    pub fn enter(&mut self, exception: usize) {
        self.pending &= !(1 << exception);
        self.active |= 1 << exception;
        self.taken |= 1 << exception;
    }

    /// Records that the handler of an exception returns.
    pub fn leave(&mut self, exception: usize) {
        self.active &= !(1 << exception);
        if self.lines >> exception & 1 == 1 {
            self.pending |= 1 << exception;
        }
    }

    /// Time at which SysTick reaches zero.
    pub fn next(&self) -> Option<Tick> {
        (self.systick.csr & 1 == 1).then_some(self.systick.zero)
    }

    /// Lets SysTick reach zero.
    pub fn advance(&mut self, now: Tick) {
        self.systick.zero = now + self.systick.period();
        self.systick.csr |= 1 << 16;
        if self.systick.csr & 2 != 0 {
            self.pend(SYSTICK);
        }
    }

    /// Reads at `offset` from 0xE000_0000; `cycles` are the cycles that the core has run.
    pub fn read(&mut self, offset: u32, size: u32, now: Tick, cycles: u32) -> Outcome<u32> {
        let wide = offset & !3;
        let word = self.read_word(wide, now, cycles)?;
        let shift = 8 * (offset & 3);
        let mask = u32::MAX >> (32 - 8 * size);
        Ok(word >> shift & mask)
    }

    fn read_word(&mut self, offset: u32, now: Tick, cycles: u32) -> Outcome<u32> {
        let word = |bits: u128, from: u32| (bits >> (FIRST as u32 + 8 * (offset - from))) as u32;
        Ok(match offset {
            DWT_CTRL => self.dwt_ctrl,
            // TRCENA, CYCCNTENA
            DWT_CYCCNT if self.demcr >> 24 & self.dwt_ctrl & 1 == 0 => 0,
            DWT_CYCCNT => cycles.wrapping_add(self.cyccnt_offset),
            SYST => {
                let csr = self.systick.csr;
                self.systick.csr &= !(1 << 16);
                csr
            }
            0xe014 => self.systick.reload,
            0xe018 if self.systick.csr & 1 == 1 => {
                let left = self.systick.zero.saturating_sub(now) / self.systick.clock;
                left.min(Tick::from(self.systick.reload)) as u32
            }
            0xe018 => 0,
            0xe100..=0xe10c => word(self.enabled, 0xe100),
            0xe180..=0xe18c => word(self.enabled, 0xe180),
            0xe200..=0xe20c => word(self.pending, 0xe200),
            0xe280..=0xe28c => word(self.pending, 0xe280),
            0xe300..=0xe30c => word(self.active, 0xe300),
            0xe400..=0xe46c => self.priorities(FIRST + (offset - 0xe400) as usize),
            0xed00 => 0x410f_c241,
            ICSR => {
                let active =
                    Self::set_bits(self.active).min_by_key(|e| self.priority(*e)).unwrap_or(0);
                let flag =
                    |exception: usize, bit: u32| ((self.pending >> exception & 1) as u32) << bit;
                active as u32 | flag(PENDSV, 28) | flag(SYSTICK, 26)
            }
            VTOR => self.vtor,
            AIRCR => 0xfa05_0000 | self.aircr,
            SCR => 0,
            // STKALIGN
            0xed14 => 0x200,
            0xed18..=0xed20 => self.priorities(4 + (offset - 0xed18) as usize),
            // SHCSR and fault status: no fault is enabled and none has occurred.
            0xed24..=0xed30 => 0,
            CPACR => self.cpacr,
            // DHCSR: no debugger.
            0xedf0 => 0,
            0xedfc => self.demcr,
            // ASPEN, LSPEN
            FPCCR => 0xc000_0000,
            _ => return Err(UNMODELLED.into()),
        })
    }

    fn priorities(&self, first: usize) -> u32 {
        let bytes = self.priority.get(first..first + 4).and_then(|bytes| bytes.first_chunk());
        bytes.map_or(0, |bytes| u32::from_le_bytes(*bytes))
    }

    /// Writes at `offset` from 0xE000_0000; `clock` is the period of the core's clock.
    pub fn write(
        &mut self,
        offset: u32,
        size: u32,
        value: u32,
        now: (Tick, u32),
        clock: Tick,
    ) -> Outcome {
        if size != 4 {
            // Only priorities can be written by the byte.
            let wide = offset & !3;
            if !matches!(wide, 0xe400..=0xe46c | 0xed18..=0xed20) {
                return Err("partial write, which is not modelled".into());
            }
            let shift = 8 * (offset & 3);
            let mask = (u32::MAX >> (32 - 8 * size)) << shift;
            let before = self.read_word(wide, now.0, now.1)?;
            return self.write(wide, 4, before & !mask | value << shift & mask, now, clock);
        }
        let bits = |from: u32| u128::from(value) << (FIRST as u32 + 8 * (offset - from));
        match offset {
            DWT_CTRL => self.dwt_ctrl = 0x4000_0000 | value & 1,
            DWT_CYCCNT => self.cyccnt_offset = value.wrapping_sub(now.1),
            SYST => {
                let started = self.systick.csr & 1 == 0 && value & 1 == 1;
                self.systick.csr = value & 7;
                // CLKSOURCE: HCLK, or an eighth of it.
                self.systick.clock = if value & 4 != 0 { clock } else { 8 * clock };
                if started {
                    self.systick.zero = now.0 + self.systick.period();
                }
            }
            0xe014 => self.systick.reload = value & 0xff_ffff,
            0xe018 => self.systick.zero = now.0 + self.systick.period(),
            0xe100..=0xe10c => self.enabled |= bits(0xe100),
            0xe180..=0xe18c => self.enabled &= !bits(0xe180),
            0xe200..=0xe20c => self.pending |= bits(0xe200),
            // An active line makes its interrupt pending again at once.
            0xe280..=0xe28c => self.pending &= !bits(0xe280) | self.lines,
            0xe400..=0xe46c => self.set_priorities(FIRST + (offset - 0xe400) as usize, value),
            ICSR => {
                for (bit, exception) in [(28, PENDSV), (26, SYSTICK), (31, NMI)] {
                    if value >> bit & 1 == 1 {
                        self.pend(exception);
                    }
                }
                for (bit, exception) in [(27, PENDSV), (25, SYSTICK)] {
                    if value >> bit & 1 == 1 {
                        self.pending &= !(1 << exception);
                    }
                }
            }
            VTOR => self.vtor = value & 0xffff_ff80,
            AIRCR if value >> 16 != 0x05fa => {}
            AIRCR if value & 0x700 != 0 => {
                return Err("priority groups, which are not modelled".into());
            }
            AIRCR => self.reset_requested |= value & 4 != 0,
            SCR if value != 0 => {
                return Err("deep sleep, sleep on exit or SEVONPEND, which are not modelled".into());
            }
            SCR => {}
            0xed18..=0xed20 => self.set_priorities(4 + (offset - 0xed18) as usize, value),
            CPACR => self.cpacr = value,
            0xedfc => self.demcr = value,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }

    fn set_priorities(&mut self, first: usize, value: u32) {
        let value = value & PRIORITY_BITS;
        if let Some(place) = self.priority.get_mut(first..first + 4) {
            place.copy_from_slice(&value.to_le_bytes());
        }
    }
}

/// Readable name of a core register.
pub fn name(address: u32) -> String {
    let name = match address & 0xf_ffff {
        0x1000..=0x1fff => "DWT",
        0x0000..=0x0fff => "ITM",
        0xe010..=0xe01f => "SysTick",
        0xe100..=0xe4ff => "NVIC",
        0xed00..=0xed8f => "SCB",
        0xed90..=0xedef => "MPU",
        0xedf0..=0xedff => "DCB",
        0xef30..=0xef4f => "FPU",
        0x4_0000..=0x4_0fff => "TPIU",
        0x4_1000..=0x4_1fff => "ETM",
        0x4_2000..=0x4_23ff => "DBGMCU",
        _ => "private peripheral bus",
    };
    format!("{name} ({address:#010x})")
}

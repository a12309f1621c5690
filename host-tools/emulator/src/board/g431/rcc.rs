//! Clocks and resets of the STM32G431 (RM0440 §7).
//!
//! Oscillators are ready after their typical start-up time. Changes of the system clock are checked
//! against the flash's wait states.

use super::wires::Bit;
use crate::board::chip::Cause;
use crate::board::oscillators::{Oscillator, Oscillators};
use crate::board::time::{self, Tick, micros};
use crate::board::{Outcome, UNMODELLED};
use stm32_metapac::rcc::regs::{Cfgr, Cr, Csr, Pllcfgr};

const CR: u32 = 0x00;
const CFGR: u32 = 0x08;
const PLLCFGR: u32 = 0x0c;
const CSR: u32 = 0x94;
const CRRCR: u32 = 0x98;

const HSI_HZ: u64 = 16_000_000;
/// Highest HCLK with boost mode and without (DS12589 table 17).
const FASTEST: u64 = 170_000_000;
const FASTEST_UNBOOSTED: u64 = 150_000_000;
/// Highest HCLK in voltage range 2.
const FASTEST_RANGE_2: u64 = 26_000_000;
/// Fastest system clock that may be switched to without halving HCLK at first (RM0440 §7.2.7).
const HALVED: u64 = 80_000_000;

/// Least time at half of the clock, where it rises above [`HALVED`] (RM0440 §7.2.7).
const HALF_SPEED: Tick = micros(1);

/// Oscillators with their typical start-up times (DS12589 tables 40 to 43).
const OSCILLATORS: [Oscillator; 4] = [
    Oscillator { register: CR, on: 8, ready: 10, start: time::nanos(800) },
    Oscillator { register: CR, on: 24, ready: 25, start: micros(15) },
    Oscillator { register: CRRCR, on: 0, ready: 1, start: time::nanos(2_500) },
    Oscillator { register: CSR, on: 0, ready: 1, start: micros(80) },
];
const HSI16: usize = 0;
const PLL: usize = 1;
const HSI48: usize = 2;

/// Reset and clock control.
pub struct Rcc {
    registers: [u32; 0xa0 / 4],
    oscillators: Oscillators,
    hclk: Tick,
    /// Time from which the system clock is above [`HALVED`] and the AHB runs at a part of it.
    halved: Tick,
}

impl Rcc {
    /// State after a reset; flags of earlier resets stay until they are cleared.
    pub fn new(cause: Cause, before: Option<&Self>) -> Self {
        let mut registers = [0; 0xa0 / 4];
        registers[CR as usize / 4] = 0x500;
        registers[CFGR as usize / 4] = 0x5;
        registers[PLLCFGR as usize / 4] = 0x1000;
        // AHB1ENR, then AHB1SMENR and the other masks of sleep mode.
        registers[0x48 / 4] = 0x100;
        for (offset, value) in [
            (0x68, 0x130f),
            (0x6c, 0x222_2f7f),
            (0x70, 0x111),
            (0x78, 0xd2fe_cd3f),
            (0x7c, 0x103),
            (0x80, 0x15_f801),
        ] {
            registers[offset / 4] = value;
        }
        let mut csr = Csr(before.map_or(0, |rcc| rcc.registers[CSR as usize / 4]) & !3);
        // Every reset also pulls the reset pin low.
        csr.set_pinrstf(true);
        match cause {
            Cause::Power => csr.set_borrstf(true),
            Cause::Software => csr.set_sftrstf(true),
            Cause::Watchdog => csr.set_iwdgrstf(true),
        }
        registers[CSR as usize / 4] = csr.0;
        let oscillators = Oscillators::new(&OSCILLATORS, HSI16);
        Self { registers, oscillators, hclk: time::HZ / HSI_HZ, halved: 0 }
    }

    fn register(&self, offset: u32) -> u32 {
        self.registers[offset as usize / 4]
    }

    /// Period of HCLK, which is also that of all buses and timers here.
    pub fn hclk(&self) -> Tick {
        self.hclk
    }

    /// Fails if the flash has too few wait states for the present clock.
    pub fn check_latency(&self, latency: u32) -> Outcome {
        check_latency(time::HZ / self.hclk, latency)
    }

    /// Whether the core is so fast that it needs boost mode.
    pub fn needs_boost(&self) -> bool {
        time::HZ / self.hclk > FASTEST_UNBOOSTED
    }

    /// Whether the core is too fast for voltage range 2.
    pub fn needs_range_1(&self) -> bool {
        time::HZ / self.hclk > FASTEST_RANGE_2
    }

    /// Whether the USB has its 48 MHz.
    pub fn usb_clock(&self, now: Tick) -> bool {
        // CLK48SEL = HSI48
        self.oscillators.is_ready(HSI48, now) && self.register(0x88) >> 26 & 3 == 0
    }

    /// Whether a bit is set, of a clock enable or a reset.
    pub fn is_set(&self, by: &Bit) -> bool {
        self.register(by.register) >> by.place & 1 == 1
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32, now: Tick) -> Outcome<u32> {
        let value = self.registers.get(offset as usize / 4).ok_or(UNMODELLED)?;
        Ok(self.oscillators.read(offset, *value, now))
    }

    /// Writes the register at `offset`; `latency` are the flash's wait states.
    pub fn write(&mut self, offset: u32, value: u32, latency: u32, now: Tick) -> Outcome {
        let place = self.registers.get_mut(offset as usize / 4).ok_or(UNMODELLED)?;
        match offset {
            CR => {
                let cr = Cr(value);
                if cr.hseon() {
                    return Err("an external crystal, which is not modelled".into());
                }
                if cr.pllon()
                    && !self.oscillators.is_on(PLL)
                    && !self.oscillators.is_ready(HSI16, now)
                {
                    return Err("the PLL is started before HSI16 is ready (HSIRDY)".into());
                }
                *place = value;
                self.oscillators.write(CR, value, now);
                let used = match self.register(CFGR) & 3 {
                    3 => [HSI16, PLL].as_slice(),
                    _ => &[HSI16],
                };
                if used.iter().any(|i| !self.oscillators.is_on(*i)) {
                    return Err("the system clock's source is switched off".into());
                }
            }
            CFGR => {
                let mut cfgr = Cfgr(value);
                let before = Cfgr(*place).sws();
                cfgr.set_sws(cfgr.sw());
                *place = cfgr.0;
                return self.switch(latency, before != cfgr.sws(), now);
            }
            PLLCFGR if self.oscillators.is_on(PLL) => {
                return Err("the PLL is running while it is set up".into());
            }
            CSR => {
                let csr = Csr(value);
                let flags = if csr.rmvf() { 0 } else { *place & 0xff00_0000 };
                *place = flags | csr.0 & 1;
                self.oscillators.write(CSR, value, now);
            }
            CRRCR => {
                *place = value & !2;
                self.oscillators.write(CRRCR, value, now);
            }
            // ICSCR: the factory calibrates it.
            0x04 => return Err(UNMODELLED.into()),
            _ => *place = value,
        }
        Ok(())
    }

    /// Switches to the system clock that CFGR and PLLCFGR select.
    ///
    /// `changes` says that its source is another than before.
    fn switch(&mut self, latency: u32, changes: bool, now: Tick) -> Outcome {
        let cfgr = self.register(CFGR);
        let sysclk = match cfgr & 3 {
            1 if self.oscillators.is_ready(HSI16, now) => HSI_HZ,
            3 if self.oscillators.is_ready(PLL, now) => self.pll()?,
            other => return Err(format!("system clock {other}, which is not ready")),
        };
        let divider = match cfgr >> 4 & 0xf {
            hpre @ 0b1000..=0b1011 => 2 << (hpre & 3),
            hpre @ 0b1100.. => 64 << (hpre & 3),
            _ => 1,
        };
        let hclk = sysclk / divider;
        let fast = sysclk > HALVED && divider == 1;
        if fast && changes {
            return Err("the clock rises above 80 MHz in one step, not with HPRE = 2 first".into());
        }
        if fast && now < self.halved + HALF_SPEED {
            return Err("HPRE = 2 lasts less than a microsecond on the way above 80 MHz".into());
        }
        if changes {
            self.halved = now;
        }
        if cfgr >> 8 & 0b100_100 != 0 {
            return Err("an APB bus slower than the AHB, which is not modelled".into());
        }
        if hclk > FASTEST {
            return Err(format!("{hclk} Hz, above the chip's maximum of {FASTEST}"));
        }
        check_latency(hclk, latency)?;
        self.hclk = time::period(hclk).ok_or_else(|| {
            format!("{hclk} Hz, which is not modelled: its period is no whole number of ticks")
        })?;
        Ok(())
    }

    /// Frequency of the PLL's R output in hertz.
    fn pll(&self) -> Outcome<u64> {
        let raw = self.register(PLLCFGR);
        let pll = Pllcfgr(raw);
        if raw & 3 != 2 || !pll.pllren() {
            return Err("the PLL's source is not HSI16, or its R output is off".into());
        }
        let (m, n, r) = ((raw >> 4 & 0xf) + 1, raw >> 8 & 0x7f, 2 * ((raw >> 25 & 3) + 1));
        let input = HSI_HZ / u64::from(m);
        let vco = input * u64::from(n);
        // DS12589 table 47, range 1.
        if !(2_660_000..=16_000_000).contains(&input) || !(96_000_000..=344_000_000).contains(&vco)
        {
            return Err(format!(
                "PLL with {input} Hz in and {vco} Hz at its oscillator: out of range"
            ));
        }
        Ok(vco / u64::from(r))
    }
}

/// Fails if the flash has too few wait states for a core at `hclk` hertz.
fn check_latency(hclk: u64, latency: u32) -> Outcome {
    // MHz per wait state with boost mode, and without (RM0440 §3.3.3).
    let step = if hclk > FASTEST_UNBOOSTED { 34 } else { 30 };
    let needed = (hclk - 1) / (step * 1_000_000);
    if u64::from(latency) < needed {
        return Err(format!("{hclk} Hz needs {needed} wait states, {latency} are set"));
    }
    Ok(())
}

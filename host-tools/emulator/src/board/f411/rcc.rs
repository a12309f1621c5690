//! Clocks and resets of the STM32F411 (RM0383 §6).
//!
//! Oscillators are ready after their start-up time. Changes of the system clock are checked
//! against the flash's wait states and the voltage scale.

use crate::board::chip::Cause;
use crate::board::oscillators::{Oscillator, Oscillators};
use crate::board::time::{self, Tick, micros, nanos};
use crate::board::{Outcome, UNMODELLED};

const CR: u32 = 0x00;
const PLLCFGR: u32 = 0x04;
const CFGR: u32 = 0x08;
const BDCR: u32 = 0x70;
const CSR: u32 = 0x74;

const HSI_HZ: u64 = 16_000_000;
/// Crystal of the Black Pill.
const HSE_HZ: u64 = 25_000_000;
/// Highest HCLK at voltage scales 1, 2 and 3 (DS10314 table 14).
const FASTEST: [u64; 3] = [100_000_000, 84_000_000, 64_000_000];
/// Highest clock of APB1.
const FASTEST_APB1: u64 = 50_000_000;
/// Hertz per wait state at 2.7 V to 3.6 V (RM0383 table 6).
const WAIT_STATE_HZ: u64 = 30_000_000;

/// Oscillators with their typical start-up times, and the PLL with its longest (DS10314 tables 38
/// to 42).
const OSCILLATORS: [Oscillator; 4] = [
    Oscillator { register: CR, on: 0, ready: 1, start: nanos(2_200) },
    Oscillator { register: CR, on: 16, ready: 17, start: micros(2_000) },
    Oscillator { register: CR, on: 24, ready: 25, start: micros(300) },
    Oscillator { register: CSR, on: 0, ready: 1, start: micros(15) },
];
const HSI: usize = 0;
const HSE: usize = 1;
const PLL: usize = 2;

/// Reset and clock control.
pub struct Rcc {
    registers: [u32; 0x90 / 4],
    oscillators: Oscillators,
    hclk: Tick,
    /// Cycles of HCLK per cycle of APB1.
    apb1: u64,
}

impl Rcc {
    /// State after a reset; flags of earlier resets stay until they are cleared.
    pub fn new(cause: Cause, before: Option<&Self>) -> Self {
        let mut registers = [0; 0x90 / 4];
        for (offset, value) in [
            (CR, 0x83),
            (PLLCFGR, 0x2400_3010),
            (0x50, 0x0061_900f),
            (0x54, 0x80),
            (0x60, 0x10e2_c80f),
            (0x64, 0x0007_7930),
            (0x84, 0x2400_3010),
        ] {
            registers[offset as usize / 4] = value;
        }
        let csr = before.map_or(0, |rcc| rcc.register(CSR) & 0xfe00_0000);
        // Every reset also pulls the reset pin low: PINRSTF.
        let cause = match cause {
            // BORRSTF, PORRSTF
            Cause::Power => 1 << 25 | 1 << 27,
            Cause::Software => 1 << 28,
            Cause::Watchdog => 1 << 29,
        };
        registers[CSR as usize / 4] = csr | 1 << 26 | cause;
        let oscillators = Oscillators::new(&OSCILLATORS, HSI);
        Self { registers, oscillators, hclk: time::HZ / HSI_HZ, apb1: 1 }
    }

    fn register(&self, offset: u32) -> u32 {
        self.registers[offset as usize / 4]
    }

    /// Period of HCLK, which is also APB2's here.
    pub fn hclk(&self) -> Tick {
        self.hclk
    }

    /// Fails if the flash has too few wait states for the present clock.
    pub fn check_latency(&self, latency: u32) -> Outcome {
        check_latency(time::HZ / self.hclk, latency)
    }

    /// Period of TIM2's clock: half of APB1's if that bus is slower (TIMPRE is not set).
    pub fn tim2_clock(&self) -> Tick {
        if self.apb1 == 1 { self.hclk } else { self.hclk * self.apb1 / 2 }
    }

    /// Whether the USB has its 48 MHz from the PLL's Q output.
    pub fn usb_clock(&self, now: Tick) -> bool {
        let divider = u64::from(self.register(PLLCFGR) >> 24 & 0xf);
        self.oscillators.is_ready(PLL, now)
            && self.oscillator(now).is_ok_and(|vco| vco == 48_000_000 * divider)
    }

    /// Whether the PLL is on.
    pub fn pll_runs(&self) -> bool {
        self.oscillators.is_on(PLL)
    }

    /// Whether the PLL is on and has locked.
    pub fn pll_is_ready(&self, now: Tick) -> bool {
        self.oscillators.is_ready(PLL, now)
    }

    /// Whether a peripheral's clock is on.
    pub fn enabled(&self, (offset, place): (u32, u32)) -> bool {
        self.register(offset) >> place & 1 == 1
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32, now: Tick) -> Outcome<u32> {
        let value = self.registers.get(offset as usize / 4).ok_or(UNMODELLED)?;
        Ok(self.oscillators.read(offset, *value, now))
    }

    /// Writes the register at `offset`.
    ///
    /// `latency` are the flash's wait states, `scale` is the voltage scale, 1 to 3, and `now` the
    /// time.
    pub fn write(
        &mut self,
        offset: u32,
        value: u32,
        (latency, scale): (u32, u32),
        now: Tick,
    ) -> Outcome {
        let pll_runs = self.pll_runs();
        let sws = self.register(CFGR) >> 2 & 3;
        let place = self.registers.get_mut(offset as usize / 4).ok_or(UNMODELLED)?;
        match offset {
            // HSEBYP, CSSON, PLLI2SON
            CR if value & (1 << 18 | 1 << 19 | 1 << 26) != 0 => return Err(UNMODELLED.into()),
            CR => {
                let on = value & (1 | 1 << 16 | 1 << 24);
                let stopped = [(0, 0), (1, 16), (2, 24)];
                if stopped.iter().any(|(clock, bit)| sws == *clock && on >> bit & 1 == 0) {
                    return Err("the system clock's source is switched off".into());
                }
                *place = value & 0xf8 | on | *place & 0xff00;
                self.oscillators.write(CR, value, now);
                // The PLL needs its source when it starts.
                if on >> 24 & 1 == 1 && !pll_runs {
                    self.oscillator(now)?;
                }
            }
            PLLCFGR if pll_runs => return Err("the PLL is running while it is set up".into()),
            CFGR => {
                *place = value & !0xc | (value & 3) << 2;
                return self.switch(latency, scale, now);
            }
            CSR => {
                // RMVF; LSION, LSIRDY
                let flags = if value >> 24 & 1 == 1 { 0 } else { *place & 0xfe00_0000 };
                *place = flags | value & 1;
                self.oscillators.write(CSR, value, now);
            }
            BDCR if value & 5 != 0 => {
                return Err("a crystal of 32 kHz, which is not modelled".into());
            }
            // RTC domain: its reset and clock selection, which have no effect here.
            BDCR => *place = if value >> 16 & 1 == 1 { 1 << 16 } else { value },
            // Interrupts, spread spectrum.
            0x0c | 0x80 => return Err(UNMODELLED.into()),
            _ => *place = value,
        }
        Ok(())
    }

    /// Switches to the system clock that CFGR and PLLCFGR select.
    fn switch(&mut self, latency: u32, scale: u32, now: Tick) -> Outcome {
        let cfgr = self.register(CFGR);
        let sysclk = match cfgr & 3 {
            0 if self.oscillators.is_ready(HSI, now) => HSI_HZ,
            2 if self.oscillators.is_ready(PLL, now) => self.pll(now)?,
            other => {
                return Err(format!("system clock {other}, which is not ready or not modelled"));
            }
        };
        let divider = match cfgr >> 4 & 0xf {
            hpre @ 0b1000..=0b1011 => 2 << (hpre & 3),
            hpre @ 0b1100.. => 64 << (hpre & 3),
            _ => 1,
        };
        let hclk = sysclk / divider;
        let bus = |ppre: u32| if ppre & 4 == 0 { 1 } else { 2 << (ppre & 3) };
        self.apb1 = bus(cfgr >> 10 & 7);
        if bus(cfgr >> 13 & 7) != 1 {
            return Err("an APB2 slower than the AHB, which is not modelled".into());
        }
        if hclk / self.apb1 > FASTEST_APB1 {
            return Err(format!(
                "APB1 at {} Hz, above its maximum of {FASTEST_APB1}",
                hclk / self.apb1
            ));
        }
        let fastest = FASTEST[scale as usize - 1];
        if hclk > fastest {
            return Err(format!(
                "{hclk} Hz, above the {fastest} of voltage scale {scale} (PWR.CR.VOS)"
            ));
        }
        check_latency(hclk, latency)?;
        self.hclk = time::period(hclk).ok_or_else(|| {
            format!("{hclk} Hz, which is not modelled: its period is no whole number of ticks")
        })?;
        Ok(())
    }

    /// Frequency of the PLL's oscillator in hertz.
    fn oscillator(&self, now: Tick) -> Outcome<u64> {
        let raw = self.register(PLLCFGR);
        let (source, hz) = if raw >> 22 & 1 == 1 { (HSE, HSE_HZ) } else { (HSI, HSI_HZ) };
        if !self.oscillators.is_ready(source, now) {
            return Err("the PLL's source is off or not ready (HSERDY, HSIRDY)".into());
        }
        let (m, n) = (u64::from(raw & 0x3f), u64::from(raw >> 6 & 0x1ff));
        if m < 2 || !(50..=432).contains(&n) {
            return Err(format!("PLL with M = {m}, N = {n}: out of range"));
        }
        let (input, vco) = (hz / m, hz / m * n);
        // DS10314 table 42.
        if !(950_000..=2_100_000).contains(&input) || !(100_000_000..=432_000_000).contains(&vco) {
            return Err(format!(
                "PLL with {input} Hz in and {vco} Hz at its oscillator: out of range"
            ));
        }
        Ok(vco)
    }

    /// Frequency of the PLL's P output in hertz.
    fn pll(&self, now: Tick) -> Outcome<u64> {
        Ok(self.oscillator(now)? / (2 * (u64::from(self.register(PLLCFGR) >> 16 & 3) + 1)))
    }
}

/// Fails if the flash has too few wait states for a core at `hclk` hertz.
fn check_latency(hclk: u64, latency: u32) -> Outcome {
    let needed = (hclk - 1) / WAIT_STATE_HZ;
    if u64::from(latency) < needed {
        return Err(format!("{hclk} Hz needs {needed} wait states, {latency} are set"));
    }
    Ok(())
}

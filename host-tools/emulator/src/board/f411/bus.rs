//! Bus of the STM32F411: passes register accesses to the peripherals.

use super::registers::{Peripheral, peripheral};
use super::{Adc, Dma, F411, Kept, Otg, PORTS};
use crate::board::chip::PRIVATE;
use crate::board::crc::Crc;
use crate::board::gpio::Gpio;
use crate::board::time::Tick;
use crate::board::usb::Device;
use crate::board::{Outcome, UNMODELLED};

/// RCC's reset registers, AHB1RSTR to APB2RSTR, and their distance to the clock enables behind
/// them.
const RESETS: std::ops::RangeInclusive<u32> = 0x10..=0x24;
const RESET: u32 = 0x20;
/// RCC's clock enables, AHB1ENR to APB2ENR.
const ENABLES: std::ops::RangeInclusive<u32> = 0x30..=0x44;
/// Alternate function of PA11 and PA12 as D− and D+ (DS10314 table 9).
const OTG: u32 = 10;
/// Distance between two ports.
const PORT: u32 = 0x400;

fn port(base: u32) -> usize {
    (base / PORT) as usize % PORTS.len()
}

impl F411 {
    /// Peripheral at an address and the offset in it; an error if its clock is off.
    fn awake(&self, address: u32) -> Outcome<Option<(&'static Peripheral, u32)>> {
        let Some(found) = peripheral(address) else { return Ok(None) };
        match found.clock {
            Some(clock) if !self.rcc.enabled(clock) => {
                Err(format!("its clock is off: RCC + {:#x}, bit {}", clock.0, clock.1))
            }
            Some((at, bit)) if self.rcc.enabled((at - RESET, bit)) => {
                Err("it is held in reset".into())
            }
            _ => Ok(Some((found, address - found.base))),
        }
    }

    /// Resets the peripherals named by a write to RCC's reset register at `offset`.
    fn reset_units(&mut self, offset: u32, value: u32) {
        let is_named = |its: &&Peripheral| {
            its.clock.is_some_and(|(at, bit)| at - RESET == offset && value >> bit & 1 == 1)
        };
        for unit in super::registers::PERIPHERALS.iter().filter(is_named) {
            let fresh = Kept::default();
            match unit.name {
                "TIM1" => self.common.tim1 = self.common.tim1.fresh(),
                "TIM2" => self.common.tim2 = self.common.tim2.fresh(),
                "ADC1" => self.adc = Adc::default(),
                "ADC_common" => self.kept.adc_common = fresh.adc_common,
                "DMA2" => self.dma = Dma::default(),
                "OTG_FS" => self.otg = Otg::default(),
                "CRC" => self.common.crc = Crc::default(),
                "PWR" => self.kept.pwr = fresh.pwr,
                "SYSCFG" => self.kept.syscfg = fresh.syscfg,
                name if name.starts_with("GPIO") => {
                    let i = port(unit.base);
                    self.common.ports[i] = Gpio::new(PORTS[i]);
                }
                _ => {}
            }
        }
    }

    /// VOSRDY in PWR's register at `offset`: the voltage follows VOS while the PLL starts.
    fn voltage_ready(&self, offset: u32, now: Tick) -> u32 {
        let starts = self.rcc.pll_runs() && !self.rcc.pll_is_ready(now);
        if offset == 0x04 && !starts { 1 << 14 } else { 0 }
    }

    /// Fails if the access comes right after the peripheral's clock is enabled.
    fn check_wake(&mut self, address: u32, now: Tick) -> Outcome {
        let clock = peripheral(address).and_then(|its| its.clock);
        self.common.check_wake(clock, now)
    }

    pub(super) fn read_unit(&mut self, address: u32, size: u32, now: (Tick, u32)) -> Outcome<u32> {
        self.check_wake(address, now.0)?;
        let Some((unit, offset)) = self.awake(address)? else {
            if address >= PRIVATE {
                return self.common.system.read(address - PRIVATE, size, now.0, now.1);
            }
            return Err(UNMODELLED.into());
        };
        let word = offset & !3;
        let value = match unit.name {
            "RCC" => self.rcc.read(word, now.0),
            "FLASH" => self.flash.read(word, now.0),
            "TIM1" => self.common.tim1.read(word, now.0),
            "TIM2" => self.common.tim2.read(word, now.0),
            "IWDG" => self.common.iwdg.read(word),
            "CRC" => self.common.crc.read(word),
            "DMA2" => self.dma.read(word),
            "ADC1" => self.adc.read(word),
            "ADC_common" => self.kept.adc_common.read(word),
            "OTG_FS" => self.otg.read(word, self.common.host.frame(now.0)),
            "PWR" => Ok(self.kept.pwr.read(word)? | self.voltage_ready(word, now.0)),
            "SYSCFG" => self.kept.syscfg.read(word),
            "EXTI" => self.kept.exti.read(word),
            "DBGMCU" => self.kept.dbgmcu.read(word),
            name if name.starts_with("GPIO") => self.common.ports[port(unit.base)].read(word),
            _ => Err(UNMODELLED.into()),
        }?;
        Ok(value >> (8 * (offset & 3)) & u32::MAX >> (32 - 8 * size))
    }

    pub(super) fn write_unit(
        &mut self,
        address: u32,
        size: u32,
        value: u32,
        (now, cycles): (Tick, u32),
    ) -> Outcome {
        let hclk = self.rcc.hclk();
        self.check_wake(address, now)?;
        let Some((unit, offset)) = self.awake(address)? else {
            if address >= PRIVATE {
                let now = (now, cycles);
                return self.common.system.write(address - PRIVATE, size, value, now, hclk);
            }
            return Err(UNMODELLED.into());
        };
        // Timers also accept half words, as for PSC.
        let halves = unit.name.starts_with("TIM") && size == 2 && offset & 3 == 0;
        if size != 4 && !halves {
            return Err("partial write, which is not modelled".into());
        }
        match unit.name {
            "RCC" => {
                if RESETS.contains(&offset) {
                    self.reset_units(offset, value);
                }
                if ENABLES.contains(&offset) {
                    let before = self.rcc.read(offset, now)?;
                    self.common.woken = Some((offset, value & !before, now));
                }
                let scale = self.scale()?;
                self.rcc.write(offset, value, (self.flash.latency(), scale), now)
            }
            "FLASH" => {
                self.flash.write(offset, value, now)?;
                self.rcc.check_latency(self.flash.latency())
            }
            "TIM1" => self.common.write_tim1(offset, value, now, hclk),
            "TIM2" => self.common.tim2.write(offset, value, now, self.rcc.tim2_clock()),
            "IWDG" => self.common.iwdg.write(offset, value, now),
            "CRC" => self.common.crc.write(offset, value),
            "DMA2" => self.dma.write(offset, value),
            "ADC1" => {
                // ADCPRE: PCLK2/4. ADON.
                let common = self.kept.adc_common.read(0x04)?;
                if common >> 16 & 3 != 1 && offset == 0x08 && value & 1 == 1 {
                    return Err(format!("the ADC's clock is not PCLK2/4: others are {UNMODELLED}"));
                }
                self.adc.write(offset, value, now, 4 * hclk)
            }
            "ADC_common" => self.kept.adc_common.write(offset, value),
            "OTG_FS" => {
                self.otg.write(offset, value, self.rcc.usb_clock(now))?;
                let wired = [11, 12].map(|pin| self.common.ports[0].alternate(pin));
                if self.otg.is_attached() && wired != [Some(OTG); 2] {
                    return Err("connected while PA11 and PA12 are not the OTG core's".into());
                }
                Ok(())
            }
            // VOS and DBP, which unlocks the RTC's domain.
            "PWR" if value & !0xc100 != 0 || offset != 0 => Err(UNMODELLED.into()),
            "PWR" if self.rcc.pll_runs() && (value ^ self.kept.pwr.read(0)?) & 0xc000 != 0 => {
                Err("VOS is changed while the PLL runs (RM0383 §5.4.1)".into())
            }
            "PWR" => self.kept.pwr.write(offset, value),
            "SYSCFG" => self.kept.syscfg.write(offset, value),
            "EXTI" => self.kept.exti.write(offset, value),
            "DBGMCU" => self.kept.dbgmcu.write(offset, value),
            name if name.starts_with("GPIO") => {
                self.common.write_port(port(unit.base), offset, value, now)
            }
            _ => Err(UNMODELLED.into()),
        }
    }
}

//! Bus of the STM32G431: passes register accesses to the peripherals.

use super::{
    ADCS, Adc, Bit, Dma, ENABLES, G431, MODES, PWR_CR5, Place, RESETS, Unit, Usb, adc_common,
    opamp, stored_registers,
};
use crate::board::chip::PRIVATE;
use crate::board::crc::Crc;
use crate::board::gpio::Gpio;
use crate::board::time::Tick;
use crate::board::usb::Device;
use crate::board::{Outcome, UNMODELLED};

impl G431 {
    /// Peripheral at an address, and the offset in it.
    pub(super) fn unit(&self, address: u32) -> Option<(&Place, u32)> {
        let owner = self.names.peripheral(address)?.address as u32;
        let at = self.units.binary_search_by_key(&owner, |place| place.base).ok()?;
        self.units.get(at).map(|place| (place, address - place.base))
    }

    /// Fails where the core is too fast for its voltage.
    fn check_voltage(&self) -> Outcome {
        let pwr = self.stored.iter().find(|(name, _)| *name == "PWR");
        // R1MODE
        let boosted =
            pwr.and_then(|(_, pwr)| pwr.read(PWR_CR5).ok()).is_some_and(|cr5| cr5 >> 8 & 1 == 0);
        // VOS
        let range = pwr.and_then(|(_, pwr)| pwr.read(0x00).ok()).map_or(0, |cr1| cr1 >> 9 & 3);
        if range != 1 && self.rcc.needs_range_1() {
            return Err("a core faster than 26 MHz outside voltage range 1 (PWR.CR1.VOS)".into());
        }
        if self.rcc.needs_boost() && !boosted {
            return Err("a core faster than 150 MHz without boost mode (PWR.CR5.R1MODE)".into());
        }
        Ok(())
    }

    /// Whether the clock recovery trims HSI48 to 48 MHz by the host's frames (RM0440 §8).
    fn is_trimmed(&self) -> bool {
        let crs = self.stored.iter().find(|(name, _)| *name == "CRS").map(|(_, crs)| crs);
        let [cr, cfgr] =
            [0x00, 0x04].map(|at| crs.and_then(|crs| crs.read(at).ok()).unwrap_or_default());
        // RELOAD is the number of cycles, less one, in 2 to the power of SYNCDIV frames.
        let hz = (((cfgr & 0xffff) + 1) * 1_000) >> (cfgr >> 24 & 7);
        // CEN and AUTOTRIMEN; USB's start of frame. A full-speed device has 0.25 % (USB 2.0
        // §7.1.11).
        cr & 0x60 == 0x60 && cfgr >> 28 & 3 == 2 && hz.abs_diff(48_000_000) <= 120_000
    }

    /// Resets the peripherals named by a write to RCC's reset register at `offset`.
    fn reset_units(&mut self, offset: u32, value: u32) {
        let is_named = |reset: &Bit| reset.register == offset && value >> reset.place & 1 == 1;
        let named = self.units.iter().filter(|place| place.reset.as_ref().is_some_and(is_named));
        for unit in named.map(|place| place.unit).collect::<Vec<_>>() {
            match unit {
                Unit::Flash => self.flash.reset(),
                Unit::Gpio(i) => self.common.ports[i] = Gpio::new(MODES[i]),
                Unit::Tim1 => self.common.tim1 = self.common.tim1.fresh(),
                Unit::Tim2 => self.common.tim2 = self.common.tim2.fresh(),
                Unit::Dma | Unit::Multiplexer => self.dma = Dma::default(),
                Unit::Adc(i) => self.adc[i] = Adc::new(ADCS[i]),
                Unit::AdcCommon => self.adc_common = adc_common(),
                Unit::Opamp(i) => self.opamp[i] = opamp(),
                Unit::Usb => self.usb = Usb::default(),
                Unit::Crc => self.common.crc = Crc::default(),
                Unit::Stored(i) => {
                    let name = self.stored[i].0;
                    if let Some(fresh) =
                        stored_registers().into_iter().find(|(its, _)| *its == name)
                    {
                        self.stored[i] = fresh;
                    }
                }
                Unit::Rcc | Unit::Iwdg | Unit::UsbMemory => {}
            }
        }
    }

    /// Peripheral at an address and the offset in it; an error if its clock is off.
    fn awake(&self, address: u32) -> Outcome<Option<(Unit, u32)>> {
        let Some((place, offset)) = self.unit(address) else { return Ok(None) };
        match &place.enable {
            Some(enable) if !self.rcc.is_set(enable) => {
                Err(format!("its clock is off: {}", enable.name))
            }
            _ if place.reset.as_ref().is_some_and(|reset| self.rcc.is_set(reset)) => {
                Err("it is held in reset".into())
            }
            _ => Ok(Some((place.unit, offset))),
        }
    }

    /// Fails if the access comes right after the peripheral's clock is enabled.
    fn check_wake(&mut self, address: u32, now: Tick) -> Outcome {
        let enable = self.unit(address).and_then(|(place, _)| place.enable.as_ref());
        let clock = enable.map(|enable| (enable.register, enable.place));
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
        let value = match unit {
            Unit::Rcc => self.rcc.read(word, now.0),
            Unit::Flash => self.flash.read(word, now.0),
            Unit::Gpio(i) => self.common.ports[i].read(word),
            Unit::Tim1 => self.common.tim1.read(word, now.0),
            Unit::Tim2 => self.common.tim2.read(word, now.0),
            Unit::Dma => self.dma.read(word),
            Unit::Multiplexer => self.dma.read_multiplexer(word),
            Unit::Adc(i) => self.adc[i].read(word),
            Unit::AdcCommon => self.adc_common.read(word),
            Unit::Opamp(i) => self.opamp[i].read(word),
            Unit::Iwdg => self.common.iwdg.read(word),
            Unit::Crc => self.common.crc.read(word),
            Unit::Usb => self.usb.read(word, self.common.host.frame(now.0)),
            Unit::UsbMemory => return self.usb.read_memory(offset, size),
            Unit::Stored(i) => self.stored[i].1.read(word),
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
                return self.common.system.write(
                    address - PRIVATE,
                    size,
                    value,
                    (now, cycles),
                    hclk,
                );
            }
            return Err(UNMODELLED.into());
        };
        // Timers also accept half words, as for PSC.
        let halves = matches!(unit, Unit::Tim1 | Unit::Tim2) && size == 2 && offset & 3 == 0;
        if size != 4 && !halves && !matches!(unit, Unit::UsbMemory) {
            return Err("partial write, which is not modelled".into());
        }
        match unit {
            Unit::Rcc => {
                if RESETS.contains(&offset) {
                    self.reset_units(offset, value);
                }
                if ENABLES.contains(&offset) {
                    let before = self.rcc.read(offset, now)?;
                    self.common.woken = Some((offset, value & !before, now));
                }
                self.rcc.write(offset, value, self.flash.latency(), now)?;
                self.check_voltage()
            }
            Unit::Flash => {
                self.flash.write(offset, value, now)?;
                self.rcc.check_latency(self.flash.latency())
            }
            Unit::Gpio(i) => self.common.write_port(i, offset, value, now),
            Unit::Tim1 => self.common.write_tim1(offset, value, now, hclk),
            Unit::Tim2 => self.common.tim2.write(offset, value, now, hclk),
            Unit::Dma => self.dma.write(offset, value),
            Unit::Multiplexer => self.dma.write_multiplexer(offset, value),
            Unit::Adc(i) => {
                // CKMODE: HCLK/4.
                if self.adc_common.read(0x08)? >> 16 & 3 != 3
                    && offset == 0x08
                    && value & 0x8000_0001 != 0
                {
                    return Err(format!("the ADC's clock is not HCLK/4: others are {UNMODELLED}"));
                }
                self.adc[i].write(offset, value, now, 4 * hclk)
            }
            Unit::AdcCommon => {
                let (dual, mdma) = (value & 0x1f, value >> 14 & 3);
                if ![0, 1, 2, 3, 5, 6, 7, 9].contains(&dual) || mdma == 1 {
                    return Err("a reserved mode (DUAL, MDMA)".into());
                }
                // Simultaneous regular sequences, without a DMA request for both. Without DUAL the
                // register's DELAY, DMACFG and MDMA have no effect.
                if ![0, 1, 2, 6].contains(&dual) || dual != 0 && mdma != 0 {
                    return Err(UNMODELLED.into());
                }
                self.adc_common.write(offset, value)
            }
            Unit::Opamp(i) => {
                // OPAEN
                if offset == 0 && self.opamp[i].read(0)? & 1 == 0 && value & 1 == 1 {
                    self.opamp_on[i] = now;
                }
                self.opamp[i].write(offset, value)?;
                self.turn_amplifiers(now);
                Ok(())
            }
            Unit::Iwdg => self.common.iwdg.write(offset, value, now),
            Unit::Crc => self.common.crc.write(offset, value),
            Unit::Usb => {
                self.usb.write(offset, value, self.rcc.usb_clock(now), now)?;
                if self.usb.is_attached() && !self.is_trimmed() {
                    return Err("connected while HSI48 does not follow the host (CRS)".into());
                }
                Ok(())
            }
            Unit::UsbMemory => self.usb.write_memory(offset, size, value),
            Unit::Stored(i) => {
                self.stored[i].1.write(offset, value)?;
                self.check_voltage()
            }
        }
    }
}

//! STM32F411CE on a Black Pill (RM0383, DS10314): its peripherals and the wires between them.

mod adc;
mod bus;
mod dma;
mod flash;
mod otg;
mod rcc;
pub mod registers;

use super::Outcome;
use super::cells::Flash as Changed;
use super::chip::{Cause, Chip, Common, EventSource, Map, Memory, PRIVATE};
use super::finger::{Finger, Moment, Source, Wiring};
use super::host::Host;
use super::stored::StoredRegisters;
use super::system;
use super::time::{self, Tick};
use crate::fetch;
use adc::Adc;
use dma::Dma;
use flash::Flash;
use otg::Otg;
use rcc::Rcc;

/// Wiring of the finger to this board (docs/boards/stm32f411.md).
const WIRING: Wiring = Wiring {
    board: "stm32f411",
    rows: scan_plan::pins::F411_ROWS,
    select: scan_plan::pins::F411_SELECT,
    columns: ["PA1", "PA2", "PA3", "PA4"],
    midpoints: ["PA5", "PA6", "PA7", "PB0"],
    bias: None,
};

/// Memory map (RM0383 §2.3; the unique identifier, §24.1).
const MAP: Map = Map {
    flash: flash::ALL,
    accelerator: fetch::F4,
    data: flash::DATA,
    ram: &[(0x2000_0000, 0x2_0000)],
    factory: (0x1fff_7000, 0x1000),
    unique_id: 0x1fff_7a10,
};

/// Reset values of the ports' mode registers, in order of address.
const PORTS: [u32; 8] = [0xa800_0000, 0x280, 0, 0, 0, 0, 0, 0];
/// Number of TIM1's compare channels.
const CHANNELS: usize = 4;

/// Interrupt numbers (RM0383 table 37).
const ADC: usize = 18;
const DMA2_STREAMS: [usize; dma::STREAMS] = [56, 57, 58, 59, 60, 68, 69, 70];
const OTG_FS: usize = 67;

/// Registers as the ROM's USB bootloader leaves them: 60 MHz from crystal and PLL, USB's interrupt.
const LEFT_BY_BOOTLOADER: [(u32, u32); 6] = [
    // FLASH.ACR, then RCC.CR, PLLCFGR, CR, CFGR, then NVIC.ISER2
    (0x4002_3c00, 0x2),
    (0x4002_3800, 1 << 16 | 0x83),
    (0x4002_3804, 5 << 24 | 1 << 22 | 1 << 16 | 240 << 6 | 25),
    (0x4002_3800, 1 << 24 | 1 << 16 | 0x83),
    (0x4002_3808, 4 << 10 | 0x2),
    (0xe000_e108, 1 << 3),
];
/// DMA2 streams and channels of the requests (RM0383 table 28): ADC1, then TIM1_CH1 to TIM1_CH3.
const FROM_ADC: (usize, u32) = (0, 0);
const FROM_TIM1: [(usize, u32); 3] = [(1, 6), (2, 6), (6, 6)];

/// Pins of the ADC's inputs: name, port, number (DS10314 table 8).
const INPUTS: [(&str, usize, u32); 16] = [
    ("PA0", 0, 0),
    ("PA1", 0, 1),
    ("PA2", 0, 2),
    ("PA3", 0, 3),
    ("PA4", 0, 4),
    ("PA5", 0, 5),
    ("PA6", 0, 6),
    ("PA7", 0, 7),
    ("PB0", 1, 0),
    ("PB1", 1, 1),
    ("PC0", 2, 0),
    ("PC1", 2, 1),
    ("PC2", 2, 2),
    ("PC3", 2, 3),
    ("PC4", 2, 4),
    ("PC5", 2, 5),
];
/// Inputs of the ADC for the reference and the temperature sensor.
const REFERENCE: u32 = 17;
const TEMPERATURE: u32 = 18;
/// TSVREFE in the ADC's common register.
const INTERNAL: u32 = 1 << 23;

/// Registers that store their values and have no other effect.
struct Kept {
    /// CR, CSR without VOSRDY.
    pwr: StoredRegisters,
    syscfg: StoredRegisters,
    exti: StoredRegisters,
    dbgmcu: StoredRegisters,
    /// CCR.
    adc_common: StoredRegisters,
}

impl Default for Kept {
    fn default() -> Self {
        Self {
            pwr: StoredRegisters::new(&[(0x00, 0x8000), (0x04, 0)]),
            syscfg: StoredRegisters::new(&[(0x08, 0), (0x0c, 0), (0x10, 0), (0x14, 0)]),
            exti: StoredRegisters::new(&[(0x00, 0), (0x08, 0), (0x0c, 0)]),
            dbgmcu: StoredRegisters::new(&[(0x00, 0x1000_6431), (0x04, 0), (0x08, 0), (0x0c, 0)]),
            adc_common: StoredRegisters::new(&[(0x04, 0)]),
        }
    }
}

/// STM32F411 with its peripherals.
pub struct F411 {
    common: Common,
    rcc: Rcc,
    flash: Flash,
    dma: Dma,
    adc: Adc,
    otg: Otg,
    kept: Kept,
}

impl F411 {
    /// Chip after power-up.
    pub fn new(mut finger: Finger, host: Host) -> Self {
        finger.wire(WIRING);
        Self {
            common: Common::new(finger, host, &PORTS, CHANNELS),
            rcc: Rcc::new(Cause::Power, None),
            flash: Flash::default(),
            dma: Dma::default(),
            adc: Adc::default(),
            otg: Otg::default(),
            kept: Kept::default(),
        }
    }

    /// Voltage scale of the core by VOS, 1 to 3. Without the PLL the chip uses 3 (RM0383 §5.4.1).
    fn scale(&self) -> Outcome<u32> {
        match self.kept.pwr.read(0x00)? >> 14 & 3 {
            0 => Err("PWR.CR.VOS = 0, which is reserved".into()),
            vos => Ok(4 - vos),
        }
    }

    fn tim1_edge(&mut self, now: Tick, memory: &mut dyn Memory) -> Outcome {
        let edges = self.common.tim1.advance(now);
        for (asked, request) in edges.compare_dma.into_iter().zip(FROM_TIM1) {
            if asked {
                self.serve(request, now, memory)?;
            }
        }
        let compared = ["TIM1_CC1", "TIM1_CC2", "TIM1_CC3", "TIM1_CC4"];
        let outputs = edges.outputs.into_iter().zip(compared);
        for (_, name) in outputs.chain([(edges.trgo, "TIM1_TRGO")]).filter(|(rises, _)| *rises) {
            if self.adc.trigger(name, now).map_err(|why| format!("ADC1: {why}"))? {
                self.common.finger.note(now, Moment::Trigger(0));
            }
        }
        Ok(())
    }

    /// Runs an event of the ADC; true if a DMA transfer or an interrupt is requested.
    fn adc_moment(&mut self, now: Tick, memory: &mut dyn Memory) -> Outcome<bool> {
        let sampled = self.adc.sampled(now);
        let source = sampled.map(|input| self.source(input)).transpose();
        if let (Some(input), Ok(Some(source))) = (sampled, &source) {
            self.check_sampling(input, *source).map_err(|why| format!("ADC1: {why}"))?;
        }
        let finger = &mut self.common.finger;
        if sampled.is_none() {
            finger.note(now, Moment::Result(0));
        }
        let asks = self.adc.advance(now, || match source? {
            Some(source) => Ok(finger.sample(source, now)),
            None => Err("sample without a source".into()),
        });
        let asks = asks.map_err(|why| format!("ADC1: {why}"))?;
        if asks && !self.common.misses(0) {
            self.serve(FROM_ADC, now, memory)?;
        }
        Ok(asks || self.adc.interrupt())
    }

    /// Fails if an input is sampled for a shorter time than its source needs.
    fn check_sampling(&self, input: u32, source: Source) -> Outcome {
        let ohm = match source {
            Source::Pin(pin) => self.common.finger.ohm(pin),
            _ => 0.0,
        };
        time::check_sampling(input, self.adc.sampling(input), self.adc.least_sampling(source, ohm))
    }

    /// Source of an ADC input.
    fn source(&self, input: u32) -> Outcome<Source> {
        let internal = self.kept.adc_common.read(0x04)? & INTERNAL != 0;
        match input {
            TEMPERATURE if internal => Ok(Source::Temperature),
            REFERENCE if internal => Ok(Source::Reference),
            _ => {
                let (name, port, number) =
                    *INPUTS.get(input as usize).ok_or("an input without a pin, not modelled")?;
                self.common.analogue("ADC1", name, port, number).map(Source::Pin)
            }
        }
    }

    fn serve(
        &mut self,
        (stream, channel): (usize, u32),
        now: Tick,
        memory: &mut dyn Memory,
    ) -> Outcome {
        let Some(transfer) = self.dma.take(stream, channel) else { return Ok(()) };
        self.transfer(transfer, now, memory)
    }
}

impl Chip for F411 {
    fn map(&self) -> Map {
        MAP
    }

    fn common(&self) -> &Common {
        &self.common
    }

    fn common_mut(&mut self) -> &mut Common {
        &mut self.common
    }

    fn flash(&mut self) -> &mut dyn Changed {
        &mut self.flash
    }

    fn hclk(&self) -> Tick {
        self.rcc.hclk()
    }

    fn reset(&mut self, cause: Cause, now: Tick) {
        self.rcc = Rcc::new(cause, (cause != Cause::Power).then_some(&self.rcc));
        self.flash.reset();
        (self.dma, self.adc) = (Dma::default(), Adc::default());
        (self.otg, self.kept) = (Otg::default(), Kept::default());
        self.common.reset(now, &PORTS);
        self.plan();
    }

    fn schedule(&mut self) {
        self.common.schedule(&[
            (self.adc.next(), EventSource::Adc(0)),
            (self.common.host.next(&self.otg), EventSource::Host),
        ]);
    }

    fn raise(&mut self) {
        self.common.raise();
        let system = &mut self.common.system;
        system.set_line(ADC, self.adc.interrupt());
        system.set_line(OTG_FS, self.otg.interrupt());
        for (i, line) in DMA2_STREAMS.iter().enumerate() {
            system.set_line(*line, self.dma.interrupt(i));
        }
    }

    fn happen(&mut self, source: EventSource, now: Tick, memory: &mut dyn Memory) -> Outcome<bool> {
        match source {
            EventSource::System => self.common.system.advance(now),
            EventSource::Tim1 => self.tim1_edge(now, memory)?,
            EventSource::Tim2 => _ = self.common.tim2.advance(now),
            EventSource::Adc(_) => return self.adc_moment(now, memory),
            EventSource::Iwdg => self.common.bite(),
            EventSource::Host => self.common.host.advance(now, &mut self.otg)?,
        }
        Ok(true)
    }

    fn read_register(&mut self, address: u32, size: u32, now: (Tick, u32)) -> Outcome<u32> {
        self.read_unit(address, size, now)
    }

    fn write_register(&mut self, address: u32, size: u32, value: u32, now: (Tick, u32)) -> Outcome {
        self.write_unit(address, size, value, now)
    }

    fn left_by_bootloader(&self) -> &'static [(u32, u32)] {
        &LEFT_BY_BOOTLOADER
    }

    fn name(&self, address: u32) -> String {
        if address >= PRIVATE && registers::peripheral(address).is_none() {
            return system::name(address);
        }
        registers::name(address, self.common.registers.get(&(address & !3)))
    }
}

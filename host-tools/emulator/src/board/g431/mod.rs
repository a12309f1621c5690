//! STM32G431CB (RM0440, DS12589): its peripherals, its bus, and the wires between them.
//!
//! The STM32G473CE (DS12712) is the same chip with other memories: its map and its flash.

mod adc;
mod bus;
mod dma;
mod flash;
pub mod names;
mod rcc;
mod sampling;
mod usb;
mod wires;

use stm32_metapac::adccommon::regs::Ccr;

use super::cells::Flash as Changed;
use super::chip::{Cause, Chip, Common, EventSource, Map, Memory, PRIVATE};
use super::finger::{Finger, Gain, Moment, Source, Wiring};
use super::host::Host;
use super::stored::StoredRegisters;
use super::system;
use super::time::{self, Tick};
use super::{Outcome, UNMODELLED};
use crate::fetch;
use adc::Adc;
use dma::Dma;
use flash::Flash;
use names::{Names, base, interrupt};
use rcc::Rcc;
use usb::Usb;
use wires::{Bit, Pad, bits, pads};

/// Wiring of the finger to this board (docs/boards/stm32g431.md).
const WIRING: Wiring = Wiring {
    board: "stm32g431",
    rows: scan_plan::pins::G431_ROWS,
    select: scan_plan::pins::G431_SELECT,
    columns: ["PA0", "PA1", "PA2", "PA3"],
    midpoints: ["PA7", "PB14", "PB0", "PB13"],
    bias: Some("PA5"),
};

/// Memory map (DS12589 §4): SRAM1 and SRAM2, and the CCM SRAM at its first address.
///
/// The CCM SRAM's second address, behind SRAM2, is left out: what runs over the end of the RAM
/// stops there instead of overwriting the stack.
const MAP: Map = Map {
    flash: flash::ALL,
    accelerator: fetch::G4,
    data: flash::DATA,
    ram: &[(0x2000_0000, 0x5800), (0x1000_0000, 0x2800)],
    factory: (0x1fff_7000, 0x1000),
    unique_id: 0x1fff_7590,
};

/// Memory map of the STM32G473CE (DS12712 §4): as above, with SRAM1 and SRAM2 as one.
const G473: Map = Map {
    flash: (0x0800_0000, 0x8_0000),
    data: (0x0807_d000, 0x3000),
    ram: &[(0x2000_0000, 0x1_8000), (0x1000_0000, 0x8000)],
    ..MAP
};

const PORTS: [&str; 6] = ["GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE", "GPIOF"];
/// Reset values of the ports' mode registers.
const MODES: [u32; 6] = [0xabff_ffff, 0xffff_febf, !0, !0, !0, !0];
/// Number of TIM1's compare channels.
const CHANNELS: usize = 6;
const ADCS: [&str; 2] = ["ADC1", "ADC2"];
/// Amplifiers with an internal connection to ADC2, and its inputs for them (RM0440 table 162).
const OPAMPS: [(&str, u32); 2] = [("OPAMP2", 16), ("OPAMP3", 18)];
/// Wake-up time of an amplifier (DS12589 table 88, largest).
const WAKE_UP: Tick = time::micros(6);
/// Inputs of ADC1 for the temperature sensor and the reference.
const TEMPERATURE: u32 = 16;
const REFERENCE: u32 = 18;

/// Registers as the ROM's USB bootloader leaves them: 68 MHz from the PLL, HSI48, USB's interrupt.
const LEFT_BY_BOOTLOADER: [(u32, u32); 6] = [
    // FLASH.ACR, then RCC.PLLCFGR, CR, CFGR, CRRCR, then NVIC.ISER0
    (0x4002_2000, 0x602),
    (0x4002_100c, 1 << 24 | 34 << 8 | 3 << 4 | 2),
    (0x4002_1000, 1 << 24 | 0x500),
    (0x4002_1008, 0x3),
    (0x4002_1098, 0x1),
    (0xe000_e100, 1 << 20),
];
/// RCC's reset registers, AHB1RSTR to APB2RSTR.
const RESETS: std::ops::RangeInclusive<u32> = 0x28..=0x40;
/// RCC's clock enables, AHB1ENR to APB2ENR.
const ENABLES: std::ops::RangeInclusive<u32> = 0x48..=0x60;
const PWR_CR5: u32 = 0x80;

/// Modelled peripheral.
#[derive(Clone, Copy, Debug)]
enum Unit {
    Rcc,
    Flash,
    Gpio(usize),
    Tim1,
    Tim2,
    Dma,
    Multiplexer,
    Adc(usize),
    AdcCommon,
    Opamp(usize),
    Iwdg,
    Crc,
    Usb,
    UsbMemory,
    Stored(usize),
}

/// Address of a peripheral, and its clock enable and reset bits.
struct Place {
    base: u32,
    unit: Unit,
    enable: Option<Bit>,
    reset: Option<Bit>,
}

impl Place {
    fn new((name, unit): (&str, Unit)) -> Self {
        let [enable, reset] = bits(name);
        Self { base: base(name), unit, enable, reset }
    }
}

/// Interrupt numbers of the modelled peripherals.
struct Lines {
    usb: usize,
    adc: usize,
    dma: Vec<usize>,
}

/// Request numbers of the DMA.
struct Requests {
    adc: [u32; 2],
    tim1: [u32; 4],
}

/// STM32G431 with its peripherals.
pub struct G431 {
    map: Map,
    common: Common,
    names: Names,
    units: Vec<Place>,
    adc_pads: [Vec<Option<Pad>>; 2],
    /// Inputs of the amplifiers, and their pins for a bias.
    opamp_pads: [Vec<Option<Pad>>; 2],
    bias_pads: [Vec<Option<Pad>>; 2],
    lines: Lines,
    requests: Requests,
    rcc: Rcc,
    flash: Flash,
    dma: Dma,
    adc: [Adc; 2],
    adc_common: StoredRegisters,
    opamp: [StoredRegisters; 2],
    /// Times from which the amplifiers have been on.
    opamp_on: [Tick; 2],
    usb: Usb,
    stored: Vec<(&'static str, StoredRegisters)>,
}

/// Stored registers: clock recovery, voltage, pin interrupts, debugging.
fn stored_registers() -> Vec<(&'static str, StoredRegisters)> {
    vec![
        // CR1 to CR5, SR1, SR2: the voltage regulator is always ready.
        (
            "PWR",
            StoredRegisters::new(&[
                (0x00, 0x200),
                (0x04, 0),
                (0x08, 0x8000),
                (0x0c, 0),
                (0x10, 0),
                (0x14, 0),
                (0x80, 0x100),
            ]),
        ),
        (
            "SYSCFG",
            StoredRegisters::new(&[
                (0x00, 0),
                (0x04, 0x7c00_0001),
                (0x08, 0),
                (0x0c, 0),
                (0x10, 0),
                (0x14, 0),
            ]),
        ),
        ("EXTI", StoredRegisters::new(&[(0x00, 0xff82_0000), (0x08, 0), (0x0c, 0)])),
        ("CRS", StoredRegisters::new(&[(0x00, 0x4000), (0x04, 0x2022_bb7f), (0x08, 0)])),
        // IDCODE, CR, APB1LFZR, APB1HFZR, APB2FZR
        (
            "DBGMCU",
            StoredRegisters::new(&[
                (0x00, 0x2001_6468),
                (0x04, 0),
                (0x08, 0),
                (0x0c, 0),
                (0x10, 0),
            ]),
        ),
    ]
}

fn adc_common() -> StoredRegisters {
    StoredRegisters::new(&[(0x08, 0)])
}

fn opamp() -> StoredRegisters {
    StoredRegisters::new(&[(0x00, 0), (0x18, 0)])
}

impl G431 {
    /// Chip after power-up.
    pub fn new(finger: Finger, host: Host) -> Self {
        Self::with(MAP, WIRING, finger, host)
    }

    /// STM32G473 after power-up, on the same board.
    pub fn g473(finger: Finger, host: Host) -> Self {
        Self::with(G473, Wiring { board: "stm32g473", ..WIRING }, finger, host)
    }

    fn with(map: Map, wiring: Wiring, mut finger: Finger, host: Host) -> Self {
        finger.wire(wiring);
        let names = Names::default();
        let stored = stored_registers();
        let mut units: Vec<(&str, Unit)> = vec![
            ("RCC", Unit::Rcc),
            ("FLASH", Unit::Flash),
            ("TIM1", Unit::Tim1),
            ("TIM2", Unit::Tim2),
            ("DMA1", Unit::Dma),
            ("DMAMUX1", Unit::Multiplexer),
            ("ADC12_COMMON", Unit::AdcCommon),
            ("IWDG", Unit::Iwdg),
            ("CRC", Unit::Crc),
            ("USB", Unit::Usb),
            ("USBRAM", Unit::UsbMemory),
        ];
        units.extend(PORTS.iter().enumerate().map(|(i, name)| (*name, Unit::Gpio(i))));
        units.extend(ADCS.iter().enumerate().map(|(i, name)| (*name, Unit::Adc(i))));
        units.extend(OPAMPS.iter().enumerate().map(|(i, (name, _))| (*name, Unit::Opamp(i))));
        units.extend(stored.iter().enumerate().map(|(i, (name, _))| (*name, Unit::Stored(i))));
        let mut units: Vec<Place> = units.into_iter().map(Place::new).collect();
        units.sort_by_key(|place| place.base);
        Self {
            map,
            common: Common::new(finger, host, &MODES, CHANNELS),
            names,
            units,
            adc_pads: ADCS.map(|name| pads(name, "IN", 20)),
            opamp_pads: OPAMPS.map(|(name, _)| pads(name, "VINP", 4)),
            bias_pads: OPAMPS.map(|(name, _)| pads(name, "VINM", 1)),
            lines: Lines {
                usb: interrupt("USB_LP"),
                adc: interrupt("ADC1_2"),
                dma: (1..=dma::CHANNELS).map(|i| interrupt(&format!("DMA1_CHANNEL{i}"))).collect(),
            },
            requests: Requests {
                adc: ADCS.map(|name| dma::request(name, name)),
                tim1: ["CH1", "CH2", "CH3", "CH4"].map(|channel| dma::request("TIM1", channel)),
            },
            rcc: Rcc::new(Cause::Power, None),
            flash: Flash::new(map.flash, map.data),
            dma: Dma::default(),
            adc: ADCS.map(Adc::new),
            adc_common: adc_common(),
            opamp: OPAMPS.map(|_| opamp()),
            opamp_on: [0; 2],
            usb: Usb::default(),
            stored,
        }
    }

    fn tim1_edge(&mut self, now: Tick, memory: &mut dyn Memory) -> Outcome {
        let edges = self.common.tim1.advance(now);
        self.turn_amplifiers(now);
        for (channel, asked) in edges.compare_dma.into_iter().enumerate() {
            if asked {
                self.serve(self.requests.tim1[channel], now, memory)?;
            }
        }
        for (rises, name) in [(edges.trgo, "TIM1_TRGO"), (edges.trgo2, "TIM1_TRGO2")] {
            for (i, its) in ADCS.iter().enumerate().filter(|_| rises) {
                // DUAL: ADC1's trigger starts both regular sequences (RM0440, dual ADC modes).
                let leader = if self.adc_common.read(0x08)? & 0x1f == 0 { i } else { 0 };
                let regular = self.adc[leader].regular_trigger();
                let starts = self.adc[i].trigger(name, regular, now);
                if starts.map_err(|why| format!("{its}: {why}"))? {
                    self.common.finger.note(now, Moment::Trigger(i));
                }
            }
        }
        Ok(())
    }

    /// Updates the amplifiers' inputs, which TIM1 switches.
    pub(super) fn turn_amplifiers(&mut self, now: Tick) {
        for i in 0..OPAMPS.len() {
            if let Ok((pin, gain)) = self.amplified(i, now) {
                self.common.finger.amplify(i, pin, gain, now);
            }
        }
    }

    /// Pin that an amplifier amplifies, and its gain; an error if it does not reach the ADC.
    fn amplified(&self, i: usize, now: Tick) -> Outcome<(&'static str, Gain)> {
        let (csr, tcmr) = (self.opamp[i].read(0x00)?, self.opamp[i].read(0x18)?);
        let name = OPAMPS[i].0;
        // OPAEN, OPAINTOEN
        if csr & 1 == 0 || csr >> 8 & 1 == 0 {
            let what = "is off or does not reach the ADC, whose open input is";
            return Err(format!("{name} {what} {UNMODELLED}"));
        }
        // VM_SEL: a follower, or the PGA. PGA_GAIN: 2 to 64, without or with a bias on VINM0.
        let gain = match (csr >> 5 & 3, csr >> 14 & 0x1f) {
            (3, _) => Gain { times: 1.0, biased: false },
            (2, code @ (0..=5 | 8..=13)) => {
                Gain { times: f64::from(2 << (code & 7)), biased: code & 8 != 0 }
            }
            _ => return Err(format!("{name}: VM_SEL or PGA_GAIN is reserved or {UNMODELLED}")),
        };
        if gain.biased {
            self.pin(name, self.bias_pads[i].first())?;
        }
        // T1CM_EN
        let turned =
            tcmr >> 3 & 1 == 1 && self.common.tim1.is_driven(5) && self.common.tim1.output(5, now);
        let select = if turned { tcmr >> 1 & 3 } else { csr >> 2 & 3 };
        let pin = self.pin(name, self.opamp_pads[i].get(select as usize))?;
        Ok((pin, gain))
    }

    /// Pin of an input; an error if the pin is not analogue.
    fn pin(&self, of: &str, input: Option<&Option<Pad>>) -> Outcome<&'static str> {
        let Some(Some(pad)) = input else {
            return Err(format!("{of} has no such input on a pin; others are {UNMODELLED}"));
        };
        self.common.analogue(of, pad.name, pad.port, pad.number)
    }

    /// Runs an event of an ADC; true if a DMA transfer is requested.
    fn adc_moment(&mut self, i: usize, now: Tick, memory: &mut dyn Memory) -> Outcome<bool> {
        let name = ADCS[i];
        let source = self.adc[i].sampled(now).map(|input| {
            let source = self.source(i, input, now)?;
            self.check_sampling(i, input, source).map(|()| source)
        });
        let finger = &mut self.common.finger;
        if source.is_none() && self.adc[i].is_converting() {
            finger.note(now, Moment::Result(i));
        }
        let asks = self.adc[i].advance(now, || match source {
            Some(source) => Ok(finger.sample(source?, now)),
            None => Err("sample without a source".into()),
        });
        let asks = asks.map_err(|why| format!("{name}: {why}"))?;
        let served = asks && !self.common.misses(i);
        if served && self.serve(self.requests.adc[i], now, memory)? {
            self.adc[i].end_dma();
        }
        self.common.system.set_line(self.lines.adc, self.adc.iter().any(Adc::interrupt));
        Ok(asks)
    }

    /// Fails if an input is sampled for a shorter time than its source needs.
    fn check_sampling(&self, i: usize, input: u32, source: Source) -> Outcome {
        let ohm = match source {
            Source::Pin(pin) => self.common.finger.ohm(pin),
            _ => 0.0,
        };
        let least = sampling::least(input, source, ohm)?;
        time::check_sampling(input, self.adc[i].sampling(input), least)
    }

    /// Source of an ADC input.
    fn source(&self, i: usize, input: u32, now: Tick) -> Outcome<Source> {
        let common = Ccr(self.adc_common.read(0x08)?);
        if i == 0 && input == TEMPERATURE && common.vsenseen() {
            return Ok(Source::Temperature);
        }
        if i == 0 && input == REFERENCE && common.vrefen() {
            return Ok(Source::Reference);
        }
        if let Some(which) = OPAMPS.iter().position(|(_, at)| i == 1 && *at == input) {
            self.amplified(which, now)?;
            if now < self.opamp_on[which] + WAKE_UP {
                return Err(format!(
                    "{} has been on for less than its wake-up time",
                    OPAMPS[which].0
                ));
            }
            return Ok(Source::Amplifier(which));
        }
        self.pin(ADCS[i], self.adc_pads[i].get(input as usize)).map(Source::Pin)
    }

    /// Makes the transfer of a request; true if its channel has none left of its turn.
    fn serve(&mut self, request: u32, now: Tick, memory: &mut dyn Memory) -> Outcome<bool> {
        let Some(channel) = self.dma.served_by(request) else { return Ok(false) };
        let Some((transfer, last)) = self.dma.take(channel)? else { return Ok(true) };
        self.transfer(transfer, now, memory).map(|()| last)
    }
}

impl Chip for G431 {
    fn map(&self) -> Map {
        self.map
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
        self.dma = Dma::default();
        self.adc = ADCS.map(Adc::new);
        self.adc_common = adc_common();
        self.opamp = OPAMPS.map(|_| opamp());
        self.usb = Usb::default();
        self.stored = stored_registers();
        self.common.reset(now, &MODES);
        self.plan();
    }

    fn schedule(&mut self) {
        self.common.schedule(&[
            (self.adc[0].next(), EventSource::Adc(0)),
            (self.adc[1].next(), EventSource::Adc(1)),
            (self.common.host.next(&self.usb), EventSource::Host),
        ]);
    }

    fn raise(&mut self) {
        self.common.raise();
        let system = &mut self.common.system;
        system.set_line(self.lines.usb, self.usb.interrupt());
        system.set_line(self.lines.adc, self.adc.iter().any(Adc::interrupt));
        for (i, line) in self.lines.dma.iter().enumerate() {
            system.set_line(*line, self.dma.interrupt(i));
        }
    }

    fn happen(&mut self, source: EventSource, now: Tick, memory: &mut dyn Memory) -> Outcome<bool> {
        match source {
            EventSource::System => self.common.system.advance(now),
            EventSource::Tim1 => self.tim1_edge(now, memory)?,
            EventSource::Tim2 => _ = self.common.tim2.advance(now),
            // A sample alone requests no interrupt.
            EventSource::Adc(i) => return self.adc_moment(i, now, memory),
            EventSource::Iwdg => self.common.bite(),
            EventSource::Host => self.common.host.advance(now, &mut self.usb)?,
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
        if address >= PRIVATE && self.unit(address).is_none() {
            return system::name(address);
        }
        self.names.register(address)
    }
}

//! The chip: its peripherals, the bus that the core reaches them by, and the wires between them.

mod bus;

use stm32_metapac::adccommon::regs::Ccr;

use super::Outcome;
use super::adc::Adc;
use super::dma::{self, Dma};
use super::finger::{Finger, Moment, Source};
use super::flash::Flash;
use super::gpio::Gpio;
use super::host::Host;
use super::iwdg::Iwdg;
use super::names::{Names, base, interrupt};
use super::plain::Plain;
use super::rcc::{Cause, Rcc};
use super::system::System;
use super::time::{Tick, micros};
use super::timer::Timer;
use super::usb::Usb;
use super::wires::{Bit, Pad, bits, pads};

/// What the DMA writes to and reads from.
pub trait Memory {
    /// Reads a word or less.
    fn read(&mut self, address: u32, size: u32) -> Outcome<u32>;
    /// Writes it.
    fn write(&mut self, address: u32, size: u32, value: u32) -> Outcome;
}

/// Begin of the private peripheral bus.
pub const PRIVATE: u32 = 0xe000_0000;

const PORTS: [(&str, u32); 6] = [
    ("GPIOA", 0xabff_ffff),
    ("GPIOB", 0xffff_febf),
    ("GPIOC", !0),
    ("GPIOD", !0),
    ("GPIOE", !0),
    ("GPIOF", !0),
];
const ADCS: [&str; 2] = ["ADC1", "ADC2"];
/// The amplifiers that reach ADC2 inside the chip, and its inputs for them (RM0440 table 162).
const OPAMPS: [(&str, u32); 2] = [("OPAMP2", 16), ("OPAMP3", 18)];
/// ADC1's inputs for the temperature sensor and the reference.
const TEMPERATURE: u32 = 16;
const REFERENCE: u32 = 18;

/// RCC's reset registers, AHB1RSTR to APB2RSTR.
const RESETS: std::ops::RangeInclusive<u32> = 0x28..=0x40;
const PWR_CR5: u32 = 0x80;
/// How long the core may be too fast for its voltage.
const UNBOOSTED: Tick = micros(1_000);

/// A peripheral that is modelled.
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
    Usb,
    UsbMemory,
    Plain(usize),
}

/// Where a peripheral stands, and which bits switch it on and reset it.
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

/// Something that has a next moment.
#[derive(Clone, Copy, Debug)]
enum Part {
    System,
    Tim1,
    Tim2,
    Adc(usize),
    Iwdg,
    Host,
    Voltage,
}

/// A fault: what is written to a register is changed on its way.
struct Plant {
    address: u32,
    change: fn(u32) -> u32,
}

/// Interrupts of what is modelled.
struct Lines {
    tim1_cc: usize,
    tim2: usize,
    usb: usize,
    adc: usize,
    dma: Vec<usize>,
}

/// Requests to the DMA.
struct Requests {
    adc: [u32; 2],
    tim1: [u32; 4],
}

/// An STM32G431CB with a finger on its pins and a host on its port.
pub struct Chip {
    names: Names,
    units: Vec<Place>,
    adc_pads: [Vec<Option<Pad>>; 2],
    opamp_pads: [Vec<Option<Pad>>; 2],
    lines: Lines,
    requests: Requests,
    rcc: Rcc,
    flash: Flash,
    gpio: Vec<Gpio>,
    tim1: Timer,
    tim2: Timer,
    dma: Dma,
    adc: [Adc; 2],
    adc_common: Plain,
    opamp: [Plain; 2],
    iwdg: Iwdg,
    usb: Usb,
    plain: Vec<(&'static str, Plain)>,
    /// The core's own.
    pub system: System,
    /// What is on the pins.
    pub finger: Finger,
    /// What is on the port.
    pub host: Host,
    /// The core stands still until then.
    pub stalled: Tick,
    /// The watchdog bit.
    bitten: bool,
    plants: Vec<Plant>,
    /// Readings of these ADCs that the DMA is still to miss.
    withheld: [u32; 2],
    /// Until when the core may be this fast at this voltage.
    voltage_limit: Option<Tick>,
    next: Option<(Tick, Part)>,
    /// All before this has happened.
    now: Tick,
}

/// What is kept as it is written: clock recovery, voltage, wiring of pins to interrupts, debugging.
fn plain() -> Vec<(&'static str, Plain)> {
    vec![
        // CR1 to CR5, SR1, SR2: the voltage regulator is ready at once.
        (
            "PWR",
            Plain::new(&[
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
            Plain::new(&[
                (0x00, 0),
                (0x04, 0x7c00_0001),
                (0x08, 0),
                (0x0c, 0),
                (0x10, 0),
                (0x14, 0),
            ]),
        ),
        ("EXTI", Plain::new(&[(0x00, 0xff82_0000), (0x08, 0), (0x0c, 0)])),
        ("CRS", Plain::new(&[(0x00, 0x4000), (0x04, 0x2022_bb7f), (0x08, 0)])),
        ("DBGMCU", Plain::new(&[(0x00, 0x2001_6468), (0x04, 0)])),
    ]
}

fn adc_common() -> Plain {
    Plain::new(&[(0x08, 0)])
}

fn opamp() -> Plain {
    Plain::new(&[(0x00, 0), (0x18, 0)])
}

impl Chip {
    /// Just powered; `data` is where the flash behind the program begins.
    pub fn new(data: u32, finger: Finger, host: Host) -> Self {
        let names = Names::default();
        let plain = plain();
        let mut units: Vec<(&str, Unit)> = vec![
            ("RCC", Unit::Rcc),
            ("FLASH", Unit::Flash),
            ("TIM1", Unit::Tim1),
            ("TIM2", Unit::Tim2),
            ("DMA1", Unit::Dma),
            ("DMAMUX1", Unit::Multiplexer),
            ("ADC12_COMMON", Unit::AdcCommon),
            ("IWDG", Unit::Iwdg),
            ("USB", Unit::Usb),
            ("USBRAM", Unit::UsbMemory),
        ];
        units.extend(PORTS.iter().enumerate().map(|(i, (name, _))| (*name, Unit::Gpio(i))));
        units.extend(ADCS.iter().enumerate().map(|(i, name)| (*name, Unit::Adc(i))));
        units.extend(OPAMPS.iter().enumerate().map(|(i, (name, _))| (*name, Unit::Opamp(i))));
        units.extend(plain.iter().enumerate().map(|(i, (name, _))| (*name, Unit::Plain(i))));
        let mut units: Vec<Place> = units.into_iter().map(Place::new).collect();
        units.sort_by_key(|place| place.base);
        Self {
            names,
            units,
            adc_pads: ADCS.map(|name| pads(name, "IN", 20)),
            opamp_pads: OPAMPS.map(|(name, _)| pads(name, "VINP", 4)),
            lines: Lines {
                tim1_cc: interrupt("TIM1_CC"),
                tim2: interrupt("TIM2"),
                usb: interrupt("USB_LP"),
                adc: interrupt("ADC1_2"),
                dma: (1..=dma::CHANNELS).map(|i| interrupt(&format!("DMA1_CHANNEL{i}"))).collect(),
            },
            requests: Requests {
                adc: ADCS.map(|name| dma::request(name, name)),
                tim1: ["CH1", "CH2", "CH3", "CH4"].map(|channel| dma::request("TIM1", channel)),
            },
            rcc: Rcc::new(Cause::Power, None),
            flash: Flash::new(data),
            gpio: PORTS.map(|(_, moder)| Gpio::new(moder)).into(),
            tim1: Timer::new(16),
            tim2: Timer::new(32),
            dma: Dma::default(),
            adc: ADCS.map(Adc::new),
            adc_common: adc_common(),
            opamp: OPAMPS.map(|_| opamp()),
            iwdg: Iwdg::default(),
            usb: Usb::default(),
            plain,
            system: System::default(),
            finger,
            host,
            stalled: 0,
            bitten: false,
            plants: Vec::new(),
            withheld: [0; 2],
            voltage_limit: None,
            next: None,
            now: 0,
        }
    }

    /// Everything but the flash's content, what is outside, and the record of the reset is as after power-up.
    pub fn reset(&mut self, cause: Cause, now: Tick) {
        self.rcc = Rcc::new(cause, (cause != Cause::Power).then_some(&self.rcc));
        self.flash.reset();
        self.gpio = PORTS.map(|(_, moder)| Gpio::new(moder)).into();
        (self.tim1, self.tim2) = (Timer::new(16), Timer::new(32));
        self.dma = Dma::default();
        self.adc = ADCS.map(Adc::new);
        self.adc_common = adc_common();
        self.opamp = OPAMPS.map(|_| opamp());
        self.iwdg = Iwdg::default();
        self.usb = Usb::default();
        self.plain = plain();
        self.system = System::default();
        (self.bitten, self.voltage_limit) = (false, None);
        self.finger.pins(0, now);
        self.plan();
    }

    /// The period of the core's clock.
    pub fn hclk(&self) -> Tick {
        self.rcc.hclk()
    }

    /// A moment by the firmware's own clock, in microseconds; TIM2 is what it counts by.
    pub fn device_us(&self, at: Tick) -> Option<u64> {
        Some(at.checked_sub(self.tim2.started()?)? / micros(1))
    }

    /// The flash behind the program.
    pub fn flash(&mut self) -> &mut Flash {
        &mut self.flash
    }

    /// Why it must reset, if it must.
    pub fn take_reset(&mut self) -> Option<Cause> {
        if std::mem::take(&mut self.bitten) {
            return Some(Cause::Watchdog);
        }
        self.system.take_reset().then_some(Cause::Software)
    }

    /// When something happens next.
    pub fn next(&self) -> Option<Tick> {
        self.next.map(|(at, _)| at)
    }

    /// It is `now`, and the host may have been told something.
    pub fn go_on(&mut self, now: Tick) {
        self.now = self.now.max(now);
        self.plan();
    }

    /// Finds out what comes next, and who asks for an interrupt.
    fn plan(&mut self) {
        self.schedule();
        self.raise();
    }

    fn schedule(&mut self) {
        let parts = [
            (self.system.next(), Part::System),
            (self.tim1.next(), Part::Tim1),
            (self.tim2.next(), Part::Tim2),
            (self.adc[0].next(), Part::Adc(0)),
            (self.adc[1].next(), Part::Adc(1)),
            (self.iwdg.next(), Part::Iwdg),
            (self.host.next(&self.usb), Part::Host),
            (self.voltage_limit, Part::Voltage),
        ];
        let known = parts.into_iter().filter_map(|(at, part)| Some((at?, part)));
        self.next = known.min_by_key(|(at, _)| *at);
    }

    /// Lets interrupts' lines follow what asks for them.
    fn raise(&mut self) {
        self.system.set_line(self.lines.tim1_cc, self.tim1.interrupt());
        self.system.set_line(self.lines.tim2, self.tim2.interrupt());
        self.system.set_line(self.lines.usb, self.usb.interrupt());
        self.system.set_line(self.lines.adc, self.adc.iter().any(Adc::interrupt));
        for (i, line) in self.lines.dma.iter().enumerate() {
            self.system.set_line(*line, self.dma.interrupt(i));
        }
    }

    /// Lets all happen that happens up to `now`.
    pub fn advance(&mut self, now: Tick, memory: &mut dyn Memory) -> Outcome {
        while let Some((at, part)) = self.next.filter(|(at, _)| *at <= now) {
            // What was waiting for something that has just come is not done in the past.
            let at = at.max(self.now);
            self.now = at;
            match part {
                Part::System => self.system.advance(at),
                Part::Tim1 => self.tim1_edge(at, memory)?,
                Part::Tim2 => _ = self.tim2.advance(at),
                Part::Adc(i) => {
                    if !self.adc_moment(i, at, memory)? {
                        // A sample alone asks for nothing.
                        self.schedule();
                        continue;
                    }
                }
                Part::Iwdg => {
                    self.bitten = true;
                    self.iwdg = Iwdg::default();
                }
                Part::Host => self.host.advance(at, &mut self.usb)?,
                Part::Voltage => {
                    return Err(
                        "a core faster than 150 MHz without boost mode (PWR.CR5.R1MODE)".into()
                    );
                }
            }
            self.plan();
        }
        self.now = now;
        Ok(())
    }

    fn tim1_edge(&mut self, now: Tick, memory: &mut dyn Memory) -> Outcome {
        let edges = self.tim1.advance(now);
        self.turn_amplifiers(now);
        for (channel, asked) in edges.compare_dma.into_iter().enumerate() {
            if asked {
                self.transfer(self.requests.tim1[channel], now, memory)?;
            }
        }
        for (rises, name) in [(edges.trgo, "TIM1_TRGO"), (edges.trgo2, "TIM1_TRGO2")] {
            for (i, its) in ADCS.iter().enumerate().filter(|_| rises) {
                let starts = self.adc[i].trigger(name, now);
                if starts.map_err(|why| format!("{its}: {why}"))? {
                    self.finger.note(now, Moment::Trigger(i));
                }
            }
        }
        Ok(())
    }

    /// The amplifiers' inputs, as TIM1 has them turned.
    fn turn_amplifiers(&mut self, now: Tick) {
        for i in 0..OPAMPS.len() {
            if let Ok(pin) = self.amplified(i, now) {
                self.finger.amplify(i, pin, now);
            }
        }
    }

    /// The pin that an amplifier amplifies.
    fn amplified(&self, i: usize, now: Tick) -> Outcome<&'static str> {
        let (csr, tcmr) = (self.opamp[i].read(0x00)?, self.opamp[i].read(0x18)?);
        let name = OPAMPS[i].0;
        // OPAEN; VM_SEL: PGA; OPAINTOEN.
        if csr & 1 == 0 || csr >> 5 & 3 != 2 || csr >> 8 & 1 == 0 {
            return Err(format!("{name} is off, without its PGA, or does not reach the ADC"));
        }
        // T1CM_EN
        let turned = tcmr >> 3 & 1 == 1 && self.tim1.is_driven(5) && self.tim1.output(5, now);
        let select = if turned { tcmr >> 1 & 3 } else { csr >> 2 & 3 };
        self.pin(name, self.opamp_pads[i].get(select as usize))
    }

    /// The pin that an input is, which must be analogue.
    fn pin(&self, of: &str, input: Option<&Option<Pad>>) -> Outcome<&'static str> {
        let Some(Some(pad)) = input else { return Err(format!("{of} has no such input")) };
        let name = pad.name;
        match self.gpio.get(pad.port) {
            Some(port) if port.is_analogue(pad.number) => Ok(name),
            _ => Err(format!("{of}'s input {name} is not set to analogue")),
        }
    }

    /// True where the DMA was asked for a transfer.
    fn adc_moment(&mut self, i: usize, now: Tick, memory: &mut dyn Memory) -> Outcome<bool> {
        let name = ADCS[i];
        let source = self.adc[i].sampled(now).map(|input| self.source(i, input, now));
        let finger = &mut self.finger;
        if source.is_none() && self.adc[i].is_converting() {
            finger.note(now, Moment::Result(i));
        }
        let asks = self.adc[i].advance(now, || match source {
            Some(source) => Ok(finger.sample(source?, now)),
            None => Err("a sample of nothing".into()),
        });
        let asks = asks.map_err(|why| format!("{name}: {why}"))?;
        if asks {
            match &mut self.withheld[i] {
                0 => self.transfer(self.requests.adc[i], now, memory)?,
                left => *left -= 1,
            }
        }
        self.system.set_line(self.lines.adc, self.adc.iter().any(Adc::interrupt));
        Ok(asks)
    }

    /// What an ADC's input is connected to.
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
            return Ok(Source::Amplifier(which));
        }
        self.pin(ADCS[i], self.adc_pads[i].get(input as usize)).map(Source::Pin)
    }

    fn transfer(&mut self, request: u32, now: Tick, memory: &mut dyn Memory) -> Outcome {
        let Some(channel) = self.dma.served_by(request) else { return Ok(()) };
        let Some(transfer) = self.dma.take(channel)? else { return Ok(()) };
        let dma::Transfer { register, memory: place, size, to_peripheral } = transfer;
        if to_peripheral {
            let value = memory.read(place, size)?;
            self.write(register, size, value, (now, 0))
        } else {
            let value = self.read(register, size, (now, 0))?;
            memory.write(place, size, value)
        }
    }

    /// Plants a fault: what is written to the register at `address` from now on is what `change` makes of
    /// it, as if the firmware had it wrong.
    pub fn plant(&mut self, address: u32, change: fn(u32) -> u32) {
        self.plants.push(Plant { address, change });
    }

    /// Withholds the DMA's next grant from an ADC, 0 or 1: as if other masters had held the bus for a whole
    /// conversion.
    pub fn withhold(&mut self, adc: usize) {
        self.withheld[adc] += 1;
    }
}

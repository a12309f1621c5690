//! What a chip is to the core and to the world, and what both chips have: the core's own peripherals, ports, the
//! two timers, the watchdog, what is connected. Clocks, flash, converters, DMA and USB are each chip's own.

use super::Outcome;
use super::cells::Flash;
use super::finger::Finger;
use super::gpio::Gpio;
use super::host::Host;
use super::iwdg::Iwdg;
use super::system::System;
use super::time::{Tick, micros};
use super::timer::Timer;

/// Begin of the private peripheral bus.
pub const PRIVATE: u32 = 0xe000_0000;

/// Interrupts that have the same number on both chips.
const TIM1_CC: usize = 27;
const TIM2: usize = 28;

/// What the DMA writes to and reads from.
pub trait Memory {
    /// Reads a word or less.
    fn read(&mut self, address: u32, size: u32) -> Outcome<u32>;
    /// Writes it.
    fn write(&mut self, address: u32, size: u32, value: u32) -> Outcome;
}

/// What one request to the DMA moves.
#[derive(Clone, Copy, Debug)]
pub struct Transfer {
    /// The peripheral's register.
    pub register: u32,
    /// The place in memory.
    pub memory: u32,
    /// Bytes.
    pub size: u32,
    /// Out of the memory.
    pub to_peripheral: bool,
}

/// What reset the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power came.
    Power,
    /// SYSRESETREQ.
    Software,
    /// The independent watchdog.
    Watchdog,
}

/// Origin of the events that the machine waits for.
#[derive(Clone, Copy, Debug)]
pub enum EventSource {
    /// SysTick.
    System,
    /// The scan's timer.
    Tim1,
    /// Time's.
    Tim2,
    /// A converter.
    Adc(usize),
    /// The watchdog.
    Iwdg,
    /// The USB's host.
    Host,
    /// The core's voltage.
    Voltage,
}

/// Where a chip has its memories: from, and how many bytes.
#[derive(Clone, Copy, Debug)]
pub struct Map {
    /// All of the flash.
    pub flash: (u32, u32),
    /// What of it the program changes; the rest is its code.
    pub data: (u32, u32),
    /// RAM, forgotten without power.
    pub ram: &'static [(u32, u32)],
    /// The factory's bytes, and where among them the unique identifier is.
    pub factory: (u32, u32),
    /// See above.
    pub unique_id: u32,
}

/// A fault: what is written to a register is changed on its way.
struct Plant {
    address: u32,
    change: fn(u32) -> u32,
}

/// What both chips have, and what is connected to them.
pub struct Common {
    /// The core's own.
    pub system: System,
    /// What is on the pins.
    pub finger: Finger,
    /// What is on the port.
    pub host: Host,
    /// The core stands still until then.
    pub stalled: Tick,
    /// Ports, A first.
    pub(super) ports: Vec<Gpio>,
    pub(super) tim1: Timer,
    pub(super) tim2: Timer,
    pub(super) iwdg: Iwdg,
    /// The watchdog bit.
    pub(super) bitten: bool,
    plants: Vec<Plant>,
    /// Readings of these converters that the DMA is still to miss.
    withheld: [u32; 2],
    pub(super) next: Option<(Tick, EventSource)>,
    /// All before this has happened.
    pub(super) now: Tick,
}

impl Common {
    /// Just powered. `ports` are reset values of the ports' mode registers, `channels` TIM1's.
    pub fn new(finger: Finger, host: Host, ports: &[u32], channels: usize) -> Self {
        Self {
            system: System::default(),
            finger,
            host,
            stalled: 0,
            ports: ports.iter().map(|moder| Gpio::new(*moder)).collect(),
            tim1: Timer::new(16, channels),
            tim2: Timer::new(32, 4),
            iwdg: Iwdg::default(),
            bitten: false,
            plants: Vec::new(),
            withheld: [0; 2],
            next: None,
            now: 0,
        }
    }

    /// All but what is outside is as after power-up.
    pub fn reset(&mut self, now: Tick, ports: &[u32]) {
        self.system = System::default();
        self.ports = ports.iter().map(|moder| Gpio::new(*moder)).collect();
        (self.tim1, self.tim2) = (self.tim1.fresh(), self.tim2.fresh());
        self.iwdg = Iwdg::default();
        self.bitten = false;
        self.finger.pins(0, now);
    }

    /// A moment by the firmware's own clock, in microseconds; TIM2 is what it counts by.
    pub fn device_us(&self, at: Tick) -> Option<u64> {
        Some(at.checked_sub(self.tim2.started()?)? / micros(1))
    }

    /// Why the chip must reset, if it must.
    pub fn take_reset(&mut self) -> Option<Cause> {
        if std::mem::take(&mut self.bitten) {
            return Some(Cause::Watchdog);
        }
        self.system.take_reset().then_some(Cause::Software)
    }

    /// When the parts do something next, these and the chip's own.
    pub(super) fn schedule(&mut self, own: &[(Option<Tick>, EventSource)]) {
        let sources = [
            (self.system.next(), EventSource::System),
            (self.tim1.next(), EventSource::Tim1),
            (self.tim2.next(), EventSource::Tim2),
            (self.iwdg.next(), EventSource::Iwdg),
        ];
        let known = sources.iter().chain(own).filter_map(|(at, source)| Some(((*at)?, *source)));
        self.next = known.min_by_key(|(at, _)| *at);
    }

    /// Lets the interrupts' lines follow the timers.
    pub(super) fn raise(&mut self) {
        self.system.set_line(TIM1_CC, self.tim1.interrupt());
        self.system.set_line(TIM2, self.tim2.interrupt());
    }

    /// The watchdog bites.
    pub(super) fn bite(&mut self) {
        self.bitten = true;
        self.iwdg = Iwdg::default();
    }

    /// Writes to a port; the finger hangs on port B.
    pub(super) fn write_port(&mut self, i: usize, offset: u32, value: u32, now: Tick) -> Outcome {
        self.ports[i].write(offset, value)?;
        if i == 1 {
            self.finger.pins(self.ports[i].high(), now);
        }
        Ok(())
    }

    /// Writes to TIM1, which the scan is timed by; `clock` is the period of its clock.
    pub(super) fn write_tim1(
        &mut self,
        offset: u32,
        value: u32,
        now: Tick,
        clock: Tick,
    ) -> Outcome {
        let ran = self.tim1.is_running();
        self.tim1.write(offset, value, now, clock)?;
        if self.tim1.is_running() && !ran {
            self.finger.scanned_anew(now);
        }
        Ok(())
    }

    /// The pin of a port, which must be set to analogue.
    pub(super) fn analogue(
        &self,
        of: &str,
        name: &'static str,
        port: usize,
        number: u32,
    ) -> Outcome<&'static str> {
        match self.ports.get(port) {
            Some(port) if port.is_analogue(number) => Ok(name),
            _ => Err(format!("{of}'s input {name} is not set to analogue")),
        }
    }

    /// Whether the DMA is to miss this reading.
    pub(super) fn misses(&mut self, adc: usize) -> bool {
        let withheld = self.withheld[adc] > 0;
        self.withheld[adc] -= u32::from(withheld);
        withheld
    }
}

/// A chip with a finger on its pins and a host on its port.
pub trait Chip {
    /// Where its memories are.
    fn map(&self) -> Map;
    /// What it has in common with the other.
    fn common(&self) -> &Common;
    /// To change it.
    fn common_mut(&mut self) -> &mut Common;
    /// The flash that the program changes.
    fn flash(&mut self) -> &mut dyn Flash;
    /// The period of the core's clock.
    fn hclk(&self) -> Tick;
    /// Everything but the flash's content, what is outside, and the record of the reset is as after power-up.
    fn reset(&mut self, cause: Cause, now: Tick);
    /// Finds out what comes next.
    fn schedule(&mut self);
    /// Lets interrupts' lines follow what asks for them.
    fn raise(&mut self);
    /// Does what a source does at its moment; true where it may ask for an interrupt.
    fn happen(&mut self, source: EventSource, now: Tick, memory: &mut dyn Memory) -> Outcome<bool>;
    /// Reads a register; `now` is the time and the core's cycles.
    fn read_register(&mut self, address: u32, size: u32, now: (Tick, u32)) -> Outcome<u32>;
    /// Writes it.
    fn write_register(&mut self, address: u32, size: u32, value: u32, now: (Tick, u32)) -> Outcome;
    /// A register as people call it.
    fn name(&self, address: u32) -> String;

    /// When something happens next.
    fn next(&self) -> Option<Tick> {
        self.common().next.map(|(at, _)| at)
    }

    /// It is `now`, and the host may have been told something.
    fn go_on(&mut self, now: Tick) {
        let common = self.common_mut();
        common.now = common.now.max(now);
        self.plan();
    }

    /// Finds out what comes next, and who asks for an interrupt.
    fn plan(&mut self) {
        self.schedule();
        self.raise();
    }

    /// Lets all happen that happens up to `now`.
    ///
    /// # Errors
    /// What the chip does not have, or must not be asked.
    fn advance(&mut self, now: Tick, memory: &mut dyn Memory) -> Outcome {
        while let Some((at, source)) = self.common().next.filter(|(at, _)| *at <= now) {
            // What was waiting for something that has just come is not done in the past.
            let at = at.max(self.common().now);
            self.common_mut().now = at;
            if self.happen(source, at, memory)? {
                self.raise();
            }
            self.schedule();
        }
        self.common_mut().now = now;
        Ok(())
    }

    /// Reads a register.
    ///
    /// # Errors
    /// The register, and why it cannot be read.
    fn read(&mut self, address: u32, size: u32, now: (Tick, u32)) -> Outcome<u32> {
        self.read_register(address, size, now)
            .map_err(|why| format!("read of {}: {why}", self.name(address)))
    }

    /// Writes a register.
    ///
    /// # Errors
    /// The register, and why it cannot be written so.
    fn write(&mut self, address: u32, size: u32, value: u32, now: (Tick, u32)) -> Outcome {
        let plants = self.common().plants.iter().filter(|plant| plant.address == address);
        let value = plants.fold(value, |value, plant| (plant.change)(value));
        self.write_register(address, size, value, now)
            .map_err(|why| format!("write of {value:#x} to {}: {why}", self.name(address)))?;
        self.go_on(now.0);
        Ok(())
    }

    /// Does what a request to the DMA asks for.
    ///
    /// # Errors
    /// The place or the register that cannot be had.
    fn transfer(&mut self, transfer: Transfer, now: Tick, memory: &mut dyn Memory) -> Outcome {
        let Transfer { register, memory: place, size, to_peripheral } = transfer;
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
    fn plant(&mut self, address: u32, change: fn(u32) -> u32) {
        self.common_mut().plants.push(Plant { address, change });
    }

    /// Withholds the DMA's next grant from a converter, ADC1 being 0: as if other masters had held the bus for
    /// a whole conversion.
    fn withhold(&mut self, adc: usize) {
        self.common_mut().withheld[adc] += 1;
    }
}

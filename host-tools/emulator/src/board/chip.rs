//! Interface of a chip, and the peripherals that both chips share.
//!
//! Shared are the core's own peripherals, ports, two timers, the watchdog and the connected parts.
//! Clocks, flash, converters, DMA and USB belong to each chip.

use std::collections::{BTreeMap, HashMap};

use super::Outcome;
use super::cells::Flash;
use super::crc::Crc;
use super::finger::Finger;
use super::gpio::Gpio;
use super::host::Host;
use super::iwdg::Iwdg;
use super::registers::{self, Row};
use super::system::System;
use super::time::{Tick, micros};
use super::timer::Timer;
use crate::fetch::Accelerator;

/// First address of the private peripheral bus.
pub const PRIVATE: u32 = 0xe000_0000;

/// Interrupts that have the same number on both chips.
const TIM1_CC: usize = 27;
const TIM2: usize = 28;

/// Memory that the DMA reads and writes.
pub trait Memory {
    /// Reads up to a word.
    fn read(&mut self, address: u32, size: u32) -> Outcome<u32>;
    /// Writes up to a word.
    fn write(&mut self, address: u32, size: u32, value: u32) -> Outcome;
}

/// Transfer of one DMA request.
#[derive(Clone, Copy, Debug)]
pub struct Transfer {
    /// Address of the peripheral's register.
    pub register: u32,
    /// Address in memory.
    pub memory: u32,
    /// Size in bytes.
    pub size: u32,
    /// Whether the transfer goes from memory to the peripheral.
    pub to_peripheral: bool,
}

/// Cause of a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power-up.
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
    /// TIM1, the scan's timer.
    Tim1,
    /// TIM2, the timer of the firmware's clock.
    Tim2,
    /// Converter; ADC1 is 0.
    Adc(usize),
    /// The watchdog.
    Iwdg,
    /// USB host.
    Host,
}

/// Memory map of a chip: first address and number of bytes of each memory.
#[derive(Clone, Copy, Debug)]
pub struct Map {
    /// Whole flash.
    pub flash: (u32, u32),
    /// Accelerator between the flash and the core.
    pub accelerator: Accelerator,
    /// Part of the flash that the program changes; the rest is code.
    pub data: (u32, u32),
    /// RAM, lost without power.
    pub ram: &'static [(u32, u32)],
    /// Memory with the factory's values.
    pub factory: (u32, u32),
    /// Address of the unique identifier, within `factory`.
    pub unique_id: u32,
}

/// Injected fault: changes the values written to a register.
struct Plant {
    address: u32,
    change: fn(u32) -> u32,
}

/// Writes of one register.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Number of writes.
    pub times: u32,
    /// Bytes of the last write, and its value.
    pub last: (u32, u32),
}

/// Record of register writes, with a fault in one of them.
#[derive(Debug, Default)]
pub struct Writes {
    /// Writes by address.
    pub by_address: BTreeMap<u32, Written>,
    /// Injected fault: address, number of the write, and bits that it inverts.
    pub fault: Option<(u32, u32, u32)>,
}

impl Writes {
    /// Records a write; returns the value that reaches the register.
    fn pass(&mut self, address: u32, size: u32, value: u32) -> u32 {
        let written = self.by_address.entry(address).or_default();
        (written.times, written.last) = (written.times + 1, (size, value));
        match self.fault {
            Some((at, times, bits)) if (at, times) == (address, written.times) => value ^ bits,
            _ => value,
        }
    }
}

/// Shared peripherals of both chips, and the connected parts.
pub struct Common {
    /// Core's own peripherals.
    pub system: System,
    /// Finger on the pins.
    pub finger: Finger,
    /// USB host on the port.
    pub host: Host,
    /// Time until which the core stalls.
    pub stalled: Tick,
    /// GPIO ports, A first.
    pub(super) ports: Vec<Gpio>,
    pub(super) tim1: Timer,
    pub(super) tim2: Timer,
    pub(super) iwdg: Iwdg,
    pub(super) crc: Crc,
    /// Whether the watchdog has expired.
    pub(super) bitten: bool,
    plants: Vec<Plant>,
    /// Registers of the chip, for the check of reserved bits.
    pub registers: HashMap<u32, Row>,
    /// Record of register writes, if kept.
    pub writes: Option<Writes>,
    /// Number of next readings of each converter that the DMA misses.
    withheld: [u32; 2],
    /// Clocks just enabled: offset of RCC's register, bits, and time.
    ///
    /// The next access to any register takes them.
    pub(super) woken: Option<(u32, u32, Tick)>,
    pub(super) next: Option<(Tick, EventSource)>,
    /// Time up to which everything has happened.
    pub(super) now: Tick,
}

impl Common {
    /// State after power-up; `ports` are reset values of the mode registers, `channels` is TIM1's
    /// number.
    pub fn new(finger: Finger, host: Host, ports: &[u32], channels: usize) -> Self {
        let registers = finger.wiring().map(|wiring| registers::of(wiring.board));
        Self {
            system: System::default(),
            registers: registers.unwrap_or_default(),
            finger,
            host,
            stalled: 0,
            ports: ports.iter().map(|moder| Gpio::new(*moder)).collect(),
            tim1: Timer::new(16, channels),
            tim2: Timer::new(32, 4),
            iwdg: Iwdg::default(),
            crc: Crc::default(),
            bitten: false,
            plants: Vec::new(),
            writes: None,
            withheld: [0; 2],
            woken: None,
            next: None,
            now: 0,
        }
    }

    /// Resets everything except the connected parts.
    pub fn reset(&mut self, now: Tick, ports: &[u32]) {
        self.system = System::default();
        self.ports = ports.iter().map(|moder| Gpio::new(*moder)).collect();
        (self.tim1, self.tim2) = (self.tim1.fresh(), self.tim2.fresh());
        (self.iwdg, self.crc) = (Iwdg::default(), Crc::default());
        self.bitten = false;
        self.finger.pins(0, now);
    }

    /// Time `at` on the firmware's clock (TIM2), in microseconds.
    pub fn device_us(&self, at: Tick) -> Option<u64> {
        Some(at.checked_sub(self.tim2.started()?)? / micros(1))
    }

    /// Times from zero of the firmware's clock (TIM2) to its half and to its end.
    pub fn alarms(&self) -> [Tick; 2] {
        self.tim2.spans()
    }

    /// Time from feeding the watchdog to its reset; `None` if it is off.
    pub fn watchdog(&self) -> Option<Tick> {
        self.iwdg.patience()
    }

    /// Longest time between two feedings of the watchdog since the last call.
    pub fn unfed(&mut self, now: Tick) -> Tick {
        self.iwdg.longest(now)
    }

    /// Takes the cause of a pending reset.
    pub fn take_reset(&mut self) -> Option<Cause> {
        if std::mem::take(&mut self.bitten) {
            return Some(Cause::Watchdog);
        }
        self.system.take_reset().then_some(Cause::Software)
    }

    /// Finds the next event among the shared peripherals and the chip's `own` ones.
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

    /// Updates the interrupt lines of the timers.
    pub(super) fn raise(&mut self) {
        self.system.set_line(TIM1_CC, self.tim1.interrupt());
        self.system.set_line(TIM2, self.tim2.interrupt());
    }

    /// Records that the watchdog has expired.
    pub(super) fn bite(&mut self) {
        self.bitten = true;
        self.iwdg = Iwdg::default();
    }

    /// Writes a port's register; the finger is on port B.
    pub(super) fn write_port(&mut self, i: usize, offset: u32, value: u32, now: Tick) -> Outcome {
        self.ports[i].write(offset, value)?;
        if i == 1 {
            if let Some(wiring) = self.finger.wiring()
                && let Some(pin) = wiring
                    .rows
                    .iter()
                    .chain(&wiring.select)
                    .find(|pin| self.ports[i].is_open_drain(**pin))
            {
                return Err(format!("PB{pin} drives the finger with an open drain"));
            }
            self.finger.pins(self.ports[i].high(), now);
        }
        Ok(())
    }

    /// Writes a register of TIM1, the scan's timer; `clock` is the period of its clock.
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

    /// Fails if the peripheral with this clock enable is accessed right after it.
    ///
    /// A peripheral answers two cycles after its clock starts (RM0440 §7.2.17, RM0383 §6.2). Any
    /// other access to a register lasts as long. Accesses in one block of instructions have the
    /// same time.
    pub(super) fn check_wake(&mut self, clock: Option<(u32, u32)>, now: Tick) -> Outcome {
        match (self.woken.take(), clock) {
            (Some((register, bits, at)), Some((its, bit)))
                if (register, at) == (its, now) && bits >> bit & 1 == 1 =>
            {
                Err("accessed right after its clock is enabled: read the enable back first".into())
            }
            _ => Ok(()),
        }
    }

    /// Returns the pin's name; an error if the pin is not set to analogue.
    pub(super) fn analogue(
        &self,
        of: &str,
        name: &'static str,
        port: usize,
        number: u32,
    ) -> Outcome<&'static str> {
        match self.ports.get(port) {
            Some(port) if port.is_analogue(number) && port.is_pulled(number) => {
                Err(format!("{of}'s input {name} has a pull-up or pull-down"))
            }
            Some(port) if port.is_analogue(number) => Ok(name),
            _ => Err(format!("{of}'s input {name} is not set to analogue")),
        }
    }

    /// Whether the DMA misses this reading of converter `adc`.
    pub(super) fn misses(&mut self, adc: usize) -> bool {
        let withheld = self.withheld[adc] > 0;
        self.withheld[adc] -= u32::from(withheld);
        withheld
    }
}

/// Chip with a finger on its pins and a host on its port.
pub trait Chip {
    /// Memory map of the chip.
    fn map(&self) -> Map;
    /// Shared peripherals.
    fn common(&self) -> &Common;
    /// Shared peripherals, mutable.
    fn common_mut(&mut self) -> &mut Common;
    /// Data part of the flash.
    fn flash(&mut self) -> &mut dyn Flash;
    /// Period of the core's clock.
    fn hclk(&self) -> Tick;
    /// Resets the chip.
    ///
    /// The contents of flash, the connected parts and the record of the reset's cause stay.
    fn reset(&mut self, cause: Cause, now: Tick);
    /// Finds the next event.
    fn schedule(&mut self);
    /// Updates the interrupt lines.
    fn raise(&mut self);
    /// Runs the event of `source`; true if it may raise an interrupt.
    fn happen(&mut self, source: EventSource, now: Tick, memory: &mut dyn Memory) -> Outcome<bool>;
    /// Reads a register; `now` is the time and the core's cycle count.
    fn read_register(&mut self, address: u32, size: u32, now: (Tick, u32)) -> Outcome<u32>;
    /// Writes a register; `now` is the time and the core's cycle count.
    fn write_register(&mut self, address: u32, size: u32, value: u32, now: (Tick, u32)) -> Outcome;
    /// Readable name of a register.
    fn name(&self, address: u32) -> String;
    /// Registers that the ROM's bootloader leaves changed, in the order of their writes.
    fn left_by_bootloader(&self) -> &'static [(u32, u32)];

    /// Time of the next event.
    fn next(&self) -> Option<Tick> {
        self.common().next.map(|(at, _)| at)
    }

    /// Moves the chip's time to `now` and looks for new events of the host.
    fn go_on(&mut self, now: Tick) {
        let common = self.common_mut();
        common.now = common.now.max(now);
        self.plan();
    }

    /// Finds the next event and updates the interrupt lines.
    fn plan(&mut self) {
        self.schedule();
        self.raise();
    }

    /// Runs all events up to `now`.
    ///
    /// # Errors
    /// An access that the model does not support, or one the chip does not allow.
    fn advance(&mut self, now: Tick, memory: &mut dyn Memory) -> Outcome {
        while let Some((at, source)) = self.common().next.filter(|(at, _)| *at <= now) {
            // An event happens no earlier than one that it depended on, or than an access to a
            // register since.
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
    /// Name of the register, and the reason why it cannot be read.
    fn read(&mut self, address: u32, size: u32, now: (Tick, u32)) -> Outcome<u32> {
        self.read_register(address, size, now)
            .map_err(|why| format!("read of {}: {why}", self.name(address)))
    }

    /// Writes a register.
    ///
    /// # Errors
    /// Name of the register, and the reason why it cannot be written.
    fn write(&mut self, address: u32, size: u32, value: u32, now: (Tick, u32)) -> Outcome {
        let value = match &mut self.common_mut().writes {
            Some(writes) => writes.pass(address, size, value),
            None => value,
        };
        let plants = self.common().plants.iter().filter(|plant| plant.address == address);
        let value = plants.fold(value, |value, plant| (plant.change)(value));
        let row = self.common().registers.get(&address);
        let [reserved, unmodelled] =
            row.map_or([0; 2], |row| [row.reserved_in(value), row.unmodelled_in(value)]);
        if reserved | unmodelled != 0 {
            let name = self.name(address);
            let (bits, what) = if reserved != 0 {
                (reserved, "sets reserved bits")
            } else {
                (unmodelled, "sets bits that are not modelled:")
            };
            return Err(format!("write of {value:#x} to {name}: {what} {bits:#x}"));
        }
        self.write_register(address, size, value, now)
            .map_err(|why| format!("write of {value:#x} to {}: {why}", self.name(address)))?;
        self.go_on(now.0);
        Ok(())
    }

    /// Runs the transfer of a DMA request.
    ///
    /// # Errors
    /// The memory address or the register that cannot be accessed.
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

    /// Injects a fault into later writes to the register at `address`.
    ///
    /// `change` replaces each value, as if the firmware wrote it wrongly.
    fn plant(&mut self, address: u32, change: fn(u32) -> u32) {
        self.common_mut().plants.push(Plant { address, change });
    }

    /// Makes the DMA miss one more reading of converter `adc`; ADC1 is 0.
    ///
    /// The effect is that of other masters holding the bus for a whole conversion.
    fn withhold(&mut self, adc: usize) {
        self.common_mut().withheld[adc] += 1;
    }
}

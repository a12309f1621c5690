//! Core: runs the image block by block, takes exceptions between blocks, and sleeps to the next
//! event.
//!
//! Time advances by the cost of each block, at the upper end of the cost table's band, and by its
//! waits for the flash. Register accesses happen at the time at which their block began.

mod alignment;
mod exceptions;
mod memory;
mod start;

use anyhow::{Result, anyhow};
use unicorn_engine::{Arch, ArmCpuModel, HookType, Mode, RegisterARM, Unicorn, uc_error};

use super::Outcome;
use super::cells::FlashContents;
use super::chip::{Cause, Chip};
use super::finger::Finger;
use super::host::Host;
use super::model::Model;
use super::system::{HARD_FAULT, Masks};
use super::time::{Tick, seconds};
use crate::block::Unknown;
use crate::clock::Clock;
use crate::fetch::{Fetch, Settings};
use alignment::{Bases, check_bases};
use memory::{CORE_MEMORY, ROM_ENTRY, Ram};

/// unicorn's numbers for a return from an exception and for a failed fetch.
///
/// `EXCEPTION_RETURN` is the lowest address of a return.
const EXCEPTION_EXIT: u32 = 8;
const PREFETCH_ABORT: u32 = 3;
const EXCEPTION_RETURN: u32 = 0xffff_ff00;

/// Reason why unicorn stopped.
#[derive(Debug)]
enum Stop {
    /// Exception to take.
    Exception(usize),
    /// Return of an exception's handler.
    Return,
    /// Reset of the chip.
    Reset(Cause),
    /// End of the time to run.
    Deadline,
    /// Start of the ROM's bootloader.
    Bootloader,
    /// Access or instruction that the model does not support.
    Fault(String),
}

/// State of the board that unicorn's callbacks can reach.
struct Inside {
    clock: Clock,
    /// Bases of the aligned accesses of each block that `clock` knows.
    bases: Vec<Bases>,
    /// Bases of the block that control is in, to be checked when control leaves it.
    on_exit: u16,
    /// Chip; `None` while it accesses memory.
    chip: Option<Box<dyn Chip>>,
    now: Tick,
    /// Cycles and waits of `clock` that `now` includes.
    counted: u64,
    /// Cycles of exceptions and stalls.
    extra: u64,
    /// Time that the core has slept.
    slept: Tick,
    deadline: Tick,
    /// Event register, which WFE waits for.
    event: bool,
    /// Whether floating-point registers are in use: CONTROL.FPCA.
    float: bool,
    stop: Option<Stop>,
}

/// Reason why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The time to run is over.
    Time,
    /// The chip was reset and is about to start.
    Reset(Cause),
    /// The program jumped to the bootloader in the chip's ROM, which is not modelled.
    Bootloader,
}

/// Board: the core, its chip, and the connected parts.
pub struct Board {
    unicorn: Unicorn<'static, Inside>,
    next: u32,
    /// Running exception handlers with their EXC_RETURN values; the last is the innermost.
    handlers: Vec<(usize, u32)>,
    /// Initial stack pointer and entry address of the image.
    vectors: [u32; 2],
}

fn failed(what: &str) -> impl Fn(uc_error) -> anyhow::Error {
    move |error| anyhow!("{what}: {error:?}")
}

impl Board {
    /// Builds a board with the program in `elf` and otherwise erased flash, just powered.
    pub fn new(model: Model, elf: &[u8], finger: Finger, host: Host) -> Result<Self> {
        let chip = model.chip(finger, host);
        let (map, segments) = (chip.map(), memory::segments(elf)?);
        let inside = Inside {
            clock: Clock::with(Fetch::new(map.accelerator, Settings::default())),
            bases: Vec::new(),
            on_exit: 0,
            chip: Some(chip),
            now: 0,
            counted: 0,
            extra: 0,
            slept: 0,
            deadline: 0,
            event: false,
            float: false,
            stop: None,
        };
        let mut unicorn = Unicorn::new_with_data(Arch::ARM, Mode::THUMB, inside)
            .map_err(failed("starting unicorn"))?;
        // Not `Mode::MCLASS`, because unicorn then emulates a Cortex-M33 whatever model is set.
        unicorn
            .ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32)
            .map_err(failed("choosing the Cortex-M4"))?;
        let vectors = memory::map(&mut unicorn, &map, &segments)?;
        unicorn.add_block_hook(1, 0, enter_block).map_err(failed("watching blocks"))?;
        unicorn.add_intr_hook(take_interrupt).map_err(failed("watching exceptions"))?;
        unicorn
            .add_mem_hook(HookType::MEM_UNMAPPED, 1, 0, move |unicorn, _, address, _, _| {
                if memory::is_below_ram(&map, address as u32) {
                    stop(unicorn, Stop::Exception(HARD_FAULT));
                }
                false
            })
            .map_err(failed("watching memory"))?;
        let mut board = Self { unicorn, next: 0, handlers: Vec::new(), vectors };
        board.power_cycle()?;
        Ok(board)
    }

    /// Chip of the board.
    pub fn chip(&mut self) -> &mut dyn Chip {
        let chip = self.unicorn.get_data_mut().chip.as_mut();
        // The chip is taken out only within a callback.
        chip.expect("the chip is in its place between runs").as_mut()
    }

    /// Finger on the pins.
    pub fn finger(&mut self) -> &mut Finger {
        &mut self.chip().common_mut().finger
    }

    /// USB host on the port.
    pub fn host(&mut self) -> &mut Host {
        &mut self.chip().common_mut().host
    }

    /// Contents of the flash part that the program changes.
    pub fn flash(&mut self) -> &mut FlashContents {
        self.chip().flash().contents()
    }

    /// Moves the stack pointer, as if the program had used the stack down to there.
    pub fn lower_stack(&mut self, to: u32) -> Result<()> {
        self.set(RegisterARM::SP, to)
    }

    /// Stalls the core for `time`.
    pub fn stall(&mut self, time: Tick) {
        let until = self.now() + time;
        self.chip().common_mut().stalled = until;
    }

    /// Virtual time since the first power-up.
    pub fn now(&self) -> Tick {
        self.unicorn.get_data().now
    }

    /// Instructions since power-up.
    pub fn instructions(&self) -> u64 {
        self.unicorn.get_data().clock.total().instructions
    }

    /// Modelled cycles that the core has run or waited for the flash, without sleep.
    pub fn cycles(&self) -> u64 {
        self.unicorn.get_data().clock.total().time()
    }

    /// Time that the core has slept since power-up.
    pub fn slept(&self) -> Tick {
        self.unicorn.get_data().slept
    }

    /// Modelled cycles that the core has waited for the flash.
    pub fn waits(&self) -> u64 {
        self.unicorn.get_data().clock.total().waits
    }

    /// Runs for `time`, or until the chip resets or enters its bootloader.
    pub fn run(&mut self, time: Tick) -> Result<End> {
        let inside = self.unicorn.get_data_mut();
        inside.deadline = inside.now + time;
        if let Some(chip) = &mut inside.chip {
            chip.go_on(inside.now);
        }
        loop {
            let outcome = self.unicorn.emu_start(u64::from(self.next | 1), 1, 0, 0);
            let at = self.get(RegisterARM::PC)?;
            self.next = at;
            let stop = self.unicorn.get_data_mut().stop.take();
            match stop {
                Some(Stop::Exception(exception)) => self.enter(exception)?,
                Some(Stop::Return) => self.leave()?,
                Some(Stop::Reset(Cause::Power)) => {
                    self.flash().cut_power_after(None);
                    self.power_cycle()?;
                    return Ok(End::Reset(Cause::Power));
                }
                Some(Stop::Reset(cause)) => {
                    self.reset(cause)?;
                    return Ok(End::Reset(cause));
                }
                Some(Stop::Bootloader) => return Ok(End::Bootloader),
                Some(Stop::Deadline) => return Ok(End::Time),
                Some(Stop::Fault(why)) => return Err(self.fault(at, &why)),
                None if at >= EXCEPTION_RETURN => self.leave()?,
                // unicorn stops at a WFI and reports a WFE as invalid.
                None if self.is_asleep()
                    && matches!(outcome, Ok(()) | Err(uc_error::INSN_INVALID)) =>
                {
                    pay(self.unicorn.get_data_mut(), at);
                    if let Some(end) = self.wait()? {
                        return Ok(end);
                    }
                }
                None => match outcome {
                    Err(error) => return Err(self.fault(at, &format!("{error:?}"))),
                    Ok(()) => return Err(self.fault(at, "the core stopped")),
                },
            }
        }
    }

    /// Counter of instructions, cycles and blocks.
    pub fn clock(&mut self) -> &mut Clock {
        &mut self.unicorn.get_data_mut().clock
    }

    fn is_asleep(&self) -> bool {
        self.unicorn.get_data().clock.current().is_some_and(|block| block.waits)
    }

    fn fault(&self, at: u32, why: &str) -> anyhow::Error {
        let link = self.get(RegisterARM::LR).unwrap_or_default();
        anyhow!("{:.6} s, at {at:#010x} called from {link:#010x}: {why}", seconds(self.now()))
    }

    fn get(&self, register: RegisterARM) -> Result<u32> {
        let value = self.unicorn.reg_read(register).map_err(failed("reading a register"))?;
        Ok(value as u32)
    }

    fn set(&mut self, register: RegisterARM, value: u32) -> Result<()> {
        self.unicorn.reg_write(register, u64::from(value)).map_err(failed("setting a register"))
    }

    fn word(&self, address: u32) -> Result<u32> {
        let mut word = [0; 4];
        let read = self.unicorn.mem_read(u64::from(address), &mut word);
        read.map_err(|error| anyhow!("the stack at {address:#010x}: {error:?}"))?;
        Ok(u32::from_le_bytes(word))
    }

    fn put(&mut self, address: u32, words: &[u32]) -> Result<()> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let written = self.unicorn.mem_write(u64::from(address), &bytes);
        written.map_err(|error| anyhow!("the stack at {address:#010x}: {error:?}"))
    }

    /// Sleeps until an event or exception wakes the core, or the run ends.
    fn wait(&mut self) -> Result<Option<End>> {
        loop {
            if std::mem::take(&mut self.unicorn.get_data_mut().event) {
                return Ok(None);
            }
            if let Some(exception) = deliverable(&mut self.unicorn) {
                self.enter(exception)?;
                return Ok(None);
            }
            let inside = self.unicorn.get_data_mut();
            let next = inside.chip.as_ref().and_then(|chip| chip.next());
            let until = next.map_or(inside.deadline, |next| next.min(inside.deadline));
            inside.slept += until.saturating_sub(inside.now);
            inside.now = inside.now.max(until);
            // The run ends during sleep; the next run repeats the wait.
            if next.is_none_or(|next| next > inside.deadline) {
                inside.event = false;
                return Ok(Some(End::Time)).inspect(|_| self.rewind());
            }
            advance(&mut self.unicorn).map_err(|why| self.fault(self.next, &why))?;
            let reset = self
                .unicorn
                .get_data_mut()
                .chip
                .as_mut()
                .and_then(|chip| chip.common_mut().take_reset());
            if let Some(cause) = reset {
                self.reset(cause)?;
                return Ok(Some(End::Reset(cause)));
            }
        }
    }

    /// Moves back to the WFE or WFI that was executed; both have two bytes.
    fn rewind(&mut self) {
        self.next -= 2;
    }
}

fn stop(unicorn: &mut Unicorn<'_, Inside>, why: Stop) {
    unicorn.get_data_mut().stop.get_or_insert(why);
    // Stopping cannot fail while unicorn runs.
    let _ = unicorn.emu_stop();
}

/// Advances the chip to the core's time.
fn advance(unicorn: &mut Unicorn<'_, Inside>) -> Outcome {
    let inside = unicorn.get_data_mut();
    let now = inside.now;
    let Some(mut chip) = inside.chip.take() else { return Err("the chip is in use".into()) };
    let done = chip.advance(now, &mut Ram(unicorn));
    unicorn.get_data_mut().chip = Some(chip);
    done
}

/// Exception to take now.
fn deliverable(unicorn: &mut Unicorn<'_, Inside>) -> Option<usize> {
    let register = |register| unicorn.reg_read(register).unwrap_or_default();
    let chip = unicorn.get_data().chip.as_ref()?;
    let system = &chip.common().system;
    if !system.is_waiting() {
        return None;
    }
    let masks = Masks {
        primask: register(RegisterARM::PRIMASK) & 1 == 1,
        basepri: register(RegisterARM::BASEPRI) as u8,
    };
    system.deliverable(masks)
}

/// Adds the cost of the block that control has left for `next` to the time.
fn pay(inside: &mut Inside, next: u32) {
    inside.clock.leave(next);
    let cycles = inside.clock.total().time();
    inside.now += (cycles - inside.counted) * inside.chip.as_ref().map_or(0, |chip| chip.hclk());
    inside.counted = cycles;
}

/// Hook on entering a block.
///
/// It adds the cost of the block before, runs the events that are due, and stops for an exception.
fn enter_block(unicorn: &mut Unicorn<'_, Inside>, start: u64, length: u32) {
    let start = start as u32;
    let inside = unicorn.get_data_mut();
    pay(inside, start);
    let left = std::mem::take(&mut inside.on_exit);
    if let Err(why) = check_bases(unicorn, left) {
        return stop(unicorn, Stop::Fault(why));
    }
    let inside = unicorn.get_data_mut();
    let Some(chip) = inside.chip.as_mut() else { return };
    inside.now = inside.now.max(chip.common().stalled);
    if start < CORE_MEMORY {
        inside.now = inside.now.max(chip.flash().busy_until());
    }
    if chip.flash().contents().has_lost_power() {
        return stop(unicorn, Stop::Reset(Cause::Power));
    }
    if let Some(cause) = chip.common_mut().take_reset() {
        return stop(unicorn, Stop::Reset(cause));
    }
    if start == ROM_ENTRY {
        return stop(unicorn, Stop::Bootloader);
    }
    if chip.next().is_some_and(|next| next <= inside.now)
        && let Err(why) = advance(unicorn)
    {
        return stop(unicorn, Stop::Fault(why));
    }
    if let Some(exception) = deliverable(unicorn) {
        return stop(unicorn, Stop::Exception(exception));
    }
    let inside = unicorn.get_data_mut();
    if inside.now >= inside.deadline {
        return stop(unicorn, Stop::Deadline);
    }
    let block = match inside.clock.find(start, length) {
        Some(block) => block,
        None => {
            let code = unicorn.mem_read_as_vec(u64::from(start), length as usize);
            let code = code.unwrap_or_default();
            let inside = unicorn.get_data_mut();
            match inside.clock.learn(start, &code) {
                Ok(block) => {
                    let learnt = inside.clock.blocks().last();
                    let bases = learnt.map(|(block, _)| Bases::of(&block.instructions, &code));
                    inside.bases.push(bases.unwrap_or_default());
                    block
                }
                Err(Unknown { address, code }) => {
                    let why =
                        format!("no model of the instruction {code:#010x} at {address:#010x}");
                    return stop(unicorn, Stop::Fault(why));
                }
            }
        }
    };
    let inside = unicorn.get_data_mut();
    let Bases { on_entry, on_exit } = inside.bases.get(block).copied().unwrap_or_default();
    if let Err(why) = check_bases(unicorn, on_entry) {
        return stop(unicorn, Stop::Fault(why));
    }
    let inside = unicorn.get_data_mut();
    inside.on_exit = on_exit;
    inside.clock.enter(block, start, [0; 2]);
    if let Some(block) = inside.clock.current() {
        inside.event |= block.signals;
        inside.float |= block.floats;
    }
}

fn take_interrupt(unicorn: &mut Unicorn<'_, Inside>, number: u32) {
    let at = unicorn.reg_read(RegisterARM::PC).unwrap_or_default() as u32;
    let why = match number {
        EXCEPTION_EXIT => Stop::Return,
        // unicorn either fetches from that address or fails at once, depending on what it knows of
        // the page.
        PREFETCH_ABORT if at >= EXCEPTION_RETURN => Stop::Return,
        other => Stop::Fault(format!("exception {other} of unicorn's")),
    };
    stop(unicorn, why);
}

/// Virtual time, and cycles that the core has run.
fn time(inside: &Inside) -> (Tick, u32) {
    (inside.now, (inside.counted + inside.extra) as u32)
}

//! Cortex-M4F with flash and RAM, without devices.
//!
//! unicorn executes the instructions. This module adds the memory map, reset and faults, [`Clock`]
//! adds time. The guest calls the host by semihosting, as it would call a debugger: to print and to
//! end. The operation numbers that the specification leaves to applications mark the calls to
//! measure (`boards/cycles/src/host.rs`).

use anyhow::{Context, Result, anyhow, bail};
use object::LittleEndian;
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};
use unicorn_engine::{Arch, ArmCpuModel, Mode, Prot, RegisterARM, Unicorn, uc_error};

use crate::block::Unknown;
use crate::clock::Clock;

/// Address of flash, which begins with the vector table.
pub const FLASH: u32 = 0x0800_0000;
const FLASH_BYTES: u64 = 1 << 20;
const RAM: u64 = 0x2000_0000;
const RAM_BYTES: u64 = 1 << 20;
/// Address of the memory that passes inputs from the host to the guest.
pub const SHARED: u32 = 0x9000_0000;
/// Size of that memory, bytes.
pub const SHARED_BYTES: u64 = 1 << 22;
const SYSTEM_CONTROL: u64 = 0xe000_e000;
/// Offset of the coprocessor access register, which start-up code uses to enable the floating-point
/// unit.
const CPACR: u64 = 0xd88;
const PAGE: u64 = 0x1000;

/// unicorn's number for the exception that BKPT raises.
const BREAKPOINT: u32 = 7;
/// BKPT 0xAB, the semihosting call of this architecture.
const SEMIHOSTING: u16 = 0xbeab;

/// State of the machine that unicorn's callbacks can reach.
#[derive(Default)]
struct Inside {
    clock: Clock,
    /// Fault that stops the run.
    fault: Option<Fault>,
    breakpoint: bool,
    cpacr: u32,
    instruction_limit: u64,
}

/// Access, exception or instruction that this machine does not support.
#[derive(Debug)]
enum Fault {
    Instruction(Unknown),
    Register { address: u64, write: bool },
    Exception(u32),
    Limit,
}

/// Semihosting call of the guest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostCall {
    /// Operation number, from R0.
    pub operation: u32,
    /// Parameter, from R1.
    pub parameter: u32,
}

/// Cortex-M4F with flash and RAM.
pub struct Machine {
    unicorn: Unicorn<'static, Inside>,
    next: u32,
}

fn failed(what: &str) -> impl Fn(uc_error) -> anyhow::Error {
    move |error| anyhow!("{what}: {error:?}")
}

impl Machine {
    /// Builds a machine with the program in `elf`, just reset.
    pub fn new(elf: &[u8]) -> Result<Self> {
        let mut machine = Self::blank()?;
        machine.load_elf(elf)?;
        machine.reset()?;
        Ok(machine)
    }

    /// Builds a machine with empty flash.
    fn blank() -> Result<Self> {
        let mut unicorn = Unicorn::new_with_data(Arch::ARM, Mode::THUMB, Inside::default())
            .map_err(failed("starting unicorn"))?;
        // Not `Mode::MCLASS`, because unicorn then emulates a Cortex-M33 whatever model is set.
        unicorn
            .ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32)
            .map_err(failed("choosing the Cortex-M4"))?;
        let map = [
            (u64::from(FLASH), FLASH_BYTES, Prot::READ | Prot::EXEC),
            (RAM, RAM_BYTES, Prot::ALL),
            (u64::from(SHARED), SHARED_BYTES, Prot::READ),
        ];
        for (address, bytes, access) in map {
            unicorn.mem_map(address, bytes, access).map_err(failed("mapping memory"))?;
        }
        unicorn
            .mmio_map(SYSTEM_CONTROL, PAGE, Some(read_system), Some(write_system))
            .map_err(failed("mapping the system control space"))?;
        unicorn.add_block_hook(1, 0, enter_block).map_err(failed("watching blocks"))?;
        unicorn.add_intr_hook(take_exception).map_err(failed("watching exceptions"))?;
        Ok(Self { unicorn, next: 0 })
    }

    fn load_elf(&mut self, elf: &[u8]) -> Result<()> {
        let header = FileHeader32::<LittleEndian>::parse(elf).context("not a 32-bit ELF file")?;
        let endian = header.endian().context("not a little-endian ELF file")?;
        for segment in header.program_headers(endian, elf)? {
            if segment.p_type(endian) == PT_LOAD
                && let Ok(data) = segment.data(endian, elf)
            {
                self.write(segment.p_paddr(endian), data)?;
            }
        }
        Ok(())
    }

    /// Loads stack pointer and program counter from the vector table.
    fn reset(&mut self) -> Result<()> {
        let [stack, entry] = [self.word(FLASH)?, self.word(FLASH + 4)?];
        self.set(RegisterARM::SP, stack)?;
        self.next = entry & !1;
        Ok(())
    }

    /// Counter of instructions, cycles and blocks; its flash has no wait states at first.
    pub fn clock(&mut self) -> &mut Clock {
        &mut self.unicorn.get_data_mut().clock
    }

    /// Runs to the next host call, for at most `instructions` instructions.
    pub fn run(&mut self, instructions: u64) -> Result<HostCall> {
        let inside = self.unicorn.get_data_mut();
        inside.instruction_limit = inside.clock.total().instructions + instructions;
        inside.breakpoint = false;
        let outcome = self.unicorn.emu_start(u64::from(self.next | 1), 1, 0, 0);
        let at = self.get(RegisterARM::PC)?;
        let inside = self.unicorn.get_data_mut();
        match inside.fault.take() {
            Some(Fault::Instruction(Unknown { address, code })) => {
                bail!("{address:#010x}: no model of the instruction {code:#010x}")
            }
            Some(Fault::Register { address, write }) => {
                let verb = if write { "write to" } else { "read of" };
                bail!("{at:#010x}: {verb} {address:#010x}, which this machine does not have")
            }
            Some(Fault::Exception(number)) => bail!("{at:#010x}: exception {number}"),
            Some(Fault::Limit) => bail!("{at:#010x}: still running after the instruction limit"),
            None => {}
        }
        outcome.map_err(|error| anyhow!("{at:#010x}: {error:?}"))?;
        if !inside.breakpoint || self.half(at)? != SEMIHOSTING {
            bail!("{at:#010x}: stopped without a semihosting call");
        }
        self.next = at + 2;
        let next = self.next;
        self.clock().pause(next);
        Ok(HostCall {
            operation: self.get(RegisterARM::R0)?,
            parameter: self.get(RegisterARM::R1)?,
        })
    }

    /// Sets the return value of the guest's last host call.
    pub fn answer(&mut self, value: u32) -> Result<()> {
        self.set(RegisterARM::R0, value)
    }

    /// Reads `length` bytes of the guest's memory at `address`.
    pub fn read(&self, address: u32, length: u32) -> Result<Vec<u8>> {
        self.unicorn
            .mem_read_as_vec(u64::from(address), length as usize)
            .map_err(|error| anyhow!("reading {length} bytes at {address:#010x}: {error:?}"))
    }

    /// Reads a little-endian word of the guest's memory at `address`.
    pub fn word(&self, address: u32) -> Result<u32> {
        let bytes = self.read(address, 4)?;
        Ok(bytes.first_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes)))
    }

    fn half(&self, address: u32) -> Result<u16> {
        let bytes = self.read(address, 2)?;
        Ok(bytes.first_chunk().map_or(0, |bytes| u16::from_le_bytes(*bytes)))
    }

    /// Writes `bytes` into the guest's memory, read-only memory included.
    pub fn write(&mut self, address: u32, bytes: &[u8]) -> Result<()> {
        self.unicorn.mem_write(u64::from(address), bytes).map_err(|error| {
            anyhow!("{} bytes at {address:#010x} do not fit the memory: {error:?}", bytes.len())
        })
    }

    fn get(&self, register: RegisterARM) -> Result<u32> {
        self.unicorn
            .reg_read(register)
            .map(|value| value as u32)
            .map_err(failed("reading a register"))
    }

    fn set(&mut self, register: RegisterARM, value: u32) -> Result<()> {
        self.unicorn.reg_write(register, u64::from(value)).map_err(failed("setting a register"))
    }
}

impl Inside {
    fn stop(unicorn: &mut Unicorn<'_, Self>, fault: Fault) {
        unicorn.get_data_mut().fault.get_or_insert(fault);
        // Stopping cannot fail while unicorn runs; if it did, the instruction limit would end the
        // run.
        let _ = unicorn.emu_stop();
    }
}

fn enter_block(unicorn: &mut Unicorn<'_, Inside>, start: u64, length: u32) {
    let start = start as u32;
    let block = match unicorn.get_data().clock.find(start, length) {
        Some(block) => block,
        None => {
            let code = unicorn.mem_read_as_vec(u64::from(start), length as usize);
            match unicorn.get_data_mut().clock.learn(start, &code.unwrap_or_default()) {
                Ok(block) => block,
                Err(unknown) => return Inside::stop(unicorn, Fault::Instruction(unknown)),
            }
        }
    };
    let registers = if unicorn.get_data().clock.watches(start) {
        [RegisterARM::LR, RegisterARM::SP]
            .map(|register| unicorn.reg_read(register).unwrap_or_default() as u32)
    } else {
        [0; 2]
    };
    let inside = unicorn.get_data_mut();
    inside.clock.enter(block, start, registers);
    if inside.clock.total().instructions > inside.instruction_limit {
        Inside::stop(unicorn, Fault::Limit);
    }
}

fn take_exception(unicorn: &mut Unicorn<'_, Inside>, number: u32) {
    if number == BREAKPOINT {
        unicorn.get_data_mut().breakpoint = true;
        // Cannot fail, as in `stop`.
        let _ = unicorn.emu_stop();
    } else {
        Inside::stop(unicorn, Fault::Exception(number));
    }
}

fn read_system(unicorn: &mut Unicorn<'_, Inside>, offset: u64, _: usize) -> u64 {
    if offset == CPACR {
        return u64::from(unicorn.get_data().cpacr);
    }
    Inside::stop(unicorn, Fault::Register { address: SYSTEM_CONTROL + offset, write: false });
    0
}

fn write_system(unicorn: &mut Unicorn<'_, Inside>, offset: u64, _: usize, value: u64) {
    if offset == CPACR {
        unicorn.get_data_mut().cpacr = value as u32;
        return;
    }
    Inside::stop(unicorn, Fault::Register { address: SYSTEM_CONTROL + offset, write: true });
}

#[cfg(test)]
mod tests;

//! Memory map of the core: the image, RAM, ROM, and the chip's registers.

use anyhow::{Context, Result, ensure};
use object::LittleEndian;
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};
use unicorn_engine::{Prot, Unicorn};

use super::{Inside, Stop, failed, stop, time};
use crate::board::Outcome;
use crate::board::chip::{Map, Memory, PRIVATE};
use crate::board::system::NMI;
use crate::fetch::Settings;

/// ROM of both chips: first address and size. Only its vectors are modelled; jumping there ends a
/// run.
pub const ROM: (u32, u32) = (0x1fff_0000, 0x7000);
/// Entry address of the ROM's bootloader.
pub const ROM_ENTRY: u32 = ROM.0 + 0x100;
const PERIPHERALS: (u32, u32) = (0x4000_0000, 0x1100_0000);
const PRIVATE_BYTES: u32 = 0x10_0000;

/// Parts of an image with their load addresses.
type Segments<'a> = Vec<(u32, &'a [u8])>;

/// Loadable parts of an image, with the addresses that they are stored at.
pub fn segments(elf: &[u8]) -> Result<Segments<'_>> {
    let header = FileHeader32::<LittleEndian>::parse(elf).context("not a 32-bit ELF file")?;
    let endian = header.endian().context("not a little-endian ELF file")?;
    let mut segments = Vec::new();
    for segment in header.program_headers(endian, elf)? {
        if segment.p_type(endian) == PT_LOAD
            && let Ok(data) = segment.data(endian, elf)
            && !data.is_empty()
        {
            segments.push((segment.p_paddr(endian), data));
        }
    }
    Ok(segments)
}

/// Maps a chip's memories and loads the image; returns its initial stack pointer and entry.
pub fn map(
    unicorn: &mut Unicorn<'_, Inside>,
    map: &Map,
    segments: &Segments<'_>,
) -> Result<[u32; 2]> {
    let (flash, data) = (map.flash, map.data);
    let behind = data.0 + data.1;
    // Flash on both sides of the data part belongs to the program.
    let code = [(flash.0, data.0 - flash.0), (behind, flash.0 + flash.1 - behind)];
    let read_only = Prot::READ | Prot::EXEC;
    let memories = code
        .iter()
        .map(|memory| (memory, read_only))
        .chain(map.ram.iter().map(|memory| (memory, Prot::ALL)))
        .chain([(&map.factory, Prot::READ), (&ROM, read_only)])
        .filter(|((_, bytes), _)| *bytes > 0);
    for ((address, bytes), access) in memories {
        let mapped = unicorn.mem_map(u64::from(*address), u64::from(*bytes), access);
        mapped.map_err(failed("mapping memory"))?;
    }
    let mut put = |address: u32, bytes: &[u8]| {
        unicorn.mem_write(u64::from(address), bytes).map_err(failed("flashing"))
    };
    for (address, bytes) in code {
        put(address, &vec![0xff; bytes as usize])?;
    }
    for (address, bytes) in segments {
        let end = *address + bytes.len() as u32;
        let within = code.iter().any(|(from, room)| *address >= *from && end <= from + room);
        ensure!(
            within,
            "the image has {} bytes at {address:#010x}, where this board has no flash for its program",
            bytes.len()
        );
        put(*address, bytes)?;
    }
    // The ROM's vectors, stack and entry; the entry is a branch to itself.
    let rom = [map.ram[0].0 + 0x1000, ROM_ENTRY | 1].map(u32::to_le_bytes).concat();
    put(ROM.0, &rom)?;
    put(ROM_ENTRY, &[0xfe, 0xe7])?;
    // Three words: coordinates on the wafer, its number, its lot.
    put(map.unique_id, &[0x0020_0013u32, 0x5033_5012, 0x2037_364b].map(u32::to_le_bytes).concat())?;
    for (start, bytes) in [data, PERIPHERALS, (PRIVATE, PRIVATE_BYTES)] {
        let read = move |unicorn: &mut Unicorn<'_, Inside>, offset: u64, size: usize| {
            read(unicorn, start + offset as u32, size)
        };
        let write =
            move |unicorn: &mut Unicorn<'_, Inside>, offset: u64, size: usize, value: u64| {
                write(unicorn, start + offset as u32, size, value as u32);
            };
        unicorn
            .mmio_map(u64::from(start), u64::from(bytes), Some(read), Some(write))
            .map_err(failed("mapping the peripherals"))?;
    }
    let mut vectors = [0; 8];
    unicorn.mem_read(u64::from(flash.0), &mut vectors).map_err(failed("reading the vectors"))?;
    let [a, b, c, d, entry @ ..] = vectors;
    Ok([[a, b, c, d], entry].map(u32::from_le_bytes))
}

/// Whether an address is just below a RAM, where the chips have no memory.
///
/// A stack that overflows gets there; the bus answers with a fault. Elsewhere such an access stops
/// the machine.
pub fn is_below_ram(map: &Map, address: u32) -> bool {
    map.ram.iter().any(|(start, _)| (start - 0x1000..*start).contains(&address))
}

/// Address space that the DMA reaches for reading and writing, from the RAM on.
///
/// It reads the flash too. The CCM SRAM is on the core's own buses at its first address (RM0440
/// §2.1).
const DMA_MEMORY: u32 = 0x2000_0000;
/// First address behind the flash, from which on only the core reads.
pub const CORE_MEMORY: u32 = 0x1000_0000;

/// unicorn's memory as the DMA accesses it.
pub struct Ram<'a, 'b>(pub &'a mut Unicorn<'b, Inside>);

impl Memory for Ram<'_, '_> {
    fn read(&mut self, address: u32, size: u32) -> Outcome<u32> {
        let mut word = [0; 4];
        if (CORE_MEMORY..DMA_MEMORY).contains(&address) {
            return Err(format!("the DMA reads {address:#010x}, which it does not reach"));
        }
        let part = word.get_mut(..size as usize).ok_or("a transfer of more than a word")?;
        let read = self.0.mem_read(u64::from(address), part);
        read.map_err(|error| format!("the DMA reads {address:#010x}: {error:?}"))?;
        Ok(u32::from_le_bytes(word))
    }

    fn write(&mut self, address: u32, size: u32, value: u32) -> Outcome {
        if address < DMA_MEMORY {
            return Err(format!("the DMA writes {address:#010x}, which it cannot"));
        }
        let word = value.to_le_bytes();
        let part = word.get(..size as usize).ok_or("a transfer of more than a word")?;
        let written = self.0.mem_write(u64::from(address), part);
        written.map_err(|error| format!("the DMA writes {address:#010x}: {error:?}"))
    }
}

fn read(unicorn: &mut Unicorn<'_, Inside>, address: u32, size: usize) -> u64 {
    let inside = unicorn.get_data_mut();
    let now = time(inside);
    let Some(chip) = inside.chip.as_mut() else { return 0 };
    let value = if address < PERIPHERALS.0 {
        // The read ends with the operation in progress.
        let busy = chip.flash().busy_until();
        let stalled = &mut chip.common_mut().stalled;
        *stalled = busy.max(*stalled);
        let read = chip.flash().fetch(address, size as u32);
        if matches!(read, Ok((_, true))) {
            chip.common_mut().system.pend(NMI);
        }
        read.map(|(value, _)| value)
    } else {
        chip.read(address, size as u32, now)
    };
    match value {
        Ok(value) => u64::from(value),
        Err(why) => {
            stop(unicorn, Stop::Fault(why));
            0
        }
    }
}

fn write(unicorn: &mut Unicorn<'_, Inside>, address: u32, size: usize, value: u32) {
    let inside = unicorn.get_data_mut();
    let now = time(inside);
    let Some(chip) = inside.chip.as_mut() else { return };
    let done = if address < PERIPHERALS.0 {
        chip.flash().program(address, size as u32, value, now.0)
    } else {
        let done = chip.write(address, size as u32, value, now);
        let settings = Settings::of(chip.flash().access_control());
        inside.clock.fetch().set(settings);
        done
    };
    if let Err(why) = done {
        stop(unicorn, Stop::Fault(why));
    }
}

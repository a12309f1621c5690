//! Flash and RAM that a firmware uses, from its ELF file and the board's `memory.x`.
//!
//! A linker takes the first `memory.x` that it finds, and the repository has one for each chip.
//! Every segment must therefore lie inside the board's own map, and the stack must start at the top
//! of its region.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};

/// Used and available bytes of a memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Use {
    /// Used bytes.
    pub used: u64,
    /// Available bytes.
    pub of: u64,
}

/// Memory use of a firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Footprint {
    /// Flash: code, constants and the statics' initial values.
    pub flash: Use,
    /// RAM: statics, without the stack.
    pub ram: Use,
    /// Core-coupled memory (CCM) above the stack: code; `None` where the chip has none.
    pub ccm: Option<Use>,
    /// Bytes for the stack: its region, else what the statics leave of the RAM.
    pub stack: u64,
}

/// Distance between the starts of a chip's memories. Below such an address there is no memory.
const MEMORIES: u64 = 0x1000_0000;

/// Measures the firmware in `elf` against the map in `memory_x`.
pub fn footprint(elf: &Path, memory_x: &Path) -> Result<Footprint> {
    let bytes = std::fs::read(elf).with_context(|| format!("reading {}", elf.display()))?;
    let map = std::fs::read_to_string(memory_x)
        .with_context(|| format!("reading {}", memory_x.display()))?;
    measure(&bytes, &map)
        .with_context(|| format!("{} against {}", elf.display(), memory_x.display()))
}

fn measure(elf: &[u8], map: &str) -> Result<Footprint> {
    let flash = region(map, "FLASH").context("the map has no region FLASH")?;
    let ram = region(map, "RAM").context("the map has no region RAM")?;
    let ccm = region(map, "CCMRAM");
    let stack = region(map, "STACK");
    if let Some(stack) = &stack {
        ensure!(
            stack.start.is_multiple_of(MEMORIES),
            "an overflow of the stack would be no fault: its region starts at {:#x}",
            stack.start
        );
    }
    let top = stack.as_ref().map_or(ram.end, |stack| stack.end);
    let header = FileHeader32::<object::LittleEndian>::parse(elf)?;
    let endian = header.endian()?;
    let (mut flash_used, mut ram_used, mut ccm_used) = (0, 0, 0);
    for segment in header.program_headers(endian, elf)? {
        if segment.p_type(endian) != PT_LOAD {
            continue;
        }
        let stored = extent(segment.p_paddr(endian), segment.p_filesz(endian));
        let in_use = extent(segment.p_vaddr(endian), segment.p_memsz(endian));
        if !stored.is_empty() {
            inside(&stored, &flash)?;
            flash_used += stored.end - stored.start;
        }
        if let Some(ccm) = ccm.as_ref().filter(|ccm| ccm.contains(&in_use.start)) {
            inside(&in_use, ccm)?;
            ccm_used += in_use.end - in_use.start;
        } else if !flash.contains(&in_use.start) && !in_use.is_empty() {
            inside(&in_use, &ram)?;
            ram_used += in_use.end - in_use.start;
        }
        // The first word of the vector table is where the stack starts.
        if stored.start == flash.start
            && let Ok(data) = segment.data(endian, elf)
            && let Some(word) = data.first_chunk()
        {
            let word = u64::from(u32::from_le_bytes(*word));
            ensure!(word == top, "the stack starts at {word:#x}, its memory ends at {top:#x}");
        }
    }
    Ok(Footprint {
        flash: Use { used: flash_used, of: flash.end - flash.start },
        ram: Use { used: ram_used, of: ram.end - ram.start },
        ccm: ccm.map(|ccm| Use { used: ccm_used, of: ccm.end - ccm.start }),
        stack: stack.map_or(ram.end - ram.start - ram_used, |stack| stack.end - stack.start),
    })
}

fn extent(start: u32, length: u32) -> Range<u64> {
    u64::from(start)..u64::from(start) + u64::from(length)
}

fn inside(part: &Range<u64>, whole: &Range<u64>) -> Result<()> {
    if part.start < whole.start || part.end > whole.end {
        bail!("{part:#x?} is outside {whole:#x?}: linked with another board's memory.x?");
    }
    Ok(())
}

/// `NAME : ORIGIN = …, LENGTH = …`
fn region(map: &str, name: &str) -> Option<Range<u64>> {
    map.lines().find_map(|line| {
        let (found, rest) = line.split_once(':')?;
        if found.split('(').next()?.trim() != name {
            return None;
        }
        let (origin, length) = rest.split_once(',')?;
        let value = |text: &str| number(text.split_once('=')?.1.trim());
        let (origin, length) = (value(origin)?, value(length)?);
        Some(origin..origin + length)
    })
}

fn number(text: &str) -> Option<u64> {
    if let Some(hex) = text.strip_prefix("0x") {
        return u64::from_str_radix(hex, 16).ok();
    }
    let (digits, unit) = match text.strip_suffix(['K', 'k']) {
        Some(digits) => (digits, 1 << 10),
        None => text.strip_suffix(['M', 'm']).map_or((text, 1), |digits| (digits, 1 << 20)),
    };
    digits.parse::<u64>().ok().map(|number| number * unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn region_is_read_in_any_unit() {
        let map = "/* FLASH : no */\nMEMORY\n{\n FLASH (rx) : ORIGIN = 0x08000000, LENGTH = 116K\n \
                   RAM : ORIGIN = 0x20000000, LENGTH = 0x5800\n}";
        assert_eq!(region(map, "FLASH"), Some(0x0800_0000..0x0801_d000));
        assert_eq!(region(map, "RAM"), Some(0x2000_0000..0x2000_5800));
        assert_eq!(region(map, "CCMRAM"), None);
    }

    #[test]
    fn product_map_reserves_12_kb_for_stored_data() {
        let map = std::fs::read_to_string(crate::run::root().join("memory.x")).unwrap();
        let [flash, calibration, settings] =
            ["FLASH", "CALIBRATION", "SETTINGS"].map(|name| region(&map, name).unwrap());
        assert_eq!((flash.end, calibration.end), (calibration.start, settings.start));
        assert_eq!(settings.end - flash.start, 128 << 10);
    }

    #[test]
    fn segment_outside_its_map_is_an_error() {
        let board = 0x0..0x40_0000;
        assert!(inside(&(0x100..0x200), &board).is_ok());
        assert!(inside(&(0x0800_0000..0x0800_0100), &board).is_err());
    }
}

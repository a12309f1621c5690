//! What a firmware takes of its board's memory, read from the ELF file and the board's `memory.x`.
//!
//! A linker takes any `memory.x` that it meets first, and the repository has one for each chip. So every
//! segment must lie inside the map of the very board, and the stack must start at the top of its RAM.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};

/// Bytes used, of how many there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Use {
    /// Used.
    pub used: u64,
    /// There.
    pub of: u64,
}

/// What a firmware takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Footprint {
    /// Code, constants, and what statics start with.
    pub flash: Use,
    /// Statics, without the stack.
    pub ram: Use,
    /// Memory that is tightly coupled to the core, where the chip has any: code and statics.
    pub ccm: Option<Use>,
}

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
            let stack = u64::from(u32::from_le_bytes(*word));
            ensure!(stack == ram.end, "the stack starts at {stack:#x}, RAM ends at {:#x}", ram.end);
        }
    }
    Ok(Footprint {
        flash: Use { used: flash_used, of: flash.end - flash.start },
        ram: Use { used: ram_used, of: ram.end - ram.start },
        ccm: ccm.map(|ccm| Use { used: ccm_used, of: ccm.end - ccm.start }),
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
    fn a_region_is_read_whatever_its_units() {
        let map = "/* FLASH : no */\nMEMORY\n{\n FLASH (rx) : ORIGIN = 0x08000000, LENGTH = 116K\n \
                   RAM : ORIGIN = 0x20000000, LENGTH = 0x5800\n}";
        assert_eq!(region(map, "FLASH"), Some(0x0800_0000..0x0801_d000));
        assert_eq!(region(map, "RAM"), Some(0x2000_0000..0x2000_5800));
        assert_eq!(region(map, "CCMRAM"), None);
    }

    #[test]
    fn the_products_map_leaves_the_last_twelve_kilobytes_to_what_survives_power_off() {
        let map = std::fs::read_to_string(crate::run::root().join("memory.x")).unwrap();
        let [flash, calibration, settings] =
            ["FLASH", "CALIBRATION", "SETTINGS"].map(|name| region(&map, name).unwrap());
        assert_eq!((flash.end, calibration.end), (calibration.start, settings.start));
        assert_eq!(settings.end - flash.start, 128 << 10);
    }

    #[test]
    fn a_firmware_outside_its_boards_map_is_refused() {
        let board = 0x0..0x40_0000;
        assert!(inside(&(0x100..0x200), &board).is_ok());
        assert!(inside(&(0x0800_0000..0x0800_0100), &board).is_err());
    }
}

//! Machine code of a firmware: its functions, their calls and the stack of each.
//!
//! The decoder knows only the calls and stack frames that Thumb-2 compilers emit (ARMv7-M ARM,
//! A7.7). It skips every other instruction by its length.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};

/// A function of the image.
#[derive(Debug)]
pub struct Function {
    /// Demangled name without the hash.
    pub name: String,
    /// Address and target of each call. A jump out of the function counts as a call.
    pub calls: Vec<(u32, u32)>,
    /// Address and register of each call through a register.
    pub indirect: Vec<(u32, u8)>,
    /// Register and value of each constant load, because a function called several times is loaded
    /// so.
    pub constants: Vec<(u8, u32)>,
    /// Most stack in bytes that the function itself takes.
    pub frame: u32,
    /// Address just after the function.
    pub end: u32,
}

/// Functions and handlers of a firmware.
#[derive(Debug)]
pub struct Image {
    /// Functions by address.
    pub functions: BTreeMap<u32, Function>,
    /// Addresses of the exception and interrupt handlers in the vector table.
    pub handlers: Vec<u32>,
}

/// Bytes that the processor stacks at an interrupt (ARMv7-M ARM, B1.5.7).
///
/// They are 26 words with floating point, and the alignment.
pub const EXCEPTION_FRAME: u32 = 27 * 4;

impl Image {
    /// Reads the firmware in `elf`.
    pub fn read(elf: &Path) -> Result<Self> {
        let bytes = std::fs::read(elf).with_context(|| format!("reading {}", elf.display()))?;
        Self::parse(&bytes).with_context(|| elf.display().to_string())
    }

    fn parse(bytes: &[u8]) -> Result<Self> {
        let file = object::File::parse(bytes)?;
        let mut functions = BTreeMap::new();
        for section in file.sections().filter(|section| section.kind() == SectionKind::Text) {
            let (start, code) = (section.address() as u32, section.data()?);
            // The symbols `$t` and `$d` mark where code and constants begin.
            let marks: BTreeMap<u32, bool> = file
                .symbols()
                .filter(|symbol| symbol.section_index() == Some(section.index()))
                .filter_map(|symbol| {
                    let name = symbol.name().ok()?;
                    let is = |mark| name == mark || name.starts_with(&format!("{mark}."));
                    (is("$t") || is("$d")).then(|| (symbol.address() as u32, is("$t")))
                })
                .collect();
            for symbol in file.symbols() {
                let inside = symbol.section_index() == Some(section.index());
                if !inside || symbol.kind() != SymbolKind::Text || symbol.size() == 0 {
                    continue;
                }
                let address = symbol.address() as u32 & !1;
                let end = address + symbol.size() as u32;
                let name = format!("{:#}", rustc_demangle::demangle(symbol.name()?));
                let (calls, indirect, constants) = (vec![], vec![], vec![]);
                let mut function = Function { name, calls, indirect, constants, frame: 0, end };
                let mut at = address;
                while at < end {
                    if marks.range(..=at).next_back().is_some_and(|(_, code)| !code) {
                        at += 2;
                        continue;
                    }
                    let half = |at: u32| -> Option<u16> {
                        let place = (at - start) as usize;
                        Some(u16::from_le_bytes(*code.get(place..)?.first_chunk()?))
                    };
                    let first =
                        half(at).ok_or_else(|| anyhow!("{} is cut short", function.name))?;
                    let second = if is_long(first) { half(at + 2) } else { None };
                    function.take(address, at, first, second)?;
                    let constant = loaded(at, first, second).and_then(|(register, place)| {
                        let bytes =
                            code.get(place.checked_sub(start)? as usize..)?.first_chunk()?;
                        Some((register, u32::from_le_bytes(*bytes)))
                    });
                    function.constants.extend(constant);
                    at += if second.is_some() { 4 } else { 2 };
                }
                functions.insert(address, function);
            }
        }
        resolve_thunks(&file, &mut functions)?;
        let handlers = handlers(&file, &functions)?;
        Ok(Self { functions, handlers })
    }

    /// Returns the function that holds `address`.
    pub fn at(&self, address: u32) -> Option<&Function> {
        let (_, function) = self.functions.range(..=address).next_back()?;
        (address < function.end).then_some(function)
    }
}

impl Function {
    fn take(&mut self, start: u32, at: u32, first: u16, second: Option<u16>) -> Result<()> {
        if let Some(target) = target(at, first, second)
            && !(start..self.end).contains(&target)
        {
            self.calls.push((at, target));
        }
        if is_indirect(first) {
            self.indirect.push((at, (first >> 3 & 0xF) as u8));
        }
        match stack_bytes(first, second) {
            Some(bytes) => self.frame += bytes,
            None => bail!("{} takes an amount of stack that only a register holds", self.name),
        }
        Ok(())
    }
}

fn is_long(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// Register and address of a PC-relative LDR.
fn loaded(at: u32, first: u16, second: Option<u16>) -> Option<(u8, u32)> {
    let pc = at.wrapping_add(4) & !3;
    match (first, second) {
        (0x4800..=0x4FFF, None) => Some(((first >> 8 & 7) as u8, pc + 4 * u32::from(first & 0xFF))),
        (0xF8DF, Some(two)) => Some(((two >> 12) as u8, pc + u32::from(two & 0xFFF))),
        (0xF85F, Some(two)) => Some(((two >> 12) as u8, pc.wrapping_sub(u32::from(two & 0xFFF)))),
        _ => None,
    }
}

/// True for BLX with a register, and for BX with any but the link register.
fn is_indirect(first: u16) -> bool {
    first & 0xFF87 == 0x4780 || (first & 0xFF87 == 0x4700 && first != 0x4770)
}

/// Returns the target of a branch or call.
fn target(at: u32, first: u16, second: Option<u16>) -> Option<u32> {
    let (one, pc) = (u32::from(first), at.wrapping_add(4));
    let signed = |value: u32, bits: u32| (value << (32 - bits)).cast_signed() >> (32 - bits);
    let offset = match second.map(u32::from) {
        Some(two) if one >> 11 == 0b11110 && two & 0x8000 != 0 => {
            let (s, j1, j2) = (one >> 10 & 1, two >> 13 & 1, two >> 11 & 1);
            let low = (two & 0x7FF) << 1;
            match two >> 12 & 0b101 {
                // BL, B
                0b101 | 0b001 => {
                    let (i1, i2) = (1 ^ j1 ^ s, 1 ^ j2 ^ s);
                    let high = s << 24 | i1 << 23 | i2 << 22 | (one & 0x3FF) << 12;
                    signed(high | low, 25)
                }
                // B with a condition; the two highest are other instructions
                0b000 if one >> 7 & 0b111 != 0b111 => {
                    signed(s << 20 | j2 << 19 | j1 << 18 | (one & 0x3F) << 12 | low, 21)
                }
                _ => return None,
            }
        }
        Some(_) => return None,
        None if one >> 11 == 0b11100 => signed((one & 0x7FF) << 1, 12),
        None if one >> 12 == 0b1101 && one >> 9 & 0b111 != 0b111 => signed((one & 0xFF) << 1, 9),
        None => return None,
    };
    Some(pc.wrapping_add_signed(offset))
}

/// Stack in bytes that an instruction takes; `None` where a register decides.
fn stack_bytes(first: u16, second: Option<u16>) -> Option<u32> {
    let (one, two) = (u32::from(first), second.map(u32::from));
    let to_sp = |two: u32| two >> 8 & 0xF == 13;
    Some(match (one, two) {
        // PUSH; SUB SP
        (0xB400..=0xB5FF, None) => 4 * (one & 0x1FF).count_ones(),
        (0xB080..=0xB0FF, None) => 4 * (one & 0x7F),
        // STMDB SP!; STR [SP, #-n]!; STRD [SP, #-n]!; VPUSH
        (0xE92D, Some(two)) => 4 * two.count_ones(),
        (0xF84D, Some(two)) if two & 0xF00 == 0xD00 => two & 0xFF,
        (0xE96D, Some(two)) => 4 * (two & 0xFF),
        (0xED2D | 0xED6D, Some(two)) => 4 * (two & 0xFF),
        // SUB.W SP, SP, #constant; SUBW SP, SP, #12 bits; SUB SP, SP, register
        (0xF1AD | 0xF5AD, Some(two)) if to_sp(two) => expand(one >> 10 & 1, two),
        (0xF2AD | 0xF6AD, Some(two)) if to_sp(two) => {
            (one >> 10 & 1) << 11 | (two >> 12 & 7) << 8 | two & 0xFF
        }
        (0xEBAD, Some(two)) if to_sp(two) => return None,
        _ => 0,
    })
}

/// Expands a modified immediate constant: ThumbExpandImm (ARMv7-M ARM, A5.3.2).
fn expand(i: u32, two: u32) -> u32 {
    let (code, byte) = (i << 4 | (two >> 12 & 7) << 1 | two >> 7 & 1, two & 0xFF);
    match code {
        0 | 1 => byte,
        2 | 3 => byte << 16 | byte,
        4 | 5 => byte << 24 | byte << 8,
        6 | 7 => byte * 0x0101_0101,
        _ => (0x80 | byte & 0x7F).rotate_right(code),
    }
}

/// Gives each linker thunk the name and the call of the function that it jumps to.
fn resolve_thunks(file: &object::File, functions: &mut BTreeMap<u32, Function>) -> Result<()> {
    const PREFIX: &str = "__Thumbv7ABSLongThunk_";
    for thunk in file.symbols() {
        let Some(name) = thunk.name()?.strip_prefix(PREFIX) else { continue };
        let target = file
            .symbols()
            .find(|symbol| symbol.name() == Ok(name))
            .with_context(|| format!("a thunk to {name}, which is not there"))?;
        let (from, to) = (thunk.address() as u32 & !1, target.address() as u32 & !1);
        if let Some(function) = functions.get_mut(&from) {
            function.indirect.clear();
            function.calls.push((from, to));
            function.name = format!("{:#}", rustc_demangle::demangle(name));
        }
    }
    Ok(())
}

fn handlers(file: &object::File, functions: &BTreeMap<u32, Function>) -> Result<Vec<u32>> {
    let section = file.section_by_name(".vector_table").context("no vector table")?;
    let words = section.data()?.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word));
    // The first two words are the stack's start and the reset.
    let mut handlers: Vec<_> =
        words.skip(2).map(|word| word & !1).filter(|word| functions.contains_key(word)).collect();
    handlers.sort_unstable();
    handlers.dedup();
    Ok(handlers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn branch_targets_match_assembler() {
        // bl .+4+0x1000 at 0x100; bl backwards by 4; b.w; b; beq
        assert_eq!(target(0x100, 0xF001, Some(0xF800)), Some(0x1104));
        assert_eq!(target(0x100, 0xF7FF, Some(0xFFFE)), Some(0x100));
        assert_eq!(target(0x100, 0xF000, Some(0xB802)), Some(0x108));
        assert_eq!(target(0x100, 0xE7FE, None), Some(0x100));
        assert_eq!(target(0x100, 0xD001, None), Some(0x106));
        // udf and svc look like conditional branches
        assert_eq!(target(0x100, 0xDE00, None), None);
        assert_eq!(target(0x100, 0xDF00, None), None);
    }

    #[test]
    fn stack_of_each_instruction_is_counted() {
        // push {r4-r7, lr}; sub sp, #24; push.w {r4-r11, lr}; vpush {d8-d15}
        assert_eq!(stack_bytes(0xB5F0, None), Some(20));
        assert_eq!(stack_bytes(0xB086, None), Some(24));
        assert_eq!(stack_bytes(0xE92D, Some(0x4FF0)), Some(36));
        assert_eq!(stack_bytes(0xED2D, Some(0x8B10)), Some(64));
        // str r8, [sp, #-4]!; sub.w sp, sp, #1024; subw sp, sp, #1004
        assert_eq!(stack_bytes(0xF84D, Some(0x8D04)), Some(4));
        assert_eq!(stack_bytes(0xF5AD, Some(0x6D80)), Some(1024));
        assert_eq!(stack_bytes(0xF2AD, Some(0x3DEC)), Some(1004));
        // add sp, #24; sub sp, sp, r4
        assert_eq!(stack_bytes(0xB006, None), Some(0));
        assert_eq!(stack_bytes(0xEBAD, Some(0x0D04)), None);
    }
}

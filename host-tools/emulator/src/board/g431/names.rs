//! Names of registers and peripherals, from the manufacturer's register descriptions.
//!
//! The firmware's register access is generated from the same descriptions.

use std::collections::HashMap;

use stm32_metapac::metadata::ir::{Array, BitOffset, BlockItemInner, IR};
use stm32_metapac::metadata::{METADATA, Peripheral};

/// Bits of an address within a page; an address without a register belongs to its page's
/// peripheral.
const PAGE_BITS: u32 = 8;

/// Names of registers, and their peripherals.
pub struct Names {
    registers: HashMap<u32, (String, &'static Peripheral)>,
    pages: HashMap<u32, &'static Peripheral>,
}

impl Default for Names {
    /// Names of the STM32G431CB.
    fn default() -> Self {
        let mut names = Self { registers: HashMap::new(), pages: HashMap::new() };
        for peripheral in METADATA.peripherals {
            names.pages.entry(peripheral.address as u32 >> PAGE_BITS).or_insert(peripheral);
            let Some(registers) = &peripheral.registers else { continue };
            let mut found = Vec::new();
            walk(registers.ir, registers.block, 0, "", &mut found);
            for (offset, name) in found {
                let address = peripheral.address as u32 + offset;
                names.pages.entry(address >> PAGE_BITS).or_insert(peripheral);
                let name = format!("{}.{}", peripheral.name, name.to_uppercase());
                names.registers.insert(address, (name, peripheral));
            }
        }
        names
    }
}

impl Names {
    /// Peripheral of the register at an address, or of its page.
    pub fn peripheral(&self, address: u32) -> Option<&'static Peripheral> {
        let register = self.registers.get(&(address & !3)).map(|(_, peripheral)| *peripheral);
        register.or_else(|| self.pages.get(&(address >> PAGE_BITS)).copied())
    }

    /// Readable name of a register.
    pub fn register(&self, address: u32) -> String {
        let name = self.registers.get(&(address & !3)).or_else(|| self.registers.get(&address));
        match (name, self.peripheral(address)) {
            (Some((name, _)), _) => format!("{name} ({address:#010x})"),
            (None, Some(peripheral)) => {
                let offset = address - peripheral.address as u32;
                format!("{} + {offset:#x} ({address:#010x})", peripheral.name)
            }
            (None, None) => format!("{address:#010x}"),
        }
    }
}

/// Collects all registers of a block, with those of blocks in it.
fn walk(ir: &IR, block: &str, base: u32, prefix: &str, found: &mut Vec<(u32, String)>) {
    let Some(block) = ir.blocks.iter().find(|candidate| same(candidate.name, block)) else {
        return;
    };
    if let Some(extends) = block.extends {
        walk(ir, extends, base, prefix, found);
    }
    for item in block.items {
        let places: Vec<u32> = match &item.array {
            None => vec![0],
            Some(Array::Regular(array)) => (0..array.len).map(|i| i * array.stride).collect(),
            Some(Array::Cursed(array)) => array.offsets.to_vec(),
        };
        for (i, place) in places.iter().enumerate() {
            let index = if places.len() > 1 { format!("[{i}]") } else { String::new() };
            let name = format!("{prefix}{}{index}", item.name);
            let offset = base + item.byte_offset + place;
            match &item.inner {
                BlockItemInner::Register(_) => found.push((offset, name)),
                BlockItemInner::Block(inner) => {
                    walk(ir, inner.block, offset, &format!("{name}."), found);
                }
            }
        }
    }
}

/// Whether two names agree without case and underscores, which the descriptions use inconsistently.
fn same(name: &str, wanted: &str) -> bool {
    let plain = |name: &str| name.replace('_', "").to_lowercase();
    plain(name) == plain(wanted)
}

/// Peripheral of this name.
///
/// # Panics
/// If the chip has no peripheral of that name, which is a mistake of this program.
pub fn peripheral(name: &str) -> &'static Peripheral {
    METADATA
        .peripherals
        .iter()
        .find(|peripheral| peripheral.name == name)
        .unwrap_or_else(|| panic!("{} has no {name}", METADATA.name))
}

/// First address of a peripheral.
pub fn base(name: &str) -> u32 {
    peripheral(name).address as u32
}

/// Number of an interrupt.
///
/// # Panics
/// As [`peripheral`].
pub fn interrupt(name: &str) -> usize {
    METADATA
        .interrupts
        .iter()
        .find(|interrupt| interrupt.name == name)
        .unwrap_or_else(|| panic!("{} has no interrupt {name}", METADATA.name))
        .number as usize
}

/// Offset of a register in its peripheral, and first bit of one of its fields.
///
/// # Panics
/// As [`peripheral`].
pub fn field(of: &str, register: &str, field: &str) -> (u32, u32) {
    let ir = peripheral(of).registers.as_ref().map(|registers| registers.ir);
    let found = ir.and_then(|ir| {
        let item = ir
            .blocks
            .iter()
            .flat_map(|block| block.items)
            .find(|item| same(item.name, register))?;
        let BlockItemInner::Register(inner) = &item.inner else { return None };
        let set = ir.fieldsets.iter().find(|set| Some(set.name) == inner.fieldset)?;
        let field = set.fields.iter().find(|candidate| same(candidate.name, field))?;
        let BitOffset::Regular(at) = &field.bit_offset else { return None };
        Some((item.byte_offset, at.offset))
    });
    found.unwrap_or_else(|| panic!("{of} has no {register}.{field}"))
}

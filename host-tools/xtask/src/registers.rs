//! `cargo xtask registers`: writes the register table of the emulated chips.
//!
//! The table is `host-tools/emulator/data/registers.csv`. Its source are the crates `stm32g4` and
//! `stm32f4`, which are generated from the manufacturer's SVD files. The firmware's register access
//! is generated from other descriptions, so that neither hides a mistake of the other. The crates
//! are read and not compiled, because compiling takes a minute.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::changes::packages;
use crate::run::{program, root};

/// Emulated chips: board, crate, module of the crate, and peripherals of interest.
const CHIPS: [(&str, &str, &str, &str); 2] = [
    (
        "stm32g431",
        "stm32g4",
        "stm32g431",
        "RCC FLASH GPIOA GPIOB GPIOC GPIOD GPIOE GPIOF TIM1 TIM2 DMA1 DMAMUX ADC1 ADC2 \
         ADC12_COMMON OPAMP IWDG CRC USB PWR SYSCFG EXTI CRS DBGMCU",
    ),
    (
        "stm32f411",
        "stm32f4",
        "stm32f411",
        "RCC FLASH GPIOA GPIOB GPIOC GPIOD GPIOE GPIOH TIM1 TIM2 DMA2 ADC1 ADC_COMMON \
         IWDG CRC OTG_FS_GLOBAL OTG_FS_DEVICE OTG_FS_PWRCLK PWR SYSCFG EXTI DBGMCU",
    ),
];

/// Register of the table.
#[derive(Debug, Default, PartialEq, Eq)]
struct Register {
    names: Vec<String>,
    reset: u32,
    /// Bits of all fields, and those that can be written.
    fields: u32,
    writable: u32,
}

/// Writes the table; with `check`, fails if it differs and writes nothing.
pub fn task(check: bool) -> Result<()> {
    let emulator = root().join("host-tools/emulator");
    let packages = packages(program("cargo", &emulator).arg("metadata").arg("--locked"))?;
    let mut text = "board,address,register,reset,fields,writable\n".to_owned();
    for (board, name, module, peripherals) in CHIPS {
        let package = packages.iter().find(|(package, _)| package == name);
        let (_, folder) =
            package.with_context(|| format!("{}: does not name {name}", emulator.display()))?;
        for (address, register) in registers(&folder.join("src").join(module), peripherals)? {
            let Register { names, reset, fields, writable } = register;
            let names = names.join(" ");
            writeln!(text, "{board},{address:#010x},{names},{reset:#x},{fields:#x},{writable:#x}")?;
        }
    }
    let path = emulator.join("data/registers.csv");
    if !check {
        return std::fs::write(&path, text).with_context(|| path.display().to_string());
    }
    if std::fs::read_to_string(&path).ok().as_deref() != Some(&text) {
        bail!("{} differs from its crates; run `cargo xtask registers`", path.display());
    }
    Ok(())
}

/// Registers of a chip by address.
fn registers(module: &Path, peripherals: &str) -> Result<BTreeMap<u32, Register>> {
    let types = read(&module.join("mod.rs"))?;
    let mut found = BTreeMap::new();
    for peripheral in peripherals.split(' ') {
        let begin = format!("pub type {peripheral} = crate::Periph<");
        let line = types.lines().find_map(|line| line.strip_prefix(&begin));
        let line = line.with_context(|| format!("{}: has no {peripheral}", module.display()))?;
        let (block, base) = line.split_once("::RegisterBlock, ").context("no address")?;
        let base = number(base.trim_end_matches(">;"))?;
        let alias = types.lines().find_map(|line| {
            line.strip_prefix("pub use self::")?.strip_suffix(&format!(" as {block};"))
        });
        let block = module.join(alias.unwrap_or(block));
        collect(&block, "impl RegisterBlock {", base, peripheral, &mut found)?;
    }
    Ok(found)
}

/// Collects the registers that the accessors in `block`.rs name.
fn collect(
    block: &Path,
    from: &str,
    base: u32,
    prefix: &str,
    found: &mut BTreeMap<u32, Register>,
) -> Result<()> {
    let text = read(&block.with_extension("rs"))?;
    let accessors = text.split_once(from).context("no accessors")?.1;
    let accessors = accessors.split_once("\n}").context("no end of the accessors")?.0;
    let (mut offset, mut end) = (None, None);
    for line in accessors.lines().map(str::trim) {
        if let Some(place) = line.strip_prefix("///0x") {
            let stop = place.find(|c: char| !c.is_ascii_hexdigit()).unwrap_or(place.len());
            offset = Some(u32::from_str_radix(&place[..stop], 16)?);
            let behind =
                place[stop..].strip_prefix("..0x").and_then(|place| place.split(' ').next());
            end = behind.map(|end| u32::from_str_radix(end, 16)).transpose()?;
        }
        let Some((name, kind)) =
            line.strip_prefix("pub const fn ").and_then(|line| line.split_once("(&self"))
        else {
            continue;
        };
        let (name, offset) = (name.to_uppercase(), offset.context("no offset")?);
        let places = match kind.strip_prefix(", n: usize") {
            None => vec![(name, base + offset)],
            // One accessor may stand for each place of an array; else there is only this one.
            Some(kind) if accessors.contains(&format!("(&self{kind}")) => continue,
            Some(_) => {
                let array = format!("    {}: [", name.to_lowercase());
                let count = text.split_once(&array).and_then(|(_, rest)| rest.split_once("; "));
                let count = count.and_then(|(_, rest)| rest.split_once(']'));
                let count: u32 = count.context("no length of an array")?.0.parse()?;
                let stride = (end.context("no end of an array")? - offset) / count;
                (0..count).map(|i| (format!("{name}{i}"), base + offset + i * stride)).collect()
            }
        };
        let kind = kind.rsplit('&').next().unwrap_or_default().trim_end_matches(" {");
        for (name, address) in places {
            let file = described(block, &text, &kind.to_lowercase());
            let description = read(&file)?;
            let name = format!("{prefix}.{name}");
            if description.contains("impl crate::RegisterSpec for") {
                let register = found.entry(address).or_default();
                add(register, &description).with_context(|| file.display().to_string())?;
                register.names.push(name);
            } else {
                let from = format!("impl {kind} {{");
                collect(&block.join(kind.to_lowercase()), &from, address, &name, found)?;
            }
        }
    }
    Ok(())
}

/// File that describes a register of a block, whose text may name another one for it.
fn described(block: &Path, text: &str, kind: &str) -> PathBuf {
    let uses = || text.lines().filter_map(|line| line.strip_prefix("pub use ")?.strip_suffix(';'));
    // A register like another one is named after it, perhaps in another peripheral.
    let same = format!(" as {kind}");
    if let Some(other) = uses().find_map(|used| used.strip_suffix(&same)) {
        return block.join(other).with_extension("rs");
    }
    let same = format!("::{kind}");
    let other = uses().find_map(|used| used.strip_prefix("crate::")?.strip_suffix(&same));
    match other.and_then(|path| path.rsplit_once("::")) {
        Some((_, other)) => block.with_file_name(other).join(kind).with_extension("rs"),
        None => block.join(kind).with_extension("rs"),
    }
}

/// Adds a description of a register; two may share an address.
fn add(register: &mut Register, description: &str) -> Result<()> {
    let part = |begin: &str| {
        let part = description.split_once(begin)?.1;
        part.split_once("\n}").map(|(part, _)| part)
    };
    for (begin, writes) in [("\nimpl R {", false), ("\nimpl W {", true)] {
        let places = part(begin).unwrap_or_default().lines().filter_map(|line| {
            let line = line.trim();
            let place = line.strip_prefix("///Bits ").or_else(|| line.strip_prefix("///Bit "))?;
            place.split(' ').next()
        });
        for place in places {
            let (low, high) = place.split_once(':').unwrap_or((place, place));
            let (low, high): (u32, u32) = (low.parse()?, high.parse()?);
            let bits = u32::MAX >> (31 - high) & u32::MAX << low;
            register.fields |= bits;
            register.writable |= if writes { bits } else { 0 };
        }
    }
    if let Some((_, reset)) = description.split_once("const RESET_VALUE: u32 = ") {
        register.reset = number(reset.split(';').next().unwrap_or_default())?;
    }
    Ok(())
}

fn number(text: &str) -> Result<u32> {
    let text = text.replace('_', "");
    Ok(match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16)?,
        None => text.parse()?,
    })
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}

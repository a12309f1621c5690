//! Registers as the manufacturer's SVD files describe them, from the sources of a crate made of
//! them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::{number, read};

/// Registers that share an address.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Register {
    pub names: Vec<String>,
    pub reset: u32,
    /// Bits of all fields, and those that can be written.
    pub fields: u32,
    pub writable: u32,
    /// Bits of each field by its name.
    pub named: BTreeMap<String, u32>,
}

/// Returns the registers of the named peripherals of a chip, by address.
pub fn registers(module: &Path, peripherals: &str) -> Result<BTreeMap<u32, Register>> {
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
        let mut bits = None;
        for line in part(begin).unwrap_or_default().lines().map(str::trim) {
            let place = line.strip_prefix("///Bits ").or_else(|| line.strip_prefix("///Bit "));
            if let Some(place) = place {
                let place = place.split(' ').next().unwrap_or_default();
                let (low, high) = place.split_once(':').unwrap_or((place, place));
                let (low, high): (u32, u32) = (low.parse()?, high.parse()?);
                bits = Some(u32::MAX >> (31 - high) & u32::MAX << low);
            }
            if line.starts_with("pub ")
                && let Some(bits) = bits.take()
            {
                register.fields |= bits;
                register.writable |= if writes { bits } else { 0 };
                let name = line.split_once("fn ").and_then(|(_, line)| line.split_once('('));
                let (name, _) = name.context("no name of a field")?;
                let name = name.trim_start_matches("r#").to_owned();
                *register.named.entry(name).or_default() |= bits;
            }
        }
    }
    if let Some((_, reset)) = description.split_once("const RESET_VALUE: u32 = ") {
        register.reset = number(reset.split(';').next().unwrap_or_default())?;
    }
    Ok(())
}

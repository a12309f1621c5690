//! Registers as `stm32-metapac` describes them, from which the firmware's register access is made.
//!
//! The crate's sources hold the descriptions as Rust literals, which are read as JSON.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::Deserialize;
use serde_json::Value;

use super::read;

/// Registers of an address: name, and bits of each field; no fields if it has no description.
pub type Registers = BTreeMap<u32, BTreeMap<String, BTreeMap<String, u32>>>;

/// Returns the registers of a chip; `source` is the crate's folder `src`.
pub fn registers(source: &Path, chip: &str) -> Result<Registers> {
    let path = source.join("chips").join(chip).join("metadata.rs");
    let text = read(&path)?;
    let include = text.split_once("include!(\"../").and_then(|(_, rest)| rest.split_once('"'));
    let (include, _) = include.with_context(|| format!("{}: no include", path.display()))?;
    let path = source.join("chips").join(include);
    let text = read(&path)?;
    let peripherals: Vec<Peripheral> = literal(&text, "PERIPHERALS: &[Peripheral] =")
        .with_context(|| path.display().to_string())?;
    let mut descriptions = HashMap::new();
    let mut found = Registers::new();
    for Peripheral { name, address, registers } in peripherals {
        let Some(Source { block, ir }) = registers else { continue };
        let module = ir.split("::").next().unwrap_or_default().to_owned();
        if !descriptions.contains_key(&module) {
            let path = source.join("registers").join(file(&text, &module)?);
            let description: Description = literal(&read(&path)?, "REGISTERS: IR =")
                .with_context(|| path.display().to_string())?;
            descriptions.insert(module.clone(), description);
        }
        descriptions[&module].collect(&block, address, &format!("{name}."), &mut found);
    }
    Ok(found)
}

/// File of a module, which the line before its declaration names.
fn file<'t>(text: &'t str, module: &str) -> Result<&'t str> {
    let declaration = format!("\npub mod {module};");
    let before = text.split_once(&declaration).map(|(before, _)| before);
    let name = before.and_then(|before| before.rsplit_once("\"../registers/"));
    let name = name.and_then(|(_, name)| name.strip_suffix("\"]"));
    name.with_context(|| format!("no file of the module {module}"))
}

#[derive(Deserialize)]
struct Peripheral {
    name: String,
    address: u32,
    registers: Option<Source>,
}

/// Name of a peripheral's block, and path of the description that holds it.
#[derive(Deserialize)]
struct Source {
    block: String,
    ir: String,
}

#[derive(Deserialize)]
struct Description {
    blocks: Vec<Block>,
    fieldsets: Vec<FieldSet>,
}

#[derive(Deserialize)]
struct Block {
    name: String,
    extends: Option<String>,
    items: Vec<Item>,
}

#[derive(Deserialize)]
struct Item {
    name: String,
    array: Option<Array>,
    byte_offset: u32,
    inner: Inner,
}

#[derive(Deserialize)]
enum Inner {
    Block { block: String },
    Register { fieldset: Option<String> },
}

#[derive(Deserialize)]
enum Array {
    Regular { len: u32, stride: u32 },
    Cursed { offsets: Vec<u32> },
}

#[derive(Deserialize)]
struct FieldSet {
    name: String,
    extends: Option<String>,
    fields: Vec<Field>,
}

#[derive(Deserialize)]
struct Field {
    name: String,
    bit_offset: BitOffset,
    bit_size: u32,
    array: Option<Array>,
}

#[derive(Deserialize)]
enum BitOffset {
    Regular { offset: u32 },
    Cursed { ranges: Vec<[u32; 2]> },
}

/// Names with their distances from the first: one, or those of an array.
///
/// An index counts from zero, where the SVD files mostly count from one, so that no name of a field
/// of an array is one of theirs.
fn places(name: &str, array: Option<&Array>) -> Vec<(String, u32)> {
    let distances: Vec<u32> = match array {
        None => return vec![(name.to_owned(), 0)],
        Some(Array::Regular { len, stride }) => (0..*len).map(|i| i * stride).collect(),
        Some(Array::Cursed { offsets }) => offsets.clone(),
    };
    let named = distances.into_iter().enumerate().map(|(i, at)| (format!("{name}[{i}]"), at));
    named.collect()
}

/// Whether two names agree without case and underscores, which the descriptions use inconsistently.
fn same(name: &str, wanted: &str) -> bool {
    let plain = |name: &str| name.replace('_', "").to_lowercase();
    plain(name) == plain(wanted)
}

impl Description {
    /// Collects the registers of a block, those that it extends first.
    fn collect(&self, block: &str, base: u32, prefix: &str, found: &mut Registers) {
        let Some(block) = self.blocks.iter().find(|one| same(&one.name, block)) else { return };
        if let Some(extends) = &block.extends {
            self.collect(extends, base, prefix, found);
        }
        for Item { name, array, byte_offset, inner } in &block.items {
            for (name, place) in places(name, array.as_ref()) {
                let address = base + byte_offset + place;
                let name = format!("{prefix}{}", name.to_uppercase());
                match inner {
                    Inner::Block { block } => {
                        self.collect(block, address, &format!("{name}."), found);
                    }
                    Inner::Register { fieldset } => {
                        let mut fields = BTreeMap::new();
                        self.fields(fieldset.as_deref(), &mut fields);
                        found.entry(address).or_default().insert(name, fields);
                    }
                }
            }
        }
    }

    /// Collects the fields of a set, those that it extends first.
    fn fields(&self, set: Option<&str>, found: &mut BTreeMap<String, u32>) {
        let Some(set) = self.fieldsets.iter().find(|one| Some(one.name.as_str()) == set) else {
            return;
        };
        self.fields(set.extends.as_deref(), found);
        for Field { name, bit_offset, bit_size, array } in &set.fields {
            let ones = |low: u32, count: u32| ((1u64 << count) - 1) << low;
            let bits = match bit_offset {
                BitOffset::Regular { offset } => ones(*offset, *bit_size),
                BitOffset::Cursed { ranges } => {
                    ranges.iter().map(|[low, high]| ones(*low, high - low + 1)).sum()
                }
            };
            for (name, place) in places(name, array.as_ref()) {
                found.insert(name, (bits << place) as u32);
            }
        }
    }
}

/// Reads the literal behind `begin` in Rust source text.
fn literal<T: serde::de::DeserializeOwned>(text: &str, begin: &str) -> Result<T> {
    let (_, text) = text.split_once(begin).with_context(|| format!("no `{begin}`"))?;
    Ok(serde_json::from_value(Literal(text).value()?)?)
}

/// Rest of a text of Rust literals.
struct Literal<'t>(&'t str);

impl<'t> Literal<'t> {
    fn eat(&mut self, token: &str) -> bool {
        self.0 = self.0.trim_start();
        let rest = self.0.strip_prefix(token);
        self.0 = rest.unwrap_or(self.0);
        rest.is_some()
    }

    fn expect(&mut self, token: &str) -> Result<()> {
        ensure!(self.eat(token), "no `{token}` at `{}`", self.0.lines().next().unwrap_or_default());
        Ok(())
    }

    /// Number, or path of a type, a variant or a static.
    fn word(&mut self) -> Result<&'t str> {
        self.0 = self.0.trim_start();
        let part = |text: &str| text.find(|c: char| !c.is_alphanumeric() && c != '_');
        let mut end = part(self.0).unwrap_or(self.0.len());
        while let Some(rest) = self.0[end..].strip_prefix("::") {
            end += 2 + part(rest).unwrap_or(rest.len());
        }
        ensure!(end > 0, "no value at `{}`", self.0.lines().next().unwrap_or_default());
        let (word, rest) = self.0.split_at(end);
        self.0 = rest;
        Ok(word)
    }

    fn text(&mut self) -> Result<Value> {
        let mut escaped = false;
        let end = self.0.find(|c| {
            let ends = c == '"' && !escaped;
            escaped = c == '\\' && !escaped;
            ends
        });
        let (text, rest) = self.0.split_at(end.context("a text without end")?);
        self.0 = &rest[1..];
        Ok(text.into())
    }

    /// Value as JSON: `Some` as its contents, other variants as objects, ranges as pairs.
    fn value(&mut self) -> Result<Value> {
        if self.eat("&") {
            return self.value();
        }
        if self.eat("\"") {
            return self.text();
        }
        if self.eat("[") {
            let mut values = Vec::new();
            while !self.eat("]") {
                values.push(self.value()?);
                self.eat(",");
            }
            return Ok(values.into());
        }
        let word = self.word()?;
        if word.starts_with(|c: char| c.is_ascii_digit()) {
            let first = super::number(word)?;
            if self.eat("..=") {
                return Ok([first, super::number(self.word()?)?].to_vec().into());
            }
            return Ok(first.into());
        }
        if self.eat("{") {
            let mut fields = serde_json::Map::new();
            while !self.eat("}") {
                let name = self.word()?.to_owned();
                self.expect(":")?;
                fields.insert(name, self.value()?);
                self.eat(",");
            }
            return Ok(fields.into());
        }
        let variant = word.rsplit("::").next().unwrap_or(word);
        if self.eat("(") {
            let inner = self.value()?;
            self.eat(",");
            self.expect(")")?;
            return Ok(match variant {
                "Some" => inner,
                variant => [(variant.to_owned(), inner)]
                    .into_iter()
                    .collect::<serde_json::Map<_, _>>()
                    .into(),
            });
        }
        Ok(if word == "None" { Value::Null } else { word.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Description in the crate's form: a register, and an array of two with the same fields.
    const TEXT: &str = r#"static REGISTERS: IR = IR {
        blocks: &[
            Block { name: "Base", extends: None, description: Some("A \"base\""), items: &[
                BlockItem { name: "cr", description: None, array: None, byte_offset: 0x4,
                    inner: BlockItemInner::Register(Register {
                        access: Access::ReadWrite, bit_size: 32, fieldset: Some("Cr"),
                    }),
                },
            ] },
            Block { name: "Top", extends: Some("Base"), description: None, items: &[
                BlockItem { name: "ch", description: None, byte_offset: 0x10,
                    array: Some(Array::Regular(RegularArray { len: 2, stride: 8 })),
                    inner: BlockItemInner::Block(BlockItemBlock { block: "Base" }),
                },
            ] },
        ],
        fieldsets: &[
            FieldSet { name: "Cr", extends: None, description: None, bit_size: 32, fields: &[
                Field { name: "mode", description: None, bit_size: 4, array: None, enumm: None,
                    bit_offset: BitOffset::Cursed(CursedBitOffset { ranges: &[0..=2, 16..=16,] }),
                },
                Field { name: "on", description: None, bit_size: 1, enumm: None,
                    array: Some(Array::Cursed(CursedArray { offsets: &[0, 5] })),
                    bit_offset: BitOffset::Regular(RegularBitOffset { offset: 8 }),
                },
            ] },
        ],
        enums: &[],
    };"#;

    #[test]
    fn description_gives_registers_with_their_fields() {
        let description: Description = literal(TEXT, "REGISTERS: IR =").unwrap();
        let mut found = Registers::new();
        description.collect("TOP", 0x100, "P.", &mut found);
        let names: Vec<_> =
            found.iter().map(|(at, one)| (*at, one.keys().next().unwrap())).collect();
        assert_eq!(
            format!("{names:x?}"),
            r#"[(104, "P.CR"), (114, "P.CH[0].CR"), (11c, "P.CH[1].CR")]"#
        );
        let fields = &found[&0x104]["P.CR"];
        let expected = [("mode", 0x1_0007), ("on[0]", 1 << 8), ("on[1]", 1 << 13)];
        assert!(
            fields.iter().map(|(name, bits)| (name.as_str(), *bits)).eq(expected),
            "{fields:?}"
        );
    }

    #[test]
    fn broken_literal_names_its_place() {
        let error = literal::<Description>("REGISTERS: IR = IR { blocks = 1 }", "REGISTERS: IR =");
        assert_eq!(error.err().unwrap().to_string(), "no `:` at `= 1 }`");
    }
}

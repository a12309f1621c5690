//! `cargo xtask protocol`: generates parts of documents and clients from the frame schema.
//!
//! The schema is `src/frame/schema.rs`. A part lies between a line with `schema: NAME` and the next
//! line with `schema: end`.

mod c;
mod docs;
mod page;
mod python;

use anyhow::{Context, Result, bail};
use taxel::frame::schema::{Columns, FIELDS, Field, Type};

use crate::marks::{Part, lines, update};
use crate::run::root;

/// Writes the parts; with `check`, fails if one differs and writes nothing.
pub fn task(check: bool) -> Result<()> {
    let files = [
        ("docs/protocol.md", docs::protocol()),
        ("docs/read-the-numbers.md", docs::manual()),
        ("host-tools/python/src/taxel/messages.py", python::messages()),
        ("host-tools/python/src/taxel/table.py", python::table()),
        ("host-tools/c/taxel_frame.h", c::header()),
        ("host-tools/c/print_frames.c", c::example()),
        ("host-tools/cli/assets/page/flags.js", page::flags()),
    ];
    let mut different = Vec::new();
    for (file, parts) in files {
        if update(&root().join(file), "schema", &parts, check).with_context(|| file.to_owned())? {
            different.push(file);
        }
    }
    if check && !different.is_empty() {
        bail!(
            "{} differ from src/frame/schema.rs; run `cargo xtask protocol`",
            different.join(", ")
        );
    }
    Ok(())
}

/// Lists the names of a field's columns.
fn columns(field: &Field) -> Vec<&'static str> {
    let names = field.columns.iter().flat_map(|columns| match columns {
        Columns::Whole(names) | Columns::Real(names) | Columns::Measured(names) => {
            names.split_whitespace()
        }
    });
    names.collect()
}

/// Lists every structure of the fields, members before the structure that holds them.
fn structures() -> Vec<(&'static str, Type)> {
    fn add(layout: &Type, known: &mut Vec<(&'static str, Type)>) {
        match layout {
            Type::Named(_) | Type::F32 => {}
            Type::Result(inner) | Type::Array(inner, _) => add(inner, known),
            Type::Struct(name, _, members) => {
                members.iter().for_each(|member| add(&member.2, known));
                if known.iter().all(|(other, _)| other != name) {
                    known.push((name, *layout));
                }
            }
        }
    }
    let mut known = Vec::new();
    FIELDS.iter().for_each(|field| add(&field.layout, &mut known));
    known
}

/// Counts the numbers of a value; `None` where clients read it by hand-written code.
fn numbers(layout: &Type) -> Option<usize> {
    match layout {
        Type::Named(_) => None,
        Type::F32 => Some(1),
        Type::Result(inner) => numbers(inner),
        Type::Array(inner, length) => Some(numbers(inner)? * length),
        Type::Struct(_, _, members) => members.iter().map(|member| numbers(&member.2)).sum(),
    }
}

/// True for a value without reasons inside: its numbers come all together.
fn is_plain(layout: &Type) -> bool {
    match layout {
        Type::Named(_) | Type::Result(_) => false,
        Type::F32 => true,
        Type::Array(inner, _) => is_plain(inner),
        Type::Struct(_, _, members) => members.iter().all(|member| is_plain(&member.2)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn generated_parts_are_up_to_date() {
        task(true).unwrap();
    }

    #[test]
    fn every_number_has_a_column() {
        for field in FIELDS {
            if let Some(numbers) = numbers(&field.layout) {
                assert_eq!(columns(field).len(), numbers, "{}", field.name);
            }
        }
    }
}

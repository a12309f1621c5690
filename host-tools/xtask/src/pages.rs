//! `cargo xtask pages`: generates the parts of documents that quote committed tables.
//!
//! Sources are the CSV files of charts and research, tables of other pages, built-in scenes and
//! constants of the reference finger. No figure of these parts is written by hand.

mod bench;
mod choices;
#[cfg(test)]
mod glossary;
pub mod links;
mod measure;
mod reference;
mod spec_sheet;
mod tables;

use anyhow::{Context, Result, bail};
use clap::Args;

use crate::marks::update;
use crate::run::root;

/// Arguments of `cargo xtask pages`.
#[derive(Args)]
pub struct Pages {
    /// Writes nothing; fails where a part differs from its tables
    #[arg(long)]
    check: bool,
    /// Simulates and fits the reference finger again first, which takes some minutes
    #[arg(long)]
    simulate: bool,
}

impl Pages {
    /// Compares only.
    pub const CHECK: Self = Self { check: true, simulate: false };
    /// Compares also the tables of the reference finger, with a finger that is simulated again.
    pub const CHECK_ALL: Self = Self { check: true, simulate: true };
}

/// Writes the parts; with `check`, fails if one differs and writes nothing.
pub fn task(pages: &Pages) -> Result<()> {
    if pages.simulate {
        reference::simulate(pages.check)?;
    }
    let files = [
        ("docs/spec-sheet.md", spec_sheet::parts()?),
        ("docs/what-to-use.md", choices::parts()?),
        (bench::PAGE, bench::parts()?),
    ];
    let mut different = Vec::new();
    for (file, parts) in files {
        if update(&root().join(file), "pages", &parts, pages.check)
            .with_context(|| file.to_owned())?
        {
            different.push(file.to_owned());
        }
    }
    different.extend(bench::update(pages.check)?);
    if pages.check && !different.is_empty() {
        bail!("{} differ from their tables; run `cargo xtask pages`", different.join(", "));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn generated_parts_are_those_of_the_tables() {
        task(&Pages::CHECK).unwrap();
    }
}

//! A table of what the core's stages cost: the committed one, or one that was just counted.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

/// A stage, by the names of the table's columns.
#[derive(Deserialize)]
pub struct Stage {
    /// What it is called.
    pub name: String,
    /// The most modelled cycles that any call took, at the dearer end of the band.
    #[serde(rename = "cycles_high")]
    pub cycles: u64,
}

/// The stages of the table in a file.
pub fn read(path: &Path) -> Result<Vec<Stage>> {
    let of = || path.display().to_string();
    parse(&std::fs::read_to_string(path).with_context(of)?).with_context(of)
}

/// The stages of a table.
pub fn parse(table: &str) -> Result<Vec<Stage>> {
    let rows = csv::Reader::from_reader(table.as_bytes()).into_deserialize();
    rows.collect::<Result<_, _>>()
        .context("no table of costs; `cargo xtask cycles --csv` writes one")
}

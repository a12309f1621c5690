//! Table of the costs of the core's stages: the committed one, or one counted just now.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

/// A stage, with the names of the table's columns.
#[derive(Deserialize)]
pub struct Stage {
    /// Name of the stage.
    pub name: String,
    /// Most modelled cycles of any call, at the upper end of the band.
    #[serde(rename = "cycles_high")]
    pub cycles: u64,
    /// Mean of the modelled cycles of a call, at the upper end of the band.
    #[serde(rename = "mean_cycles_high", default)]
    pub mean_cycles: f64,
}

/// Reads the stages of the table in a file.
pub fn read(path: &Path) -> Result<Vec<Stage>> {
    let of = || path.display().to_string();
    parse(&std::fs::read_to_string(path).with_context(of)?).with_context(of)
}

/// Parses the stages of a table in CSV.
pub fn parse(table: &str) -> Result<Vec<Stage>> {
    let rows = csv::Reader::from_reader(table.as_bytes()).into_deserialize();
    rows.collect::<Result<_, _>>()
        .context("no table of costs; `cargo xtask cycles --csv` writes one")
}

//! Tables of measurements as CSV files: a line for each row, its fields by name.

use std::path::Path;

use anyhow::Context as _;
use serde::{Serialize, de::DeserializeOwned};
use taxel_files::save;

/// Writes a table.
///
/// # Errors
/// The file cannot be written.
pub fn write<R: Serialize>(rows: &[R], path: &Path) -> anyhow::Result<()> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    rows.iter().try_for_each(|row| writer.serialize(row))?;
    Ok(save(path, String::from_utf8(writer.into_inner()?)?)?)
}

/// Reads a table.
///
/// # Errors
/// A line is not one that [`write`] writes.
pub fn parse<R: DeserializeOwned>(text: &str) -> anyhow::Result<Vec<R>> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let rows = reader.deserialize().enumerate();
    rows.map(|(i, row)| row.with_context(|| format!("line {}", i + 2))).collect()
}

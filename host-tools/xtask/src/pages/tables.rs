//! Reads committed tables: CSV files, tables of pages, numbers of scenes.

use std::collections::HashMap;

use anyhow::{Context, Result, bail};

use crate::run::root;

/// Reads a file of the repository.
pub fn read(path: &str) -> Result<String> {
    std::fs::read_to_string(root().join(path)).with_context(|| path.to_owned())
}

/// Table of a CSV file with a header.
pub struct Csv {
    path: &'static str,
    rows: Vec<HashMap<String, String>>,
}

impl Csv {
    /// Reads a file of the repository.
    pub fn read(path: &'static str) -> Result<Self> {
        let text = read(path)?;
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(text.as_bytes());
        let rows = reader.deserialize().collect::<Result<_, _>>().with_context(|| path)?;
        Ok(Self { path, rows })
    }

    /// Cells of `column` in the rows that have these values in these columns.
    pub fn cells(&self, wanted: &[(&str, &str)], column: &str) -> Result<Vec<&str>> {
        let fits = |row: &&HashMap<String, String>| {
            wanted.iter().all(|(k, v)| row.get(*k).is_some_and(|c| c == v))
        };
        let cells: Option<Vec<&str>> =
            self.rows.iter().filter(fits).map(|row| row.get(column).map(String::as_str)).collect();
        match cells {
            Some(cells) if !cells.is_empty() => Ok(cells),
            _ => bail!("{}: no `{column}` of {wanted:?}", self.path),
        }
    }

    /// Mean of a column's numbers in these rows.
    pub fn mean(&self, wanted: &[(&str, &str)], column: &str) -> Result<f64> {
        let cells = self.cells(wanted, column)?;
        let numbers = cells.iter().map(|cell| cell.parse::<f64>()).collect::<Result<Vec<_>, _>>();
        let numbers =
            numbers.with_context(|| format!("{}: `{column}` of {wanted:?}", self.path))?;
        Ok(numbers.iter().sum::<f64>() / numbers.len() as f64)
    }
}

/// Cell of a page's table: the row that begins with `row`, below a heading, its column from 0.
pub fn cell(page: &str, heading: &str, row: &str, column: usize) -> Result<String> {
    let text = read(page)?;
    let mut lines = text.lines().skip_while(|line| line.trim_start_matches('#').trim() != heading);
    let found = lines.find_map(|line| {
        let cells: Vec<&str> =
            line.strip_prefix('|')?.strip_suffix('|')?.split('|').map(str::trim).collect();
        (cells.first()?.trim_matches('*') == row).then_some(cells)
    });
    let cells = found.with_context(|| format!("{page}: no row `{row}` below `{heading}`"))?;
    let cell =
        cells.get(column).with_context(|| format!("{page}: `{row}` has no column {column}"))?;
    Ok(cell.replace("**", ""))
}

/// First number of a text such as `**505 µs**`.
pub fn number(text: &str) -> Result<f64> {
    let digits: String = text
        .chars()
        .skip_while(|c| !c.is_ascii_digit())
        .take_while(|c| c.is_ascii_digit() || matches!(c, '.' | ' '))
        .filter(|c| *c != ' ')
        .collect();
    digits.parse().with_context(|| format!("no number in `{text}`"))
}

/// Lowest and highest value of a key of a built-in scene's first `[[random]]`.
pub fn random(scene: &str, key: &str) -> Result<[f64; 2]> {
    let path = format!("host-tools/sim/scenes/{scene}.toml");
    let table: toml::Table = read(&path)?.parse()?;
    let values = table.get("random").and_then(|random| random.get(0)?.get(key)?.as_array());
    let values = values.into_iter().flatten();
    let values: Vec<f64> =
        values.filter_map(|v| v.as_float().or(v.as_integer().map(|i| i as f64))).collect();
    values.try_into().map_err(|_| anyhow::anyhow!("{path}: no two numbers `random.{key}`"))
}

/// Number of a key of a built-in scene, such as `friction.mu`.
pub fn key(scene: &str, key: &str) -> Result<f64> {
    let path = format!("host-tools/sim/scenes/{scene}.toml");
    let table: toml::Table = read(&path)?.parse()?;
    let (part, name) = key.split_once('.').context("PART.KEY")?;
    let value = table.get(part).and_then(|part| part.get(name));
    let value = value.and_then(|v| v.as_float().or(v.as_integer().map(|i| i as f64)));
    value.with_context(|| format!("{path}: no `{key}`"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_row_or_number_is_an_error() {
        let page = "docs/accuracy.md";
        assert!(cell(page, "Specification", "torsion", 3).unwrap().ends_with("N·mm"));
        assert!(cell(page, "Specification", "weight", 3).is_err());
        assert!(cell(page, "No such heading", "torsion", 3).is_err());
        assert_eq!(number("at most 1 003.5 µs").unwrap(), 1003.5);
        assert!(number("–").is_err());
        assert!(random("presses", "fz_n").unwrap()[1] > 0.0);
        assert!(random("presses", "weight").is_err() && key("presses", "friction.nu").is_err());
    }
}

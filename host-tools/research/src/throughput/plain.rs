//! Reader of traces by the crate `csv` and the standard library's numbers, to compare with.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use anyhow::Context;
use csv::{ReaderBuilder, StringRecord};
use taxel::scan::{Codes, Midpoints, SENSORS, Scan, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};

/// Reader of traces of a finger with the matrix, four force sensors and the reference channel.
pub(super) struct PlainReader {
    rows: csv::Reader<BufReader<File>>,
    full_scale: FullScale,
    /// Positions of the time and of the codes, in the order of [`Self::taken`].
    columns: Vec<usize>,
    record: StringRecord,
    numbers: Vec<f64>,
}

impl PlainReader {
    /// Opens a trace.
    pub(super) fn open(path: &Path) -> anyhow::Result<Self> {
        let file = || anyhow::Ok(BufReader::new(File::open(path)?));
        let first = file()?.lines().next().transpose()?.unwrap_or_default();
        let full_scale = first.strip_prefix("# full_scale=").map_or(Ok(4095), str::parse)?;
        let full_scale = FullScale::new(full_scale).context("a full scale of 0")?;
        let mut rows = ReaderBuilder::new().comment(Some(b'#')).from_reader(file()?);
        let names = rows.headers()?;
        let position = |wanted: String| {
            let found = names.iter().position(|name| name == wanted);
            found.with_context(|| format!("no column {wanted}"))
        };
        let columns = columns().map(position).collect::<anyhow::Result<_>>()?;
        let (record, numbers) = (StringRecord::new(), Vec::new());
        Ok(Self { rows, full_scale, columns, record, numbers })
    }

    fn read(&mut self) -> anyhow::Result<Option<Scan>> {
        if !self.rows.read_record(&mut self.record)? {
            return Ok(None);
        }
        self.numbers.clear();
        for cell in &self.record {
            // An unknown truth is an empty cell.
            self.numbers.push(if cell.is_empty() { f64::NAN } else { cell.parse()? });
        }
        self.taken().context("a row is too short").map(Some)
    }

    fn taken(&self) -> Option<Scan> {
        let mut numbers = self.columns.iter().map(|at| self.numbers.get(*at).copied());
        let time = Micros(numbers.next()?? as u64);
        let mut code = || Some(Code(numbers.next()?? as u16));
        let mut taxels = TaxelCodes::default();
        for slot in taxels.lit.as_flattened_mut().iter_mut().chain(&mut taxels.dark) {
            *slot = code()?;
        }
        let mut bridges = [None; SENSORS];
        for bridge in &mut bridges {
            *bridge = Some(Midpoints { a: code()?, b: code()?, c: code()?, d: code()? });
        }
        let reference = Some(code()?);
        let (full_scale, taxels) = (self.full_scale, Some(taxels));
        let codes = Codes { full_scale, taxels, bridges, reference, temperature: None };
        Some(Scan { time, lost: 0, codes })
    }
}

impl Iterator for PlainReader {
    type Item = anyhow::Result<Scan>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}

/// Names of the columns that a scan needs.
fn columns() -> impl Iterator<Item = String> {
    let lit = (0..4).flat_map(|row| (0..4).map(move |column| format!("lit_r{row}c{column}")));
    let dark = (0..4).map(|column| format!("dark_c{column}"));
    let bridges =
        (0..SENSORS).flat_map(|s| ["a", "b", "c", "d"].map(|arm| format!("bridge_s{s}_{arm}")));
    let time = std::iter::once("t_us".to_owned());
    time.chain(lit).chain(dark).chain(bridges).chain(["aux_vref".to_owned()])
}

//! Recordings in CSV.
//!
//! Facts come before the header line, as in `# serial=F-0042`. A missing value is an empty cell,
//! without its reason.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

mod text;

use crate::FileError;
use crate::frames::{Cell, Column, Kind, columns};
use crate::lines::Lines;
use taxel::frame::Fields;

use crate::recording::header::Header;
use crate::recording::{Existing, Recording, Sink, begin, host_columns};

pub(crate) struct Writer {
    path: PathBuf,
    file: BufWriter<File>,
    /// Text of a row.
    row: Vec<u8>,
}

impl Writer {
    pub(crate) fn create(
        path: &Path,
        header: &Header,
        columns: &[Column],
        existing: Existing,
    ) -> Result<Self, FileError> {
        let failed = |error: std::io::Error| FileError::io(path, &error);
        let mut file = BufWriter::new(begin(path, existing)?);
        for (name, value) in &header.facts {
            // A line break within a fact would begin a line that is no fact.
            let value = value.replace(char::is_control, "?");
            writeln!(file, "# {name}={value}").map_err(failed)?;
        }
        let mut names = csv::Writer::from_writer(&mut file);
        let written = names.write_record(columns.iter().map(|column| column.name.as_str()));
        written.map_err(|error| FileError::csv(path, error))?;
        names.flush().map_err(failed)?;
        drop(names);
        file.flush().map_err(failed)?;
        Ok(Self { path: path.to_owned(), file, row: Vec::new() })
    }
}

impl Sink for Writer {
    /// Writes a row. Its cells are numbers, which need no quotes.
    fn write(&mut self, row: &[Cell]) -> Result<(), FileError> {
        self.row.clear();
        for cell in row {
            text::push(cell, &mut self.row);
            self.row.push(b',');
        }
        if let Some(last) = self.row.last_mut() {
            *last = b'\n';
        }
        self.file.write_all(&self.row).map_err(|error| FileError::io(&self.path, &error))
    }

    fn flush(&mut self) -> Result<(), FileError> {
        self.file.flush().map_err(|error| FileError::io(&self.path, &error))
    }

    fn finish(mut self: Box<Self>) -> Result<(), FileError> {
        self.flush()
    }
}

/// Opens a frames CSV, or any other with a time column `t_us`.
pub(crate) fn open(path: &Path) -> Result<Recording, FileError> {
    let file = File::open(path).map_err(|error| FileError::io(path, &error))?;
    let mut lines = Lines::new(BufReader::new(file), path);
    let mut header = Header::default();
    let mut names = csv::StringRecord::new();
    let found = lines.next(&mut names, |comment, _| {
        if let Some((name, value)) = comment.split_once('=') {
            header.facts.insert(name.trim().to_owned(), value.trim().to_owned());
        }
        Ok(())
    })?;
    let Some(line) = found else {
        return Err(FileError::new(path, "the file is empty: expected a line of column names"));
    };
    if !names.iter().any(|name| name == "t_us") {
        return Err(FileError::new(path, "the column is missing")
            .line(line)
            .column("t_us")
            .mend("a recording needs device time in microseconds"));
    }
    let known: Vec<_> = columns(Fields::ALL).into_iter().chain(host_columns()).collect();
    let columns: Vec<Column> = names
        .iter()
        .map(|name| {
            let known = known.iter().find(|column| column.name == name).cloned();
            match known {
                Some(column) => column,
                None => Column { name: name.to_owned(), kind: Kind::Real },
            }
        })
        .collect();
    let rows = Rows { lines, columns: columns.clone(), record: csv::StringRecord::new() };
    Ok(Recording { header, columns, whole: true, rows: Box::new(rows) })
}

struct Rows<R> {
    lines: Lines<R>,
    columns: Vec<Column>,
    record: csv::StringRecord,
}

impl<R: BufRead> Iterator for Rows<R> {
    type Item = Result<Vec<Cell>, FileError>;

    fn next(&mut self) -> Option<Self::Item> {
        let line = match self.lines.next_row(&mut self.record, self.columns.len()) {
            Ok(line) => line?,
            Err(error) => return Some(Err(error)),
        };
        let cell = |(text, column): (&str, &Column)| {
            let value = match column.kind {
                _ if text.is_empty() => Some(Cell::Empty),
                Kind::Whole => text.parse().ok().map(Cell::Whole),
                Kind::Real | Kind::Measured => {
                    text.parse().ok().filter(|value: &f32| value.is_finite()).map(Cell::Real)
                }
            };
            value.ok_or_else(|| {
                let wanted =
                    if column.kind == Kind::Whole { "a whole number" } else { "a finite number" };
                FileError::new(self.lines.path(), format!("expected {wanted}, found `{text}`"))
                    .line(line)
                    .column(&column.name)
                    .mend("correct the cell, or leave it empty where there is no value")
            })
        };
        Some(self.record.iter().zip(&self.columns).map(cell).collect())
    }
}

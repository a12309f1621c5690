//! Lines of a CSV file with the line numbers that an editor shows.
//!
//! The CSV library splits each line. This module finds the lines, because the library does not
//! count blank lines and knows no comments with a meaning.

use std::io::BufRead;
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::error::FileError;

/// Longest accepted line in bytes.
///
/// No trace has one nearly as long, and a binary file is not read whole.
const LONGEST: u64 = 1 << 20;
/// Mark with which some programs begin UTF-8 files.
const BYTE_ORDER_MARK: &str = "\u{feff}";

/// Reader of lines that are neither blank nor comments.
pub struct Lines<R> {
    source: R,
    path: PathBuf,
    line: u64,
    text: Vec<u8>,
    /// True after the line of column names.
    named: bool,
}

impl<R: BufRead> Lines<R> {
    /// Creates a reader of `source`; `path` is only for messages.
    pub fn new(source: R, path: &Path) -> Self {
        Self { source, path: path.to_owned(), line: 0, text: Vec::new(), named: false }
    }

    /// Path of the file, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the next line's fields and returns its number, counted from 1; `None` at the end.
    ///
    /// `comment` receives the skipped comments without their `#`.
    ///
    /// # Errors
    /// The line cannot be read, or is no CSV.
    pub fn next(
        &mut self,
        record: &mut StringRecord,
        mut comment: impl FnMut(&str, u64) -> Result<(), FileError>,
    ) -> Result<Option<u64>, FileError> {
        loop {
            self.text.clear();
            let length = std::io::Read::take(&mut self.source, LONGEST)
                .read_until(b'\n', &mut self.text)
                .map_err(|error| FileError::io(&self.path, &error))?;
            if length == 0 {
                return Ok(None);
            }
            self.line += 1;
            let text = std::str::from_utf8(&self.text).map_err(|_| {
                FileError::new(&self.path, "not text: expected a CSV file in UTF-8")
                    .line(self.line)
                    .mend("export it as CSV, UTF-8")
            })?;
            if length as u64 == LONGEST {
                let problem = "a line of more than a million bytes: expected a CSV file";
                return Err(FileError::new(&self.path, problem)
                    .line(self.line)
                    .mend("export it as CSV, a row a line"));
            }
            let text = text.trim().trim_start_matches(BYTE_ORDER_MARK);
            if text.is_empty() {
                continue;
            }
            if let Some(words) = text.strip_prefix('#') {
                comment(words, self.line)?;
                continue;
            }
            split(text, record)
                .map_err(|error| FileError::new(&self.path, error.to_string()).line(self.line))?;
            if !std::mem::replace(&mut self.named, true) {
                self.separated_by_commas(record)?;
            }
            return Ok(Some(self.line));
        }
    }

    /// Rejects other separators, because spreadsheets choose theirs by country.
    fn separated_by_commas(&self, names: &StringRecord) -> Result<(), FileError> {
        let other = |names: &str| [';', '\t', '|'].into_iter().find(|mark| names.contains(*mark));
        match (names.len(), names.get(0).and_then(other)) {
            (1, Some(mark)) => {
                let problem = format!("columns are separated by {mark:?}: expected commas");
                Err(FileError::new(&self.path, problem)
                    .line(self.line)
                    .mend("export it with commas, and points in the numbers"))
            }
            _ => Ok(()),
        }
    }

    /// Reads the next line as [`Self::next`] does and skips all comments.
    ///
    /// # Errors
    /// As [`Self::next`], or the line has another number of fields than the header.
    pub fn next_row(
        &mut self,
        record: &mut StringRecord,
        fields: usize,
    ) -> Result<Option<u64>, FileError> {
        let Some(line) = self.next(record, |_, _| Ok(()))? else { return Ok(None) };
        if record.len() == fields {
            return Ok(Some(line));
        }
        let problem = format!("{} fields where the header has {fields}", record.len());
        Err(FileError::new(&self.path, problem)
            .line(line)
            .mend("complete or remove the line; a recording cut short often ends in one"))
    }
}

fn split(text: &str, record: &mut StringRecord) -> Result<bool, csv::Error> {
    csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .buffer_capacity(text.len() + 1)
        .from_reader(text.as_bytes())
        .read_record(record)
}

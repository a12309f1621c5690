//! A CSV file line by line, with the line numbers that an editor shows.
//!
//! The CSV library splits each line; finding lines is done here, because the library passes over blank
//! lines without counting them and knows no comments with a meaning.

use std::io::BufRead;
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::error::FileError;

/// No line of a trace or table is nearly as long; a binary file without line ends is not read whole.
const LONGEST: u64 = 1 << 20;
/// Some programs begin UTF-8 files with it.
const BYTE_ORDER_MARK: &str = "\u{feff}";

/// Lines that are neither blank nor comments.
pub struct Lines<R> {
    source: R,
    path: PathBuf,
    line: u64,
    text: Vec<u8>,
    /// The line of column names has passed.
    named: bool,
}

impl<R: BufRead> Lines<R> {
    /// Lines of `source`; `path` is only for messages.
    pub fn new(source: R, path: &Path) -> Self {
        Self { source, path: path.to_owned(), line: 0, text: Vec::new(), named: false }
    }

    /// For messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next line's fields and its number, counted from 1; `None` at the end. `comment` hears the
    /// comments passed on the way, without their `#`.
    ///
    /// # Errors
    /// It cannot be read, or is no CSV file.
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

    /// Spreadsheets separate by what their country does.
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

    /// As [`Self::next`], for lines that must have as many fields as the header; comments mean nothing.
    ///
    /// # Errors
    /// As [`Self::next`], or the line has not as many fields.
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

//! Lines of a CSV file with the line numbers that an editor shows.
//!
//! The CSV library splits each line with quotes or blanks; one splitter serves all lines, because
//! to make one takes longer than to split a line. This module finds the lines, because the library
//! does not count blank lines and knows no comments with a meaning.

use std::io::BufRead;
use std::path::{Path, PathBuf};

use csv::StringRecord;
use csv_core::ReadRecordResult;

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
    splitter: Splitter,
    /// True after the line of column names.
    named: bool,
}

impl<R: BufRead> Lines<R> {
    /// Creates a reader of `source`; `path` is only for messages.
    pub fn new(source: R, path: &Path) -> Self {
        let (path, splitter) = (path.to_owned(), Splitter::new());
        Self { source, path, line: 0, text: Vec::new(), splitter, named: false }
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
            self.splitter.split(text, record);
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

/// Splits lines into fields.
struct Splitter {
    reader: csv_core::Reader,
    fields: Vec<u8>,
    ends: Vec<usize>,
}

impl Splitter {
    fn new() -> Self {
        // The library's `Default` makes a reader without its tables.
        Self { reader: csv_core::Reader::new(), fields: Vec::new(), ends: Vec::new() }
    }

    fn split(&mut self, text: &str, record: &mut StringRecord) {
        if is_plain(text) {
            record.clear();
            let mut start = 0;
            for end in memchr::memchr_iter(b',', text.as_bytes()).chain([text.len()]) {
                record.push_field(text.get(start..end).unwrap_or_default());
                start = end + 1;
            }
            return;
        }
        // No field is longer than its text; the splitter wants a byte more than it writes.
        self.fields.resize(text.len() + 1, 0);
        self.ends.resize(text.len() + 1, 0);
        self.reader.reset();
        let (result, _, bytes, mut ended) =
            self.reader.read_record(text.as_bytes(), &mut self.fields, &mut self.ends);
        let rest = (self.fields.get_mut(bytes..), self.ends.get_mut(ended..));
        if let (ReadRecordResult::InputEmpty, (Some(fields), Some(ends))) = (result, rest) {
            // Nothing more comes, which ends the last field.
            ended += self.reader.read_record(&[], fields, ends).3;
        }
        record.clear();
        // The fields are the text's without commas and quotes, so they are UTF-8 as it is.
        let fields = self.fields.get(..bytes).and_then(|fields| std::str::from_utf8(fields).ok());
        let fields = fields.unwrap_or_default();
        let mut start = 0;
        for end in self.ends.iter().take(ended) {
            record.push_field(fields.get(start..*end).unwrap_or_default().trim());
            start = *end;
        }
    }
}

/// Returns whether a line's fields are what stands between its commas: it has no quotes, and no
/// blanks to trim. Most lines are; the library takes longer for them than all else that is read.
fn is_plain(text: &str) -> bool {
    // Without an early end, several bytes are compared at once.
    text.bytes().fold(true, |plain, byte| plain & byte.is_ascii_graphic() & (byte != b'"'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Splits lines one after the other, because a splitter keeps its buffers.
        #[test]
        fn each_line_is_split_as_by_a_reader_of_its_own(
            lines in proptest::collection::vec("[ -~]{0,9}|[aµ€,\" ]{1,9}|[0-9.,\r]{1,20}", 1..6),
        ) {
            let (mut splitter, mut found) = (Splitter::new(), StringRecord::new());
            for text in lines.iter().map(|line| line.trim()).filter(|line| !line.is_empty()) {
                splitter.split(text, &mut found);
                let mut expected = StringRecord::new();
                csv::ReaderBuilder::new()
                    .has_headers(false)
                    .flexible(true)
                    .trim(csv::Trim::All)
                    .from_reader(text.as_bytes())
                    .read_record(&mut expected)
                    .unwrap();
                prop_assert_eq!(&found, &expected, "{:?}", text);
            }
        }
    }
}

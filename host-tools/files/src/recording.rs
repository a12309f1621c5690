//! Recordings: what a finger said, row by row, in the kind of file that the name asks for.
//!
//! ```text
//! Frame ──crate::frames::cells──▶ row ──Recorder──▶ .mcap · .parquet · .csv ──Recording──▶ row
//! ```
//! A recording is a [`Header`] (which finger, which calibration), named columns, and rows. Nothing in
//! here knows what a column means, so that a field which frames gain is recorded without a change.

mod csv;
mod header;
mod mcap;
mod parquet;
mod scans;
pub mod schema;

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

use crate::FileError;
use crate::frames::{Cell, Column, Kind};
use crate::trace::is_code;

pub use header::Header;
pub use scans::Scans;

/// The column of host receive time: microseconds since 1970-01-01 UTC.
pub const HOST_TIME: &str = "host_us";

/// What the host knows of a frame, after the finger's own columns: when it came; when it was scanned, by the
/// host's clock, and how far off that may be (both empty before the finger's is known); and by which of the
/// recording's connections, from 1.
#[must_use]
pub fn host_columns() -> [Column; 4] {
    [HOST_TIME, "host_scan_us", "host_scan_error_us", "connection"]
        .map(|name| Column { name: name.to_owned(), kind: Kind::Whole })
}

/// The kinds of file there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Csv,
    Mcap,
    Parquet,
}

impl Format {
    fn of(path: &Path) -> Result<Self, FileError> {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("csv") => Ok(Self::Csv),
            Some("mcap") => Ok(Self::Mcap),
            Some("parquet") => Ok(Self::Parquet),
            _ => Err(FileError::new(path, "no kind of recording that its name tells")
                .mend("let it end in .mcap, .parquet or .csv")),
        }
    }
}

/// What becomes of a file that is there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// It stays, and nothing is written.
    Keep,
    /// It is overwritten.
    Replace,
}

/// A file to write into. A device, such as a pipe, is there already.
fn begin(path: &Path, existing: Existing) -> Result<File, FileError> {
    let device = path.metadata().is_ok_and(|found| !found.is_file());
    let mut options = File::options();
    options.write(true);
    match existing {
        Existing::Keep if !device => options.create_new(true),
        _ => options.create(true).truncate(true),
    };
    options.open(path).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => taken(path),
        _ => FileError::io(path, &error),
    })
}

fn taken(path: &Path) -> FileError {
    FileError::new(path, "there is such a file already")
        .mend("choose another name, or add --force to overwrite it")
}

/// Writes a recording.
pub struct Recorder(Box<dyn Sink + Send>);

/// A kind of file.
trait Sink {
    fn write(&mut self, row: &[Cell]) -> Result<(), FileError>;
    fn flush(&mut self) -> Result<(), FileError>;
    fn finish(self: Box<Self>) -> Result<(), FileError>;
}

impl Recorder {
    /// Makes sure that a file may be begun, and touches nothing.
    ///
    /// # Errors
    /// Its name tells no kind of recording, or it is there and shall stay.
    pub fn check(path: &Path, existing: Existing) -> Result<(), FileError> {
        if Format::of(path)? == Format::Parquet {
            parquet::check(path)?;
        }
        if existing == Existing::Keep && path.is_file() { Err(taken(path)) } else { Ok(()) }
    }

    /// Begins the file of what comes but once: it is safe from the end of this process.
    ///
    /// # Errors
    /// Its name tells no kind of recording, it cannot be written, or it is there and shall stay.
    pub fn create(
        path: &Path,
        header: &Header,
        columns: &[Column],
        existing: Existing,
    ) -> Result<Self, FileError> {
        Self::check(path, existing)?;
        if Format::of(path)? == Format::Parquet {
            return Ok(Self(Box::new(parquet::Spooled::create(path, header, columns, existing)?)));
        }
        Self::derived(path, header, columns, existing)
    }

    /// Begins the file of what another file has, from which it can be made again.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn derived(
        path: &Path,
        header: &Header,
        columns: &[Column],
        existing: Existing,
    ) -> Result<Self, FileError> {
        Ok(Self(match Format::of(path)? {
            Format::Csv => Box::new(csv::Writer::create(path, header, columns, existing)?),
            Format::Mcap => Box::new(mcap::Writer::create(path, header, columns, existing)?),
            Format::Parquet => Box::new(parquet::Writer::create(path, header, columns, existing)?),
        }))
    }

    /// Appends a row, a cell for each column.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, row: &[Cell]) -> Result<(), FileError> {
        self.0.write(row)
    }

    /// Makes what was written so far safe from the end of this process.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), FileError> {
        self.0.flush()
    }

    /// Ends the file; a recorder that is merely dropped cannot say that the disk was full.
    ///
    /// # Errors
    /// The end could not be written.
    pub fn finish(self) -> Result<(), FileError> {
        self.0.finish()
    }
}

type Rows = Box<dyn Iterator<Item = Result<Vec<Cell>, FileError>> + Send>;

/// Reads a recording. Rows come one by one; an error among them says what could not be read, and where the
/// rest of the file can be read, its rows follow.
pub struct Recording {
    /// Which finger it is of.
    pub header: Header,
    /// What the cells of a row are.
    pub columns: Vec<Column>,
    /// It ends as its writer ends a file; of CSV that cannot be told.
    pub whole: bool,
    rows: Rows,
}

impl Recording {
    /// Opens a file.
    ///
    /// # Errors
    /// It is no recording, or cannot be read.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        match Format::of(path)? {
            Format::Csv => csv::open(path),
            Format::Mcap => mcap::open(path),
            Format::Parquet => parquet::open(path),
        }
    }

    /// What to say of one that is not [whole](Self::whole).
    #[must_use]
    pub fn cut_short(&self, path: &Path) -> String {
        format!("{}: has no end: the recording was cut short, or still goes on", path.display())
    }

    /// What whoever plays it should be told of it: a line each, with what to do. `path` is where it lies.
    #[must_use]
    pub fn remarks(&self, path: &Path) -> Vec<String> {
        let (place, path, header) = (path, path.display(), &self.header);
        let mut remarks = Vec::new();
        if !self.whole {
            remarks.push(self.cut_short(place));
        }
        if !self.columns.iter().any(|column| is_code(&column.name)) {
            return remarks;
        }
        if header.biased() && header.bias().is_none() {
            remarks.push(format!(
                "{path}: the finger had a bias taken on command, which is not in this recording: forces are \
                 computed with the calibration's; record again"
            ));
        }
        let scans: f64 = header.fact("scan_hz").parse().unwrap_or_default();
        if header.filter_hz() > 0 && header.rate_hz() < scans {
            remarks.push(format!(
                "{path}: the finger's filter had all {scans} scans a second, the recording has {}: what is \
                 computed from it differs by noise; record with --rate {scans}",
                header.rate_hz()
            ));
        }
        remarks
    }

    /// Where the column of this name stands in a row.
    #[must_use]
    pub fn position(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column.name == name)
    }
}

impl Iterator for Recording {
    type Item = Result<Vec<Cell>, FileError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.rows.next()
    }
}

//! Recordings of a finger's frames, row by row; the file's extension sets the format.
//!
//! ```text
//! Frame ──crate::frames::cells──▶ row ──Recorder──▶ .mcap · .parquet · .csv ──Recording──▶ row
//! ```
//! A recording is a [`Header`] (the finger and its calibration), named columns and rows. This
//! module knows no column's meaning, so a new field of frames needs no change here.

#[cfg(not(feature = "recording"))]
mod absent;
mod csv;
#[cfg(feature = "recording")]
pub mod foxglove;
mod header;
#[cfg(feature = "recording")]
mod mcap;
#[cfg(feature = "recording")]
mod parquet;
mod scans;
#[cfg(feature = "recording")]
mod scene;
#[cfg(feature = "recording")]
pub mod schema;
mod spooled;

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

use crate::FileError;
use crate::frames::{Cell, Column, Kind};
use crate::trace::is_code;

#[cfg(not(feature = "recording"))]
use absent as mcap;
#[cfg(not(feature = "recording"))]
use absent as parquet;

pub use header::Header;
pub use scans::Scans;
#[cfg(feature = "recording")]
pub use scene::{Contact, contact_frame};

/// Extension of a recording whose format the user did not choose.
pub const EXTENSION: &str = if cfg!(feature = "recording") { "mcap" } else { "csv" };

/// Column of the host's receive time in microseconds since 1970-01-01 UTC.
pub const HOST_TIME: &str = "host_us";

/// Lists the host's columns, which follow the finger's own.
///
/// They are the receive time, the scan time by the host's clock, its error, and the connection. The
/// scan time and its error are empty until the finger's clock is known. Connections of a recording
/// count from 1.
#[must_use]
pub fn host_columns() -> [Column; 4] {
    [HOST_TIME, "host_scan_us", "host_scan_error_us", "connection"]
        .map(|name| Column { name: name.to_owned(), kind: Kind::Whole })
}

/// Format of a recording.
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
            _ => Err(FileError::new(path, "unknown kind of recording")
                .mend("let it end in .mcap, .parquet or .csv")),
        }
    }
}

/// Treatment of an existing file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Keeps the file and writes nothing.
    Keep,
    /// Overwrites the file.
    Replace,
}

/// Most that device time may differ from host time between first and last row: a share for the
/// clocks, and an amount in µs for the delay of the link.
#[cfg(feature = "recording")]
const CLOCKS: (f64, f64) = (0.02, 1e6);

/// Returns whether the finger did not restart within the recording, so that its device time goes
/// forward. `span` returns the first and the last value of a column.
#[cfg(feature = "recording")]
fn in_order(span: impl Fn(&str) -> Option<(u64, u64)>) -> bool {
    let Some((from, to)) = span("t_us").filter(|(from, to)| from <= to) else { return false };
    let once = span("connection").is_none_or(|(from, to)| from == to);
    let kept = span(HOST_TIME).is_none_or(|(host_from, host_to)| {
        let (device, host) = ((to - from) as f64, host_to as f64 - host_from as f64);
        let (share, most) = CLOCKS;
        (device - host).abs() <= share * host.abs() + most
    });
    once && kept
}

/// Opens a file to write into. A device, such as a pipe, already exists.
fn begin(path: &Path, existing: Existing) -> Result<File, FileError> {
    let device = path.metadata().is_ok_and(|found| !found.is_file());
    let mut options = File::options();
    options.write(true);
    match existing {
        Existing::Keep if !device => options.create_new(true),
        _ => options.create(true).truncate(true),
    };
    options.open(path).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => already_exists(path),
        _ => FileError::io(path, &error),
    })
}

fn already_exists(path: &Path) -> FileError {
    FileError::new(path, "the file exists already")
        .mend("choose another name, or add --force to overwrite it")
}

/// Writer of a recording.
pub struct Recorder(Box<dyn Sink + Send>);

/// Writer of one format.
trait Sink {
    fn write(&mut self, row: &[Cell]) -> Result<(), FileError>;
    fn flush(&mut self) -> Result<(), FileError>;
    fn finish(self: Box<Self>) -> Result<(), FileError>;
}

impl Recorder {
    /// Checks that a file can be created, and touches nothing.
    ///
    /// # Errors
    /// The name has no known extension, the file exists and must stay, or the rows of a killed
    /// recording are beside it.
    pub fn check(path: &Path, existing: Existing) -> Result<(), FileError> {
        spooled::check(path)?;
        if existing == Existing::Keep && path.is_file() {
            Err(already_exists(path))
        } else {
            Ok(())
        }
    }

    /// Creates the file of unrepeatable data, which survives the end of this process.
    ///
    /// A file that it replaces stays until the new one has ended, and for good if no row came.
    ///
    /// # Errors
    /// The name has no known extension, the file cannot be written, or it exists and must stay.
    pub fn create(
        path: &Path,
        header: &Header,
        columns: &[Column],
        existing: Existing,
    ) -> Result<Self, FileError> {
        Self::check(path, existing)?;
        if Format::of(path)? == Format::Parquet || path.is_file() {
            let spooled = spooled::Spooled::create(path, header, columns, existing)?;
            return Ok(Self(Box::new(spooled)));
        }
        Self::derived(path, header, columns, existing)
    }

    /// Creates the file of data that another file holds, so that it can be made again.
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

    /// Appends a row with a cell for each column.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, row: &[Cell]) -> Result<(), FileError> {
        self.0.write(row)
    }

    /// Flushes all rows, so that they survive the end of this process.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), FileError> {
        self.0.flush()
    }

    /// Ends the file.
    ///
    /// A dropped recorder cannot report that the disk was full.
    ///
    /// # Errors
    /// The end cannot be written.
    pub fn finish(self) -> Result<(), FileError> {
        self.0.finish()
    }
}

type Rows = Box<dyn Iterator<Item = Result<Vec<Cell>, FileError>> + Send>;

/// Reader of a recording, row by row.
///
/// An error stands for rows that cannot be read. Readable rows after it follow.
pub struct Recording {
    /// Header: the finger and its settings.
    pub header: Header,
    /// Columns of the rows.
    pub columns: Vec<Column>,
    /// True for a file that its writer ended; CSV files do not show their end.
    pub whole: bool,
    rows: Rows,
}

impl Recording {
    /// Opens a recording.
    ///
    /// # Errors
    /// The file is no recording, or cannot be read.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        match Format::of(path)? {
            Format::Csv => csv::open(path),
            Format::Mcap => mcap::open(path),
            Format::Parquet => parquet::open(path),
        }
    }

    /// Opens a recording at or before a device time in seconds, without reading what lies before it
    /// where the format and the file permit: rows before it may come first.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_from(path: &Path, seconds: f64) -> Result<Self, FileError> {
        let micros = (seconds * 1e6).floor();
        match Format::of(path)? {
            // A negative time or none is the beginning.
            Format::Mcap if micros > 0.0 => mcap::open_from(path, micros as u64),
            Format::Parquet if micros > 0.0 => parquet::open_from(path, micros as u64),
            _ => Self::open(path),
        }
    }

    /// Returns the remark on a recording that is not [whole](Self::whole).
    #[must_use]
    pub fn cut_short(&self, path: &Path) -> String {
        format!("{}: has no end: the recording was cut short, or still goes on", path.display())
    }

    /// Lists remarks for a user who plays the recording; `path` is its file.
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
        if let Some(part) = header.bad_bias() {
            remarks.push(format!(
                "{path}: `{part}` of its header is damaged: expected the noise and the levels of a bias; forces \
                 are computed with the calibration's; record again"
            ));
        } else if header.biased() && header.bias().is_none() {
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

    /// Returns the position of the named column in a row.
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

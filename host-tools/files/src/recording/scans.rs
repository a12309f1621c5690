//! Scans of a trace or of a recording with codes, which can be played and computed again.

use std::io::{self, BufReader, Cursor, Read};
use std::path::Path;

use crate::FileError;
use crate::calibration;
use crate::frames::Cell;
use crate::trace::{self, Sample, TraceReader, is_code};
use taxel::calibration::Calibration;

use crate::recording::{Format, Header, Recording};

type Samples = Box<dyn Iterator<Item = Result<Sample, FileError>> + Send>;

/// Scans and settings for the core to compute from.
pub struct Scans {
    /// Scans; those of a trace with their truth.
    pub samples: Samples,
    /// Finger and settings; a trace lacks them.
    pub header: Header,
    /// Active calibration of the recording.
    pub calibration: Option<Calibration>,
    /// Remarks for the user; see [`Recording::remarks`].
    pub remarks: Vec<String>,
}

impl Scans {
    /// Opens a trace or a recording of any format.
    ///
    /// # Errors
    /// The file cannot be read, or holds no codes.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        Self::open_from(path, f64::NEG_INFINITY)
    }

    /// Opens a trace or a recording at or before a device time in seconds, as
    /// [`Recording::open_from`].
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_from(path: &Path, seconds: f64) -> Result<Self, FileError> {
        if !is_recording(path) {
            let mut header = Header::default();
            // The reader of the trace reports a file that cannot be read.
            if let Ok(Some(origin)) = trace::simulated(path) {
                header = header.with(trace::SIMULATED_KEY, origin);
            }
            return Ok(Self {
                samples: Box::new(TraceReader::open(path)?),
                header,
                calibration: None,
                remarks: Vec::new(),
            });
        }
        let recording = Recording::open_from(path, seconds)?;
        let text = recording.header.calibration.as_deref();
        let calibration = text.map(|text| calibration::parse(path, text)).transpose()?;
        let (header, remarks) = (recording.header.clone(), recording.remarks(path));
        Ok(Self { samples: Box::new(samples(recording, path)?), header, calibration, remarks })
    }
}

/// Returns whether a file is a recording; a CSV file without the column `seq` is a trace.
fn is_recording(path: &Path) -> bool {
    match Format::of(path) {
        Ok(Format::Mcap | Format::Parquet) => true,
        // For any other name, the reader of traces reports the error.
        _ => crate::recording::csv::open(path)
            .is_ok_and(|recording| recording.position("seq").is_some()),
    }
}

fn samples(
    mut recording: Recording,
    path: &Path,
) -> Result<impl Iterator<Item = Result<Sample, FileError>> + Send + use<>, FileError> {
    // A channel that the finger lacks has empty cells in every row, so the first row shows it.
    let first = recording.next().transpose()?.unwrap_or_default();
    let kept = recording.columns.iter().zip(&first).map(|(column, cell)| {
        column.name == "t_us" || is_code(&column.name) && *cell != Cell::Empty
    });
    let kept: Vec<bool> = kept.collect();
    if !recording.columns.iter().zip(&kept).any(|(column, kept)| *kept && is_code(&column.name)) {
        return Err(FileError::new(path, "no ADC codes in it, so it cannot be computed again")
            .mend("record with the field `codes`"));
    }
    let names = recording.columns.iter().zip(&kept).filter(|(_, kept)| **kept);
    let names: Vec<_> = names.map(|(column, _)| column.name.as_str()).collect();
    let full_scale = match recording.header.fact("full_scale") {
        "" => "4095",
        known => known,
    };
    let head = format!("# full_scale={full_scale}\n{}\n", names.join(","));
    let text =
        TraceText { line: Cursor::new(head.into_bytes()), ahead: Some(first), recording, kept };
    TraceReader::new(BufReader::new(text), path)
}

/// A recording as the text of a trace, so that the reader of traces checks it.
struct TraceText {
    line: Cursor<Vec<u8>>,
    ahead: Option<Vec<Cell>>,
    recording: Recording,
    kept: Vec<bool>,
}

impl Read for TraceText {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.line.read(buffer)?;
            if read > 0 || buffer.is_empty() {
                return Ok(read);
            }
            let row = match self.ahead.take() {
                Some(row) => row,
                None => match self.recording.next() {
                    None => return Ok(0),
                    Some(row) => row.map_err(io::Error::other)?,
                },
            };
            let cells = row.iter().zip(&self.kept).filter(|(_, kept)| **kept);
            let cells: Vec<_> = cells.map(|(cell, _)| cell.to_string()).collect();
            self.line = Cursor::new((cells.join(",") + "\n").into_bytes());
        }
    }
}

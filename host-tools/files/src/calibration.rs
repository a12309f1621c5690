//! Calibration files in TOML: a finger's record, or a model of another sensor's table.
//!
//! ```toml
//! taxel_calibration = 2      # version of the format
//! kind = "finger"            # or "table"
//! crc32 = "8d2a11c3"         # CRC-32 of the record's bytes, as `taxel info` shows it
//! serial = "F-0042"
//! date = "2026-11-21T09:30:00Z"
//! …
//! ```
//! Numbers are the chip's exact f32 values. A file edited by hand no longer matches its CRC.

pub mod date;
mod finger;
mod quantised;

use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use taxel::calibration::{Calibration, CalibrationError, MAX_BYTES, VERSION, names};

use crate::error::FileError;
use crate::save;
use finger::FingerFile;

/// Subject of a calibration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A taxel finger; the record goes onto the chip.
    Finger,
    /// A table of N channels.
    Table,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Finger => "finger",
            Self::Table => "table",
        }
    }
}

#[derive(Serialize, Deserialize)]
struct File<T> {
    taxel_calibration: u16,
    kind: Kind,
    crc32: String,
    #[serde(flatten)]
    body: T,
}

#[derive(Deserialize)]
struct Head {
    taxel_calibration: u16,
    kind: Kind,
    crc32: String,
}

/// Reads the kind of a calibration file.
///
/// # Errors
/// The file cannot be read, or is no calibration of this version.
pub fn kind(path: impl AsRef<Path>) -> Result<Kind, FileError> {
    let path = path.as_ref();
    Ok(head(path, &text(path)?)?.kind)
}

/// Reads a finger's calibration, checks its CRC and every field, and rehearses it as a finger does.
///
/// # Errors
/// The file is damaged or invalid, and the error names the line; or a finger would refuse it.
pub fn read(path: impl AsRef<Path>) -> Result<Calibration, FileError> {
    let path = path.as_ref();
    parse(path, &text(path)?)
}

/// Parses a finger's calibration; `path` is only for messages.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &str) -> Result<Calibration, FileError> {
    let (head, file): (Head, FingerFile) = open(path, text, Kind::Finger)?;
    let calibration = file.calibration().map_err(|(key, problem)| {
        located(path, text, key, problem).mend("fit the calibration again")
    })?;
    let crc = record_crc(&calibration).map_err(|error| {
        let error = match error {
            CalibrationError::Field { section, field } => match names(section, field) {
                Some((section, field)) => in_section(path, text, section, field),
                None => FileError::new(path, error.to_string()),
            },
            error => FileError::new(path, error.to_string()),
        };
        error.mend("fit the calibration again")
    })?;
    check_crc(path, text, &head, crc)?;
    calibration
        .rehearse()
        .map_err(|error| FileError::new(path, format!("a finger refuses it: {error}")))?;
    Ok(calibration)
}

/// Writes a finger's calibration file.
///
/// # Errors
/// The record is not valid, or the file cannot be written.
pub fn write(path: impl AsRef<Path>, calibration: &Calibration) -> Result<(), FileError> {
    let path = path.as_ref();
    save(path, &to_text(path, calibration)?)
}

/// Formats a finger's calibration as [`write`] does; `path` is only for messages.
///
/// # Errors
/// The record is not valid, or a finger would refuse it.
pub fn to_text(path: &Path, calibration: &Calibration) -> Result<String, FileError> {
    let crc = calibration.rehearse().and_then(|()| record_crc(calibration));
    let crc = crc.map_err(|error| FileError::new(path, format!("not written: {error}")))?;
    text_of(path, Kind::Finger, crc, &FingerFile::new(calibration))
}

/// Reads a table's model.
///
/// # Errors
/// The file is damaged or invalid; the error names the line.
pub fn read_table<T: Serialize + DeserializeOwned>(path: impl AsRef<Path>) -> Result<T, FileError> {
    let path = path.as_ref();
    let text = text(path)?;
    let (head, model): (Head, T) = open(path, &text, Kind::Table)?;
    check_crc(path, &text, &head, model_crc(path, &model)?)?;
    Ok(model)
}

/// Writes a table's model.
///
/// # Errors
/// The file cannot be written.
pub fn write_table<T: Serialize>(path: impl AsRef<Path>, model: &T) -> Result<(), FileError> {
    let path = path.as_ref();
    save(path, &text_of(path, Kind::Table, model_crc(path, model)?, model)?)
}

fn text(path: &Path) -> Result<String, FileError> {
    let bytes = std::fs::read(path).map_err(|error| FileError::io(path, &error))?;
    String::from_utf8(bytes).map_err(|_| {
        FileError::new(path, "not text: expected a calibration in TOML")
            .mend("`taxel calibrate fit --out CAL.toml` writes one")
    })
}

fn head(path: &Path, text: &str) -> Result<Head, FileError> {
    if text.trim().is_empty() {
        return Err(FileError::new(path, "the file is empty: expected a calibration in TOML")
            .mend("`taxel calibrate fit --out CAL.toml` writes one"));
    }
    let head: Head = toml::from_str(text).map_err(|error| toml_error(path, text, &error))?;
    if head.taxel_calibration != VERSION {
        let problem =
            format!("version {} where this build reads {VERSION}", head.taxel_calibration);
        return Err(located(path, text, "taxel_calibration", problem)
            .mend("fit it again with this build, or use the build it was made with"));
    }
    Ok(head)
}

fn open<T: DeserializeOwned>(
    path: &Path,
    text: &str,
    wanted: Kind,
) -> Result<(Head, T), FileError> {
    let head = head(path, text)?;
    if head.kind != wanted {
        let problem =
            format!("a {} calibration where a {} one is needed", head.kind.name(), wanted.name());
        return Err(located(path, text, "kind", problem).mend("give the other file"));
    }
    let file: File<T> = toml::from_str(text).map_err(|error| toml_error(path, text, &error))?;
    Ok((head, file.body))
}

fn text_of<T: Serialize>(path: &Path, kind: Kind, crc: u32, body: &T) -> Result<String, FileError> {
    let file = File { taxel_calibration: VERSION, kind, crc32: format!("{crc:08x}"), body };
    toml::to_string(&file).map_err(|error| FileError::new(path, format!("not written: {error}")))
}

fn check_crc(path: &Path, text: &str, head: &Head, crc: u32) -> Result<(), FileError> {
    if u32::from_str_radix(&head.crc32, 16) == Ok(crc) {
        return Ok(());
    }
    let problem = format!("says {}, the contents give {crc:08x}", head.crc32);
    Err(located(path, text, "crc32", problem)
        .mend("the file was damaged or edited: restore it or fit again"))
}

/// Returns the CRC-32 of a calibration record, which identifies it.
///
/// # Errors
/// The record is not valid.
pub fn record_crc(calibration: &Calibration) -> Result<u32, CalibrationError> {
    let mut buffer = [0; MAX_BYTES];
    let bytes = calibration.to_bytes(&mut buffer)?;
    Ok(bytes.last_chunk().map_or(0, |crc| u32::from_le_bytes(*crc)))
}

fn model_crc<T: Serialize>(path: &Path, model: &T) -> Result<u32, FileError> {
    let bytes = postcard::to_allocvec(model)
        .map_err(|error| FileError::new(path, format!("not a model: {error}")))?;
    Ok(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes))
}

/// Returns an error at the line of an invalid field in its section's table.
fn in_section(path: &Path, text: &str, section: &str, field: &str) -> FileError {
    let table = format!("[{section}]");
    let sensor = section.strip_prefix('s').map(|number| format!("sensor = {number}"));
    let begins = |line: &&str| *line == table || sensor.as_deref() == Some(line);
    let skipped = text.lines().map(str::trim).take_while(|line| !begins(line)).count();
    let rest: String = text.split_inclusive('\n').skip(skipped).collect();
    let error = FileError::new(path, format!("{field} of {section} is out of range")).column(field);
    match line_of(&rest, field) {
        Some(line) => error.line((skipped + line) as u64 + 1),
        None => error,
    }
}

/// Returns the line that sets `key`, counted from 0.
fn line_of(text: &str, key: &str) -> Option<usize> {
    text.lines().position(|line| {
        line.trim_start().strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with('='))
    })
}

/// Returns an error at the line that sets `key`.
fn located(path: &Path, text: &str, key: &str, problem: impl Into<String>) -> FileError {
    let line = line_of(text, key);
    let error = FileError::new(path, problem).column(key);
    match line {
        Some(line) => error.line(line as u64 + 1),
        None => error,
    }
}

fn toml_error(path: &Path, text: &str, error: &toml::de::Error) -> FileError {
    let new = FileError::new(path, error.message())
        .mend("`taxel calibrate fit --out CAL.toml` writes a calibration that fits");
    match error.span() {
        Some(span) => {
            new.line(text.get(..span.start).unwrap_or_default().matches('\n').count() as u64 + 1)
        }
        None => new,
    }
}

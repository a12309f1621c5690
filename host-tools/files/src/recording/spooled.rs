//! Recordings whose rows stand in a file of their own until the end.
//!
//! A Parquet file is unreadable before its end: its rows go to an MCAP file beside it and become
//! Parquet then. A recording that replaces a file goes to one beside it, which takes its name then.
//! After a crash `taxel export` makes the recording of the rows.

use std::path::{Path, PathBuf};

use tempfile::TempPath;

use crate::FileError;
use crate::frames::{Cell, Column};
use crate::recording::header::Header;
use crate::recording::{Existing, Format, Recorder, Recording, Sink, already_exists};
use crate::save::{self, Pending};

/// File that a recording replaces: a symbolic link stays in place, and its target is replaced.
fn target(path: &Path) -> PathBuf {
    let linked = if path.is_symlink() { path.canonicalize().ok() } else { None };
    linked.unwrap_or_else(|| path.to_owned())
}

/// Path of a recording's rows until it ends.
fn spool(path: &Path) -> Result<PathBuf, FileError> {
    let own = match Format::of(path)? {
        Format::Csv => "csv.part.csv",
        Format::Mcap => "mcap.part.mcap",
        Format::Parquet => "parquet.part.mcap",
    };
    Ok(target(path).with_extension(own))
}

/// Rejects a path with rows of a killed recording, which must never be overwritten.
pub(super) fn check(path: &Path) -> Result<(), FileError> {
    #[cfg(not(feature = "recording"))]
    if Format::of(path)? == Format::Parquet {
        return super::absent::refused(path);
    }
    let spool = spool(path)?;
    if !spool.exists() {
        return Ok(());
    }
    let (part, whole) = (spool.display(), path.display());
    let force = if path.is_file() { " --force" } else { "" };
    let mend =
        format!("`taxel export {part} --out {whole}{force}`, then remove it, and record again");
    Err(FileError::new(&spool, "has the rows of a recording that was killed").mend(mend))
}

/// Writer of a stream through a file beside its own.
pub(super) struct Spooled {
    path: PathBuf,
    existing: Existing,
    spool: PathBuf,
    rows: Recorder,
    /// Removes the rows' file until it has a row.
    empty: Option<TempPath>,
}

impl Spooled {
    pub(super) fn create(
        path: &Path,
        header: &Header,
        columns: &[Column],
        existing: Existing,
    ) -> Result<Self, FileError> {
        let spool = spool(path)?;
        let rows = Recorder::derived(&spool, header, columns, Existing::Keep)?;
        let empty = TempPath::try_from_path(&spool);
        let empty = Some(empty.map_err(|error| FileError::io(&spool, &error))?);
        Ok(Self { path: path.to_owned(), existing, spool, rows, empty })
    }
}

impl Sink for Spooled {
    fn write(&mut self, row: &[Cell]) -> Result<(), FileError> {
        if let Some(empty) = self.empty.take() {
            empty.keep().map_err(|error| FileError::io(&self.spool, &error.error))?;
        }
        self.rows.write(row)
    }

    fn flush(&mut self) -> Result<(), FileError> {
        self.rows.flush()
    }

    /// Gives the rows their name and format.
    fn finish(self: Box<Self>) -> Result<(), FileError> {
        let Self { path, existing, spool, rows, empty } = *self;
        rows.finish()?;
        let former = path.metadata().ok().filter(std::fs::Metadata::is_file);
        if empty.is_some() && former.is_some() {
            return Ok(());
        }
        let turned = || {
            if former.is_some() && existing == Existing::Keep {
                return Err(already_exists(&path));
            }
            if Format::of(&path)? != Format::Parquet {
                return save::rename(&spool, &target(&path), former.as_ref())
                    .map_err(|error| FileError::io(&path, &error));
            }
            let pending = Pending::new(&path)?;
            let rows = Recording::open(&spool)?;
            let (to, named) = (pending.path(), |error| pending.named(error));
            let table = Recorder::derived(to, &rows.header, &rows.columns, Existing::Replace);
            let mut table = table.map_err(named)?;
            for row in rows {
                table.write(&row?).map_err(named)?;
            }
            table.finish().map_err(named)?;
            pending.commit()?;
            std::fs::remove_file(&spool).map_err(|error| FileError::io(&spool, &error))
        };
        turned().map_err(|error: FileError| {
            error.mend(format!(
                "all rows are in {}; fix the cause, then `taxel export` it",
                spool.display()
            ))
        })
    }
}

//! MCAP and Parquet in a build without the feature `recording`: every call is refused.

use std::path::Path;

use crate::FileError;
use crate::frames::{Cell, Column};
use crate::recording::{Existing, Header, Recording, Sink};

/// Writer that no build without the feature can create.
pub(crate) enum Writer {}

pub(crate) fn refused<T>(path: &Path) -> Result<T, FileError> {
    Err(FileError::new(path, "this small build knows only .csv").mend(
        "the full command knows .mcap and .parquet: `cargo install --path host-tools/cli` in the repository",
    ))
}

pub(crate) fn open(path: &Path) -> Result<Recording, FileError> {
    refused(path)
}

pub(crate) fn open_from(path: &Path, _: u64) -> Result<Recording, FileError> {
    refused(path)
}

impl Writer {
    pub(crate) fn create(
        path: &Path,
        _: &Header,
        _: &[Column],
        _: Existing,
    ) -> Result<Self, FileError> {
        refused(path)
    }
}

impl Sink for Writer {
    fn write(&mut self, _: &[Cell]) -> Result<(), FileError> {
        match *self {}
    }

    fn flush(&mut self) -> Result<(), FileError> {
        match *self {}
    }

    fn finish(self: Box<Self>) -> Result<(), FileError> {
        match *self {}
    }
}

//! What can be wrong with a file, in one line: where, what was expected, and how to mend it.

use std::fmt;
use std::path::{Path, PathBuf};

/// Something is wrong with a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileError {
    path: PathBuf,
    line: Option<u64>,
    column: Option<String>,
    problem: String,
    mend: Option<String>,
}

impl FileError {
    /// `problem` says what was found and what was expected.
    pub fn new(path: impl AsRef<Path>, problem: impl Into<String>) -> Self {
        Self {
            path: path.as_ref().to_owned(),
            line: None,
            column: None,
            problem: problem.into(),
            mend: None,
        }
    }

    /// On this line of the file, counted from 1.
    #[must_use]
    pub fn line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// In this column or key.
    #[must_use]
    pub fn column(mut self, column: impl Into<String>) -> Self {
        self.column = Some(column.into());
        self
    }

    /// How to mend it.
    #[must_use]
    pub fn mend(mut self, mend: impl Into<String>) -> Self {
        self.mend = Some(mend.into());
        self
    }

    /// An operating-system error on `path`.
    pub fn io(path: impl AsRef<Path>, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let new = Self::new(path, error.to_string());
        match error.kind() {
            ErrorKind::NotFound => new.mend("check the path"),
            ErrorKind::PermissionDenied => new.mend("check who may read or write it"),
            ErrorKind::StorageFull => new.mend("free some space; what was written so far is kept"),
            _ => new,
        }
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        write!(f, ": ")?;
        if let Some(column) = &self.column {
            write!(f, "`{column}`: ")?;
        }
        // One line whatever a library put into it.
        let problem = self.problem.split_whitespace().collect::<Vec<_>>().join(" ");
        write!(f, "{problem}")?;
        if let Some(mend) = &self.mend {
            write!(f, "; {mend}")?;
        }
        Ok(())
    }
}

impl std::error::Error for FileError {}

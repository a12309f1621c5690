//! Errors of files, in one line: where, what was found, what was expected, how to mend it.

use std::fmt;
use std::path::{Path, PathBuf};

/// A fault of a file, with its place and mend.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileError {
    path: PathBuf,
    line: Option<u64>,
    column: Option<String>,
    problem: String,
    mend: Option<String>,
}

impl FileError {
    /// Creates an error; `problem` states the finding and the expectation.
    pub fn new(path: impl AsRef<Path>, problem: impl Into<String>) -> Self {
        Self {
            path: path.as_ref().to_owned(),
            line: None,
            column: None,
            problem: problem.into(),
            mend: None,
        }
    }

    /// Replaces the path, such as that of a temporary file.
    #[must_use]
    pub(crate) fn at(mut self, path: &Path) -> Self {
        path.clone_into(&mut self.path);
        self
    }

    /// Adds the line of the file, counted from 1.
    #[must_use]
    pub fn line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// Adds the column or key.
    #[must_use]
    pub fn column(mut self, column: impl Into<String>) -> Self {
        self.column = Some(column.into());
        self
    }

    /// Adds the mend.
    #[must_use]
    pub fn mend(mut self, mend: impl Into<String>) -> Self {
        self.mend = Some(mend.into());
        self
    }

    /// Creates an error of a CSV writer on `path`.
    pub fn csv(path: impl AsRef<Path>, error: csv::Error) -> Self {
        match error.into_kind() {
            csv::ErrorKind::Io(error) => Self::io(path, &error),
            other => Self::new(path, format!("{other:?}")),
        }
    }

    /// Creates an error of the operating system on `path`.
    pub fn io(path: impl AsRef<Path>, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let new = Self::new(path, error.to_string());
        match error.kind() {
            ErrorKind::NotFound => new.mend("check the path"),
            ErrorKind::PermissionDenied => new.mend("check who may read or write it"),
            ErrorKind::IsADirectory => new.mend("give a file"),
            ErrorKind::InvalidData => new.mend("save it as plain text, UTF-8"),
            ErrorKind::StorageFull => new.mend("free some space"),
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
            write!(f, "`{}`: ", one_line(column))?;
        }
        write!(f, "{}", one_line(&self.problem))?;
        if let Some(mend) = &self.mend {
            write!(f, "; {}", one_line(mend))?;
        }
        Ok(())
    }
}

/// Turns any text into one line of at most 500 characters.
#[must_use]
pub fn one_line(text: &str) -> String {
    const MOST: usize = 500;
    // Rust appends the system's error number, which helps no user.
    let said = text.rfind(" (os error ").filter(|_| text.ends_with(')'));
    let text = &text[..said.unwrap_or(text.len())];
    let words = text.split(|c: char| c.is_whitespace() || c.is_control());
    let line = words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line,
    }
}

impl std::error::Error for FileError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn system_error_drops_its_number() {
        let missing = std::io::Error::from_raw_os_error(2);
        assert!(missing.to_string().contains("os error 2"));
        let said = FileError::io("a.csv", &missing).to_string();
        assert!(said.starts_with("a.csv: ") && said.ends_with("; check the path"), "{said}");
        assert!(!said.contains("os error"), "{said}");
    }

    #[test]
    fn error_of_any_file_is_one_line() {
        let error = FileError::new("a.csv", "found `x\ny\u{1b}[2J`")
            .line(3)
            .column("m\n0")
            .mend("remove\tit");
        assert_eq!(error.to_string(), "a.csv:3: `m 0`: found `x y [2J`; remove it");
        let long = FileError::new("a.csv", "x".repeat(9999)).to_string();
        assert!(long.len() < 600, "{}", long.len());
    }
}

//! `FILE@FROM..TO`: a recording, or a time range of it in seconds.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::error::FileError;

/// A file and a time range of it, in seconds of the recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// Path of the recording.
    pub path: PathBuf,
    from: f64,
    to: f64,
}

impl Stretch {
    /// Selects the whole file.
    pub fn whole(path: impl AsRef<Path>) -> Self {
        Self { path: path.as_ref().to_owned(), from: f64::NEG_INFINITY, to: f64::INFINITY }
    }

    /// Begin in seconds; negative infinity if it is open.
    #[must_use]
    pub fn from(&self) -> f64 {
        self.from
    }

    /// Returns a frame's time in seconds as it is read from its decimal text, to the bit.
    #[must_use]
    pub fn seconds(micros: u64) -> f64 {
        micros as f64 / 1e6
    }

    /// Returns whether `seconds` lies in the range, from FROM to before TO.
    #[must_use]
    pub fn contains(&self, seconds: f64) -> bool {
        (self.from..self.to).contains(&seconds)
    }

    /// Returns whether `seconds` is at or after the range's end.
    #[must_use]
    pub fn ended(&self, seconds: f64) -> bool {
        seconds >= self.to
    }

    /// Returns the error for a range without rows; `all` is the file's first and last time.
    #[must_use]
    pub fn without_rows(&self, all: Option<(f64, f64)>) -> FileError {
        let whole = *self == Self::whole(&self.path);
        match all {
            Some((first, last)) if !whole => {
                let problem = format!(
                    "no rows {}: those of the recording lie between {first} and {last} s",
                    self.range()
                );
                FileError::new(&self.path, problem).mend("check the stretch FILE@FROM..TO")
            }
            _ => FileError::new(&self.path, "no rows after the line of column names")
                .mend("give a recording with rows"),
        }
    }

    fn range(&self) -> String {
        let end = |word: &str, end: f64| {
            if end.is_finite() { format!(" {word} {end} s") } else { String::new() }
        };
        format!("{}{}", end("from", self.from), end("to", self.to)).trim_start().to_owned()
    }
}

impl FromStr for Stretch {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // A path may hold an `@`; only a range after it selects a part.
        let Some((path, range)) = text.rsplit_once('@').filter(|(_, range)| range.contains(".."))
        else {
            return Ok(Self::whole(text));
        };
        let (from, to) = range.split_once("..").unwrap_or((range, ""));
        let seconds = |text: &str, open: f64| match text.trim() {
            "" => Ok(open),
            text => text.parse::<f64>().ok().filter(|s| s.is_finite()).ok_or_else(|| {
                format!(
                    "`{text}` is not a time in seconds; write FILE@FROM..TO, as in press.csv@0..30"
                )
            }),
        };
        let from = seconds(from, f64::NEG_INFINITY)?;
        let to = seconds(to, f64::INFINITY)?;
        if from >= to {
            return Err(format!("the stretch {range} is empty: FROM must be less than TO"));
        }
        Ok(Self { path: path.into(), from, to })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn range_is_half_open_with_optional_ends() {
        let stretch: Stretch = "a/b.csv@0.5..30".parse().unwrap();
        assert_eq!(stretch.path, Path::new("a/b.csv"));
        assert!(stretch.contains(0.5) && !stretch.contains(30.0) && stretch.ended(30.0));
        let tail: Stretch = "b.csv@30..".parse().unwrap();
        assert!(tail.contains(1e9) && !tail.contains(29.9));
        let head: Stretch = "b.csv@..3".parse().unwrap();
        assert!(head.contains(0.0) && !head.contains(3.0));
    }

    #[test]
    fn time_as_printed_is_the_time_of_its_frame() {
        for micros in (0..20_000_000).step_by(999) {
            let printed = format!("a.csv@{}.{:06}..", micros / 1_000_000, micros % 1_000_000);
            let stretch: Stretch = printed.parse().unwrap();
            assert!(stretch.contains(Stretch::seconds(micros)), "{printed}");
            let before: Stretch =
                printed.replace('@', "@..").trim_end_matches("..").parse().unwrap();
            assert!(!before.contains(Stretch::seconds(micros)), "{printed}");
        }
    }

    #[test]
    fn at_sign_in_a_path_is_no_range() {
        let stretch: Stretch = "me@home.csv".parse().unwrap();
        assert_eq!(stretch, Stretch::whole("me@home.csv"));
    }

    #[test]
    fn invalid_range_is_an_error_with_mend() {
        for text in ["a.csv@x..3", "a.csv@5..5", "a.csv@9..1", "a.csv@NaN..1"] {
            assert!(text.parse::<Stretch>().is_err(), "{text}");
        }
    }
}

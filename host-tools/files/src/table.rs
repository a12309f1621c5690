//! Tables: any CSV file with a header and numeric input, reference and time columns.

use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::error::FileError;
use crate::lines::Lines;
use crate::number;
use crate::stretch::Stretch;

/// Selected columns of a CSV file as numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Path of the file.
    pub path: PathBuf,
    /// Names of the columns, in the requested order.
    pub names: Vec<String>,
    /// Names of the columns that were not requested, without those of the time.
    pub others: Vec<String>,
    /// Rows of numbers, one for each column.
    pub rows: Vec<Vec<f64>>,
    /// Time of each row in seconds; empty where the file has no time column.
    pub times: Vec<f64>,
}

impl Table {
    /// Keeps only the columns whose names `wanted` accepts.
    pub fn keep(&mut self, mut wanted: impl FnMut(&str) -> bool) {
        let kept: Vec<usize> = (0..self.names.len()).filter(|i| wanted(&self.names[*i])).collect();
        let pick = |row: &Vec<f64>| kept.iter().map(|i| row[*i]).collect();
        self.rows = self.rows.iter().map(pick).collect();
        self.names = kept.iter().map(|i| self.names[*i].clone()).collect();
    }
}

/// Reads the columns that match `patterns` over a time range of a file.
///
/// In a pattern, `*` stands for any text. Columns come in the order of the patterns, and within a
/// pattern in that of the file. The time is the column `t_s` or `t_us`; a file without it
/// can only be read whole.
///
/// # Errors
/// The file cannot be read, a pattern matches nothing, a cell holds no measured number, time runs
/// backwards, or the range has no rows.
pub fn read(stretch: &Stretch, patterns: &[&str]) -> Result<Table, FileError> {
    let path = &stretch.path;
    let file = std::fs::File::open(path).map_err(|error| FileError::io(path, &error))?;
    read_from(file, stretch, patterns)
}

/// Reads a table from any source as [`read`] does; the path is only for messages.
///
/// # Errors
/// As [`read`].
pub fn read_from(
    source: impl Read,
    stretch: &Stretch,
    patterns: &[&str],
) -> Result<Table, FileError> {
    let path = stretch.path.as_path();
    let mut lines = Lines::new(BufReader::new(source), path);
    let mut names = StringRecord::new();
    let Some(line) = lines.next(&mut names, |_, _| Ok(()))? else {
        return Err(FileError::new(path, "no header: the file is empty")
            .mend("the first line names the columns"));
    };
    let columns = select((&names, line), patterns, path)?;
    let time = time_column(&names);
    if time.is_none() && *stretch != Stretch::whole(path) {
        return Err(FileError::new(path, "the column is missing")
            .line(line)
            .column("t_s")
            .mend("a stretch FILE@FROM..TO needs a time column, `t_s` or `t_us`"));
    }
    let mut table = Table {
        path: path.to_owned(),
        names: columns.iter().map(|at| names[*at].to_owned()).collect(),
        others: (0..names.len())
            .filter(|at| !columns.contains(at) && !is_time(&names[*at]))
            .map(|at| names[at].to_owned())
            .collect(),
        rows: Vec::new(),
        times: Vec::new(),
    };
    let mut record = StringRecord::new();
    let mut all: Option<(f64, f64)> = None;
    while let Some(line) = lines.next_row(&mut record, names.len())? {
        let number = |at: usize, read: fn(&str) -> Result<f64, String>| {
            read(&record[at]).map_err(|problem| {
                FileError::new(path, problem)
                    .line(line)
                    .column(&names[at])
                    .mend("correct the cell, remove the line, or leave the column out")
            })
        };
        if let Some((at, ticks)) = time {
            let seconds = number(at, number::finite)? / ticks;
            if let Some((_, last)) = all.filter(|(_, last)| seconds < *last) {
                // Times compare in whole microseconds, the resolution of every clock here.
                let [last, now] = [last, seconds].map(|t| (1e6 * t).round() / 1e6);
                return Err(FileError::new(path, format!("after {last} s comes {now} s"))
                    .line(line)
                    .column(&names[at])
                    .mend(
                        "sort the rows by their time, or cut the file where its clock began again",
                    ));
            }
            all = Some((all.map_or(seconds, |(first, _)| first), seconds));
            if !stretch.contains(seconds) {
                continue;
            }
            table.times.push(seconds);
        }
        let row = columns
            .iter()
            .map(|at| {
                number(*at, if is_time(&names[*at]) { number::finite } else { number::measured })
            })
            .collect::<Result<_, _>>()?;
        table.rows.push(row);
    }
    if table.rows.is_empty() {
        return Err(stretch.without_rows(all));
    }
    Ok(table)
}

/// Returns whether a column holds times: `t_s` or `t_us`.
#[must_use]
pub fn is_time(name: &str) -> bool {
    ticks_a_second(name).is_some()
}

/// Returns the number of a time column's units in a second.
fn ticks_a_second(name: &str) -> Option<f64> {
    match name {
        "t_s" => Some(1.0),
        "t_us" => Some(1e6),
        _ => None,
    }
}

fn time_column(names: &StringRecord) -> Option<(usize, f64)> {
    names.iter().enumerate().find_map(|(at, name)| Some((at, ticks_a_second(name)?)))
}

fn select(
    (names, line): (&StringRecord, u64),
    patterns: &[&str],
    path: &Path,
) -> Result<Vec<usize>, FileError> {
    let mut columns = Vec::new();
    for pattern in patterns {
        let found: Vec<usize> =
            (0..names.len()).filter(|at| matches(pattern, &names[*at])).collect();
        if found.is_empty() {
            let some: Vec<&str> = names.iter().take(6).collect();
            let more = if names.len() > some.len() { " …" } else { "" };
            return Err(FileError::new(path, "no column matches")
                .line(line)
                .column(*pattern)
                .mend(format!("this file has {}{more}", some.join(", "))));
        }
        let twice = |at: &&usize| names.iter().filter(|name| *name == &names[**at]).count() > 1;
        if let Some(at) = found.iter().find(twice) {
            return Err(FileError::new(path, "duplicate column")
                .line(line)
                .column(&names[*at])
                .mend("remove one of them"));
        }
        columns.extend(found.into_iter().filter(|at| !columns.contains(at)).collect::<Vec<_>>());
    }
    Ok(columns)
}

/// Matches a name against a pattern, in which `*` stands for any text.
fn matches(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == name,
        Some((head, tail)) => name.strip_prefix(head).is_some_and(|rest| {
            rest.char_indices()
                .map(|(at, _)| at)
                .chain([rest.len()])
                .any(|at| matches(tail, &rest[at..]))
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str, stretch: &str, patterns: &[&str]) -> Result<Table, String> {
        read_from(text.as_bytes(), &stretch.parse().unwrap(), patterns).map_err(|e| e.to_string())
    }

    #[test]
    fn patterns_select_columns_and_range_rows() {
        let text = "t_s,m0,force_n,m1\n0,1,2,3\n1,4,5,6\n2,7,8,9\n";
        let table = read_text(text, "a.csv@1..2", &["m*", "force_n"]).unwrap();
        assert_eq!(table.names, ["m0", "m1", "force_n"]);
        assert!(table.others.is_empty());
        assert_eq!(read_text(text, "a.csv", &["m1"]).unwrap().others, ["m0", "force_n"]);
        assert_eq!(table.rows, [[4.0, 6.0, 5.0]]);
        assert_eq!(table.times, [1.0]);
    }

    #[test]
    fn star_matches_any_text_anywhere() {
        for (pattern, name, fits) in [
            ("m*", "m12", true),
            ("*_n", "force_n", true),
            ("a*c*e", "abcde", true),
            ("m*", "xm", false),
            ("m1", "m12", false),
            ("*", "", true),
        ] {
            assert_eq!(matches(pattern, name), fits, "{pattern} {name}");
        }
    }

    #[test]
    fn bad_cells_name_line_and_column() {
        let cases = [
            ("", "a.csv: no header: the file is empty; the first line names the columns"),
            (
                "m0\nx\n",
                "a.csv:2: `m0`: expected a finite number, found `x`; correct the cell, remove the line, or leave the column out",
            ),
            (
                "m0\nNaN\n",
                "a.csv:2: `m0`: expected a finite number, found `NaN`; correct the cell, remove the line, or leave the column out",
            ),
            (
                "m0,b\n1,2\n3\n",
                "a.csv:3: 1 fields where the header has 2; complete or remove the line; a recording cut short often ends in one",
            ),
            ("b,c\n1,2\n", "a.csv:1: `m*`: no column matches; this file has b, c"),
        ];
        for (text, message) in cases {
            assert_eq!(read_text(text, "a.csv", &["m*"]).unwrap_err(), message);
        }
    }

    #[test]
    fn backward_time_is_an_error() {
        let error = read_text("t_us,m0\n10,1\n30,1\n20,1\n", "a.csv", &["m0"]).unwrap_err();
        let said = "a.csv:4: `t_us`: after 0.00003 s comes 0.00002 s; sort the rows by their time, or cut the file \
                    where its clock began again";
        assert_eq!(error, said);
        let table = read_text("t_s,m0\n1,1\n1,2\n2,3\n", "a.csv", &["m0"]).unwrap();
        assert_eq!(table.times, [1.0, 1.0, 2.0]);
    }

    #[test]
    fn blank_lines_and_comments_count_as_lines() {
        let error = read_text("\n# made by hand\nm0\n\n1\n\n\nx\n", "a.csv", &["m0"]).unwrap_err();
        assert!(error.starts_with("a.csv:8: "), "{error}");
    }

    proptest::proptest! {
        #[test]
        fn reader_accepts_any_bytes(
            bytes in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..300),
            text in "[mt_s0-9,.#\"\n -]{0,200}",
        ) {
            let _ = read_from(&bytes[..], &Stretch::whole("x"), &["m*"]);
            let _ = read_from(text.as_bytes(), &Stretch::whole("x"), &["m*", "t_s"]);
        }
    }

    #[test]
    fn range_of_a_file_without_time_is_an_error() {
        let error = read_text("m0\n1\n", "a.csv@0..1", &["m0"]).unwrap_err();
        assert!(error.contains("t_s"), "{error}");
    }
}

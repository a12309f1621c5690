//! Forms of the bench protocol: expectations of a board, with the values measured on it.
//!
//! `cargo xtask pages` makes the blank forms of `docs/`. A filled-in form is compared with the
//! blank one of its board, so that nobody judges by limits that were changed by hand.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use csv::StringRecord;

use crate::error::FileError;
use crate::lines::Lines;
use crate::number;

/// Boards with their blank forms.
const BLANK: [(&str, &str); 2] = [
    ("stm32g431", include_str!("../../../docs/bench-stm32g431.csv")),
    ("stm32f411", include_str!("../../../docs/bench-stm32f411.csv")),
];

/// Keys of the lines at the top, `# KEY=VALUE`; the board is the first.
pub const HEAD: [&str; 7] =
    ["board", "serial", "firmware", "commit", "force_sensors", "date", "by"];

/// Columns of a form; those up to the unit are the same as in the blank form.
const COLUMNS: [&str; 10] =
    ["step", "check", "expected", "min", "max", "matrix_max", "unit", "measured", "passed", "note"];

/// Form of a board, all steps of its blank form in their order.
#[derive(Clone, Debug, PartialEq)]
pub struct Form {
    /// Values of [`HEAD`]; empty where nobody gave one.
    pub head: [String; HEAD.len()],
    /// All steps of the blank form.
    pub steps: Vec<Step>,
}

impl Form {
    /// Value of a key of [`HEAD`]; empty where nobody gave one.
    #[must_use]
    pub fn head(&self, key: &str) -> &str {
        given(&self.head, key)
    }

    /// Whether the finger is said to have no force sensors.
    #[must_use]
    pub fn is_matrix_alone(&self) -> bool {
        self.head("force_sensors") == "0"
    }
}

/// Value of a key of [`HEAD`] among the values of a form; empty where nobody gave one.
#[must_use]
pub fn given<'h>(head: &'h [String; HEAD.len()], key: &str) -> &'h str {
    HEAD.iter().position(|known| *known == key).map_or("", |at| &head[at])
}

/// Expectation, and what was found of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Name, such as `B2`, or `B8a` where a step has several expectations.
    pub step: String,
    /// Subject of the step.
    pub check: String,
    /// Expectation in words.
    pub expected: String,
    /// `None` where a person judges by the words of the expectation.
    pub limits: Option<Limits>,
    /// Cells that were filled in.
    pub found: Found,
}

/// Range of a measured number.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Lowest value that is met.
    pub min: f64,
    /// Highest value that is met.
    pub max: f64,
    /// Highest value of a finger without force sensors, where it is another.
    pub matrix_max: Option<f64>,
    /// Unit of all of them and of the measured number.
    pub unit: String,
}

/// Cells that the person at the bench filled in; empty ones are `None` or an empty text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Number, or words on what was seen.
    pub measured: String,
    /// Number of `measured`, where the step has limits.
    pub value: Option<f64>,
    /// Verdict of the person at the bench.
    pub passed: Option<bool>,
    /// Anything else.
    pub note: String,
}

/// Reads a form.
///
/// # Errors
/// The file is no form, its board or a step is unknown or stands twice, an expectation is not that
/// of the blank form, or a cell holds neither nothing nor what its column takes.
pub fn read(path: &Path) -> Result<Form, FileError> {
    let file = File::open(path).map_err(|error| FileError::io(path, &error))?;
    parse(BufReader::new(file), path)
}

fn parse(source: impl BufRead, path: &Path) -> Result<Form, FileError> {
    let (head, rows) = rows(source, path)?;
    let board = head[0].as_str();
    let Some((_, blank)) = BLANK.iter().find(|(known, _)| *known == board) else {
        let boards = BLANK.map(|(board, _)| board).join(" or ");
        let found = if board.is_empty() { "none".to_owned() } else { format!("`{board}`") };
        return Err(FileError::new(path, format!("expected {boards}, found {found}"))
            .column("# board=")
            .mend("begin the file with a line such as `# board=stm32g431`"));
    };
    let mend = || format!("copy your values into the form of this version, docs/bench-{board}.csv");
    let (_, blank) = self::rows(blank.as_bytes(), path)?;
    let steps: Result<Vec<Step>, FileError> = blank.iter().map(|row| row.step(path)).collect();
    let mut steps = steps?;
    let mut lines: Vec<Option<u64>> = vec![None; steps.len()];
    for row in rows {
        let (name, last) = (row.cell("step"), steps.last().map_or("", |step| &step.step));
        let found = steps.iter().position(|step| step.step == name);
        let at = found.ok_or_else(|| {
            let problem = format!("unknown step `{name}`: expected one of {board}'s, up to {last}");
            row.error(path, "step", problem).mend(mend())
        })?;
        if let Some(first) = lines[at].replace(row.line) {
            let problem = format!("step `{name}` stands in line {first} already");
            return Err(row
                .error(path, "step", problem)
                .mend("keep the row that counts, remove the other"));
        }
        row.is_as_in(&steps[at], path).map_err(|error| error.mend(mend()))?;
        steps[at].found = row.found(steps[at].limits.as_ref(), path)?;
    }
    Ok(Form { head, steps })
}

/// Row of a form with its line.
struct Row {
    line: u64,
    cells: [String; COLUMNS.len()],
}

impl Row {
    fn cell(&self, column: &str) -> &str {
        COLUMNS.iter().position(|known| *known == column).map_or("", |at| &self.cells[at])
    }

    fn error(&self, path: &Path, column: &str, problem: impl Into<String>) -> FileError {
        FileError::new(path, problem).line(self.line).column(column)
    }

    /// Number of a cell, `None` if it is empty.
    fn number(&self, path: &Path, column: &str) -> Result<Option<f64>, FileError> {
        // Spreadsheets and people write the sign of typography.
        let text = self.cell(column).replace('−', "-");
        let number = (!text.is_empty()).then(|| number::measured(&text)).transpose();
        number.map_err(|problem| self.error(path, column, problem))
    }

    /// Limits, `None` for a step that is judged by words.
    fn limits(&self, path: &Path) -> Result<Option<Limits>, FileError> {
        let [min, max, matrix_max] =
            ["min", "max", "matrix_max"].map(|column| self.number(path, column));
        let (Some(min), Some(max)) = (min?, max?) else { return Ok(None) };
        Ok(Some(Limits { min, max, matrix_max: matrix_max?, unit: self.cell("unit").to_owned() }))
    }

    /// Step of a blank form.
    fn step(&self, path: &Path) -> Result<Step, FileError> {
        let [step, check, expected] =
            ["step", "check", "expected"].map(|column| self.cell(column).to_owned());
        Ok(Step { step, check, expected, limits: self.limits(path)?, found: Found::default() })
    }

    /// Compares check and limits with those of the blank form. The words of the expectation may
    /// have suffered in a spreadsheet.
    fn is_as_in(&self, blank: &Step, path: &Path) -> Result<(), FileError> {
        let differs = |column: &str, expected: String| {
            let expected = if expected.is_empty() { "nothing" } else { &expected };
            let found = Some(self.cell(column)).filter(|cell| !cell.is_empty());
            let found = found.unwrap_or("nothing");
            self.error(path, column, format!("expected {expected}, found {found}"))
        };
        if self.cell("check") != blank.check {
            return Err(differs("check", blank.check.clone()));
        }
        let limits = blank.limits.as_ref();
        let expected = [
            ("min", limits.map(|limits| limits.min)),
            ("max", limits.map(|limits| limits.max)),
            ("matrix_max", limits.and_then(|limits| limits.matrix_max)),
        ];
        for (column, limit) in expected {
            if self.number(path, column)? != limit {
                return Err(differs(column, limit.map(|l| l.to_string()).unwrap_or_default()));
            }
        }
        match limits {
            Some(limits) if self.cell("unit") != limits.unit => {
                Err(differs("unit", limits.unit.clone()))
            }
            _ => Ok(()),
        }
    }

    fn found(&self, limits: Option<&Limits>, path: &Path) -> Result<Found, FileError> {
        let value = match limits {
            Some(limits) => self.number(path, "measured").map_err(|error| {
                error.mend(format!(
                    "write the number alone, in {}; words belong in `note`",
                    limits.unit
                ))
            })?,
            None => None,
        };
        let passed = match self.cell("passed") {
            "1" => Some(true),
            "0" => Some(false),
            "" => None,
            other => {
                let problem = format!("expected 1, 0 or nothing, found `{other}`");
                return Err(self
                    .error(path, "passed", problem)
                    .mend("1 is passed, 0 is failed; leave it empty if you did not get to it"));
            }
        };
        let [measured, note] = ["measured", "note"].map(|column| self.cell(column).to_owned());
        Ok(Found { measured, value, passed, note })
    }
}

type Head = [String; HEAD.len()];

/// Reads the lines at the top and the rows that are not blank.
fn rows(source: impl BufRead, path: &Path) -> Result<(Head, Vec<Row>), FileError> {
    let mut head = Head::default();
    let mut given = [false; HEAD.len()];
    let mut lines = Lines::new(source, path);
    let mut record = StringRecord::new();
    let mut top = |words: &str, line: u64| {
        // A spreadsheet fills the line up with separators, and quotes a text with a comma.
        let words = words.trim_end_matches([',', ';', '\t']).trim().trim_matches('"');
        let Some((key, value)) = words.split_once('=') else { return Ok(()) };
        let error = |problem: String, mend: &str| {
            Err(FileError::new(path, problem).line(line).column(format!("# {key}=")).mend(mend))
        };
        let Some(at) = HEAD.iter().position(|known| *known == key.trim()) else {
            let known = HEAD.join(", ");
            return error(
                format!("unknown: expected a bench form, whose first lines are {known}"),
                "give a filled-in docs/bench-BOARD.csv, or write remarks without `=`",
            );
        };
        if std::mem::replace(&mut given[at], true) {
            return error("stands twice".to_owned(), "keep one of the lines");
        }
        value.trim().clone_into(&mut head[at]);
        Ok(())
    };
    let line = loop {
        let Some(line) = lines.next(&mut record, &mut top)? else {
            return Err(FileError::new(path, "no header: expected a bench form")
                .mend("give a filled-in docs/bench-BOARD.csv"));
        };
        // A spreadsheet quotes a line at the top that has a comma.
        match record.get(0).and_then(|first| first.strip_prefix('#')) {
            Some(words) => top(words, line)?,
            None => break line,
        }
    };
    let mut at = [0; COLUMNS.len()];
    for (column, at) in COLUMNS.iter().zip(&mut at) {
        let mut found =
            record.iter().enumerate().filter(|(_, name)| name.trim() == *column).map(|(at, _)| at);
        let error = |problem| FileError::new(path, problem).line(line).column(*column);
        *at = found.next().ok_or_else(|| {
            error("the column is missing: expected a bench form").mend(format!(
                "name the columns as docs/bench-BOARD.csv does: {}",
                COLUMNS.join(",")
            ))
        })?;
        if found.next().is_some() {
            return Err(error("duplicate column").mend("remove one of them"));
        }
    }
    let (fields, mut rows) = (record.len(), Vec::new());
    while let Some(line) = lines.next_row(&mut record, fields)? {
        let cells = at.map(|at| record.get(at).unwrap_or_default().trim().to_owned());
        if cells.iter().any(|cell| !cell.is_empty()) {
            rows.push(Row { line, cells });
        }
    }
    Ok((head, rows))
}

#[cfg(test)]
mod tests;

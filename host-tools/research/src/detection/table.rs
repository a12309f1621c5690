//! Rows of the table `detection.csv`.

use std::collections::HashMap;
use std::fmt::Write as _;

use anyhow::Context;

use super::bench::{Has, Phase};
use super::judge::{Case, Frame};
use crate::faults::Kind;

/// Class of the rows of sound scenes.
pub(super) const CLEAN: &str = "clean";

/// Figures of one kind of fault in one phase on one finger, or of one sound scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Kind of fault, or scene.
    pub kind: String,
    /// Kind of place.
    pub place: String,
    /// Class of the fault, or `clean`.
    pub class: String,
    /// Moment at which the fault starts.
    pub phase: String,
    /// Parts of the finger.
    pub finger: String,
    /// Number of cases: places, devices and touches. Of a sound scene, the number of frames.
    pub cases: u64,
    /// Cases with any flag of a fault; frames of a sound scene with one.
    pub flagged: u64,
    /// Cases in which the right channel and no other is named.
    pub named: u64,
    /// Those within the time that the class asks for.
    pub in_time: u64,
    /// Cases in which a sound channel is named. Of a sound scene, the flagged frames less those
    /// whose taxels light has clipped.
    pub wrong: u64,
    /// Time to the naming frame in ms: half of the named cases, and the slowest of them.
    pub median_ms: Option<f64>,
    /// Slowest of the named cases in ms.
    pub worst_ms: Option<f64>,
    /// Share of frames that are withheld or flagged, in per cent.
    pub withheld: f64,
    /// Share of frames that are off by more than the limit without a flag, in per cent.
    pub silent: f64,
    /// Error of force in frames without a flag in mN: 99 of 100, and the largest.
    pub p99_mn: Option<f64>,
    /// Largest error of force in frames without a flag in mN.
    pub max_mn: Option<f64>,
    /// Cases with a slide that the sound run does not have.
    pub slides: u64,
    /// Cases with a slip warning that the sound run does not have.
    pub warnings: u64,
}

const HEADER: &str = "kind,place,class,phase,finger,cases,flagged,named,in_time,wrong,median_ms,\
                      worst_ms,withheld_percent,silent_percent,error_p99_mn,error_max_mn,false_slides,\
                      false_slip_warnings\n";

impl Row {
    pub(super) fn of_cases(kind: Kind, has: Has, phase: Phase, cases: &[Case]) -> Self {
        let count =
            |holds: &dyn Fn(&Case) -> bool| cases.iter().filter(|c| holds(c)).count() as u64;
        let times = sorted(cases.iter().filter_map(|case| case.named_ms).collect());
        let in_time = |ms: f64| kind.class.aim_ms().is_none_or(|aim| ms <= aim);
        let errors = cases.iter().flat_map(|case| &case.errors);
        let errors = sorted(errors.map(|error| 1e3 * f64::from(*error)).collect());
        let sum = |of: fn(&Case) -> usize| cases.iter().map(of).sum::<usize>() as f64;
        let frames = sum(|case| case.frames).max(1.0);
        let silent = errors.iter().filter(|error| **error > has.limit_mn()).count() as f64;
        Self {
            kind: kind.name.into(),
            place: kind.place.name().into(),
            class: kind.class.name().into(),
            phase: phase.name().into(),
            finger: has.name().into(),
            cases: cases.len() as u64,
            flagged: count(&|case| case.flagged_ms.is_some()),
            named: times.len() as u64,
            in_time: count(&|case| case.named_ms.is_some_and(in_time)),
            wrong: count(&|case| case.wrong),
            median_ms: at_share(&times, 0.5),
            worst_ms: times.last().copied(),
            withheld: 100.0 * sum(|case| case.withheld) / frames,
            silent: 100.0 * silent / frames,
            p99_mn: at_share(&errors, 0.99),
            max_mn: errors.last().copied(),
            slides: count(&|case| case.slides),
            warnings: count(&|case| case.warns),
        }
    }

    /// Row of a sound scene before its first frame.
    pub(super) fn clean(scene: &str, has: Has) -> Self {
        Self {
            kind: scene.into(),
            place: "scene".into(),
            class: CLEAN.into(),
            phase: "whole".into(),
            finger: has.name().into(),
            ..Self::default()
        }
    }

    /// Counts a frame of a sound scene. A flag for taxels that light has `clipped` is no false one.
    pub(super) fn add_clean(&mut self, frame: &Frame, clipped: u32) {
        let before = self.withheld * self.cases as f64;
        self.cases += 1;
        self.flagged += u64::from(frame.fault);
        let explained = frame.named != 0 && frame.named & !clipped == 0 && !frame.unclipped;
        self.wrong += u64::from(frame.fault && !explained);
        let doubted = if frame.doubted { 100.0 } else { 0.0 };
        self.withheld = (before + doubted) / self.cases as f64;
    }

    /// Returns whether the row is that of a sound scene.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.class == CLEAN
    }
}

/// Fingers by their names, with the aim for the largest error of force without a flag, in mN.
pub(super) const LIMITS: [(&str, f64); 2] =
    [(Has::Matrix.name(), Has::Matrix.limit_mn()), (Has::Sensors.name(), Has::Sensors.limit_mn())];

/// One kind of fault at one kind of place, all phases and fingers together.
pub(super) struct Fault<'r> {
    pub place: &'r str,
    pub kind: &'r str,
    pub rows: Vec<&'r Row>,
}

impl Fault<'_> {
    fn of(&self, finger: &str) -> impl Iterator<Item = &Row> + Clone {
        self.rows.iter().copied().filter(move |row| row.finger == finger)
    }

    /// Returns whether the finger has the place.
    pub fn is_of(&self, finger: &str) -> bool {
        self.of(finger).next().is_some()
    }

    /// Returns the largest of a figure of one finger.
    pub fn most(&self, finger: &str, figure: fn(&Row) -> Option<f64>) -> Option<f64> {
        self.of(finger).filter_map(figure).reduce(f64::max)
    }

    /// Largest share of frames that are off by more than the limit without a flag, in per cent.
    pub fn silent(&self) -> f64 {
        LIMITS.iter().filter_map(|(finger, _)| self.silent_of(finger)).fold(0.0, f64::max)
    }

    /// That share of one finger, the mean of the phases.
    pub fn silent_of(&self, finger: &str) -> Option<f64> {
        let n = self.of(finger).count();
        (n > 0).then(|| self.of(finger).map(|row| row.silent).sum::<f64>() / n as f64)
    }
}

/// Groups the rows of faults by kind and place, in their order.
pub(super) fn faults(rows: &[Row]) -> Vec<Fault<'_>> {
    let mut faults: Vec<Fault<'_>> = Vec::new();
    for row in rows.iter().filter(|row| !row.is_clean()) {
        let of = |fault: &&mut Fault<'_>| fault.place == row.place && fault.kind == row.kind;
        match faults.iter_mut().find(of) {
            Some(fault) => fault.rows.push(row),
            None => faults.push(Fault { place: &row.place, kind: &row.kind, rows: vec![row] }),
        }
    }
    faults
}

fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values
}

/// Value below which this share of the sorted values lies.
fn at_share(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((share * last as f64).ceil() as usize).copied()
}

/// Formats the table.
#[must_use]
pub fn csv(rows: &[Row]) -> String {
    let cell = |value: Option<f64>, digits: usize| {
        value.map(|value| format!("{value:.digits$}")).unwrap_or_default()
    };
    let mut text = HEADER.to_owned();
    for row in rows {
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "\"{}\",{},{},{},{},{},{},{},{},{},{},{},{:.2},{:.2},{},{},{},{}",
            row.kind,
            row.place,
            row.class,
            row.phase,
            row.finger,
            row.cases,
            row.flagged,
            row.named,
            row.in_time,
            row.wrong,
            cell(row.median_ms, 2),
            cell(row.worst_ms, 2),
            row.withheld,
            row.silent,
            cell(row.p99_mn, 1),
            cell(row.max_mn, 1),
            row.slides,
            row.warnings
        );
    }
    text
}

/// Reads the table.
///
/// # Errors
/// A column is missing or no number.
pub fn parse(text: &str) -> anyhow::Result<Vec<Row>> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let rows = reader.deserialize().map(|row| {
        let row: HashMap<String, String> = row?;
        let word = |name: &str| row.get(name).cloned().with_context(|| format!("no column {name}"));
        let count = |name: &str| -> anyhow::Result<u64> { Ok(word(name)?.parse()?) };
        let figure = |name: &str| -> anyhow::Result<Option<f64>> {
            let word = word(name)?;
            Ok(if word.is_empty() { None } else { Some(word.parse()?) })
        };
        Ok(Row {
            kind: word("kind")?,
            place: word("place")?,
            class: word("class")?,
            phase: word("phase")?,
            finger: word("finger")?,
            cases: count("cases")?,
            flagged: count("flagged")?,
            named: count("named")?,
            in_time: count("in_time")?,
            wrong: count("wrong")?,
            median_ms: figure("median_ms")?,
            worst_ms: figure("worst_ms")?,
            withheld: figure("withheld_percent")?.unwrap_or_default(),
            silent: figure("silent_percent")?.unwrap_or_default(),
            p99_mn: figure("error_p99_mn")?,
            max_mn: figure("error_max_mn")?,
            slides: count("false_slides")?,
            warnings: count("false_slip_warnings")?,
        })
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::KINDS;

    fn case(named_ms: Option<f64>, errors: &[f32]) -> Case {
        Case { named_ms, errors: errors.to_vec(), frames: 4, withheld: 1, ..Case::default() }
    }

    #[test]
    fn row_counts_cases_in_time() {
        let total = *KINDS.iter().find(|kind| kind.class.aim_ms() == Some(0.0)).unwrap();
        let cases = [case(Some(0.0), &[0.01]), case(Some(3.0), &[0.5]), case(None, &[])];
        let row = Row::of_cases(total, Has::Matrix, Phase::Loaded, &cases);
        assert_eq!((row.cases, row.named, row.in_time), (3, 2, 1));
        assert_eq!((row.worst_ms, row.withheld), (Some(3.0), 25.0));
        // One frame of twelve is off by more than 50 mN.
        assert!((row.silent - 100.0 / 12.0).abs() < 1e-9);
        assert!((row.max_mn.unwrap() - 500.0).abs() < 1e-3);
    }

    #[test]
    fn table_is_read_as_written() {
        let total = *KINDS.first().unwrap();
        let row = Row::of_cases(total, Has::Sensors, Phase::Onset, &[case(None, &[])]);
        let mut clean = Row::clean("press", Has::Matrix);
        let flagged = Frame { fault: true, doubted: true, named: 1 << 3, ..Frame::default() };
        clean.add_clean(&flagged, 0);
        clean.add_clean(&flagged, 1 << 3 | 1 << 7);
        clean.add_clean(&Frame { unclipped: true, ..flagged }, 1 << 3);
        clean.add_clean(&Frame::default(), 0);
        assert_eq!((clean.cases, clean.flagged, clean.wrong, clean.withheld), (4, 3, 2, 75.0));
        let rows = [row, clean];
        assert_eq!(parse(&csv(&rows)).unwrap(), rows);
        assert!(parse("kind\nx\n").is_err());
    }
}

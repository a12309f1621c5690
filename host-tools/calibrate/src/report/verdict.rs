//! Verdict: uses that the measured errors allow, against the [`needs`] of each.

mod needs;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use serde::Serialize;
use taxel::scan::{COLS, ROWS};
use taxel_regress::quantile::quantile;

pub(crate) use self::needs::{Ladder, Quantity, of_finger, of_table};
use super::judge::Trial;
use super::map::ErrorMap;
use super::series::{Kind, Row, Series, extent};
use super::stated::Stated;
use crate::coverage::nearest;

/// Share of the loaded rows that must err by no more than a need.
pub(crate) const SHARE: f64 = 0.95;
/// Least share of the loaded rows with a value that is not flagged.
pub(crate) const GIVEN: f64 = 0.8;
/// Fewest presses, all recordings together.
pub(crate) const PRESSES: usize = 10;
/// Fewest rows of a table, whose presses are unknown.
pub(crate) const TABLE_ROWS: usize = 200;
/// Least range of the labels, in multiples of a need that it shows to be met.
pub(crate) const REACH: f64 = 3.0;
/// Standard deviations of the labels' noise that 95 % of the rows do not exceed.
pub(crate) const NOISE: f64 = 2.0;
/// Largest share of values beyond three of the standard deviations that they state.
pub(crate) const BEYOND: f64 = 0.02;

/// Reason against judging a changing force, or the errors stated for it.
const HIDES_LAG: &str = "a clock offset may hide a lag";

/// Whether the calibration was fitted to the judged rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HeldOut {
    /// It was fitted to other rows.
    Yes,
    /// It was fitted to some of them.
    No,
    /// The recordings of the fit are not known.
    Unknown,
}

impl HeldOut {
    /// Finds it from whether the fit is unknown, and the warnings about recordings of the fit.
    pub fn of(unknown: bool, warnings: &[String]) -> Self {
        match (unknown, warnings) {
            (true, _) => Self::Unknown,
            (false, []) => Self::Yes,
            (false, _) => Self::No,
        }
    }
}

/// Verdict on a calibration, in words and by need.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// Most demanding use of each quantity whose need is met.
    pub good_for: Vec<String>,
    /// Least demanding use of each quantity whose need is not met, and regions without a value.
    pub not_for: Vec<String>,
    /// Quantities that the recordings cannot judge, with the reason.
    pub not_judged: Vec<String>,
    /// Reasons to doubt the verdict as a whole.
    pub doubts: Vec<String>,
    /// Range of the loads that it was tested with.
    pub tested: String,
    /// Every need with the error found.
    pub needs: Vec<Judged>,
}

/// A need and the error found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// Quantity of the need.
    pub quantity: String,
    /// Use with that need.
    pub purpose: &'static str,
    /// Largest error that the use bears.
    pub need: f64,
    /// Unit of need and error.
    pub unit: &'static str,
    /// Error that 95 % of the loaded rows do not exceed, in the worst recording.
    pub found: Option<f64>,
    /// Whether only rows at rest were judged, because a clock may hide a lag.
    pub at_rest: bool,
    /// Whether the need is met; `None` if the recordings cannot tell.
    pub met: Option<bool>,
    /// Reason for a need that is not judged or fails for want of values.
    pub why: String,
}

/// Judges the trials.
pub(crate) fn verdict(
    quantities: &[Quantity],
    trials: &[Trial],
    stated: &[Stated],
    held_out: HeldOut,
) -> Verdict {
    let mut verdict = Verdict { tested: tested(trials), ..Verdict::default() };
    if held_out == HeldOut::Unknown {
        let known = "not known whether these rows were fitted to (--fitted-to tells it)";
        verdict.doubts.push(known.into());
    }
    let hidden = trials.iter().flat_map(|trial| &trial.series).any(Series::hides_lag);
    if hidden {
        verdict.not_judged.push(format!("changing forces: {HIDES_LAG}"));
    }
    for quantity in quantities {
        let found = Found::of(quantity, trials);
        // Force sensors without labels of their own need no word.
        let expected = quantity.kinds.iter().any(|kind| !matches!(kind, Kind::Sensor(..)));
        match found {
            Some(found) => verdict.add(found.judge(quantity, held_out)),
            None if expected => {
                let names: Vec<String> = quantity.kinds.iter().map(Kind::name).collect();
                let why = format!("no labels ({})", names.join(", "));
                verdict.not_judged.push(format!("{}: {why}", quantity.name));
            }
            None => {}
        }
    }
    // Only a finger states errors, and its series have presses.
    let all = trials.iter().filter_map(|trial| trial.series.iter().find(|s| !s.rows.is_empty()));
    let presses = all.map(|series| presses(series.loaded())).sum();
    verdict.add(vec![trust(stated, presses, held_out, hidden)]);
    verdict
}

impl Verdict {
    /// Names the regions of the pad that were pressed and have no value.
    pub(crate) fn add_regions(&mut self, maps: &[ErrorMap]) {
        for map in maps {
            let silent = map.without_value();
            if !silent.is_empty() {
                self.not_for.push(format!("{}: no value in {}", map.quantity, silent.join(", ")));
            }
        }
    }

    /// Adds the needs of one quantity, from the least to the most demanding.
    fn add(&mut self, needs: Vec<Judged>) {
        let met = needs.iter().rfind(|need| need.met == Some(true));
        let unmet = needs.iter().find(|need| need.met == Some(false));
        self.good_for.extend(met.map(Judged::told));
        self.not_for.extend(unmet.map(Judged::told));
        // Nothing is judged, or nothing beyond the needs that are met.
        if let (None, Some(open)) = (unmet, needs.iter().find(|need| need.met.is_none())) {
            let name = if met.is_some() { open.wanted() } else { open.quantity.clone() };
            self.not_judged.push(format!("{name}: {}", open.why));
        }
        self.needs.extend(needs);
    }
}

impl Judged {
    /// A use with its need and the error found: "weighing to a gram (normal force to 10 mN; …)".
    fn told(&self) -> String {
        let measured = match self.found {
            _ if !self.why.is_empty() => self.why.clone(),
            Some(found) => {
                format!("measured {}{}", amount(found, self.unit), at_rest(self.at_rest))
            }
            None => "nothing measured".into(),
        };
        format!("{} ({}; {measured})", self.purpose, self.wanted())
    }

    /// Quantity and need: "normal force to 10 mN".
    pub(crate) fn wanted(&self) -> String {
        format!("{} to {}", self.quantity, amount(self.need, self.unit))
    }
}

/// Words for a quantity of which only rows at rest were judged.
pub(crate) fn at_rest(only: bool) -> &'static str {
    if only { " at rest" } else { "" }
}

/// An amount in the unit that people say: mN below a newton, otherwise the unit itself.
pub(crate) fn amount(value: f64, unit: &str) -> String {
    let (value, unit) = if unit == "N" { (1e3 * value, "mN") } else { (value, unit) };
    let digits = match value.abs() {
        size if size >= 9.95 => 0,
        size if size >= 0.995 => 1,
        _ => 2,
    };
    let text = format!("{value:.digits$}");
    let text =
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} {unit}")
}

/// Errors of a quantity over all trials.
struct Found {
    /// Error of the worst recording and series.
    error: Option<f64>,
    /// Least share of loaded rows with an unflagged value.
    given: f64,
    /// Presses of all recordings; `None` for a table.
    presses: Option<usize>,
    /// Number of loaded rows.
    rows: usize,
    /// Largest range of the labels, in the unit of the needs.
    range: f64,
    /// Largest noise of the labels.
    noise: f64,
    /// Whether a clock may hide a lag, and only rows at rest were judged.
    hidden: bool,
}

impl Found {
    fn of<'t>(quantity: &Quantity, trials: &'t [Trial]) -> Option<Self> {
        let of = |trial: &'t Trial| -> Vec<&'t Series> {
            trial.series.iter().filter(|s| quantity.kinds.contains(&s.kind)).collect()
        };
        let found: Vec<Vec<&Series>> = trials.iter().map(of).filter(|s| !s.is_empty()).collect();
        let mut all = found.iter().flatten().copied().peekable();
        all.peek()?;
        let table = all.clone().any(|series| series.rows.is_empty());
        let loaded = |series: &Series| series.judged().count();
        let presses = found.iter().filter_map(|series| Some(presses(series.first()?.judged())));
        Some(Self {
            error: all
                .clone()
                .filter_map(|series| scaled(series, quantity.ladder))
                .reduce(f64::max),
            given: all
                .clone()
                .filter(|series| loaded(series) > 0)
                .map(|series| {
                    let given = series.judged().filter(|(_, error)| error.is_some()).count();
                    given as f64 / loaded(series) as f64
                })
                .fold(1.0, f64::min),
            presses: (!table).then(|| presses.sum()),
            rows: found.iter().filter_map(|series| Some(loaded(series.first()?))).sum(),
            range: if table { f64::INFINITY } else { all.clone().map(reach).fold(0.0, f64::max) },
            noise: all.clone().map(|series| series.label_noise).fold(0.0, f64::max),
            hidden: all.any(Series::hides_lag),
        })
    }

    /// Judges each need of the ladder.
    fn judge(&self, quantity: &Quantity, held_out: HeldOut) -> Vec<Judged> {
        let ladder = quantity.ladder;
        let mut needs: Vec<Judged> = ladder
            .needs
            .iter()
            .map(|(need, purpose)| {
                let (met, why) = self.meets(*need, ladder.unit, held_out);
                Judged {
                    quantity: quantity.name.clone(),
                    purpose,
                    need: *need,
                    unit: ladder.unit,
                    found: self.error,
                    at_rest: self.hidden,
                    met,
                    why,
                }
            })
            .collect();
        // A strict need that is met shows the lenient ones, for which the labels may be too small.
        if let Some(strictest) = needs.iter().rposition(|need| need.met == Some(true)) {
            needs[..strictest].iter_mut().for_each(|need| {
                (need.met, need.why) = (Some(true), String::new());
            });
        }
        needs
    }

    fn meets(&self, need: f64, unit: &str, held_out: HeldOut) -> (Option<bool>, String) {
        let Self { error, given, presses, rows, range, noise, hidden } = *self;
        if held_out == HeldOut::No {
            return (None, "the calibration was fitted to these rows, which are no test".into());
        }
        let few = match presses {
            Some(presses) => too_few(presses, PRESSES, "presses"),
            None => too_few(rows, TABLE_ROWS, "rows"),
        };
        if let Some(few) = few {
            let few = if hidden { format!("{HIDES_LAG}; at rest {few}") } else { few };
            return (None, few);
        }
        if given < GIVEN {
            let missing = if error.is_none() {
                "no estimates: no loaded row has a sound value".to_owned()
            } else {
                format!("{:.0} % of the loaded rows have no sound value", 100.0 * (1.0 - given))
            };
            return (Some(false), missing);
        }
        match error {
            None => (None, "no loaded row has a value".into()),
            Some(error) if error <= need && range >= REACH * need => (Some(true), String::new()),
            Some(error) if error <= need => {
                let (range, need) = (amount(range, unit), amount(REACH * need, unit));
                (None, format!("the labels span {range}, where {need} are needed"))
            }
            // The finger's own part of the error may be small enough.
            Some(error) if error <= need.hypot(NOISE * noise) => {
                (None, format!("the labels' own noise, {}, hides it", amount(noise, unit)))
            }
            Some(_) => (Some(false), String::new()),
        }
    }
}

/// Sentence about too little data; `None` if there is enough.
fn too_few(found: usize, needed: usize, what: &str) -> Option<String> {
    (found < needed).then(|| format!("too little data: {found} {what} of {needed} needed"))
}

/// Judges whether the stated standard deviations can be trusted.
fn trust(stated: &[Stated], presses: usize, held_out: HeldOut, hidden: bool) -> Judged {
    let worst = stated.iter().map(|stated| 100.0 * (1.0 - stated.within[2])).reduce(f64::max);
    let need = 100.0 * BEYOND;
    let (met, why) = match worst {
        _ if held_out == HeldOut::No => {
            (None, "the calibration was fitted to these rows".to_owned())
        }
        _ if hidden => (None, HIDES_LAG.to_owned()),
        None => (None, "no error is stated for what the labels tell".to_owned()),
        Some(worst) => match too_few(presses, PRESSES, "presses") {
            Some(few) => (None, few),
            None => (Some(worst <= need), String::new()),
        },
    };
    Judged {
        quantity: "values beyond three stated σ".into(),
        purpose: "trusting the stated error",
        need,
        unit: "%",
        found: worst,
        at_rest: false,
        met,
        why,
    }
}

/// Range of the labels that a need must be small against: from zero for a force, else the span.
fn reach(series: &Series) -> f64 {
    match series.kind {
        Kind::Point(_) => series.span(),
        _ => series.reference.iter().map(|value| value.abs()).fold(0.0, f64::max),
    }
}

/// Error that 95 % of a series' loaded rows do not exceed, in the unit of the ladder.
fn scaled(series: &Series, ladder: &Ladder) -> Option<f64> {
    let error = within(series.judged().filter_map(|(_, error)| error))?;
    match ladder.unit {
        "%" => (series.span() > 0.0).then(|| 100.0 * error / series.span()),
        _ => Some(error),
    }
}

/// Absolute error that 95 % of some errors do not exceed; `None` without any.
pub(crate) fn within(errors: impl Iterator<Item = f64>) -> Option<f64> {
    let errors: Vec<f64> = errors.map(f64::abs).collect();
    (!errors.is_empty()).then(|| quantile(errors, SHARE))
}

/// Number of presses among some rows.
pub(crate) fn presses<T>(rows: impl Iterator<Item = (Row, T)>) -> usize {
    rows.filter_map(|(row, _)| row.press).collect::<BTreeSet<usize>>().len()
}

/// A sentence about the loads of the trials.
fn tested(trials: &[Trial]) -> String {
    let find = |kind: Kind| {
        let series = trials.iter().flat_map(|trial| &trial.series);
        series.filter(move |series| series.kind == kind)
    };
    let names: Vec<&str> = trials.iter().map(|trial| trial.recording.as_str()).collect();
    let mut parts = Vec::new();
    let rows = trials.iter().filter_map(|trial| trial.series.iter().find(|s| !s.rows.is_empty()));
    let rows: Vec<&Series> = rows.collect();
    if !rows.is_empty() {
        let presses: usize = rows.iter().map(|series| presses(series.loaded())).sum();
        let places = rows.iter().flat_map(|series| series.loaded());
        let regions: BTreeSet<usize> =
            places.filter_map(|(row, _)| row.place).map(nearest).collect();
        parts.push(format!("{presses} presses"));
        if !regions.is_empty() {
            parts.push(format!("on {} of {} regions of the pad", regions.len(), ROWS * COLS));
        }
    }
    let (_, normal) = extent(find(Kind::Force(2)).flat_map(|s| s.reference.iter().copied()));
    if normal > 0.0 {
        parts.push(format!("up to {normal:.1} N into the skin"));
    }
    let shear = [0, 1].map(|axis| find(Kind::Force(axis)).map(reach).fold(0.0, f64::max));
    let shear = shear[0].max(shear[1]);
    if shear > 0.0 {
        parts.push(format!("and {shear:.1} N sideways"));
    }
    format!("Tested on {}: {}.", names.join(", "), parts.join(" ")).replace(": .", ".")
}

//! Verdict: uses that the measured errors allow, against needs stated in [`LADDERS`].

use std::collections::BTreeSet;

use serde::Serialize;
use taxel::scan::{COLS, ROWS, SENSORS};
use taxel_regress::quantile::quantile;

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

/// Uses of a quantity, from the least to the most demanding.
pub(crate) struct Ladder {
    /// Unit of the needs.
    pub unit: &'static str,
    /// Largest error that each use bears, and the use.
    pub needs: [(f64, &'static str); 3],
}

/// Needs of a normal force.
const NORMAL: Ladder = Ladder {
    unit: "N",
    needs: [
        (0.2, "gripping sturdy objects"),
        (0.05, "holding fragile objects"),
        (0.01, "weighing to a gram"),
    ],
};
/// Needs of a shear force, in x and in y.
const SHEAR: Ladder = Ladder {
    unit: "N",
    needs: [
        (0.2, "telling a pull from a lift"),
        (0.05, "keeping a light grip from slipping"),
        (0.01, "feeling a gram pull sideways"),
    ],
};
/// Needs of a contact point, in x and in y.
const PLACE: Ladder = Ladder {
    unit: "mm",
    needs: [
        (2.0, "telling which taxel is pressed"),
        (0.5, "following an edge"),
        (0.1, "aligning parts"),
    ],
};
/// Needs of any other quantity, in percent of its span.
const PERCENT: Ladder = Ladder {
    unit: "%",
    needs: [(10.0, "telling low from high"), (3.0, "control"), (1.0, "measuring")],
};

/// Quantity with the series that tell it, and its needs.
pub(crate) struct Quantity {
    /// Name in the report.
    pub name: String,
    /// Kinds of its series; the worst counts.
    pub kinds: Vec<Kind>,
    /// Needs of its uses.
    pub ladder: &'static Ladder,
}

/// Quantities of a finger: force, contact point, and each force sensor.
pub(crate) fn of_finger() -> Vec<Quantity> {
    let quantity = |name: &str, kinds, ladder| Quantity { name: name.into(), kinds, ladder };
    let on_sensors = |axes: &[usize]| -> Vec<Kind> {
        (0..SENSORS).flat_map(|i| axes.iter().map(move |axis| Kind::Sensor(i, *axis))).collect()
    };
    vec![
        quantity("normal force", vec![Kind::Force(2)], &NORMAL),
        quantity("shear", vec![Kind::Force(0), Kind::Force(1)], &SHEAR),
        quantity("contact place", vec![Kind::Point(0), Kind::Point(1)], &PLACE),
        quantity("normal force on each sensor", on_sensors(&[2]), &NORMAL),
        quantity("shear on each sensor", on_sensors(&[0, 1]), &SHEAR),
    ]
}

/// Quantities of a table: its targets.
pub(crate) fn of_table(targets: &[String]) -> Vec<Quantity> {
    let quantity = |name: &String| Quantity {
        name: name.clone(),
        kinds: vec![Kind::Column(name.clone())],
        ladder: &PERCENT,
    };
    targets.iter().map(quantity).collect()
}

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
    fn of(quantity: &Quantity, trials: &[Trial]) -> Option<Self> {
        let of = |trial: &'_ Trial| -> Vec<Series> {
            trial.series.iter().filter(|s| quantity.kinds.contains(&s.kind)).cloned().collect()
        };
        let found: Vec<Vec<Series>> = trials.iter().map(of).filter(|s| !s.is_empty()).collect();
        let mut all = found.iter().flatten().peekable();
        all.peek()?;
        let is_table = |series: &&Series| series.rows.is_empty();
        let table = all.clone().any(|series| is_table(&series));
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

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Presses of ten rows that reach `most`, with errors of a uniform distribution up to `error`.
    fn series(kind: Kind, presses: usize, most: f64, error: f64) -> Series {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut series = Series::empty(kind);
        for row in 0..20 * presses {
            let loaded = row % 20 < 10;
            let reference = if loaded { most * (row % 10) as f64 / 9.0 } else { 0.0 };
            let error = error * rng.random_range(-1.0..1.0);
            series.time.push(row as f64 * 1e-2);
            series.reference.push(reference);
            series.estimate.push(Some(if loaded { reference + error } else { 0.0 }));
            series.sigma.push(Some(error.abs()));
            let press = loaded.then_some(row / 20);
            series.rows.push(Row {
                press,
                flagged: false,
                place: Some([0.0; 2]),
                ..Row::default()
            });
        }
        series
    }

    fn normal(presses: usize, most: f64, error: f64) -> Verdict {
        of(series(Kind::Force(2), presses, most, error), HeldOut::Yes)
    }

    fn of(series: Series, held_out: HeldOut) -> Verdict {
        let trial = Trial::new("a.csv".into(), 9.0, 900, vec![series]);
        verdict(&of_finger(), &[trial], &[], held_out)
    }

    fn met(verdict: &Verdict) -> Vec<Option<bool>> {
        let normal = verdict.needs.iter().filter(|need| need.quantity == "normal force");
        normal.map(|need| need.met).collect()
    }

    #[test]
    fn verdict_follows_the_measured_errors() {
        for step in 0..60 {
            let error = 1e-3 * 1.15_f64.powi(step);
            let verdict = normal(40, 10.0, error);
            for need in verdict.needs.iter().filter(|need| need.quantity == "normal force") {
                let found = need.found.unwrap();
                assert!((found / error - SHARE).abs() < 0.05, "{found} {error}");
                assert_eq!(need.met, Some(found <= need.need), "{need:?}");
            }
            let good = met(&verdict).iter().filter(|met| **met == Some(true)).count();
            assert_eq!(verdict.good_for.len(), usize::from(good > 0));
            assert_eq!(verdict.not_for.len(), usize::from(good < 3));
        }
    }

    #[test]
    fn larger_errors_never_meet_more_needs() {
        let good =
            |error| met(&normal(40, 2.0, error)).iter().flatten().filter(|met| **met).count();
        let counts: Vec<usize> = (0..40).map(|step| good(1e-3 * 1.2_f64.powi(step))).collect();
        assert!(counts.is_sorted_by(|a, b| a >= b), "{counts:?}");
        assert_eq!((counts[0], counts[39]), (3, 0));
    }

    #[test]
    fn verdict_names_the_strictest_met_and_the_mildest_unmet_use() {
        let verdict = normal(40, 2.0, 0.03);
        assert!(
            verdict.good_for[0]
                .starts_with("holding fragile objects (normal force to 50 mN; measured 2")
        );
        assert!(
            verdict.not_for[0].starts_with("weighing to a gram (normal force to 10 mN; measured")
        );
        let shear = "shear: no labels (fx_n, fy_n)";
        assert_eq!(verdict.not_judged[0], shear);
        assert_eq!(
            verdict.tested,
            "Tested on a.csv: 40 presses on 1 of 16 regions of the pad up to 2.0 N into the skin."
        );
    }

    #[test]
    fn too_little_data_gives_no_verdict() {
        let few = normal(PRESSES - 1, 2.0, 0.001);
        assert_eq!(met(&few), [None; 3]);
        assert_eq!(few.not_judged[0], "normal force: too little data: 9 presses of 10 needed");
        assert!(few.good_for.is_empty() && few.not_for.is_empty());
        // Labels of 50 mN cannot show that a need of 50 mN is met.
        assert_eq!(met(&normal(40, 0.05, 0.012)), [None, None, Some(false)]);
        // A stricter need that is met shows it.
        assert_eq!(met(&normal(40, 0.05, 0.005)), [Some(true); 3]);
    }

    #[test]
    fn rows_of_the_fit_are_no_test() {
        let verdict = of(series(Kind::Force(2), 40, 2.0, 0.001), HeldOut::No);
        assert_eq!(met(&verdict), [None; 3]);
        assert!(verdict.not_judged[0].contains("fitted to these rows"), "{verdict:?}");
    }

    #[test]
    fn unknown_fit_is_told_in_the_verdict() {
        let verdict = of(series(Kind::Force(2), 40, 2.0, 0.001), HeldOut::Unknown);
        assert_eq!(met(&verdict), [Some(true); 3]);
        assert!(verdict.doubts[0].starts_with("not known whether"), "{verdict:?}");
    }

    #[test]
    fn changing_forces_are_not_judged_behind_a_hidden_lag() {
        let mut hidden = series(Kind::Force(2), 40, 2.0, 0.001);
        hidden.rows.iter_mut().for_each(|row| row.changing = true);
        let stated = Stated {
            target: "fz_n".into(),
            unit: "N",
            rows: 400,
            flagged: 0,
            median: 0.001,
            label_noise: 0.0,
            within: [0.7, 0.95, 1.0],
        };
        let judged = |series: &Series| {
            let trial = Trial::new("a.csv".into(), 9.0, 900, vec![series.clone()]);
            verdict(&of_finger(), &[trial], std::slice::from_ref(&stated), HeldOut::Yes)
        };
        let verdict = judged(&hidden);
        assert_eq!(met(&verdict), [None; 3]);
        assert_eq!(verdict.good_for, Vec::<String>::new());
        assert_eq!(verdict.not_judged[0], "changing forces: a clock offset may hide a lag");
        assert_eq!(verdict.needs.last().unwrap().met, None);
        // Forces at rest have no lag.
        hidden.rows.iter_mut().step_by(3).for_each(|row| row.changing = false);
        let verdict = judged(&hidden);
        assert_eq!(met(&verdict), [Some(true); 3]);
        assert!(verdict.good_for[0].ends_with(" mN at rest)"), "{verdict:?}");
    }

    #[test]
    fn missing_values_fail_a_need_and_flagged_ones_are_missing() {
        let mut flagged = series(Kind::Force(2), 40, 2.0, 0.001);
        flagged.rows.iter_mut().step_by(3).for_each(|row| row.flagged = true);
        let verdict = of(flagged, HeldOut::Yes);
        assert_eq!(met(&verdict), [Some(false); 3]);
        assert!(verdict.not_for[0].contains("% of the loaded rows have no sound value"));
    }

    #[test]
    fn quantity_without_any_value_fails_in_its_recording() {
        let sound = series(Kind::Point(0), 40, 4.0, 0.001);
        let mut silent = sound.clone();
        silent.estimate.iter_mut().for_each(|estimate| *estimate = None);
        let alone = of(silent.clone(), HeldOut::Yes);
        let told = "telling which taxel is pressed (contact place to 2 mm; no estimates";
        assert!(alone.not_for[0].starts_with(told), "{alone:?}");
        let trial = |series| Trial::new("a.csv".into(), 9.0, 900, vec![series]);
        let both = verdict(&of_finger(), &[trial(sound), trial(silent)], &[], HeldOut::Yes);
        assert_eq!(both.good_for, Vec::<String>::new());
        assert!(both.not_for[0].contains("100 % of the loaded rows"), "{both:?}");
    }

    #[test]
    fn need_below_label_noise_is_not_judged() {
        let mut noisy = series(Kind::Force(2), 40, 2.0, 0.03);
        noisy.label_noise = 0.002;
        assert_eq!(met(&of(noisy.clone(), HeldOut::Yes)), [Some(true), Some(true), Some(false)]);
        noisy.label_noise = 0.015;
        let verdict = of(noisy, HeldOut::Yes);
        assert_eq!(met(&verdict), [Some(true), Some(true), None]);
        let hidden = "normal force to 10 mN: the labels' own noise, 15 mN, hides it";
        assert_eq!(verdict.not_judged[0], hidden);
    }

    #[test]
    fn amounts_are_said_in_millinewtons() {
        let told =
            [(0.05, "N"), (0.0032, "N"), (2.0, "mm"), (0.1, "mm"), (0.047, "mm"), (2.0, "%")];
        assert_eq!(
            told.map(|(value, unit)| amount(value, unit)),
            ["50 mN", "3.2 mN", "2 mm", "0.1 mm", "0.05 mm", "2 %"]
        );
    }
}

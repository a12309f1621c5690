//! Checks errors against a committed baseline: the tables of `taxel chart --quick` in `data/`.

use std::collections::HashMap;
use std::sync::atomic::AtomicBool;

use taxel_research::failures::Of;
use taxel_research::{Effort, Waiting, estimators, failures};

/// Largest ratio of a new error to the old one, because nets train differently on other machines.
const MARGIN: f64 = 1.1;
/// Growth of an error that is always allowed: 0.5 mN or 0.5 µm.
const ERROR: f64 = 5e-4;
/// Growth of a share that is always allowed: one frame in a hundred.
const SHARE: f64 = 0.01;

const UPDATE_HINT: &str = "if that is intended, write the baseline again: \
                    `taxel chart --quick --only estimators --only failures --out host-tools/research/data`, and keep its three CSV";

/// Splits a table into rows: the first `keys` cells, and the cells after them.
fn rows(table: &str, keys: usize) -> Vec<(Vec<String>, Vec<String>)> {
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let rows = reader.records().map(|row| {
        let cells: Vec<String> = row.unwrap().iter().map(str::to_owned).collect();
        let (key, rest) = cells.split_at(keys);
        (key.to_vec(), rest.to_vec())
    });
    rows.collect()
}

fn number(cell: &str) -> Option<f64> {
    cell.parse().ok()
}

/// Describes each row that is worse than in the baseline.
fn worse(
    baseline: &str,
    now: &str,
    keys: usize,
    judge: impl Fn(&[String], &[String]) -> Option<String>,
) -> Vec<String> {
    let before: HashMap<_, _> = rows(baseline, keys).into_iter().collect();
    let now = rows(now, keys);
    assert!(!now.is_empty());
    let gone = before.keys().filter(|key| !now.iter().any(|(now, _)| now == *key));
    let gone = gone.map(|key| format!("{}: gone, it was in the baseline", key.join(", ")));
    now.iter()
        .filter_map(|(key, now)| match before.get(key) {
            None => Some(format!("{}: not in the baseline", key.join(", "))),
            Some(before) => judge(before, now).map(|what| format!("{}: {what}", key.join(", "))),
        })
        .chain(gone)
        .collect()
}

/// Judges a row of `estimators.csv`.
fn larger_error(before: &[String], now: &[String]) -> Option<String> {
    let [before, now] = [before, now].map(|cells| number(&cells[1]).unwrap());
    (now > MARGIN * before + ERROR).then(|| format!("{now}, was {before}"))
}

/// Judges a row of `boundaries.csv`.
fn more_silent(before: &[String], now: &[String]) -> Option<String> {
    let share = |cells: &[String]| {
        let [frames, silent] = [1, 2].map(|i| number(&cells[i]).unwrap());
        silent / frames
    };
    let [before, now] = [before, now].map(share);
    (now > MARGIN * before + SHARE)
        .then(|| format!("{now} of the values undetected errors, was {before}"))
}

fn waiting(stop: &AtomicBool) -> Waiting<'_> {
    Waiting { progress: &|_, _| {}, stop }
}

/// Runs both tables in one test, because the second measurement reuses the first one's
/// calibrations.
#[test]
fn estimators_and_failure_maps_match_the_baseline() {
    let stop = AtomicBool::new(false);
    estimators_match_the_baseline(&stop);
    failure_maps_match_the_baseline(&stop);
}

fn estimators_match_the_baseline(stop: &AtomicBool) {
    let found = estimators::measure(&Effort::quick(), waiting(stop)).unwrap();
    let worse =
        worse(include_str!("../../data/estimators.csv"), &estimators::csv(&found), 3, larger_error);
    assert!(worse.is_empty(), "{worse:#?}; {UPDATE_HINT}");
}

fn failure_maps_match_the_baseline(stop: &AtomicBool) {
    let maps = failures::measure(&Effort::quick(), waiting(stop)).unwrap();
    // Shares of silent failures: all, in the working range; then false flags.
    let totals = failures::totals(&maps, Of::Finger);
    assert!(totals.silent[0] < 0.005 && totals.silent[1] < 0.0005, "{totals:?}");
    assert!(totals.false_flags < 0.001, "{totals:?}");
    let silent = worse(
        include_str!("../../data/boundaries.csv"),
        &failures::boundaries(&maps),
        2,
        more_silent,
    );
    assert!(silent.is_empty(), "{silent:#?}; {UPDATE_HINT}");
    let worse =
        worse(include_str!("../../data/failures.csv"), &failures::csv(&maps), 3, |before, now| {
            let within = now[0] == "true";
            let [flags_before, flags] = [before, now].map(|cells| number(&cells[3]).unwrap());
            if flags < flags_before - SHARE && !within || flags > flags_before + SHARE && within {
                return Some(format!("flagged {flags}, was {flags_before}"));
            }
            // With almost all values missing, the rest proves nothing.
            let (Some(before), Some(now)) = (number(&before[1]), number(&now[1])) else {
                return None;
            };
            (flags < 0.9 && now > MARGIN * before + ERROR)
                .then(|| format!("off by {now}, was {before}"))
        });
    assert!(worse.is_empty(), "{worse:#?}; {UPDATE_HINT}");
}

/// Five devices against the tables of `docs/accuracy.md`.
mod nightly {
    use super::*;

    #[test]
    fn five_devices_match_the_tables_of_the_page() {
        let stop = AtomicBool::new(false);
        let effort = Effort::full();
        let found = estimators::measure(&effort, waiting(&stop)).unwrap();
        let page = include_str!("../../../../docs/images/estimators.csv");
        let worse = worse(page, &estimators::csv(&found), 3, larger_error);
        assert!(worse.is_empty(), "{worse:#?}; draw the charts of docs/images again");
        let maps = failures::measure(&effort, waiting(&stop)).unwrap();
        let page = include_str!("../../../../docs/images/boundaries.csv");
        let worse = super::worse(page, &failures::boundaries(&maps), 2, more_silent);
        assert!(worse.is_empty(), "{worse:#?}; draw the charts of docs/images again");
    }
}

//! Tests of the verdict on made series.

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
        series.rows.push(Row { press, flagged: false, place: Some([0.0; 2]), ..Row::default() });
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
    let good = |error| met(&normal(40, 2.0, error)).iter().flatten().filter(|met| **met).count();
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
    assert!(verdict.not_for[0].starts_with("weighing to a gram (normal force to 10 mN; measured"));
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
    let told = [(0.05, "N"), (0.0032, "N"), (2.0, "mm"), (0.1, "mm"), (0.047, "mm"), (2.0, "%")];
    assert_eq!(
        told.map(|(value, unit)| amount(value, unit)),
        ["50 mN", "3.2 mN", "2 mm", "0.1 mm", "0.05 mm", "2 %"]
    );
}

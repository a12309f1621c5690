//! Tests with a generic sensor, as CSV text.

use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

use taxel_files::table::read_from;
use taxel_regress::FitError;
use taxel_regress::model::Family;
use taxel_regress::network::NetOptions;
use taxel_regress::table::{TableOptions, TableRecording, evaluate, fit};

fn recording(rows: usize, from: usize, inputs: &[&str], targets: &[&str]) -> TableRecording {
    let mut text = String::from("t_s,m0,m1,m2,force_n\n");
    for i in from..from + rows {
        let t = i as f64 * 0.1;
        let (a, b) = (40.0 * t.sin(), 300.0 * (0.7 * t).cos());
        writeln!(text, "{t},{a},{b},3.5,{}", 2.0 * (a / 30.0).tanh() + b / 100.0).unwrap();
    }
    let stretch = "other.csv".parse().unwrap();
    TableRecording {
        inputs: read_from(text.as_bytes(), &stretch, inputs).unwrap(),
        targets: read_from(text.as_bytes(), &stretch, targets).unwrap(),
    }
}

fn options() -> TableOptions {
    TableOptions {
        hidden: Some(5),
        net: NetOptions { seed: 0, starts: 1, steps: 90 },
        ..TableOptions::default()
    }
}

#[test]
fn model_generalises_and_names_its_columns() {
    let train = recording(800, 0, &["m*"], &["force_n"]);
    let fitted = fit(&[train], &options(), &mut |_| {}, &AtomicBool::new(false)).unwrap();
    assert_eq!(fitted.model.inputs, ["m0", "m1", "m2"]);
    assert!(fitted.warnings[0].starts_with("m2: the same value"), "{:?}", fitted.warnings);
    let judged = evaluate(&fitted.model, &recording(300, 900, &["m*"], &["force_n"])).unwrap();
    let figures = judged.targets[0].figures.unwrap();
    assert!(figures.rmse < 0.05 && figures.n == 300, "{figures:?}");
    assert_eq!(judged.beyond_range, 0);
    assert!(!fitted.model.within_range(&[40.0, 900.0, 3.5]));
}

#[test]
fn constant_inputs_are_refused_by_name() {
    let train = recording(400, 0, &["m2"], &["force_n"]);
    let error = fit(&[train], &options(), &mut |_| {}, &AtomicBool::new(false)).unwrap_err();
    let error = error.to_string();
    assert!(error.starts_with("other.csv: m2: the same value in every row, and"), "{error}");
}

#[test]
fn columns_unlike_the_models_are_refused() {
    let train = recording(400, 0, &["m*"], &["force_n"]);
    let other = recording(400, 0, &["m0", "m1"], &["force_n"]);
    let fit = |recordings: &[TableRecording]| {
        fit(recordings, &options(), &mut |_| {}, &AtomicBool::new(false))
    };
    assert!(matches!(fit(&[train.clone(), other.clone()]), Err(FitError::Mismatch { .. })));
    let fitted = fit(&[train]).unwrap();
    assert!(matches!(evaluate(&fitted.model, &other), Err(FitError::Mismatch { .. })));
    assert!(matches!(fit(&[]), Err(FitError::NoRecording)));
}

#[test]
fn a_dozen_rows_are_refused() {
    let few = recording(12, 0, &["m*"], &["force_n"]);
    let error = fit(&[few], &options(), &mut |_| {}, &AtomicBool::new(false)).unwrap_err();
    assert!(matches!(error, FitError::TooFewRows { rows: 12, .. }), "{error}");
}

#[test]
fn polynomials_fit_functions_in_their_terms() {
    let recording = |rows: usize, from: usize, force: fn(f64, f64) -> f64| {
        let mut text = String::from("m0,m1,force_n\n");
        for i in from..from + rows {
            let t = i as f64 * 0.1;
            let (a, b) = (7.0 + (1.1 * t).sin(), 500.0 + 30.0 * (0.7 * t).cos());
            writeln!(text, "{a},{b},{}", force(a - 7.0, b / 30.0 - 16.0)).unwrap();
        }
        let stretch = "other.csv".parse().unwrap();
        TableRecording {
            inputs: read_from(text.as_bytes(), &stretch, &["m*"]).unwrap(),
            targets: read_from(text.as_bytes(), &stretch, &["force_n"]).unwrap(),
        }
    };
    let additive: fn(f64, f64) -> f64 = |a, b| a - 2.0 * a * a * a + 0.5 * b * b;
    let products: fn(f64, f64) -> f64 = |a, b| 3.0 * a * b + b * b - a;
    for (family, force, name, good) in [
        (Family::Cubic, additive, "cubic 2-1", true),
        (Family::Quadratic, products, "quadratic 2-1", true),
        (Family::Cubic, products, "cubic 2-1", false),
        (Family::Ridge, additive, "linear 2-1", false),
    ] {
        let options = TableOptions { family, ..TableOptions::default() };
        let stop = AtomicBool::new(false);
        let fitted = fit(&[recording(240, 0, force)], &options, &mut |_| {}, &stop).unwrap();
        assert_eq!(fitted.model.shape(), name);
        let judged = evaluate(&fitted.model, &recording(300, 900, force)).unwrap();
        let rmse = judged.targets[0].figures.unwrap().rmse;
        assert_eq!(rmse < 0.005, good, "{family} {rmse}");
    }
}

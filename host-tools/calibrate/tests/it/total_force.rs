//! Tests of the force sensors' fit from the total force alone, as a load cell under the finger
//! gives it.

use std::sync::atomic::AtomicBool;

use taxel::finger::Finger;
use taxel::measured::NoValue;
use taxel::scan::SENSORS;
use taxel_calibrate::evaluate::{self, Only};
use taxel_calibrate::finger::{Channel, FitOptions, Fitted, fit};
use taxel_calibrate::moments::{Located, WRENCH};
use taxel_calibrate::recording::Recording;
use taxel_files::table::Table;
use taxel_files::trace::{Sample, Truth};
use taxel_regress::align::Alignment;
use taxel_regress::network::NetOptions;

use crate::judge::{Rms, presses, run};

/// Presses with shear; the truth has no force on single sensors.
fn recording(seed: u64, keep: fn(Truth) -> Truth) -> Recording {
    let samples = run(3, seed, 250, 9.0, 0.8, &presses(40, [0.0, 0.9], 0.0));
    let samples = samples.into_iter().map(|sample| {
        let truth = keep(Truth { sensors: [[None; 3]; SENSORS], ..sample.truth });
        Sample { truth, ..sample }
    });
    Recording { name: "cell.csv".into(), samples: samples.collect() }
}

fn force_only(truth: Truth) -> Truth {
    Truth { force: truth.force, ..Truth::default() }
}

/// The log of a load cell with 6 mN of noise.
fn by_load_cell() -> Recording {
    let mut known = recording(1, force_only);
    for (row, sample) in known.samples.iter_mut().enumerate() {
        for (axis, force) in sample.truth.force.iter_mut().enumerate() {
            let unit = (12.9898 * ((row * 3 + axis) as f64).powi(2)).sin();
            *force = force.map(|force| force + 0.006 * std::f64::consts::SQRT_2 * unit);
        }
    }
    known
}

fn fitted(recording: &Recording) -> Fitted {
    let net = NetOptions { seed: 0, starts: 1, steps: 3 };
    let options = FitOptions { net, hidden: Some(1), ..FitOptions::default() };
    let recordings = std::slice::from_ref(recording);
    fit(recordings, &options, &mut |_| {}, &AtomicBool::new(false)).unwrap()
}

/// RMS errors of the array alone, as far as it gives these quantities.
fn errors(fitted: &Fitted, unseen: &Recording) -> Vec<(String, f64)> {
    let (calibration, unseen) = Only::Array.of(&fitted.calibration, unseen);
    let metrics = evaluate::finger(&calibration, &unseen);
    metrics.into_iter().filter_map(|m| Some((m.target, m.figures?.rmse))).collect()
}

fn channel<'f>(fitted: &'f Fitted, columns: &str) -> &'f Channel {
    fitted.channels.iter().find(|channel| channel.columns == columns).unwrap()
}

#[test]
fn total_force_alone_calibrates_four_sensors() {
    let unseen = recording(2, |truth| truth);
    let fitted = fitted(&by_load_cell());
    assert!(!fitted.warnings.iter().any(|warning| warning.contains("axes")));
    for (target, error) in errors(&fitted, &unseen) {
        // Scans before the gate opens have a force, and no estimate of it.
        let most = if target == "fz_n" { 0.007 } else { 0.002 };
        assert!(error < most, "{target}: {error}");
    }
    let stated = fitted.calibration.array.unwrap().residual;
    assert!(stated.iter().all(|sigma| *sigma < 0.004), "the cell's noise is not the finger's");
    for i in 0..SENSORS {
        let bridge = channel(&fitted, &format!("bridge_s{i}_*"));
        assert_eq!(bridge.used, ["array of sensors 3x12"]);
    }
    let sensors = &fitted.calibration.sensors;
    assert!(sensors.iter().all(Option::is_some));
}

#[test]
fn total_force_alone_finds_where_the_matrix_is_touched() {
    let unseen = recording(2, |truth| truth);
    let (calibration, unseen) = Only::Matrix.of(&fitted(&by_load_cell()).calibration, &unseen);
    let metrics = evaluate::finger(&calibration, &unseen);
    let limits = [("fx_n", 0.06), ("fy_n", 0.06), ("fz_n", 0.02), ("x_mm", 0.15), ("y_mm", 0.15)];
    for (target, most) in limits {
        let found = metrics.iter().find(|metrics| metrics.target == target).unwrap();
        let (error, beyond) = (found.figures.unwrap().rmse, found.beyond.unwrap());
        assert!(error < most, "{target}: {error}");
        assert!(target == "fz_n" || beyond < 0.03, "{target}: {beyond} beyond three sigma");
    }
}

#[test]
fn reference_noise_below_that_at_rest_is_not_taken() {
    let known = by_load_cell();
    let net = NetOptions { seed: 0, starts: 1, steps: 3 };
    let given = FitOptions { net, hidden: Some(1), ..FitOptions::default() };
    let given = FitOptions { reference_noise: Some(0.0), ..given };
    let (found, none) = (
        fitted(&known),
        fit(std::slice::from_ref(&known), &given, &mut |_| {}, &AtomicBool::new(false)).unwrap(),
    );
    assert_eq!(none.calibration.model, found.calibration.model);
    let told = |fit: &Fitted| fit.warnings.iter().any(|w| w.contains("--reference-noise out"));
    assert!(told(&none) && !told(&found), "{:?}", none.warnings);
    let skin = none.parts.iter().find(|part| part.name == "model of the skin").unwrap();
    assert!(skin.held_out, "{skin:?}");
}

#[test]
fn exchanged_axes_of_load_cell_are_warned_of() {
    let mut known = by_load_cell();
    known.samples.iter_mut().for_each(|sample| sample.truth.force.swap(0, 1));
    let warnings = fitted(&known).warnings;
    assert!(
        warnings.iter().any(|warning| warning.contains("to the sensors' axes")),
        "{warnings:?}"
    );
}

#[test]
fn contact_points_add_moments_of_the_array() {
    let unseen = recording(2, |truth| truth);
    let known =
        |truth: Truth| Truth { torsion: truth.torsion, point: truth.point, ..force_only(truth) };
    let fitted = fitted(&recording(1, known));
    assert!(channel(&fitted, "x_mm, y_mm").used.contains(&"array of sensors 6x12".to_owned()));
    let array = fitted.calibration.array.unwrap();
    assert!(array.moment_residual < 0.1, "{array:?}");
    for (target, error) in errors(&fitted, &unseen) {
        assert!(error < 0.007, "{target}: {error}");
    }
    let (calibration, unseen) = Only::Array.of(&fitted.calibration, &unseen);
    let (finger, mut state) = Finger::new(Some(calibration));
    let mut point = Rms::default();
    for Sample { scan, truth } in &unseen.samples {
        let found = finger.estimate(&mut state, scan).point;
        if let (Ok(p), [Some(x), Some(y)], Some(0.2..)) = (found, truth.point, truth.force[2]) {
            point.add((f64::from(p.x.0) - x).hypot(f64::from(p.y.0) - y));
        }
    }
    assert!(point.count() > 500 && point.value() < 0.2, "{} mm", point.value());
}

/// Locates the contacts of [`by_load_cell`] with moments about an origin 25 mm under the skin, 0.1
/// N·mm of noise, and these factors of the moments.
fn located(factors: [f64; 3], cell_at: [f64; 3]) -> (Recording, Option<Located>) {
    let (mut known, truth) = (by_load_cell(), recording(1, |truth| truth));
    let row = |(row, (noisy, exact)): (usize, (&Sample, &Sample))| {
        let [fx, fy, fz] = exact.truth.force.map(Option::unwrap);
        let [x, y] = exact.truth.point.map(Option::unwrap_or_default);
        let moments = [y * fz + 25.0 * fy, -x * fz - 25.0 * fx, x * fy - y * fx];
        let moments = moments.into_iter().enumerate().map(|(axis, moment)| {
            let unit = (78.233 * ((row * 3 + axis) as f64).powi(2)).sin();
            factors[axis] * (moment + 0.1 * std::f64::consts::SQRT_2 * unit)
        });
        noisy.truth.force.into_iter().flatten().chain(moments).collect()
    };
    let both = known.samples.iter().zip(&truth.samples).enumerate();
    let log = Table {
        path: "cell.csv".into(),
        names: WRENCH.map(str::to_owned).to_vec(),
        others: Vec::new(),
        rows: both.map(row).collect(),
        times: known.samples.iter().map(|s| s.scan.time.0 as f64 * 1e-6).collect(),
    };
    let alignment = Alignment { offset: 0.0, rate: 0.0, residual: 0.0, correlation: 1.0 };
    let found = known.locate(&log, &alignment, cell_at);
    (known, found)
}

#[test]
fn moments_of_load_cell_give_contact_points() {
    let (known, found) = located([1.0; 3], [0.0, 0.0, 25.0]);
    let (unseen, truth) = (recording(2, |truth| truth), recording(1, |truth| truth));
    assert_eq!(found.as_ref().unwrap().warning, None);
    let (mut error, mut stated) = (Rms::default(), Rms::default());
    for (own, exact) in known.samples.iter().zip(&truth.samples) {
        let ([Some(x), Some(y)], [Some(at_x), Some(at_y)]) = (own.truth.point, exact.truth.point)
        else {
            continue;
        };
        error.add((x - at_x).hypot(y - at_y));
        stated.add(std::f64::consts::SQRT_2 * own.truth.point_sigma.unwrap());
    }
    let (error, stated) = (error.value(), stated.value());
    assert!(error < 0.25 && (0.8..1.25).contains(&(stated / error)), "{error} {stated} mm");
    let fitted = fitted(&known);
    assert!(channel(&fitted, "x_mm, y_mm").used.contains(&"array of sensors 6x12".to_owned()));
    assert_eq!(channel(&fitted, "torsion_nmm").used, ["array of sensors 6x12"]);
    // The noise of the labels is not the array's.
    assert!(fitted.calibration.array.as_ref().unwrap().moment_residual < 0.1);
    for (part, most) in [(Only::Matrix, 0.1), (Only::Array, 0.1)] {
        let (calibration, unseen) = part.of(&fitted.calibration, &unseen);
        let metrics = evaluate::finger(&calibration, &unseen);
        for found in metrics.iter().filter(|metrics| metrics.target.ends_with("_mm")) {
            let error = found.figures.unwrap().rmse;
            assert!(error < most, "{part:?}, {}: {error}", found.target);
        }
    }
}

#[test]
fn wrong_origin_or_sign_of_moments_is_warned_of() {
    let warned = |factors, cell_at| located(factors, cell_at).1.unwrap().warning.unwrap();
    let nearly_right = warned([1.0; 3], [4.0, 0.0, 25.0]);
    assert!(nearly_right.contains("4 mm elsewhere; --cell-at 0,0,2"), "{nearly_right}");
    let forgotten = warned([1.0; 3], [0.0; 3]);
    assert!(forgotten.contains("--cell-at 0,0,2"), "{forgotten}");
    let turned = warned([1.0, -1.0, 1.0], [0.0, 0.0, 25.0]);
    assert!(turned.contains("by my_nmm: probably its sign is wrong"), "{turned}");
    let metres = warned([1e-3; 3], [0.0, 0.0, 25.0]);
    assert!(metres.contains("exchanged, or not in N·mm"), "{metres}");
}

#[test]
fn own_contact_points_are_kept_beside_moments() {
    let (mut known, _) = located([1.0; 3], [0.0, 0.0, 25.0]);
    let before = known.clone();
    let (names, path) = (WRENCH.map(str::to_owned).to_vec(), "cell.csv".into());
    let log =
        Table { path, names, others: vec![], rows: vec![vec![0.0; 6]; 9], times: vec![0.0; 9] };
    let alignment = Alignment { offset: 0.0, rate: 0.0, residual: 0.0, correlation: 1.0 };
    assert_eq!(known.locate(&log, &alignment, [0.0; 3]), None);
    assert_eq!(known, before);
}

#[test]
fn shear_is_stated_unknown_if_never_loaded() {
    let samples = run(3, 1, 250, 9.0, 0.8, &presses(40, [0.0, 0.0], 0.0));
    let samples = samples.into_iter().map(|s| Sample { truth: force_only(s.truth), ..s });
    let fitted = fitted(&Recording { name: "normal.csv".into(), samples: samples.collect() });
    let [x, y, z] = fitted.calibration.array.unwrap().residual;
    assert!(x > 1.0 && y > 1.0 && z < 0.01, "{x} {y} {z}");
    assert!(fitted.warnings.iter().any(|w| w.contains("no shear in x")), "{:?}", fitted.warnings);
}

/// A load cell of one axis under presses without shear.
#[test]
fn normal_force_alone_gives_places_and_no_shear() {
    let recording = |seed| {
        let samples = run(3, seed, 250, 9.0, 0.8, &presses(40, [0.0, 0.0], 0.0));
        Recording { name: "axis.csv".into(), samples }
    };
    let (mut known, unseen) = (recording(1), recording(2));
    for truth in known.samples.iter_mut().map(|sample| &mut sample.truth) {
        *truth = Truth { force: [None, None, truth.force[2]], ..Truth::default() };
    }
    let fitted = fitted(&known);
    let calibration = &fitted.calibration;
    assert!(!calibration.model.as_ref().unwrap().shear, "{:?}", fitted.choices);
    // An array would give a shear of 0 N.
    assert!(calibration.array.is_none() && calibration.sensors.iter().all(Option::is_none));
    for i in 0..SENSORS {
        let bridge = channel(&fitted, &format!("bridge_s{i}_*"));
        assert!(bridge.used.is_empty() && bridge.why.contains("no fx_n and fy_n"), "{bridge:?}");
    }
    assert!(channel(&fitted, "fz_n").used.contains(&"model of the skin".to_owned()));
    assert!(channel(&fitted, "fx_n, fy_n").why.contains("not estimated"));
    let metrics = evaluate::finger(calibration, &unseen);
    for (target, most) in [("fz_n", 0.02), ("x_mm", 0.15), ("y_mm", 0.15)] {
        let found = metrics.iter().find(|metrics| metrics.target == target).unwrap();
        let error = found.figures.unwrap().rmse;
        println!("{target}: {error}");
        assert!(error < most, "{target}: {error}");
    }
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let estimates = unseen.samples.iter().map(|sample| finger.estimate(&mut state, &sample.scan));
    let touched = estimates.filter(|estimate| estimate.force.z.is_ok_and(|fz| fz.0 > 0.0));
    let shear: Vec<_> = touched.map(|estimate| (estimate.force.x, estimate.force.y)).collect();
    let none = (Err(NoValue::NotEstimated), Err(NoValue::NotEstimated));
    assert!(shear.len() > 500 && shear.iter().all(|shear| *shear == none), "{shear:?}");
}

#[test]
fn silent_and_absent_sensors_are_named() {
    let (unseen, mut known) = (recording(2, |truth| truth), recording(1, force_only));
    let idle = known.samples[0].scan.codes.bridges[1];
    for (row, sample) in known.samples.iter_mut().enumerate() {
        let bridges = &mut sample.scan.codes.bridges;
        bridges[3] = None;
        bridges[1] = idle;
        bridges[1].iter_mut().for_each(|s| s.a.0 += (row % 2) as u16);
    }
    let fitted = fitted(&known);
    assert_eq!(channel(&fitted, "bridge_s0_*").used, ["array of sensors 3x6"]);
    let silent = channel(&fitted, "bridge_s1_*");
    assert!(silent.used.is_empty() && silent.why.contains("does not respond"), "{silent:?}");
    assert!(fitted.channels.iter().all(|channel| channel.columns != "bridge_s3_*"));
    // Two of four sensors under a plate know the shear well and the normal force roughly.
    let found = errors(&fitted, &unseen);
    assert!(found.len() == 3 && found.iter().all(|(_, error)| *error < 0.3), "{found:?}");
}

//! Tests of the force sensors' fit from the total force alone, as a load cell under the finger
//! gives it.

use std::sync::atomic::AtomicBool;

use taxel::finger::Finger;
use taxel::scan::SENSORS;
use taxel_calibrate::evaluate::{self, Only};
use taxel_calibrate::finger::{Channel, FitOptions, Fitted, fit};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::{Sample, Truth};
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

#[test]
fn shear_is_stated_unknown_if_never_loaded() {
    let samples = run(3, 1, 250, 9.0, 0.8, &presses(40, [0.0, 0.0], 0.0));
    let samples = samples.into_iter().map(|s| Sample { truth: force_only(s.truth), ..s });
    let fitted = fitted(&Recording { name: "normal.csv".into(), samples: samples.collect() });
    let [x, y, z] = fitted.calibration.array.unwrap().residual;
    assert!(x > 1.0 && y > 1.0 && z < 0.01, "{x} {y} {z}");
    assert!(fitted.warnings.iter().any(|w| w.contains("no shear in x")), "{:?}", fitted.warnings);
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

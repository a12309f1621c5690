//! Tests of fitting and judging a made-up finger with known physics.
//!
//! Presses and shears on a small grid of positions, a force sensor with crosstalk, and every defect
//! that recordings may have.

use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::estimate::quantised::Net;
use taxel::scan::{Codes, Midpoints, SENSORS, Scan, TAXEL_CENTRES, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};
use taxel_calibrate::Form;
use taxel_calibrate::evaluate;
use taxel_calibrate::finger::{FitOptions, Fitted, Subject, fit};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::{Sample, Truth};
use taxel_regress::FitError;
use taxel_regress::metrics::{Figures, TargetMetrics};
use taxel_regress::model::Family;
use taxel_regress::network::NetOptions;

use crate::judge;

/// Outputs of a bridge per newton, as fractions of full scale: u = G·f.
const G: [[f64; 3]; 3] = [[0.008, 0.0004, 0.0], [-0.0003, 0.009, 0.0002], [0.0005, 0.0, 0.012]];

fn code(level: f64, noise: f64) -> Code {
    Code((level * 65535.0 + 3.0 * noise).round() as u16)
}

/// One row: a force at a position of the finger, and one on sensor 0.
fn sample(row: usize, force: [f64; 3], at: [f64; 2], on_sensor: [f64; 3]) -> Sample {
    let noise = |channel: usize| (12.9898 * ((row * 41 + channel) as f64).powi(2)).sin();
    let [fx, fy, fz] = force;
    let lit = |k: usize| {
        let [x, y] = TAXEL_CENTRES[k].map(|c| f64::from(c.0));
        let (dx, dy) = ((x - at[0]) / 2.5, (y - at[1]) / 2.5);
        let field = (-0.5 * (dx * dx + dy * dy)).exp();
        code(0.4 + 0.05 + 0.1 * field * (fz + 0.8 * (fx * dx + fy * dy)), noise(k))
    };
    let taxels = TaxelCodes {
        lit: std::array::from_fn(|r| std::array::from_fn(|c| lit(4 * r + c))),
        dark: [code(0.05, noise(16)); 4],
    };
    let [ux, uy, uz] = G.map(|row| row.iter().zip(on_sensor).map(|(g, f)| g * f).sum::<f64>());
    let mid = |v: f64, channel: usize| code(0.5 + v, noise(20 + channel));
    let pressed = Midpoints {
        a: mid(uz / 4.0 - ux / 2.0, 0),
        b: mid(uz / 4.0 + ux / 2.0, 1),
        c: mid(uy / 2.0 - uz / 4.0, 2),
        d: mid(-uy / 2.0 - uz / 4.0, 3),
    };
    let idle = Midpoints { a: mid(0.0, 4), b: mid(0.0, 5), c: mid(0.0, 6), d: mid(0.0, 7) };
    let codes = Codes {
        full_scale: FullScale::BITS_16,
        taxels: Some(taxels),
        bridges: [Some(pressed), Some(idle), None, None],
        reference: None,
        temperature: None,
    };
    let truth = Truth {
        force: force.map(Some),
        point: at.map(Some),
        contact: Some(fz > 0.0),
        ..Truth::default()
    };
    Sample { scan: Scan { time: Micros(row as u64 * 2000), lost: 0, codes }, truth }
}

fn recording(samples: Vec<Sample>) -> Recording {
    Recording { name: "made-up.csv".into(), samples }
}

/// A fifth of a second without load, then `presses` presses with `shear` of the normal force.
fn presses(presses: usize, from: usize, shear: f64) -> Recording {
    let mut samples: Vec<Sample> =
        (0..100).map(|row| sample(row, [0.0; 3], [0.0; 2], [0.0; 3])).collect();
    for press in from..from + presses {
        let p = press as f64;
        let at = [0.6 * (2.3 * p).sin(), 0.6 * (1.7 * p + 1.0).sin()];
        for step in 0..40 {
            let fz = 1.5 * (std::f64::consts::PI * f64::from(step) / 40.0).sin();
            let force = [shear * fz * (0.9 * p).cos(), shear * fz * (1.3 * p).sin(), fz];
            samples.push(sample(samples.len(), force, at, [0.0; 3]));
        }
    }
    recording(samples)
}

/// A fifth of a second without load, then force on sensor 0 alone.
fn bench(rows: usize, axes: [f64; 3]) -> Recording {
    let mut samples: Vec<Sample> =
        (0..100).map(|row| sample(row, [0.0; 3], [0.0; 2], [0.0; 3])).collect();
    for i in 0..rows {
        let t = i as f64 * 0.05;
        let force = [0.3 * t.sin(), 0.3 * (1.7 * t).sin(), 0.5 * (1.0 - (0.6 * t).cos())];
        let force: [f64; 3] = std::array::from_fn(|k| axes[k] * force[k]);
        let mut sample = sample(100 + i, [0.0; 3], [0.0; 2], force);
        sample.truth.force = force.map(Some);
        samples.push(sample);
    }
    recording(samples)
}

fn options() -> FitOptions {
    let net = NetOptions { seed: 1, starts: 1, steps: 60 };
    FitOptions { net, hidden: Some(8), net_only: true, ..FitOptions::default() }
}

fn fit_quietly(recordings: &[Recording], options: &FitOptions) -> Result<Fitted, FitError> {
    fit(recordings, options, &mut |_| {}, &AtomicBool::new(false))
}

fn figures(metrics: &[TargetMetrics], target: &str) -> Figures {
    metrics.iter().find(|m| m.target == target).and_then(|m| m.figures).unwrap()
}

#[test]
fn bench_recording_fits_only_its_sensor() {
    let fitted = fit_quietly(&[bench(1000, [1.0; 3])], &options()).unwrap();
    assert!(fitted.calibration.taxels.is_none());
    assert_eq!(fitted.parts[0].name, "s0");
    assert!((1..SENSORS).all(|i| fitted.calibration.sensors[i].is_none()));
    let metrics = evaluate::finger(&fitted.calibration, &bench(700, [0.7; 3]));
    for target in ["fx_n", "fy_n", "fz_n"] {
        let figures = figures(&metrics, target);
        assert!(figures.rmse < 0.01 && figures.n == 800, "{target} {figures:?}");
    }
}

#[test]
fn unloaded_rows_are_found_despite_cell_noise() {
    // The load cell of [Ospina2017] has an error of 6 mN for forces up to 1 N.
    let mut bench = bench(1000, [1.0; 3]);
    for (row, sample) in bench.samples.iter_mut().enumerate() {
        for (axis, force) in sample.truth.force.iter_mut().enumerate() {
            let unit = (12.9898 * ((row * 3 + axis) as f64).powi(2)).sin();
            *force = force.map(|force| force + 0.006 * std::f64::consts::SQRT_2 * unit);
        }
    }
    let fitted = fit_quietly(&[bench], &options()).unwrap();
    let metrics = evaluate::finger(&fitted.calibration, &self::bench(700, [0.7; 3]));
    for target in ["fx_n", "fy_n", "fz_n"] {
        let figures = figures(&metrics, target);
        assert!(figures.rmse < 0.01 && figures.n == 800, "{target} {figures:?}");
    }
}

#[test]
fn quantised_net_reports_small_added_error() {
    let recordings = [presses(60, 0, 0.4)];
    let float = fit_quietly(&recordings, &options()).unwrap();
    let quantised = fit_quietly(&recordings, &FitOptions { form: Form::Q15, ..options() }).unwrap();
    assert_eq!(quantised.parts[0], float.parts[0]);
    assert_eq!(quantised.parts[1].name, "the net in 16 bits");
    assert!(matches!(quantised.calibration.net, Some(Net::Quantised(_))));
    let kept = quantised.calibration.taxels.as_ref().unwrap().residual;
    for ((float, q15), kept) in
        float.parts[0].residual.iter().zip(&quantised.parts[1].residual).zip(kept)
    {
        assert!((q15 / float - 1.0).abs() < 0.01, "{float} {q15}");
        assert_eq!(*q15 as f32, kept);
    }
    let judged = |fitted: &Fitted| evaluate::finger(&fitted.calibration, &presses(20, 100, 0.4));
    let [float, q15] = [&float, &quantised].map(|fitted| figures(&judged(fitted), "fz_n").rmse);
    // Compare the added error. Its share of the total would say less, because the gate affects the
    // total.
    let added = (q15 * q15 - float * float).max(0.0).sqrt();
    assert!(added < 5e-4, "{added}: {float} {q15}");
}

#[test]
fn net_generalises_to_unseen_presses_with_shear() {
    let net = NetOptions { seed: 1, starts: 1, steps: 240 };
    let options = FitOptions { net, net_only: true, ..FitOptions::default() };
    let fitted = fit_quietly(&[presses(100, 0, 0.4)], &options).unwrap();
    assert_eq!(fitted.parts[0].name, "net 16-16-3");
    assert_eq!(fitted.calibration.validate(), Ok(()));
    let metrics = evaluate::finger(&fitted.calibration, &presses(20, 100, 0.4));
    assert!(figures(&metrics, "fz_n").rmse < 0.03, "{metrics:?}");
    assert!(figures(&metrics, "fx_n").rmse < 0.1, "{metrics:?}");
    assert!(metrics.iter().all(|m| !m.withheld.contains_key("out of trained range")));
    assert!(figures(&metrics, "x_mm").rmse < 1.0);
}

#[test]
fn only_normal_force_is_fitted_without_shear() {
    let fitted = fit_quietly(&[presses(30, 0, 0.0)], &options()).unwrap();
    assert_eq!(fitted.parts[0].name, "net 16-8-1");
    let metrics = evaluate::finger(&fitted.calibration, &presses(10, 30, 0.0));
    assert!(metrics.iter().all(|m| m.target != "fx_n"));
    assert!(figures(&metrics, "fz_n").rmse < 0.05);
}

#[test]
fn bench_and_press_recordings_give_one_record() {
    let fitted = fit_quietly(&[bench(1000, [1.0; 3]), presses(30, 0, 0.0)], &options()).unwrap();
    assert!(fitted.calibration.taxels.is_some() && fitted.calibration.sensors[0].is_some());
}

#[test]
fn load_far_beyond_training_gives_no_value() {
    let fitted = fit_quietly(&[presses(30, 0, 0.0)], &options()).unwrap();
    let mut strong = presses(0, 0, 0.0);
    for row in 100..200 {
        strong.samples.push(sample(row, [0.0, 0.0, 4.0], [0.3, 0.2], [0.0; 3]));
    }
    let metrics = evaluate::finger(&fitted.calibration, &strong);
    let fz = metrics.iter().find(|m| m.target == "fz_n").unwrap();
    assert!(fz.withheld["out of trained range"] > 95, "{fz:?}");
}

#[test]
fn sensor_reference_columns_fit_in_any_recording() {
    let mut both = presses(30, 0, 0.0);
    let alone = bench(1000, [1.0; 3]);
    for (i, sample) in both.samples.iter_mut().enumerate() {
        sample.scan.codes.bridges = alone.samples[i % 1100].scan.codes.bridges;
        sample.truth.sensors[0] = alone.samples[i % 1100].truth.force;
    }
    let fitted =
        fit_quietly(&[both.clone()], &FitOptions { subject: Subject::Finger, ..options() })
            .unwrap();
    assert!(fitted.calibration.taxels.is_some());
    let metrics = evaluate::finger(&fitted.calibration, &both);
    assert!(figures(&metrics, "s0_fz_n").rmse < 0.01);
}

#[test]
fn record_survives_serialisation() {
    let fitted = fit_quietly(&[presses(30, 0, 0.4)], &options()).unwrap();
    let mut buffer = [0; taxel::calibration::MAX_BYTES];
    let bytes = fitted.calibration.to_bytes(&mut buffer).unwrap();
    assert_eq!(Calibration::from_bytes(bytes), Ok(fitted.calibration));
}

#[test]
fn bias_uses_first_still_frames_without_reference() {
    let mut silent = presses(30, 0, 0.0);
    silent.samples.iter_mut().for_each(|s| s.truth = Truth::default());
    let known = presses(30, 0, 0.0).bias(None).unwrap().taxels.unwrap();
    let found = silent.bias(None).unwrap().taxels.unwrap();
    let apart = |(a, b): (&f32, &f32)| (a - b).abs() < 2.0 * known.noise;
    assert!(known.level.iter().zip(&found.level).all(apart));
}

#[test]
fn saturated_rows_are_left_out_with_warning() {
    let mut bright = presses(40, 0, 0.0);
    let top = FullScale::BITS_16.top();
    for sample in bright.samples.iter_mut().skip(400).take(20) {
        sample.scan.codes.taxels.iter_mut().for_each(|t| t.lit[0][0] = top);
    }
    let fitted = fit_quietly(&[bright], &options()).unwrap();
    assert_eq!(fitted.parts[0].left_out, 20);
    assert!(fitted.warnings[0].contains("saturated"), "{:?}", fitted.warnings);
}

/// Force on sensor 0 with the sensor's own reference, as in a recording of the finger.
fn own_reference(rows: usize) -> Recording {
    let mut recording = bench(rows, [1.0; 3]);
    for sample in &mut recording.samples {
        sample.scan.codes.taxels = None;
        let force = std::mem::take(&mut sample.truth.force);
        sample.truth = Truth::default();
        sample.truth.sensors[0] = force.map(|f| Some(f.unwrap_or_default()));
    }
    recording
}

#[test]
fn sensor_fit_uses_rows_with_known_force() {
    let finger = FitOptions { subject: Subject::Finger, ..options() };
    let whole = fit_quietly(&[own_reference(1000)], &finger).unwrap();
    assert_eq!((whole.parts[0].name.as_str(), whole.parts[0].rows), ("s0", 1100));
    let mut holes = own_reference(1000);
    holes.samples[300].truth.sensors[0][1] = None;
    holes.samples[1060..].iter_mut().for_each(|sample| sample.truth = Truth::default());
    let holed = fit_quietly(&[holes], &finger).unwrap();
    assert_eq!((holed.parts[0].name.as_str(), holed.parts[0].rows), ("s0", 1059));
    let [whole, holed] =
        [whole, holed].map(|fitted| fitted.calibration.sensors[0].as_ref().unwrap().sensitivity.0);
    for (whole, holed) in whole.as_flattened().iter().zip(holed.as_flattened()) {
        assert!((whole - holed).abs() < 0.01 * whole.abs().max(10.0), "{whole} {holed}");
    }
}

#[test]
fn unfitted_sensor_is_named_with_reason() {
    let warned = |known: fn(f64) -> [Option<f64>; 3], sensor: usize| {
        let mut presses = presses(30, 0, 0.0);
        for sample in &mut presses.samples {
            sample.truth.sensors[sensor] = known(sample.truth.force[2].unwrap_or_default());
        }
        let fitted = fit_quietly(&[presses], &options()).unwrap();
        assert!(fitted.calibration.sensors.iter().all(Option::is_none));
        fitted.warnings
    };
    let begins = "s0: its matrix S was not fitted: made-up.csv: ";
    for (known, why) in [
        (
            (|fz| [None, Some(0.0), Some(fz)]) as fn(f64) -> _,
            "no row has all of s0_fx_n, s0_fy_n, ",
        ),
        (|_| [Some(0.0); 3], "s0_fx_n … s0_fz_n are zero throughout"),
    ] {
        let warnings = warned(known, 0);
        assert!(warnings.iter().any(|w| w.starts_with(&format!("{begins}{why}"))), "{warnings:?}");
    }
    let absent = warned(|fz| [Some(0.1 * fz), Some(0.0), Some(fz)], 2);
    let why =
        "s2: its matrix S was not fitted: made-up.csv: columns bridge_s2_a … bridge_s2_d missing";
    assert!(absent.iter().any(|w| w.starts_with(why)), "{absent:?}");
    assert!(
        !fit_quietly(&[presses(30, 0, 0.0)], &options())
            .unwrap()
            .warnings
            .iter()
            .any(|w| w.contains("matrix S"))
    );
}

#[test]
fn undetermined_sensor_is_skipped_with_warning() {
    let mut presses = presses(30, 0, 0.0);
    for (row, s) in presses.samples.iter_mut().enumerate() {
        let fz = 0.25 * s.truth.force[2].unwrap_or_default();
        s.scan.codes.bridges = sample(row, [0.0; 3], [0.0; 2], [0.0, 0.0, fz]).scan.codes.bridges;
        s.truth.sensors[0] = [Some(0.0), Some(0.0), Some(fz)];
    }
    let finger = FitOptions { subject: Subject::Finger, ..options() };
    let alone = fit_quietly(std::slice::from_ref(&presses), &finger).unwrap();
    assert!(alone.calibration.net.is_some() && alone.calibration.sensors[0].is_none());
    let why = "s0: its matrix S was not fitted: s0: fx_n, fy_n: never loaded";
    assert!(alone.warnings.iter().any(|w| w.starts_with(why)), "{:?}", alone.warnings);
    // Presses without shear are fitted for what they tell: the array from the total force.
    let all = fit_quietly(&[presses], &FitOptions { net_only: false, ..finger }).unwrap();
    assert!(all.warnings.iter().any(|w| w.starts_with(why)), "{:?}", all.warnings);
    assert!(all.calibration.net.is_some() && all.calibration.array.is_some());
}

#[test]
fn unloaded_axis_is_refused_and_one_sided_is_warned() {
    let sheared = |x: fn(f64) -> f64| {
        let mut recording = presses(60, 0, 0.4);
        for sample in &mut recording.samples {
            sample.truth.force[0] = sample.truth.force[0].map(x);
        }
        recording
    };
    for family in [Family::Mlp, Family::Auto, Family::LeastSquares] {
        let options = FitOptions { family, ..options() };
        let refused = fit_quietly(&[sheared(|_| 0.0)], &options).unwrap_err().to_string();
        assert!(refused.starts_with("net: fx_n: the same throughout"), "{refused}");
    }
    let told = |x| fit_quietly(&[sheared(x)], &options()).unwrap().warnings;
    let one_way = told(f64::abs);
    assert!(one_way.iter().any(|w| w.starts_with("fx goes one way only (0.00 … ")), "{one_way:?}");
    let hardly = told(|fx| 0.01 * fx);
    assert!(hardly.iter().any(|w| w.starts_with("no shear in x (less than 1 %")), "{hardly:?}");
    let both = told(|fx| fx);
    assert!(!both.iter().any(|w| w.contains("one way") || w.contains("no shear")), "{both:?}");
}

#[test]
fn outlier_rows_are_counted_as_left_out() {
    let mut loose = presses(60, 0, 0.4);
    let wrong: Vec<usize> =
        (120..loose.samples.len() - 20).step_by(40).map(|row| row + 10).collect();
    for row in &wrong {
        loose.samples[*row].truth.force[2] = Some(30.0);
    }
    let fitted = fit_quietly(&[loose], &options()).unwrap();
    assert_eq!(fitted.parts[0].left_out, wrong.len(), "{:?}", fitted.warnings);
}

#[test]
fn fit_error_names_missing_data_and_remedy() {
    let refused = |recordings: &[Recording], options: &FitOptions| {
        fit_quietly(recordings, options).unwrap_err().to_string()
    };
    assert_eq!(refused(&[], &options()), "no recording to fit to; give at least one");

    let mut unbroken = presses(30, 0, 0.0);
    unbroken.samples.drain(..100);
    unbroken.samples.iter_mut().for_each(|s| s.truth.contact = Some(true));
    assert!(refused(&[unbroken], &options()).contains("half a second in which nothing touches"));

    assert!(refused(&[presses(0, 0, 0.0)], &options()).contains("no load"));

    let mut few = presses(1, 0, 0.4);
    few.samples.truncate(112);
    assert!(refused(&[few], &options()).contains("usable rows where at least"));

    let sensor = |sensor| FitOptions { subject: Subject::Sensor(sensor), ..options() };
    let along_x = refused(&[bench(500, [1.0, 0.0, 0.0])], &sensor(0));
    assert!(along_x.starts_with("s0: fy_n, fz_n: never loaded"), "{along_x}");
    assert!(along_x.contains("load it in x, y and z"), "{along_x}");
    assert!(refused(&[bench(500, [1.0; 3])], &sensor(2)).contains("bridge_s2_a"));
    assert!(refused(&[bench(500, [1.0; 3])], &sensor(7)).contains("s0 … s3"));

    let mut unreferenced = presses(30, 0, 0.0);
    unreferenced.samples.iter_mut().for_each(|s| s.truth.force = [None; 3]);
    assert!(refused(&[unreferenced], &options()).contains("fz_n"));

    let wide = FitOptions { hidden: Some(64), ..options() };
    assert!(refused(&[presses(30, 0, 0.0)], &wide).contains("hidden units"));
}

#[test]
fn few_force_sensors_help_and_state_their_error() {
    for count in [1, 2] {
        let recording = |seed, duration, presses: u32| {
            let act = judge::presses(presses, [0.0, 0.9], 1.0);
            let mut samples = judge::run(11, seed, 500, duration, 0.8, &act);
            let codes = samples.iter_mut().map(|sample| &mut sample.scan.codes);
            codes.for_each(|codes| codes.bridges[count..].fill(None));
            let truths = samples.iter_mut().map(|sample| &mut sample.truth);
            truths.for_each(|truth| truth.sensors = Default::default());
            Recording { name: format!("{count} sensors"), samples }
        };
        let net = NetOptions { seed: 0, starts: 1, steps: 3 };
        let options = FitOptions { net, hidden: Some(1), ..FitOptions::default() };
        let fitted =
            fit(&[recording(1, 31.0, 145)], &options, &mut |_| {}, &AtomicBool::new(false))
                .unwrap();
        let told = fitted.choices.iter().find(|line| line.starts_with("force: matrix"));
        println!("{told:?}");
        assert!(told.is_some_and(|line| line.contains(" over ")), "{:?}", fitted.choices);
        let unseen = recording(2, 13.0, 60);
        let both = evaluate::finger(&fitted.calibration, &unseen);
        let matrix = Calibration { array: None, ..fitted.calibration };
        let matrix = evaluate::finger(&matrix, &unseen);
        let squares = |metrics: &[TargetMetrics]| {
            let force = metrics.iter().filter(|m| m.target.starts_with('f'));
            force.map(|m| m.figures.unwrap().rmse.powi(2)).sum::<f64>()
        };
        for metrics in &both {
            println!("{count} {}: {:?} {:?}", metrics.target, metrics.figures, metrics.beyond);
        }
        assert!(squares(&both) <= squares(&matrix), "{both:?} {matrix:?}");
        for metrics in both.iter().filter(|m| m.target.starts_with('f')) {
            assert!(metrics.beyond.unwrap() < 0.05, "{metrics:?}");
        }
    }
}

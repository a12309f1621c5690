//! Tests of the in-place recalibration of an aged device, by weights and by a load cell.
//!
//! It is judged on other presses of the device, unseen by fit and adjustment, with noise.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};

use taxel::calibration::Calibration;
use taxel::estimate::quantised::{Net, QuantisedNet};
use taxel::units::Code;
use taxel_calibrate::adjust::{Adjusted, Part, adjust, weigh};
use taxel_calibrate::evaluate::{self, Only};
use taxel_calibrate::finger::{FitOptions, Subject, fit};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::{Sample, Truth};
use taxel_regress::error::FitError;
use taxel_regress::network::{NetOptions, Progress};

use crate::fixtures::record;
use crate::judge::{FRICTION, calibrated, presses, run};

/// Device and name of its record.
pub const DEVICE: u32 = 23;
pub const NAME: &str = "ages";
/// Weight of the presses, newtons.
const WEIGHT: f64 = 1.0;

fn recording(samples: Vec<Sample>) -> Recording {
    Recording { name: format!("device {DEVICE}"), samples }
}

/// Skin a tenth softer or stiffer than the 0.236 MPa of calibration.
const YOUNG: &str = "";
const SOFT: &str = "[material]\nyoung_mpa = 0.2145\n";
/// Largest change of an LED, as a share.
const FADED: f64 = 0.15;
const STIFF: &str = "[material]\nyoung_mpa = 0.2596\n";

/// Changes the light of each LED by a share of its own, up to `most`.
fn faded(mut samples: Vec<Sample>, most: f64) -> Vec<Sample> {
    let gain = |k: usize| 1.0 + most * (7.3 * k as f64).sin();
    for sample in &mut samples {
        let codes = sample.scan.codes.taxels.as_mut().unwrap();
        for k in 0..16 {
            let dark = f64::from(codes.dark[k % 4].0);
            let lit = &mut codes.lit[k / 4][k % 4];
            *lit = Code((gain(k) * (f64::from(lit.0) - dark) + dark).round() as u16);
        }
    }
    samples
}

/// Adjusts a record to one recording.
fn adjusted(record: &Calibration, presses: Recording) -> Adjusted {
    adjust(record, &[presses], 1, &mut |_| {}, &AtomicBool::new(false)).unwrap()
}

/// Fits the calibration of the young device.
pub fn fitted() -> Calibration {
    let act = presses(445, [0.0, 0.99], 2.0);
    let net = NetOptions { seed: 0, starts: 1, steps: 80 };
    let options = FitOptions { subject: Subject::Finger, net, ..FitOptions::default() };
    let recordings = [recording(run(DEVICE, 1, 500, 90.0, FRICTION, &act))];
    let fitted = fit(&recordings, &options, &mut |_| {}, &AtomicBool::new(false)).unwrap();
    assert!(fitted.calibration.model.is_some(), "{:?}", fitted.warnings);
    // The sensors would help, but this test is about ageing taxels.
    Calibration { sensors: Default::default(), array: None, ..fitted.calibration }
}

/// Records weights put down at nine positions; their weight is the only known reference.
///
/// Before, the pad is pressed by hand `times` as hard, briefly, up to what the skin bears; not at
/// all for zero.
fn weights(
    calibration: &Calibration,
    (seed, weight, times): (u64, f64, f64),
    (skin, light): (&str, f64),
) -> Recording {
    let mut acts = skin.to_owned();
    let mut press = |at: f64, [x, y]: [f64; 2], force: f64, hold: f64| {
        write!(
            acts,
            "[[press]]\nat_s = {at:.2}\nx_mm = {x}\ny_mm = {y}\nfz_n = {force}\nrise_s = 0.05\n\
             hold_s = {hold}\nfall_s = 0.05\n"
        )
        .unwrap();
    };
    for i in (0..25).filter(|_| times > 0.0) {
        let place = [i % 5, i / 5].map(|k| 2.0 * f64::from(k - 2));
        press(1.0 + 0.16 * f64::from(i), place, (times * weight).min(2.1), 0.02);
    }
    for i in 0..9 {
        let place = [i % 3, i / 3].map(|k| 3.0 * f64::from(k - 1));
        press(5.5 + 0.7 * f64::from(i), place, weight, 0.4);
    }
    let mut recording = recording(faded(run(DEVICE, seed, 500, 12.0, FRICTION, &acts), light));
    recording.samples.iter_mut().for_each(|sample| sample.truth = Truth::default());
    weigh(calibration, &mut recording, weight).unwrap();
    recording
}

/// RMS error of f_z in newtons.
fn error(calibration: &Calibration, judged: &Recording) -> f64 {
    let found = evaluate::finger(calibration, judged);
    found.iter().find(|m| m.target == "fz_n").and_then(|m| m.figures).unwrap().rmse
}

#[test]
fn nine_weights_correct_only_an_aged_device() {
    let all = record(NAME);
    let act = presses(60, [0.0, 0.8], 1.0);
    let young = recording(run(DEVICE, 2, 500, 13.0, 0.8, &act));
    // The softer skin moves as far as in calibration at a tenth less force.
    let act = act.replace("[0.1, 2]", "[0.09, 1.8]");
    let old = recording(faded(run(DEVICE, 2, 500, 13.0, 0.8, &format!("{SOFT}{act}")), FADED));
    let largest = all.taxels.as_ref().unwrap().range.as_flattened().iter();
    let largest = largest.fold(0.0f32, |most, end| most.max(end.abs()));
    let quantised = QuantisedNet::new(all.net.as_ref().and_then(Net::float).unwrap(), largest);
    assert!(quantised.is_some());
    let alone = |model: bool| Calibration {
        model: all.model.clone().filter(|_| model),
        slip: all.slip.filter(|_| model),
        ..all.clone()
    };
    let in_16_bits = Calibration { net: quantised.map(Net::Quantised), ..alone(false) };
    for (name, record, most) in [
        ("net", alone(false), 0.02),
        ("net in 16 bits", in_16_bits, 0.02),
        ("model of the skin", alone(true), 0.0035),
    ] {
        let Adjusted { calibration: mended, presses, parts, errors, warnings, .. } =
            adjusted(&record, weights(&record, (7, WEIGHT, 2.0), (SOFT, FADED)));
        assert_eq!(presses, 9);
        assert!(errors.iter().all(|e| e.after < e.zeroed || e.quantity != "fz_n"), "{errors:?}");
        let mut bias_only = record.clone();
        bias_only.taxels.as_mut().unwrap().bias = mended.taxels.as_ref().unwrap().bias;
        let [once, before, after] =
            [(&record, &young), (&bias_only, &old), (&mended, &old)].map(|(c, r)| error(c, r));
        println!(
            "{name}: {once:.4} N young, {before:.4} aged, {after:.4} mended; {parts:?} {warnings:?}"
        );
        assert!(after < 0.5 * before && after < most, "{name}: {once} {before} {after}");
        for (seed, weight) in [(8, 1.0), (9, 0.4905), (10, 1.8)] {
            let same = weights(&record, (seed, weight, 2.0), (YOUNG, 0.0));
            let adjusted = adjusted(&record, same);
            let after = error(&adjusted.calibration, &young);
            println!(
                "{name}, not aged, {weight} N: {once:.4} N before, {after:.4} after; {:?} {:?}",
                adjusted.parts, adjusted.warnings
            );
            assert!(after < 1.02 * once, "{name}: {once} {after}");
        }
    }
}

/// A skin is stiffer until it was pressed as hard, which weights cannot tell from ageing.
#[test]
fn weights_on_an_unpressed_skin_leave_its_stiffness() {
    let record = Calibration { model: None, slip: None, ..record(NAME) };
    for (times, looked_for) in [(0.0, false), (0.8, false), (2.0, true)] {
        let Adjusted { presses, parts, warnings, .. } =
            adjusted(&record, weights(&record, (7, WEIGHT, times), (SOFT, FADED)));
        println!("{times}: {parts:?} {warnings:?}");
        assert_eq!(presses, 9, "{times}");
        assert_eq!(parts.iter().any(|tried| tried.part == Part::Skin), looked_for, "{times}");
        let told = |w: &&String| w.starts_with("stiffness of the skin: not looked for");
        assert_eq!(warnings.iter().filter(told).count(), usize::from(!looked_for), "{times}");
        assert!(parts.iter().any(|tried| tried.part == Part::Light && tried.kept), "{times}");
    }
}

/// RMS errors of force and contact point of the finger and of its matrix alone.
fn figures(calibration: &Calibration, judged: &Recording) -> Vec<(String, f64)> {
    let parts = [Only::Both, Only::Matrix].into_iter();
    let each = parts.flat_map(|only| {
        let (calibration, judged) = only.of(calibration, judged);
        let named = evaluate::finger(&calibration, &judged).into_iter();
        named.filter_map(move |m| Some((format!("{only:?} {}", m.target), m.figures?.rmse)))
    });
    each.collect()
}

/// Presses with shear on an aged device, with the labels of a load cell.
fn sheared(device: u32, seed: u64, skin: &str, light: f64) -> Recording {
    let acts = format!("{skin}{}", presses(60, [0.0, 0.8], 1.0));
    let mut samples = faded(run(device, seed, 500, 13.0, 0.8, &acts), light);
    samples.iter_mut().for_each(|sample| sample.truth.sensors = Default::default());
    recording(samples)
}

#[test]
fn aged_devices_are_repaired_and_nothing_is_worse() {
    for (device, seed, skin, light) in [
        (11, 21, SOFT, 0.0),
        (12, 22, STIFF, 0.0),
        (13, 23, YOUNG, 0.1),
        (14, 24, SOFT, -0.08),
        (15, 25, STIFF, 0.08),
    ] {
        let record = calibrated(device);
        let adjusted = adjusted(&record, sheared(device, seed, skin, light));
        println!("device {device}: {:?} {:?}", adjusted.parts, adjusted.warnings);
        let unseen = sheared(device, seed + 100, skin, light);
        let mut zeroed = record.clone();
        if light != 0.0 {
            zeroed.taxels.as_mut().unwrap().bias = adjusted.calibration.bias().taxels.unwrap();
        }
        let [before, after] =
            [&zeroed, &adjusted.calibration].map(|record| figures(record, &unseen));
        for ((name, before), (_, after)) in before.iter().zip(&after) {
            println!("  {name}: {before:.4} {after:.4}");
            assert!(*after < 1.05 * before + 1e-3, "device {device}, {name}: {before} {after}");
        }
        // The given record may never end a contact, and then tells touches that a young finger's
        // gate hides. The repaired one must be as good as it, or as the young finger.
        let young = sheared(device, seed + 100, YOUNG, 0.0);
        let [given, young] = [&unseen, &young].map(|judged| figures(&record, judged));
        for (name, after) in after.iter().filter(|(name, _)| name.starts_with("Both f")) {
            let of = |all: &[(String, f64)]| all.iter().find(|(n, _)| n == name).map(|(_, e)| *e);
            let (given, young) = (of(&given).unwrap(), of(&young).unwrap());
            println!("  {name}: given {given:.4}, after {after:.4}, young {young:.4}");
            let most = 1.05 * given.max(young) + 1e-3;
            assert!(*after < most, "device {device}, {name}: {given} {after} {young}");
        }
        let normal = |of: &[(String, f64)]| {
            of.iter().find(|(name, _)| name == "Matrix fz_n").map(|(_, error)| *error).unwrap()
        };
        let (before, after) = (normal(&before), normal(&after));
        assert!(after < 0.5 * before, "device {device}: {before} {after}");
    }
}

#[test]
fn young_devices_keep_their_records() {
    for (device, seed) in [(11, 31), (12, 32), (13, 33), (14, 34), (15, 35), (17, 36)] {
        let record = calibrated(device);
        let adjusted = adjusted(&record, sheared(device, seed, YOUNG, 0.0));
        assert_eq!(adjusted.calibration, record, "device {device}: {:?}", adjusted.parts);
        assert!(adjusted.unaged, "device {device}: {:?}", adjusted.warnings);
        assert!(adjusted.warnings.is_empty(), "device {device}: {:?}", adjusted.warnings);
    }
}

#[test]
fn another_finger_or_no_labels_are_refused() {
    let refused_all = |recordings: &[Recording]| {
        adjust(&calibrated(11), recordings, 1, &mut |_| {}, &AtomicBool::new(false))
            .unwrap_err()
            .to_string()
    };
    let refused = |recording| refused_all(&[recording]);
    let (own, other) = (sheared(11, 63, YOUNG, 0.0), sheared(12, 61, YOUNG, 0.3));
    for recordings in [&[other.clone()][..], &[own, other]] {
        let told = refused_all(recordings);
        assert!(told.contains("looks like another finger"), "{told}");
    }
    let mut bare = sheared(11, 62, SOFT, 0.0);
    bare.samples.iter_mut().for_each(|sample| sample.truth = Truth::default());
    assert_eq!(refused(bare), "no force labels: give --reference or --weight");
}

#[test]
fn weaker_force_sensors_are_repaired_by_total_force() {
    let record = calibrated(11);
    let weak = |seed| {
        let mut weak = sheared(11, seed, "[electronics]\nbridge_gain = 14.5\n", 0.0);
        weak.samples.iter_mut().for_each(|sample| sample.scan.codes.taxels = None);
        weak
    };
    let record = Only::Array.of(&record, &weak(41)).0;
    let adjusted = adjusted(&record, weak(41));
    assert!(adjusted.gains(Part::Array).is_some(), "{:?}", adjusted.parts);
    let unseen = weak(42);
    let (before, after) = (error(&record, &unseen), error(&adjusted.calibration, &unseen));
    assert!(after < 0.5 * before, "{before} {after}");
}

/// Adjusts to a softer skin with a dimmer light, and stops when the progress names this part.
fn stopped_in(part: &str) -> Result<Adjusted, FitError> {
    let stop = AtomicBool::new(false);
    let mut told = |progress: Progress| {
        if progress.part.starts_with(part) {
            stop.store(true, Ordering::Relaxed);
        }
    };
    adjust(&calibrated(14), &[sheared(14, 24, SOFT, -0.08)], 1, &mut told, &stop)
}

#[test]
fn stopped_adjustment_keeps_what_helped_before() {
    for part in ["as it is", "zero"] {
        assert_eq!(stopped_in(part), Err(FitError::Stopped), "{part}");
    }
    let stopped = stopped_in("light of the taxels").unwrap();
    let parts: Vec<Part> = stopped.parts.iter().map(|tried| tried.part).collect();
    assert!(stopped.stopped && !stopped.unaged && parts == [Part::Bias], "{stopped:?}");
    // The parts that were not tried may repair what is left: it is no reason to fit again.
    assert!(stopped.warnings.is_empty(), "{:?}", stopped.warnings);
    let old = calibrated(14);
    let zero = |record: &Calibration| record.taxels.as_ref().unwrap().bias;
    assert_ne!(zero(&stopped.calibration), zero(&old));
    assert_eq!(stopped.calibration.net, old.net);
    assert_eq!(stopped.calibration.model, old.model);
}

//! Tests of the in-place recalibration of an aged device by nine presses with one known weight.
//!
//! It is judged on other presses of the device, unseen by fit and adjustment, with noise.

use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::estimate::quantised::{Net, QuantisedNet};
use taxel::scan::TaxelCodes;
use taxel::units::Code;
use taxel_calibrate::adjust::{adjust, weigh};
use taxel_calibrate::evaluate;
use taxel_calibrate::finger::{FitOptions, Subject, fit};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::{Sample, Truth};
use taxel_regress::network::NetOptions;

use crate::fixtures::record;
use crate::judge::{FRICTION, presses, run};

/// Device and name of its record.
pub const DEVICE: u32 = 23;
pub const NAME: &str = "ages";
/// Rows before the first touch.
const UNLOADED: usize = 400;
/// Weight of the presses, newtons.
const WEIGHT: f64 = 1.0;

fn recording(samples: Vec<Sample>) -> Recording {
    Recording { name: format!("device {DEVICE}"), samples }
}

/// Ages the device: light changes by up to 15 %, and every signal rises by a tenth.
///
/// The LEDs age one by one; the signals rise because the skin softens.
fn aged(mut samples: Vec<Sample>) -> Vec<Sample> {
    const SKIN: f64 = 1.1;
    let gain = |k: usize| 1.0 + 0.15 * (7.3 * k as f64).sin();
    let light = |codes: &TaxelCodes, k: usize| {
        f64::from(codes.lit[k / 4][k % 4].0) - f64::from(codes.dark[k % 4].0)
    };
    let unloaded: Vec<f64> = (0..16)
        .map(|k| {
            let rows = samples[..UNLOADED].iter();
            rows.map(|s| light(&s.scan.codes.taxels.unwrap(), k)).sum::<f64>() / UNLOADED as f64
        })
        .collect();
    for sample in &mut samples {
        let codes = sample.scan.codes.taxels.as_mut().unwrap();
        let before = *codes;
        for (k, unloaded) in unloaded.iter().enumerate() {
            let light = unloaded + SKIN * (light(&before, k) - unloaded);
            let code = gain(k) * light + f64::from(before.dark[k % 4].0);
            codes.lit[k / 4][k % 4] = Code(code.round() as u16);
        }
    }
    samples
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
fn weights(
    calibration: &Calibration,
    (seed, weight): (u64, f64),
    since: fn(Vec<Sample>) -> Vec<Sample>,
) -> Recording {
    let mut acts = String::new();
    for i in 0..9 {
        let (x, y) = (3.0 * f64::from(i % 3 - 1), 3.0 * f64::from(i / 3 - 1));
        let at = 1.0 + 0.7 * f64::from(i);
        write!(
            acts,
            "[[press]]\nat_s = {at:.2}\nx_mm = {x}\ny_mm = {y}\nfz_n = {weight}\nrise_s = 0.05\n\
             hold_s = 0.4\nfall_s = 0.05\n"
        )
        .unwrap();
    }
    let mut recording = recording(since(run(DEVICE, seed, 500, 7.5, FRICTION, &acts)));
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
    let old = recording(aged(young.samples.clone()));
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
    for (name, record, estimators, most) in [
        ("net", alone(false), 1, 0.02),
        ("net in 16 bits", in_16_bits, 1, 0.02),
        ("model of the skin", alone(true), 2, 0.0035),
    ] {
        let adjusted = adjust(&record, &[weights(&record, (7, WEIGHT), aged)], 1).unwrap();
        assert_eq!((adjusted.presses, adjusted.helped.len()), (9, estimators));
        assert!(adjusted.helped.iter().all(|h| h.after < h.before), "{:?}", adjusted.helped);
        let mended = adjusted.calibration;
        let mut bias_only = record.clone();
        bias_only.taxels.as_mut().unwrap().bias = mended.taxels.as_ref().unwrap().bias;
        let [once, before, after] =
            [(&record, &young), (&bias_only, &old), (&mended, &old)].map(|(c, r)| error(c, r));
        println!(
            "{name}: {once:.4} N young, {before:.4} aged, {after:.4} mended; {:?} {:?}",
            adjusted.helped, adjusted.warnings
        );
        assert!(after < 0.5 * before && after < most, "{name}: {once} {before} {after}");
        for (seed, weight) in [(8, 1.0), (9, 0.4905), (10, 1.8)] {
            let same = weights(&record, (seed, weight), |samples| samples);
            let adjusted = adjust(&record, &[same], 1).unwrap();
            let after = error(&adjusted.calibration, &young);
            println!(
                "{name}, not aged, {weight} N: {once:.4} N before, {after:.4} after; {:?} {:?}",
                adjusted.helped, adjusted.warnings
            );
            assert!(after < 1.02 * once, "{name}: {once} {after}");
        }
    }
}

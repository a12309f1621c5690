//! Tests of a finger at other temperatures than in calibration, with and without a warm-up
//! recording.

use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel_calibrate::finger::{FitOptions, Subject, fit};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::Sample;
use taxel_regress::network::NetOptions;
use taxel_sim::{Effect, Scene, Simulator};

use crate::fixtures::record;

/// Seed of the device.
pub const DEVICE: u32 = 31;

fn samples(scene: Scene, seed: u64) -> Vec<Sample> {
    let mut scene = scene.with_effect(Effect::Temperature);
    scene.device.seed = DEVICE.into();
    Simulator::new(&scene, seed).collect()
}

/// The first `seconds` of a built-in scene.
fn recorded(name: &str, seconds: u64) -> Recording {
    let mut samples = samples(Scene::load(name).unwrap(), 1);
    samples.retain(|sample| sample.scan.time.0 < seconds * 1_000_000);
    Recording { name: name.into(), samples }
}

/// Name of the device's record, fitted with or without a warm-up recording.
pub fn name(warm_up: bool) -> &'static str {
    if warm_up { "warm-up" } else { "no-warm-up" }
}

/// Fits the device's record.
pub fn fitted(warm_up: bool) -> Calibration {
    let mut recordings = vec![recorded("presses", 15), recorded("shear", 15)];
    if warm_up {
        recordings.push(recorded("warm-up", 60));
    }

    let net = NetOptions { seed: 0, starts: 1, steps: 20 };
    let options =
        FitOptions { subject: Subject::Finger, net, net_only: true, ..FitOptions::default() };
    fit(&recordings, &options, &mut |_| {}, &AtomicBool::new(false)).unwrap().calibration
}

/// Presses with another seed in a room at `celsius`.
fn presses(celsius: f64) -> Vec<Sample> {
    let text = format!(
        "effects = ['noise', 'gain-spread', 'bridge-mismatch', 'bridge-crosstalk', 'temperature']\n\
         [scan]\nrate_hz = 500\nduration_s = 6\n[device]\nseed = {DEVICE}\nbits = 16\n\
         [temperature]\nstart_c = {celsius}\nend_c = {celsius}\n[indenter]\nradius_mm = 6\n\
         [[random]]\nat_s = 1\npresses = 24\neach_s = 0.2\nx_mm = [-2, 2]\ny_mm = [-2, 2]\n\
         fz_n = [0.2, 2]\nshear_of_limit = [0, 0.9]\n"
    );
    samples(Scene::parse("presses.toml", &text).unwrap(), 9)
}

/// RMS error of the force sensors in newtons, and share of frames with the temperature flag.
fn judged(record: &Calibration, samples: &[Sample]) -> (f64, f64) {
    let (finger, mut state) = Finger::new(Some(record.clone()));
    let (mut squares, mut n, mut flagged) = (0.0, 0.0, 0);
    for sample in samples {
        let estimate = finger.estimate(&mut state, &sample.scan);
        flagged += usize::from(estimate.status.contains(Status::TEMPERATURE));
        for (force, truth) in estimate.sensors.iter().zip(&sample.truth.sensors) {
            for (found, truth) in [force.x, force.y, force.z].iter().zip(truth) {
                let (Ok(found), Some(truth)) = (found, truth) else { continue };
                squares += (f64::from(found.0) - truth).powi(2);
                n += 1.0;
            }
        }
    }
    assert!(n > 10_000.0, "{n} values");
    ((squares / n).sqrt(), flagged as f64 / samples.len() as f64)
}

#[test]
fn warm_up_recording_compensates_temperature() {
    let [with, without] = [true, false].map(|warm_up| record(name(warm_up)));
    let (room, flagged) = judged(&with, &presses(25.0));
    println!("25 °C: {room:.5} N");
    assert_eq!(flagged, 0.0);
    for celsius in [12.0, 23.0, 27.0, 38.0] {
        let samples = presses(celsius);
        let ((left, flagged), (before, told)) =
            (judged(&with, &samples), judged(&without, &samples));
        println!("{celsius} °C: {left:.5} N, {before:.5} N without a recording of it");
        assert!(left < 1.5 * room, "{celsius} °C: {left} N, {room} N in its room");
        assert_eq!(flagged, 0.0, "{celsius} °C");
        assert!(before > 2.0 * left && told > 0.99, "{celsius} °C: {before} N, {told} flagged");
    }
    for celsius in [-10.0, 60.0] {
        assert!(judged(&with, &presses(celsius)).1 > 0.99, "{celsius} °C");
    }
}

#[test]
fn noise_of_a_load_cell_is_no_load_of_a_warm_up() {
    for seed in 1..4 {
        let warm_up = Scene::load("warm-up").unwrap().with_effect(Effect::BenchError);
        let warm_up = Recording { name: "warm-up".into(), samples: samples(warm_up, seed) };
        assert!(warm_up.samples.iter().any(|s| s.truth.force[2].is_some_and(|f| f > 0.015)));
        let recordings = [recorded("presses", 15), recorded("shear", 15), warm_up];
        let net = NetOptions { seed: 0, starts: 1, steps: 3 };
        let options =
            FitOptions { subject: Subject::Finger, net, net_only: true, ..FitOptions::default() };
        let fitted = fit(&recordings, &options, &mut |_| {}, &AtomicBool::new(false)).unwrap();
        assert!(fitted.calibration.warmth.is_some());
    }
}

#[test]
fn warm_up_is_skipped_without_thermometer_elsewhere() {
    let mut loads = recorded("shear", 15);
    loads.samples.iter_mut().for_each(|sample| sample.scan.codes.temperature = None);
    let net = NetOptions { seed: 0, starts: 1, steps: 5 };
    let options =
        FitOptions { subject: Subject::Finger, net, net_only: true, ..FitOptions::default() };
    let recordings = [loads, recorded("warm-up", 60)];
    let fitted = fit(&recordings, &options, &mut |_| {}, &AtomicBool::new(false)).unwrap();
    assert_eq!(fitted.calibration.warmth, None);
    assert!(fitted.warnings.iter().any(|w| w.contains("aux_temp")), "{:?}", fitted.warnings);
    let alone = fit(&recordings[1..], &options, &mut |_| {}, &AtomicBool::new(false)).unwrap_err();
    assert!(alone.to_string().contains("no load"), "{alone}");
}

//! Judging of the estimators: a device is calibrated on one recording and judged on an unseen run.
//!
//! Both have noise.
#![allow(dead_code, reason = "test and bench use their parts")]

pub mod limit_surfaces;
pub mod page;
pub mod response;
pub mod slip;

use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::estimate::limit_surface::LimitSurface;
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::measured::Measured;
use taxel::units::Newtons;
use taxel_calibrate::finger::{FitOptions, Subject, fit};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::Sample;
use taxel_regress::network::NetOptions;
use taxel_sim::{Scene, Simulator};

/// Effects of every scene here.
const EFFECTS: &str = "'noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                       'bridge-mismatch', 'bridge-crosstalk'";

/// Simulates `acts` on `device` at `rate` frames a second.
pub fn run(device: u32, seed: u64, rate: u32, duration: f64, mu: f64, acts: &str) -> Vec<Sample> {
    let text = format!(
        "effects = [{EFFECTS}]\n[scan]\nrate_hz = {rate}\nduration_s = {duration}\n\
         [device]\nseed = {device}\nbits = 16\n[indenter]\nradius_mm = 6\n[friction]\nmu = {mu}\n{acts}"
    );
    Simulator::new(&Scene::parse("judge.toml", &text).unwrap(), seed).collect()
}

/// `[[random]]` presses all over the pad after a second without load.
pub fn presses(count: u32, shear: [f64; 2], roll: f64) -> String {
    format!(
        "[[random]]\nat_s = 1\npresses = {count}\neach_s = 0.2\nx_mm = [-4.2, 4.2]\n\
         y_mm = [-4.2, 4.2]\nfz_n = [0.1, 2]\nshear_of_limit = {shear:?}\nroll_mm = {roll}\n"
    )
}

/// Friction coefficient in calibration: its shear must cover all later shear.
pub const FRICTION: f64 = 1.2;

/// Name of a device's committed record.
pub fn name(device: u32) -> String {
    format!("device-{device}")
}

/// Reads the device's committed calibration.
pub fn calibrated(device: u32) -> Calibration {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures");
    taxel_files::calibration::read(format!("{folder}/{}.toml", name(device))).unwrap()
}

/// Fits the device's calibration to 90 s of presses.
///
/// The net has a single unit, because it is not judged.
pub fn fitted(device: u32) -> Calibration {
    let samples = run(device, 1, 500, 90.0, FRICTION, &presses(445, [0.0, 0.99], 2.0));
    let recording = Recording { name: format!("device {device}"), samples };
    let net = NetOptions { seed: 0, starts: 1, steps: 3 };
    let options =
        FitOptions { subject: Subject::Finger, net, hidden: Some(1), ..FitOptions::default() };
    let fitted = fit(&[recording], &options, &mut |_| {}, &AtomicBool::new(false)).unwrap();
    assert!(fitted.calibration.model.is_some(), "{:?}", fitted.warnings);
    fitted.calibration
}

/// Sensors of a finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum With {
    Both,
    Matrix,
    Array,
}

/// Runs the finger over every scan and returns its estimates.
pub fn replay(calibration: &Calibration, samples: &[Sample], with: With) -> Vec<Estimate> {
    let mut calibration = calibration.clone();
    match with {
        With::Both => {}
        With::Matrix => {
            calibration.array = None;
            calibration.sensors = Default::default();
        }
        With::Array => {
            (calibration.taxels, calibration.net, calibration.model) = (None, None, None);
        }
    }
    let (finger, mut state) = Finger::new(Some(calibration));
    samples
        .iter()
        .map(|sample| {
            let mut scan = sample.scan;
            match with {
                With::Both => {}
                With::Matrix => scan.codes.bridges = [None; 4],
                With::Array => scan.codes.taxels = None,
            }
            finger.estimate(&mut state, &scan)
        })
        .collect()
}

/// Root mean square of a quantity: sum of squares and count.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rms(f64, usize);

impl Rms {
    pub fn add(&mut self, error: f64) {
        self.0 += error * error;
        self.1 += 1;
    }

    pub fn value(&self) -> f64 {
        (self.0 / self.1.max(1) as f64).sqrt()
    }

    pub fn count(&self) -> usize {
        self.1
    }
}

/// Errors of one device in one ring of the pad.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ring {
    pub point: Rms,
    pub force: [Rms; 3],
    /// Angle between estimated and true force in degrees, at 0.3 N and more.
    pub direction: Rms,
    pub torsion: Rms,
    /// Frames judged, and those of them without a contact point or without a component of the
    /// force.
    pub frames: usize,
    pub missing: usize,
}

/// Greatest |x| and |y| of each ring, mm: middle, out to the outer taxels, beyond them.
pub const RINGS: [f64; 3] = [2.0, 3.75, 4.2];

/// Errors by ring, for the frames with a normal force of at least `least` newtons.
pub fn errors(samples: &[Sample], estimates: &[Estimate], least: f64) -> [Ring; 3] {
    let mut rings = [Ring::default(); 3];
    for (sample, estimate) in samples.iter().zip(estimates) {
        let truth = &sample.truth;
        let force = truth.force.map(Option::unwrap);
        let [Some(x), Some(y)] = truth.point else { continue };
        if force[2] < least {
            continue;
        }
        let out = x.abs().max(y.abs());
        let found = [estimate.force.x, estimate.force.y, estimate.force.z].map(newtons);
        for (ring, limit) in rings.iter_mut().zip(RINGS) {
            // Each ring includes those inside it: "to the outer taxel row".
            if out > limit {
                continue;
            }
            ring.frames += 1;
            ring.missing += usize::from(estimate.point.is_err() || found.contains(&None));
            if let Ok(p) = estimate.point {
                ring.point.add((f64::from(p.x.0) - x).hypot(f64::from(p.y.0) - y));
            }
            for ((rms, found), force) in ring.force.iter_mut().zip(found).zip(force) {
                found.inspect(|found| rms.add(found - force));
            }
            if let [Some(fx), Some(fy), Some(fz)] = found
                && norm(force) >= 0.3
            {
                ring.direction.add(angle([fx, fy, fz], force));
            }
            if let (Ok(torsion), Some(truth)) = (estimate.torsion, truth.torsion) {
                ring.torsion.add(f64::from(torsion.0) - truth);
            }
        }
    }
    rings
}

pub fn newtons(force: Measured<Newtons>) -> Option<f64> {
    force.ok().map(|force| f64::from(force.0))
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

fn angle(a: [f64; 3], b: [f64; 3]) -> f64 {
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    (dot / (norm(a) * norm(b)).max(1e-12)).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Mean of some values, such as figures of several devices.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    sum / f64::max(count, 1.0)
}

/// Results on pairs of contacts.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pairs {
    pub shown: usize,
    /// Pairs with both contacts found, each within half a pitch.
    pub found: usize,
    pub point: Rms,
    pub normal: Rms,
}

/// Positions spread evenly over the unit square: the additive recurrence of the plastic number.
fn spread(i: u32) -> [f64; 2] {
    [0.754_877_666_246_692_7, 0.569_840_290_998_053_3].map(|step| (step * f64::from(i)).fract())
}

/// Judges two simultaneous presses, one pair after the other.
///
/// The presses are at least two pitches (5 mm) apart, with 0.2 to 0.8 N each.
pub fn pairs(device: u32, record: &Calibration, count: usize, with: With) -> Pairs {
    let on_pad = |unit: [f64; 2]| unit.map(|u| 7.5 * u - 3.75);
    let shown = (0u32..).map(|i| {
        let [a, b] = [spread(2 * i), spread(5 * i + 3)].map(on_pad);
        let [fa, fb] = spread(3 * i + 1).map(|u| 0.2 + 0.6 * u);
        ([a, b], [fa, fb])
    });
    let apart = |[a, b]: [[f64; 2]; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let shown: Vec<_> = shown.filter(|(places, _)| apart(*places) >= 5.0).take(count).collect();
    let begin = |i: usize| 1.0 + 0.25 * i as f64;
    let mut acts = String::new();
    for (i, (places, normals)) in shown.iter().enumerate() {
        for ([x, y], fz) in places.iter().zip(normals) {
            acts += &format!(
                "[[press]]\nat_s = {}\nx_mm = {x}\ny_mm = {y}\nfz_n = {fz}\nrise_s = 0.05\n\
                 hold_s = 0.1\nfall_s = 0.05\n",
                begin(i)
            );
        }
    }
    let samples = run(device, 5, 1000, begin(count) + 1.0, 0.8, &acts);
    let estimates = replay(record, &samples, with);
    let mut outcome = Pairs { shown: shown.len(), ..Pairs::default() };
    for (i, (places, normals)) in shown.iter().enumerate() {
        let held = ((begin(i) + 0.1) * 1000.0) as usize;
        let Ok(contacts) = estimates[held].contacts else { continue };
        let away = |place: [f64; 2], k: usize| {
            let point = contacts[k].point;
            (f64::from(point.x.0) - place[0]).hypot(f64::from(point.y.0) - place[1])
        };
        let straight = away(places[0], 0) + away(places[1], 1);
        let order =
            if straight < away(places[0], 1) + away(places[1], 0) { [0, 1] } else { [1, 0] };
        let errors = [away(places[0], order[0]), away(places[1], order[1])];
        outcome.found += usize::from(errors.iter().all(|error| *error < 1.25));
        for (k, normal) in order.into_iter().zip(normals) {
            outcome.normal.add(f64::from(contacts[k].normal.0) - normal);
        }
        errors.into_iter().for_each(|error| outcome.point.add(error));
    }
    outcome
}

/// Number of frames of single contacts, and of those estimated as two.
pub fn false_pairs(estimates: &[Estimate]) -> (usize, usize) {
    let touched = || estimates.iter().filter(|e| e.status.contains(Status::CONTACT));
    (touched().count(), touched().filter(|e| e.contacts.is_ok()).count())
}

/// Twelve presses of 0.3 to 2 N all over the pad, each with a moment about its normal.
///
/// The moment is two thirds of the limit at a friction of 1.2, alternating in sign.
pub fn twisted(device: u32) -> Vec<Sample> {
    let mut acts = String::new();
    for i in 0..12u32 {
        let [x, y] = spread(i).map(|unit| 7.5 * unit - 3.75);
        let fz = 0.3 + 1.7 * spread(7 * i + 2)[0];
        // [Ospina2017] §2.3 for Hertz's pressure: τ = κ·μ·N·a, κ = 3π/16.
        let holds = LimitSurface::hertz(6.0, 0.236).most_torsion(fz as f32, FRICTION as f32);
        let torsion = f64::from(holds) * if i % 2 == 0 { 0.66 } else { -0.66 };
        acts += &format!(
            "[[press]]\nat_s = {}\nx_mm = {x}\ny_mm = {y}\nfz_n = {fz}\ntorsion_nmm = {torsion}\n\
             rise_s = 0.1\nhold_s = 0.3\nfall_s = 0.1\n",
            1.0 + 0.6 * f64::from(i)
        );
    }
    run(device, 8, 1000, 8.5, FRICTION, &acts)
}

/// Root mean square of the true torsion during contact, in N·mm.
pub fn true_torsion(samples: &[Sample]) -> f64 {
    let mut all = Rms::default();
    let touched = samples.iter().filter(|sample| sample.truth.contact == Some(true));
    touched.filter_map(|sample| sample.truth.torsion).for_each(|torsion| all.add(torsion));
    all.value()
}

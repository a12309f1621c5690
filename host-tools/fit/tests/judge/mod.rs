//! How the estimators are judged: a device is calibrated on its own recording, then seen on a run of its
//! own that the fit has never met, noise on.
#![allow(dead_code, reason = "test and bench use their parts")]

use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::measured::Measured;
use taxel::units::Newtons;
use taxel_fit::finger::{FitOptions, Subject, fit};
use taxel_fit::network::NetOptions;
use taxel_fit::recording::Recording;
use taxel_formats::trace::Sample;
use taxel_sim::{Scene, Simulator};

/// Effects of every scene here.
const EFFECTS: &str = "'noise', 'ambient', 'flicker', 'gain-spread', 'optical-crosstalk', \
                       'bridge-mismatch', 'bridge-crosstalk'";

/// What happens on `device` at `rate` frames a second.
pub fn run(device: u32, seed: u64, rate: u32, duration: f64, mu: f64, acts: &str) -> Vec<Sample> {
    let text = format!(
        "effects = [{EFFECTS}]\n[scan]\nrate_hz = {rate}\nduration_s = {duration}\n\
         [device]\nseed = {device}\nbits = 16\n[indenter]\nradius_mm = 6\n[friction]\nmu = {mu}\n{acts}"
    );
    Simulator::new(&Scene::parse("judge.toml", &text).unwrap(), seed).collect()
}

/// `[[random]]` presses all over the pad after a second of nothing.
pub fn presses(count: u32, shear: [f64; 2], roll: f64) -> String {
    format!(
        "[[random]]\nat_s = 1\npresses = {count}\neach_s = 0.2\nx_mm = [-4.2, 4.2]\n\
         y_mm = [-4.2, 4.2]\nfz_n = [0.1, 2]\nshear_of_limit = {shear:?}\nroll_mm = {roll}\n"
    )
}

/// Of what touches a finger in calibration: shear has to cover all that it will meet.
pub const FRICTION: f64 = 1.2;

/// The device's calibration: 90 s of presses. The net is a token one, for what is judged is not it.
pub fn calibrated(device: u32) -> Calibration {
    let samples = run(device, 1, 500, 90.0, FRICTION, &presses(445, [0.0, 0.99], 2.0));
    let recording = Recording { name: format!("device {device}"), samples };
    let net = NetOptions { seed: 0, starts: 1, steps: 3 };
    let options =
        FitOptions { subject: Subject::Finger, net, hidden: Some(1), ..FitOptions::default() };
    let fitted = fit(&[recording], &options, &mut |_| {}, &AtomicBool::new(false)).unwrap();
    assert!(fitted.calibration.model.is_some(), "{:?}", fitted.warnings);
    fitted.calibration
}

/// Which sensors a finger has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum With {
    Both,
    Matrix,
    Array,
}

/// What the finger says of every scan.
pub fn replay(calibration: &Calibration, samples: &[Sample], with: With) -> Vec<Estimate> {
    let mut calibration = calibration.clone();
    match with {
        With::Both => {}
        With::Matrix => {
            calibration.array = None;
            calibration.sensors = Default::default();
        }
        With::Array => {
            (calibration.taxels, calibration.force, calibration.model) = (None, None, None);
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

/// Sum of squares and count of something.
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
    /// Angle between force and truth in degrees, at 0.3 N and more.
    pub direction: Rms,
    pub torsion: Rms,
    /// Frames without a value.
    pub missing: usize,
}

/// Middle of the pad, out to the outer taxels, beyond them: greatest |x|, |y| of a ring in mm.
pub const RINGS: [f64; 3] = [2.0, 3.75, 4.2];

/// Errors by ring, of the frames with a normal force of at least `least` newtons.
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
            // Each ring holds those inside it: "to the outer taxel row".
            if out > limit {
                continue;
            }
            match estimate.point {
                Ok(p) => ring.point.add((f64::from(p.x.0) - x).hypot(f64::from(p.y.0) - y)),
                Err(_) => ring.missing += 1,
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

fn newtons(force: Measured<Newtons>) -> Option<f64> {
    force.ok().map(|force| f64::from(force.0))
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

fn angle(a: [f64; 3], b: [f64; 3]) -> f64 {
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    (dot / (norm(a) * norm(b)).max(1e-12)).clamp(-1.0, 1.0).acos().to_degrees()
}

/// Means over devices.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    sum / f64::max(count, 1.0)
}

/// How pairs of contacts fared.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pairs {
    pub shown: usize,
    /// Both told, each within half a pitch.
    pub found: usize,
    pub point: Rms,
    pub normal: Rms,
}

/// Places that spread evenly over the unit square: the additive recurrence of the plastic number.
fn spread(i: u32) -> [f64; 2] {
    [0.754_877_666_246_692_7, 0.569_840_290_998_053_3].map(|step| (step * f64::from(i)).fract())
}

/// Two presses at once, two to four pitches apart and of 0.2 to 0.8 N each, one pair after the other.
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

/// Frames of single contacts, and those of them that were said to be two.
pub fn false_pairs(estimates: &[Estimate]) -> (usize, usize) {
    let touched = || estimates.iter().filter(|e| e.status.contains(Status::CONTACT));
    (touched().count(), touched().filter(|e| e.contacts.is_ok()).count())
}

/// How many slides began, and before how many of them the warning came 20 ms ahead: the first on a thing of
/// unknown friction, and the later ones.
#[derive(Clone, Copy, Debug, Default)]
pub struct Onsets {
    pub first: [usize; 2],
    pub later: [usize; 2],
}

/// Friction coefficients and loads of the slides.
pub const FRICTIONS: [f64; 4] = [0.2, 0.4, 0.8, 1.2];
pub const LOADS: [f64; 4] = [0.2, 0.5, 1.0, 2.0];

/// Four slides at every friction and load: shear grows for 150 ms until it breaks loose.
pub fn onsets(device: u32, record: &Calibration, with: With) -> Onsets {
    let mut outcome = Onsets::default();
    for (mu, load) in FRICTIONS.into_iter().flat_map(|mu| LOADS.map(|load| (mu, load))) {
        let mut acts = String::new();
        for i in 0..4 {
            let (at, y) = (1.0 + 2.2 * f64::from(i), 1.0 - 0.5 * f64::from(i));
            acts += &format!(
                "[[slide]]\nat_s = {at}\nfrom_mm = [-1.5, {}]\nto_mm = [1.5, {y}]\nfz_n = {load}\n\
                 rise_s = 0.2\ntravel_s = 1.5\nfall_s = 0.2\n",
                -y
            );
        }
        let samples = run(device, 3, 1000, 10.5, mu, &acts);
        let estimates = replay(record, &samples, with);
        let (mut pressed, mut slides) = (0, 0);
        for i in 1..samples.len() {
            let truth = |i: usize| &samples[i].truth;
            // Shear begins where the normal force has come up: a warning before that is a false one.
            if truth(i).force[0] == Some(0.0) {
                pressed = i;
            }
            if truth(i).slip == Some(true) && truth(i - 1).slip != Some(true) {
                let warned = |i: usize| estimates[i].status.contains(Status::SLIP_WARNING);
                let ahead = !warned(pressed) && (pressed..=i - 20).any(warned);
                let counts = if slides == 0 { &mut outcome.first } else { &mut outcome.later };
                counts[0] += 1;
                counts[1] += usize::from(ahead);
                slides += 1;
            }
        }
        assert_eq!(slides, 4);
    }
    outcome
}

/// Warnings, counted when they begin, in `minutes` of a grasp with up to half of its friction in use; `known`:
/// after one slide that told what that is.
pub fn false_warnings(
    device: u32,
    record: &Calibration,
    (with, mu, known): (With, f64, bool),
    minutes: f64,
) -> usize {
    let slide = "[[slide]]\nat_s = 1\nfrom_mm = [-1.5, 0]\nto_mm = [1.5, 0]\nfz_n = 1\nrise_s = 0.2\n\
                 travel_s = 1.5\nfall_s = 0.2\n";
    let count = (minutes * 60.0 / 0.4) as u32;
    let grasp = format!(
        "[[random]]\nat_s = 3.5\npresses = {count}\neach_s = 0.4\nx_mm = [-3, 3]\ny_mm = [-3, 3]\n\
         fz_n = [0.2, 2]\nshear_of_limit = [0, 0.5]\n"
    );
    let acts = if known { format!("{slide}{grasp}") } else { grasp };
    let samples = run(device, 9, 500, 4.5 + 60.0 * minutes, mu, &acts);
    let estimates = replay(record, &samples, with);
    let after = estimates.iter().skip_while(|e| e.time.0 < 3_200_000);
    let warned: Vec<bool> = after.map(|e| e.status.contains(Status::SLIP_WARNING)).collect();
    warned.windows(2).filter(|pair| !pair[0] && pair[1]).count()
}

/// Standard deviation of f_x, f_y, f_z while a press of 1 N is held, in newtons.
pub fn resolution(device: u32, record: &Calibration, with: With) -> [f64; 3] {
    let press = "[[press]]\nat_s = 1\nx_mm = 0.4\ny_mm = -0.3\nfz_n = 1\nrise_s = 0.2\nhold_s = 2\n\
                 fall_s = 0.2\n";
    let held = 1700..2700;
    let estimates = replay(record, &run(device, 6, 1000, 3.5, 0.8, press), with);
    let forces: Vec<[f64; 3]> = estimates[held]
        .iter()
        .map(|e| [e.force.x, e.force.y, e.force.z].map(|f| f64::from(f.unwrap().0)))
        .collect();
    std::array::from_fn(|axis| {
        let middle = mean(forces.iter().map(|f| f[axis]));
        mean(forces.iter().map(|f| (f[axis] - middle).powi(2))).sqrt()
    })
}

/// What is left of the peak of a tap of 2.5 ms, half a period of 200 Hz, at 4000 frames a second.
pub fn tap_at_200_hz(device: u32, record: &Calibration, with: With) -> f64 {
    let tap = "[[tap]]\nat_s = 1\nx_mm = 0.4\ny_mm = -0.3\nfz_n = 1\nwidth_s = 0.0025\n";
    let samples = run(device, 6, 4000, 1.2, 0.8, tap);
    let peak = |forces: &mut dyn Iterator<Item = f64>| forces.fold(0.0, f64::max);
    let found = replay(record, &samples, with);
    peak(&mut found.iter().filter_map(|e| newtons(e.force.z)))
        / peak(&mut samples.iter().filter_map(|s| s.truth.force[2]))
}

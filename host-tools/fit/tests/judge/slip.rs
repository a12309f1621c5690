//! Slip: is it told in time, and is it told where there is none.

use taxel::calibration::Calibration;
use taxel::finger::Estimate;
use taxel::frame::Status;
use taxel_formats::trace::Sample;

use super::{With, replay, run};

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

/// Four slides at every friction and load: shear grows for 150 ms until it breaks loose. As each of `with` tells
/// the same slides.
pub fn onsets<const N: usize>(device: u32, record: &Calibration, with: [With; N]) -> [Onsets; N] {
    let mut outcomes = [Onsets::default(); N];
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
        for (outcome, with) in outcomes.iter_mut().zip(with) {
            outcome.count(&samples, &replay(record, &samples, with));
        }
    }
    outcomes
}

impl Onsets {
    /// Adds the four slides of one scene.
    fn count(&mut self, samples: &[Sample], estimates: &[Estimate]) {
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
                let counts = if slides == 0 { &mut self.first } else { &mut self.later };
                counts[0] += 1;
                counts[1] += usize::from(ahead);
                slides += 1;
            }
        }
        assert_eq!(slides, 4);
    }

    /// First and later ones together.
    pub fn all(&self) -> [usize; 2] {
        std::array::from_fn(|i| self.first[i] + self.later[i])
    }
}

/// A grasp with up to half of its friction in use, at `rate` frames a second for `minutes`, after one slide that tells
/// what that friction is.
pub fn grasp(device: u32, rate: u32, mu: f64, minutes: f64) -> Vec<Sample> {
    let slide = "[[slide]]\nat_s = 1\nfrom_mm = [-1.5, 0]\nto_mm = [1.5, 0]\nfz_n = 1\nrise_s = 0.2\n\
                 travel_s = 1.5\nfall_s = 0.2\n";
    let held = held(3.5, (minutes * 60.0 / 0.4) as u32);
    run(device, 9, rate, 4.5 + 60.0 * minutes, mu, &format!("{slide}{held}"))
}

/// The first four seconds with a thing of unknown friction; which ones is `seed`'s choice.
pub fn first_touches(device: u32, seed: u64, rate: u32, mu: f64) -> Vec<Sample> {
    run(device, seed, rate, 5.0, mu, &held(1.0, 10))
}

fn held(at: f64, presses: u32) -> String {
    format!(
        "[[random]]\nat_s = {at}\npresses = {presses}\neach_s = 0.4\nx_mm = [-3, 3]\ny_mm = [-3, 3]\n\
         fz_n = [0.2, 2]\nshear_of_limit = [0, 0.5]\n"
    )
}

/// The frames of a grasp in which a warning begins; `known`: to a finger that has felt the slide before it.
pub fn false_warnings(
    record: &Calibration,
    grasp: &[Sample],
    with: With,
    known: bool,
) -> Vec<usize> {
    let after = grasp.partition_point(|sample| sample.scan.time.0 < 3_200_000);
    let from = if known { 0 } else { after };
    warnings(&replay(record, &grasp[from..], with)[after - from..])
}

/// The frames in which a warning begins.
pub fn warnings(estimates: &[Estimate]) -> Vec<usize> {
    let warned = |i: usize| estimates[i].status.contains(Status::SLIP_WARNING);
    (1..estimates.len()).filter(|i| warned(*i) && !warned(i - 1)).collect()
}

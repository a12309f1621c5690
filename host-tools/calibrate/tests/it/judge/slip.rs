//! Judging of slip: warnings in time, and false warnings.

use taxel::calibration::Calibration;
use taxel::estimate::limit_surface::LimitSurface;
use taxel::finger::Estimate;
use taxel::frame::Status;
use taxel_files::trace::Sample;

use super::{With, replay, run};

/// Results on onsets of slip.
#[derive(Clone, Debug, Default)]
pub struct Onsets {
    /// Onsets shown, and warned of 20 ms ahead: first ones at unknown friction, and later ones.
    pub first: [usize; 2],
    pub later: [usize; 2],
    /// Milliseconds from the beginning of gross slip to its report, for slips reported in time.
    pub told: Vec<usize>,
    /// Number of slips reported before they began.
    pub early: usize,
    /// Frames of gross slip from the first report on, and those of them with a report.
    pub sliding: [usize; 2],
}

/// Time after a slide that begins at one second, microseconds.
const SLID_US: u64 = 3_200_000;

/// Friction coefficients and loads of slides and twists.
pub const FRICTIONS: [f64; 4] = [0.2, 0.4, 0.8, 1.2];
pub const LOADS: [f64; 4] = [0.2, 0.5, 1.0, 2.0];

/// Adds four slides at every friction and load, as reported with each of `with`.
///
/// Shear grows for 150 ms until the contact breaks loose. All of `with` see the same slides.
pub fn onsets<const N: usize>(
    all: &mut [Onsets; N],
    device: u32,
    record: &Calibration,
    with: [With; N],
) {
    for (mu, load) in scenes() {
        let acts: String = (0..4).map(|i| slide(1.0 + 2.2 * f64::from(i), i, load)).collect();
        let samples = run(device, 3, 1000, 10.5, mu, &acts);
        for (all, with) in all.iter_mut().zip(with) {
            all.count(&samples, &replay(record, &samples, with), 4);
        }
    }
}

/// Results on two twists under one friction and one load, in opposite directions.
#[derive(Clone, Debug)]
pub struct Twists {
    pub friction: f64,
    pub load: f64,
    /// Limit of the torsion, in N·mm.
    pub holds: f64,
    /// Twists shown, and warned of 20 ms ahead: after a slide that shows the friction, or without.
    pub known: [usize; 2],
    pub unknown: [usize; 2],
}

/// Judges torsion that grows for 150 ms to 1.05 of its limit, at every friction and load.
///
/// The finger has matrix and sensors.
pub fn twists(device: u32, record: &Calibration) -> Vec<Twists> {
    let both = |(friction, load)| {
        let holds = LimitSurface::hertz(6.0, 0.236).most_torsion(load as f32, friction as f32);
        let holds = f64::from(holds);
        let twist = |at: f64, x: f64, torsion: f64| {
            format!(
                "[[press]]\nat_s = {at}\nx_mm = {x}\ny_mm = {}\nfz_n = {load}\ntorsion_nmm = {torsion}\n\
                 rise_s = 0.2\nhold_s = 0.45\nfall_s = 0.2\n",
                -x
            )
        };
        let [there, back] = [twist(3.3, -1.5, 1.05 * holds), twist(4.3, 1.5, -1.05 * holds)];
        let acts = format!("{}{there}{back}", slide(1.0, 0, load));
        let samples = run(device, 3, 1000, 5.3, friction, &acts);
        let after = samples.partition_point(|sample| sample.scan.time.0 < SLID_US);
        let [known, unknown] = [true, false].map(|known| {
            let mut onsets = Onsets::default();
            let said = after_slide(record, &samples, With::Both, known);
            onsets.count(&samples[after..], &said, 2);
            onsets.all()
        });
        Twists { friction, load, holds, known, unknown }
    };
    scenes().map(both).collect()
}

/// Results on stick-slip.
#[derive(Clone, Debug, Default)]
pub struct Jerks {
    /// Slips shown, and reported within 30 ms.
    pub told: [usize; 2],
    /// Longest report after the end of a slip, until the next, in milliseconds.
    pub lingered: usize,
}

/// Adds a drag at 3 mm/s under 1 N through a spring, at every friction.
///
/// The contact sticks for tenths of a second and slips for hundredths.
pub fn jerks<const N: usize>(
    all: &mut [Jerks; N],
    device: u32,
    record: &Calibration,
    with: [With; N],
) {
    for mu in FRICTIONS {
        let acts = format!(
            "mu_kinetic = {}\n[[slide]]\nat_s = 1\nfrom_mm = [-3, 0.5]\nto_mm = [3, -0.5]\nfz_n = 1\n\
             rise_s = 0.3\ntravel_s = 2\nfall_s = 0.3\nspring = {{ stiffness_n_mm = 1, mass_g = 20 }}\n",
            0.6 * mu
        );
        let mut samples = run(device, 3, 1000, 4.0, mu, &acts);
        // The contact also slips at the release.
        samples.truncate(3300);
        let (slips, end) = (|i: usize| samples[i].truth.slip == Some(true), samples.len() - 30);
        for (all, with) in all.iter_mut().zip(with) {
            let estimates = replay(record, &samples, with);
            let slides = |i: &usize| estimates[*i].status.contains(Status::SLIDES);
            for begun in (1..end).filter(|i| slips(*i) && !slips(i - 1)) {
                all.told[0] += 1;
                all.told[1] += usize::from((begun..begun + 30).any(|i| slides(&i)));
                let over = (begun..end).find(|i| !slips(*i)).unwrap_or(end);
                let next = (over..end).find(|i| slips(*i)).unwrap_or(end);
                all.lingered = all.lingered.max((over..next).filter(slides).count());
            }
        }
    }
}

fn scenes() -> impl Iterator<Item = (f64, f64)> {
    FRICTIONS.into_iter().flat_map(|mu| LOADS.map(|load| (mu, load)))
}

/// Path of the `i`th of four slides over the pad.
fn slide(at: f64, i: i32, load: f64) -> String {
    let y = 1.0 - 0.5 * f64::from(i);
    format!(
        "[[slide]]\nat_s = {at}\nfrom_mm = [-1.5, {}]\nto_mm = [1.5, {y}]\nfz_n = {load}\nrise_s = 0.2\n\
         travel_s = 1.5\nfall_s = 0.2\n",
        -y
    )
}

impl Onsets {
    /// Adds the slips of one scene.
    fn count(&mut self, samples: &[Sample], estimates: &[Estimate], shown: usize) {
        let said = |i: usize, what| estimates[i].status.contains(what);
        let slips = |i: usize| samples[i].truth.slip == Some(true);
        let (mut pressed, mut begun) = (0, 0);
        for i in 1..samples.len() {
            let truth = &samples[i].truth;
            // Shear begins after the normal force has risen: an earlier warning is false.
            if (truth.force[0], truth.torsion) == (Some(0.0), Some(0.0)) {
                pressed = i;
            }
            if slips(i) && !slips(i - 1) {
                let warned = |i: usize| said(i, Status::SLIP_WARNING);
                let ahead = !warned(pressed) && (pressed..=i - 20).any(warned);
                let counts = if begun == 0 { &mut self.first } else { &mut self.later };
                counts[0] += 1;
                counts[1] += usize::from(ahead);
                begun += 1;
                let slid = |i: &usize| said(*i, Status::SLIDES);
                let end = (i..samples.len()).find(|i| !slips(*i)).unwrap_or(samples.len());
                self.early += usize::from((pressed..i).any(|i| slid(&i)));
                if let Some(told) = (i..end).find(slid) {
                    self.told.push(told - i);
                    self.sliding[0] += end - told;
                    self.sliding[1] += (told..end).filter(slid).count();
                }
            }
        }
        assert_eq!(begun, shown);
    }

    /// Milliseconds within which 50, 95 and 100 in 100 of the reported slips were reported.
    pub fn delays(&self) -> [usize; 3] {
        let mut told = self.told.clone();
        told.sort_unstable();
        [50, 95, 100].map(|share| told[(told.len() * share).div_ceil(100) - 1])
    }

    /// Sums of the first and later onsets.
    pub fn all(&self) -> [usize; 2] {
        std::array::from_fn(|i| self.first[i] + self.later[i])
    }
}

/// A grasp that uses up to half of its friction, after one slide that shows this friction.
///
/// `rate` is in frames a second, `minutes` the duration.
pub fn grasp(device: u32, rate: u32, mu: f64, minutes: f64) -> Vec<Sample> {
    let acts = slide(1.0, 2, 1.0) + &held(3.5, (minutes * 60.0 / 0.4) as u32);
    run(device, 9, rate, 4.5 + 60.0 * minutes, mu, &acts)
}

/// The first four seconds with an object of unknown friction; `seed` chooses the touches.
pub fn first_touches(device: u32, seed: u64, rate: u32, mu: f64) -> Vec<Sample> {
    run(device, seed, rate, 5.0, mu, &held(1.0, 10))
}

fn held(at: f64, presses: u32) -> String {
    format!(
        "[[random]]\nat_s = {at}\npresses = {presses}\neach_s = 0.4\nx_mm = [-3, 3]\ny_mm = [-3, 3]\n\
         fz_n = [0.2, 2]\nshear_of_limit = [0, 0.5]\n"
    )
}

/// Estimates of a grasp after its slide; `known` means that the finger has seen the slide.
pub fn after_slide(
    record: &Calibration,
    grasp: &[Sample],
    with: With,
    known: bool,
) -> Vec<Estimate> {
    let after = grasp.partition_point(|sample| sample.scan.time.0 < SLID_US);
    let from = if known { 0 } else { after };
    replay(record, &grasp[from..], with).split_off(after - from)
}

/// Indices of the frames in which the flags `what` become set.
pub fn begins(estimates: &[Estimate], what: Status) -> Vec<usize> {
    let said = |i: usize| estimates[i].status.contains(what);
    (1..estimates.len()).filter(|i| said(*i) && !said(i - 1)).collect()
}

/// Four minutes of vibration without gross slip: name, acts, and most reported slides.
///
/// The limits are those of matrix, sensors and both.
pub fn shaken() -> [(&'static str, String, [usize; 3]); 4] {
    let random = |each: f64, roll: f64| {
        format!(
            "[[random]]\nat_s = 1\npresses = {}\neach_s = {each}\nx_mm = [-3, 3]\ny_mm = [-3, 3]\n\
             fz_n = [0.2, 2]\nshear_of_limit = [0, 0.5]\nroll_mm = {roll}\n",
            (60.0 / each) as u32
        )
    };
    let tap = |i: u32| {
        let [at, x, y] = [1.0 + 0.3 * f64::from(i), f64::from(i % 7) - 3.0, f64::from(i % 5) - 2.0];
        let fz = 0.2 + 0.3 * f64::from(i % 6);
        format!("[[tap]]\nat_s = {at}\nx_mm = {x}\ny_mm = {y}\nfz_n = {fz}\nwidth_s = 0.006\n")
    };
    let lamps = format!("[light]\nflicker_ratio = 0.01\n{}", random(0.4, 0.0));
    [
        // The matrix at 500 frames a second has 32 frames of such a press.
        ("presses of 64 ms", random(0.08, 0.0), [3, 0, 0]),
        ("taps of 6 ms", (0..200).map(tap).collect(), [0; 3]),
        ("lamps that flicker by 1 %", lamps, [0; 3]),
        // A steady shear along the path of a roll is taken for a slide's.
        ("rolled by up to 2 mm in 0.3 s", random(0.4, 2.0), [3, 2, 2]),
    ]
}

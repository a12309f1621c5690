//! Resolution and frequency response of a finger.

use taxel::calibration::Calibration;
use taxel::frame::Status;
use taxel::units::Micros;
use taxel_files::trace::Sample;
use taxel_sim::{Scene, Simulator};

use super::{EFFECTS, With, mean, newtons, replay, run};

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

/// Loads in newtons among which the detection threshold is sought.
const LIGHT: [f64; 8] = [0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03];

/// Detection threshold: the least of the [`LIGHT`] loads that is detected, as are all heavier ones.
///
/// A load is detected if every scan of half a second of its hold shows contact. The finger has then
/// rested for three seconds, in which it follows what drifts.
pub fn least_felt(device: u32, record: &Calibration, with: With) -> Option<f64> {
    let felt = |load: &&f64| {
        let press = format!(
            "[[press]]\nat_s = 3\nx_mm = 0.4\ny_mm = -0.3\nfz_n = {load}\nrise_s = 0.2\nhold_s = 0.8\n\
             fall_s = 0.2\n"
        );
        let estimates = replay(record, &run(device, 6, 1000, 4.3, 0.8, &press), with);
        estimates[3400..3900].iter().all(|e| e.status.contains(Status::CONTACT))
    };
    LIGHT.iter().rev().take_while(felt).last().copied()
}

/// Scans of a press that rises from 0.5 N to 1.5 N within a second, at [`RATE`].
///
/// They give a finger's reading at any force between, noise included.
struct Ramp(Vec<Sample>);

/// Frames a second of the sweep.
const RATE: u32 = 4000;
/// Frequencies of the sweep, in hertz; the first gives the response to a slow force.
pub const SWEEP: [f64; 8] = [10.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1200.0, 1600.0];
/// Mean and amplitude of the force, in newtons.
const MIDDLE: f64 = 1.0;
const SWING: f64 = 0.3;

impl Ramp {
    fn of(device: u32) -> Self {
        let press = "[[press]]\nat_s = 0.1\nx_mm = 0.4\ny_mm = -0.3\nfz_n = 1.5\nrise_s = 1\n\
                     hold_s = 0.01\nfall_s = 0.1\n";
        let samples = run(device, 6, RATE, 1.3, 0.8, press);
        let rising = samples.into_iter().filter(|s| s.scan.time.0 <= 1_100_000);
        Self(rising.filter(|s| s.truth.force[2] > Some(0.5)).collect())
    }

    /// Returns a scan with a force within 2 mN of this one, another one in each of 16 turns: a scan
    /// that repeats is a fault.
    fn at(&self, force: f64, turn: usize) -> &Sample {
        let above = self.0.partition_point(|sample| sample.truth.force[2] < Some(force));
        &self.0[(above + turn % 16).saturating_sub(8).min(self.0.len() - 1)]
    }

    /// Amplitude ratio of the finger's f_z to a sine of force.
    ///
    /// The fit is by least squares over a tenth of a second.
    fn gain(&self, record: &Calibration, with: With, hz: f64) -> f64 {
        let phase = |i: usize| std::f64::consts::TAU * hz * i as f64 / f64::from(RATE);
        let sine = (0..RATE as usize / 2).map(|i| {
            let mut sample = *self.at(MIDDLE + SWING * phase(i).sin(), i);
            sample.scan.time = Micros((1e6 * i as f64 / f64::from(RATE)) as u64);
            sample
        });
        let samples: Vec<Sample> = sine.collect();
        let estimates = replay(record, &samples, with);
        // Whole periods of every frequency of the sweep, after the contact has settled.
        let from = estimates.len() - RATE as usize / 10;
        let found = |i: usize| newtons(estimates[i].force.z).unwrap();
        let middle = mean((from..estimates.len()).map(found));
        let swing = |wave: fn(f64) -> f64| {
            2.0 * mean((from..estimates.len()).map(|i| (found(i) - middle) * wave(phase(i))))
        };
        swing(f64::sin).hypot(swing(f64::cos)) / SWING
    }
}

/// Amplitude response at each frequency of the [`SWEEP`], relative to a slow force.
pub fn response(device: u32, record: &Calibration, with: With) -> [f64; SWEEP.len()] {
    let ramp = Ramp::of(device);
    let slow = ramp.gain(record, with, SWEEP[0]);
    SWEEP.map(|hz| ramp.gain(record, with, hz) / slow)
}

/// Setting of a scan: scans a second, samples a reading, and settle time in microseconds.
pub type ScanSetting = (u32, u16, u32);

/// Standard deviation of f_x, f_z and x while a press of 1 N is held: of scans, and of their means
/// over a millisecond.
///
/// The phototransistors lag with the time constant of the boards' load.
pub fn held(device: u32, record: &Calibration, setting: ScanSetting, with: With) -> [[f64; 3]; 2] {
    let (hz, samples, settle) = setting;
    // The simulator's conversions end a step, a quarter of a microsecond each.
    let step = settle + u32::from(samples).div_ceil(4);
    let text = format!(
        "effects = [{EFFECTS}, 'settling']\n[scan]\nrate_hz = {hz}\nduration_s = 2\nstep_us = {step}\n\
         [device]\nseed = {device}\nbits = 16\n[indenter]\nradius_mm = 6\n[friction]\nmu = 0.8\n\
         [electronics]\noversampling = {samples}\ntime_constant_us = 2.17\n\
         [[press]]\nat_s = 1\nx_mm = 0.4\ny_mm = -0.3\nfz_n = 1\nrise_s = 0.2\nhold_s = 0.7\n\
         fall_s = 0.05\n"
    );
    let scans: Vec<Sample> =
        Simulator::new(&Scene::parse("judge.toml", &text).unwrap(), 6).collect();
    let estimates = replay(record, &scans, with);
    // The hold without its first 0.2 s.
    let each = hz as usize;
    let held: Vec<[f64; 3]> = estimates[each * 14 / 10..each * 19 / 10]
        .iter()
        .map(|e| {
            let x = e.point.unwrap().x.0;
            [e.force.x.unwrap().0, e.force.z.unwrap().0, x].map(f64::from)
        })
        .collect();
    [1, each / 1000].map(|scans| {
        std::array::from_fn(|axis| {
            let means: Vec<f64> =
                held.chunks_exact(scans).map(|all| mean(all.iter().map(|f| f[axis]))).collect();
            let middle = mean(means.iter().copied());
            mean(means.iter().map(|value| (value - middle).powi(2))).sqrt()
        })
    })
}

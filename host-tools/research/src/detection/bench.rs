//! Calibrated reference fingers with sound runs of touches.

use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::finger::{Estimate, Finger, FingerState, Wanted};
use taxel::frame::Fields;
use taxel::scan::{Codes, SENSORS, Scan};
use taxel_sim::Simulator;

use super::judge::Frame;
use crate::faults::{CHANNELS, Flat, Place, RATE_HZ, Sound, flat};
use crate::reference::{TOP, calibrated, of_board, scene, without_sensors};

/// Seed of the touches and sound scenes.
pub(super) const SEED: u64 = 41;
/// Touches: place in mm and force in newtons.
const TOUCHES: [[f64; 5]; 4] = [
    [0.6, -0.4, 0.2, 0.1, 1.0],
    [-2.1, 1.8, -0.1, 0.25, 1.0],
    [1.9, 1.2, 0.3, -0.1, 1.0],
    [-0.3, -1.7, -0.2, -0.2, 1.0],
];
/// Time of the touch, of its rise and of its end in seconds. Until the touch the finger learns how
/// long its channels rest, as one in use has.
const TOUCH_S: f64 = 2.0;
const RISE_S: f64 = 0.05;
const END_S: f64 = 2.8;
/// Scans that are judged from the fault on: 0.45 s.
const JUDGED: usize = 1800;
/// Wanted of each scan: the default fields, in a frame of its own.
pub(super) const WANTED: Wanted = Wanted { fields: Fields::ESTIMATES, due: true };

/// Moment at which a fault starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Nothing touches; a press comes 0.1 s later.
    Unloaded,
    /// The touch begins.
    Onset,
    /// A press of 1 N with shear is held.
    Loaded,
}

pub(super) const PHASES: [Phase; 3] = [Phase::Unloaded, Phase::Onset, Phase::Loaded];

impl Phase {
    /// Name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unloaded => "unloaded",
            Self::Onset => "onset",
            Self::Loaded => "loaded",
        }
    }

    /// First faulty scan and number of judged scans.
    pub fn scans(self) -> [usize; 2] {
        let at_s = match self {
            Self::Unloaded => TOUCH_S - 0.1,
            Self::Onset => TOUCH_S,
            Self::Loaded => TOUCH_S + 0.3,
        };
        [(at_s * RATE_HZ).round() as usize, JUDGED]
    }
}

/// Parts of a finger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Has {
    /// The matrix alone.
    Matrix,
    /// Matrix and force sensors.
    Sensors,
    /// Matrix, force sensors and a calibration of warming.
    Thermometer,
}

impl Has {
    /// Fingers that have a place which may be faulty.
    pub fn of(place: Place) -> &'static [Self] {
        if place.is_auxiliary() {
            &[Self::Thermometer]
        } else if place.of_matrix() {
            &[Self::Matrix, Self::Sensors]
        } else {
            &[Self::Sensors]
        }
    }

    /// Name in the table.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Matrix => "matrix",
            Self::Sensors | Self::Thermometer => "matrix and sensors",
        }
    }

    /// Aim for the largest error of force without a flag, in mN.
    pub const fn limit_mn(self) -> f64 {
        match self {
            Self::Matrix => 50.0,
            Self::Sensors | Self::Thermometer => 20.0,
        }
    }

    /// Returns the codes of a finger that has these parts.
    pub fn cut(self, mut codes: Codes) -> Codes {
        if self == Self::Matrix {
            codes.bridges = [None; SENSORS];
        }
        of_board(codes)
    }
}

/// A calibrated device with its sound runs.
pub(super) struct Bench {
    device: u64,
    warm: bool,
    calibration: Calibration,
    runs: Vec<(Has, Run)>,
}

/// A sound run of one touch.
pub(super) struct Run {
    pub finger: Finger,
    /// Scans, and their codes as a list.
    pub scans: Vec<Scan>,
    pub codes: Vec<Flat>,
    /// Frames of the sound finger.
    pub frames: Vec<Frame>,
    /// State before the first faulty scan of each phase.
    states: Vec<FingerState>,
    sigma: [f64; CHANNELS],
}

impl Bench {
    /// Calibrates a device by default, or also on its warming, and records its touches.
    pub fn new(device: u64, warm: bool, stop: &AtomicBool) -> anyhow::Result<Self> {
        let calibration = calibrated(device, warm, stop)?;
        let mut bench = Self { device, warm, calibration, runs: Vec::new() };
        for touch in TOUCHES {
            let own: &[Has] = if warm { &[Has::Thermometer] } else { &[Has::Matrix, Has::Sensors] };
            for has in own {
                bench.runs.push((*has, bench.run(*has, touch)?));
            }
        }
        Ok(bench)
    }

    /// Returns whether this bench has fingers of these parts.
    pub fn is(&self, has: Has) -> bool {
        self.warm == (has == Has::Thermometer)
    }

    /// Returns the sound runs of a finger with these parts.
    pub fn runs(&self, has: Has) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(move |(of, _)| *of == has).map(|(_, run)| run)
    }

    /// Seed of the device.
    pub fn device(&self) -> u64 {
        self.device
    }

    /// Makes a finger that has these parts, and its initial state.
    pub fn finger(&self, has: Has) -> (Finger, FingerState) {
        Finger::new(Some(match has {
            Has::Matrix => without_sensors(&self.calibration),
            Has::Sensors | Has::Thermometer => self.calibration.clone(),
        }))
    }

    fn run(&self, has: Has, [x, y, fx, fy, fz]: [f64; 5]) -> anyhow::Result<Run> {
        let keys = [
            ("scan.duration_s", END_S),
            ("press.at_s", TOUCH_S),
            ("press.x_mm", x),
            ("press.y_mm", y),
            ("press.fx_n", fx),
            ("press.fy_n", fy),
            ("press.fz_n", fz),
            ("press.rise_s", RISE_S),
            ("press.hold_s", END_S - TOUCH_S - 3.0 * RISE_S),
            ("press.fall_s", RISE_S),
        ];
        let mut set = keys.map(|(key, value)| format!("{key}={value:?}")).to_vec();
        set.push(format!("scan.rate_hz={RATE_HZ}"));
        let scene = scene("press", self.device, self.warm, &set)?;
        let (finger, mut state) = self.finger(has);
        let mut run = Run {
            finger,
            scans: Vec::new(),
            codes: Vec::new(),
            frames: Vec::new(),
            states: Vec::new(),
            sigma: [0.0; CHANNELS],
        };
        let mut estimate = Estimate::NOTHING;
        for (n, sample) in Simulator::new(&scene, SEED).enumerate() {
            let scan = Scan { codes: has.cut(sample.scan.codes), ..sample.scan };
            if PHASES.iter().any(|phase| phase.scans()[0] == n) {
                run.states.push(state.clone());
            }
            run.finger.update(&mut estimate, &mut state, &scan, WANTED);
            run.frames.push(Frame::of(&estimate));
            run.codes.push(flat(&scan.codes));
            run.scans.push(scan);
        }
        let rest = Phase::Unloaded.scans()[0];
        run.sigma = deviations(&run.codes[..rest]);
        Ok(run)
    }
}

impl Run {
    /// State of the sound finger before the first faulty scan.
    pub fn state(&self, phase: Phase) -> FingerState {
        let at = PHASES.iter().position(|of| *of == phase).unwrap_or_default();
        self.states[at].clone()
    }

    /// Sound codes from which a fault starts.
    pub fn sound(&self, phase: Phase) -> Sound {
        Sound { held: self.codes[phase.scans()[0]], sigma: self.sigma, top: TOP }
    }
}

/// Standard deviation of each channel's noise, from second differences: light that swings with the
/// mains is no noise.
fn deviations(codes: &[Flat]) -> [f64; CHANNELS] {
    /// Sum of the squared weights of a second difference.
    const GAIN: f64 = 6.0;
    core::array::from_fn(|k| {
        let differences = codes.windows(3).filter_map(|three| {
            let [a, b, c] = <&[Flat; 3]>::try_from(three).ok()?.map(|codes| f64::from(codes[k]));
            Some(a - 2.0 * b + c)
        });
        let n = codes.len().saturating_sub(2).max(1) as f64;
        (differences.map(|d| d * d).sum::<f64>() / (GAIN * n)).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_begin_in_order_and_end_before_the_run() {
        let [unloaded, onset, loaded] = PHASES.map(|phase| phase.scans()[0]);
        assert!(unloaded < onset && onset < loaded);
        assert!(loaded + JUDGED <= (END_S * RATE_HZ) as usize);
    }

    #[test]
    fn deviation_is_that_of_the_noise_without_the_swing() {
        // Steps of 2 with a period of three scans have a variance of 8/9, on a slow ramp.
        let codes: Vec<Flat> = (0..302)
            .map(|n| [(1000 + 10 * n + if n % 3 == 0 { 2 } else { 0 }) as u16; CHANNELS])
            .collect();
        let squares = (16.0 + 4.0 + 4.0) / 3.0;
        let expected = (squares / 6.0f64).sqrt();
        assert!(deviations(&codes).iter().all(|sigma| (sigma - expected).abs() < 1e-9));
    }
}

//! A virtual finger: its recordings, and what its signals are.

use anyhow::Context;
use taxel::condition::{Bias, Levels, Signals};
use taxel_fit::recording::Recording;
use taxel_formats::trace::Sample;
use taxel_sim::{Scene, Simulator};

/// The scenes that a finger is calibrated on, as the README does it.
pub const CALIBRATION: [&str; 2] = ["presses", "shear"];
/// Seed of those runs; others are judged on.
const FITTED: u64 = 1;
const JUDGED: u64 = 2;

/// One finger of many: gains, gaps, offsets and mismatches of its own.
pub struct Device {
    seed: u64,
    /// What it is calibrated on.
    pub recordings: Vec<Recording>,
    /// What it reads with nothing touching it.
    pub bias: Bias,
}

/// A moment of a run.
pub struct Moment {
    /// Codes and truth.
    pub sample: Sample,
    /// The codes, conditioned.
    pub signals: Signals,
}

impl Device {
    /// The device with this seed, and its calibration recordings.
    ///
    /// # Errors
    /// A built-in scene cannot be run.
    pub fn new(seed: u64) -> anyhow::Result<Self> {
        let recordings = CALIBRATION.map(|name| {
            let samples = run(seed, name, FITTED)?;
            Ok(Recording { name: name.to_owned(), samples })
        });
        let recordings: Vec<Recording> = recordings.into_iter().collect::<anyhow::Result<_>>()?;
        let bias = recordings.first().context("nothing to calibrate on")?.bias(None)?;
        Ok(Self { seed, recordings, bias })
    }

    /// A run of a built-in scene that no fit has seen.
    ///
    /// # Errors
    /// There is no such scene.
    pub fn unseen(&self, scene: &str) -> anyhow::Result<Vec<Moment>> {
        Ok(self.moments(run(self.seed, scene, JUDGED)?))
    }

    /// Samples with their signals.
    #[must_use]
    pub fn moments(&self, samples: Vec<Sample>) -> Vec<Moment> {
        let signals = |sample: &Sample| self.bias.apply(&Levels::read(&sample.scan.codes), None);
        samples.into_iter().map(|sample| Moment { signals: signals(&sample), sample }).collect()
    }
}

fn run(device: u64, scene: &str, seed: u64) -> anyhow::Result<Vec<Sample>> {
    let mut scene = Scene::load(scene)?;
    scene.device.seed = device;
    Ok(Simulator::new(&scene, seed).collect())
}

//! A simulated finger with its recordings and signals.

use anyhow::Context;
use taxel::condition::{Bias, Levels, Signals};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::Sample;
use taxel_sim::scene::Changes;
use taxel_sim::{Scene, Simulator};

use crate::truth::{Beyond, Touches};

/// Scenes of the calibration in the README, without the warm-up.
pub const CALIBRATION: [&str; 2] = ["presses", "shear"];
/// Scene of the temperature calibration.
const WARM_UP: &str = "warm-up";
/// Seed of the calibration runs; methods are judged on runs of other seeds.
pub(crate) const FITTED: u64 = 1;
pub(crate) const JUDGED: u64 = 2;

/// One simulated finger with gains, gaps, offsets and mismatches of its own.
pub struct Device {
    pub(crate) seed: u64,
    /// Calibration recordings.
    pub recordings: Vec<Recording>,
    /// Recording of the unloaded finger while it warms up.
    pub warm_up: Recording,
    /// Bias, read without contact.
    pub bias: Bias,
}

/// One scan of a run with its signals and truth.
pub struct Moment {
    /// Codes and truth.
    pub sample: Sample,
    /// Signals conditioned from the codes.
    pub signals: Signals,
    /// Truth that the sample itself does not hold.
    pub beyond: Beyond,
}

impl Device {
    /// Creates the device with this seed and records its calibration.
    ///
    /// # Errors
    /// A built-in scene cannot be run.
    pub fn new(seed: u64) -> anyhow::Result<Self> {
        let recordings = CALIBRATION.map(|name| recorded(seed, name));
        let recordings: Vec<Recording> = recordings.into_iter().collect::<anyhow::Result<_>>()?;
        let bias = recordings.first().context("nothing to calibrate on")?.bias(None)?;
        Ok(Self { seed, recordings, warm_up: recorded(seed, WARM_UP)?, bias })
    }

    /// Records a built-in scene that no fit has seen.
    ///
    /// # Errors
    /// There is no such scene.
    pub fn unseen(&self, scene: &str) -> anyhow::Result<Vec<Moment>> {
        let mut scene = Scene::load(scene)?;
        scene.device.seed = self.seed;
        let mut touches = Touches::new(&scene, JUDGED);
        let samples = Simulator::new(&scene, JUDGED);
        Ok(samples.map(|sample| self.moment(sample, touches.at(&sample))).collect())
    }

    /// Conditions a sample into a moment.
    #[must_use]
    pub fn moment(&self, sample: Sample, beyond: Beyond) -> Moment {
        let signals = self.bias.apply(&Levels::read(&sample.scan.codes), None);
        Moment { sample, signals, beyond }
    }
}

fn recorded(device: u64, name: &str) -> anyhow::Result<Recording> {
    let samples = run(device, name, &["effects.temperature=true"], FITTED)?;
    Ok(Recording { name: name.to_owned(), samples })
}

/// Runs a built-in scene with changes on the device with this seed.
pub(crate) fn run(
    device: u64,
    scene: &str,
    set: &[&str],
    seed: u64,
) -> anyhow::Result<Vec<Sample>> {
    let set = set.iter().map(|change| (*change).to_owned()).collect();
    let mut scene = Scene::load_changed(scene, &Changes { reference: false, set })?;
    scene.device.seed = device;
    Ok(Simulator::new(&scene, seed).collect())
}

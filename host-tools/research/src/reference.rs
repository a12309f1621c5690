//! The reference finger, calibrated as a user does it: the recordings of the README, fitted by
//! default.

use std::sync::atomic::AtomicBool;

use taxel::calibration::Calibration;
use taxel::finger::{Estimate, Finger};
use taxel::scan::Codes;
use taxel::units::FullScale;
use taxel_calibrate::evaluate::Only;
use taxel_calibrate::finger::{FitOptions, fit};
use taxel_calibrate::recording::Recording;
use taxel_regress::model::Family;
use taxel_sim::{Scene, Simulator, scene::Changes};

/// Recordings of the calibration: scene and seed, as in the README.
const CALIBRATION: [(&str, u64); 2] = [("presses", 1), ("shear", 2)];
/// Recording of the finger at rest while it warms.
const WARM_UP: (&str, u64) = ("warm-up", 4);

/// Scans of the unloaded finger that become its bias, as a user takes one before work.
pub(crate) const BIAS: u16 = 100;
/// Highest code of the board: a sum of eight conversions of 12 bits.
pub(crate) const TOP: u16 = 8 * 4095;

/// Loads a built-in scene for the reference finger of this device, with changes.
pub(crate) fn scene(name: &str, device: u64, warm: bool, set: &[String]) -> anyhow::Result<Scene> {
    let mut all = vec![format!("device.seed={device}")];
    if warm {
        all.push("effects.temperature=true".into());
    }
    all.extend_from_slice(set);
    Ok(Scene::load_changed(name, &Changes { reference: true, set: all })?)
}

/// Calibrates a device by default, or also on its warming.
pub(crate) fn calibrated(
    device: u64,
    warm: bool,
    stop: &AtomicBool,
) -> anyhow::Result<Calibration> {
    let names = CALIBRATION.into_iter().chain(warm.then_some(WARM_UP));
    let recordings = names.map(|(name, seed)| {
        // Nobody reads a load cell while the finger warms.
        let exact = (name == WARM_UP.0).then(|| "effects.bench-error=false".to_owned());
        let scene = scene(name, device, warm, exact.as_slice())?;
        Ok(Recording { name: name.into(), samples: Simulator::new(&scene, seed).collect() })
    });
    let recordings: Vec<Recording> = recordings.collect::<anyhow::Result<_>>()?;
    // As the command does by default.
    let options = FitOptions { family: Family::Auto, ..FitOptions::default() };
    Ok(fit(&recordings, &options, &mut |_| {}, stop)?.calibration)
}

/// Record of a finger without force sensors.
pub(crate) fn without_sensors(record: &Calibration) -> Calibration {
    Calibration { array: None, sensors: Default::default(), ..record.clone() }
}

/// Codes as the board sends them.
pub(crate) fn of_board(codes: Codes) -> Codes {
    match FullScale::new(TOP) {
        Some(top) => codes.rescaled(top),
        None => codes,
    }
}

/// Estimates of a part of the finger, which has taken its bias at the beginning.
pub(crate) fn estimates(part: Only, record: &Calibration, recording: &Recording) -> Vec<Estimate> {
    let (record, recording) = part.of(record, recording);
    let (finger, mut state) = Finger::new(Some(record));
    state.take_bias(BIAS);
    recording.samples.iter().map(|s| finger.estimate(&mut state, &s.scan)).collect()
}

//! A finger's recording as the chip sees it, and what it is for.

use taxel::condition::{Bias, Signals, Warmth};
use taxel::scan::SENSORS;

use crate::error::FitError;
use crate::finger::Subject;
use crate::recording::Recording;

/// A sensor answers if its signals reach this many times its noise in one row of a hundred …
const ANSWERS: f32 = 8.0;
/// … and this share of the signals of the sensor that answers most.
const ANSWERS_SHARE: f32 = 0.02;

/// A recording with its signals as the chip sees them.
pub(crate) struct Prepared<'r> {
    pub recording: &'r Recording,
    pub bias: Bias,
    pub signals: Vec<Signals>,
}

impl<'r> Prepared<'r> {
    pub fn new(recording: &'r Recording, warmth: Option<&Warmth>) -> Result<Self, FitError> {
        let bias = recording.bias(warmth)?;
        let signals = recording.signals(&bias, warmth);
        Ok(Self { recording, bias, signals })
    }

    /// How far a sensor's signals stand out of its noise: the 99th percentile over the recording.
    fn answer(&self, sensor: usize) -> f32 {
        let Some(bias) = self.bias.bridges[sensor] else { return 0.0 };
        let mut ratios: Vec<f32> = self
            .signals
            .iter()
            .filter_map(|s| s.bridges[sensor])
            .map(|u| (u.iter().map(|u| u * u).sum::<f32>() / 3.0).sqrt() / bias.noise)
            .collect();
        ratios.sort_by(f32::total_cmp);
        ratios.get(ratios.len() * 99 / 100).copied().unwrap_or_default()
    }

    /// A bench recording if exactly one sensor answers, else the finger's.
    pub fn subject(&self) -> Subject {
        let answers: [f32; SENSORS] = std::array::from_fn(|sensor| self.answer(sensor));
        let most = answers.iter().copied().fold(0.0, f32::max);
        let mut responding = answers
            .iter()
            .enumerate()
            .filter(|(_, answer)| **answer > ANSWERS.max(ANSWERS_SHARE * most));
        match (responding.next(), responding.next()) {
            (Some((sensor, _)), None) => Subject::Sensor(sensor),
            _ => Subject::Finger,
        }
    }

    /// The recording knows the force on this sensor, and there is some.
    pub fn loads(&self, sensor: usize) -> bool {
        let truths = || self.recording.samples.iter().map(|s| s.truth.sensors[sensor]);
        truths().all(|truth| truth.iter().all(Option::is_some))
            && truths().flatten().flatten().any(|force| force != 0.0)
    }
}

//! Load cell under the finger: total force, with a noise, a rate and a clock of its own.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use taxel_files::trace::Sample;

use crate::seeds::{Purpose, stream};

/// Noise of each component, that of [Ospina2017]'s cell, in newtons.
const NOISE_N: f64 = 0.006;
/// Time between two rows.
const PERIOD_US: u64 = 10_000;
/// Lead of its clock over the finger's in seconds, and its relative rate.
const AHEAD_S: f64 = 2.7;
const FAST: f64 = 5e-5;

/// A cell that logs 100 rows a second.
#[derive(Clone, Debug)]
pub struct LoadCell {
    rng: ChaCha8Rng,
    next_us: u64,
}

impl LoadCell {
    /// Creates the cell of a run with this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { rng: stream(seed, Purpose::Reference), next_us: 0 }
    }

    /// Header of the log.
    #[must_use]
    pub fn header() -> &'static str {
        "t_s,fx_n,fy_n,fz_n"
    }

    /// Row of the log, if one is due at this sample and its force is known.
    pub fn read(&mut self, sample: &Sample) -> Option<String> {
        let now = sample.scan.time.0;
        let ([Some(x), Some(y), Some(z)], true) = (sample.truth.force, now >= self.next_us) else {
            return None;
        };
        self.next_us += PERIOD_US;
        let [x, y, z] = [x, y, z].map(|force| {
            let unit: f64 = StandardNormal.sample(&mut self.rng);
            force + NOISE_N * unit
        });
        let time = AHEAD_S + (1.0 + FAST) * now as f64 * 1e-6;
        Some(format!("{time:.5},{x:.4},{y:.4},{z:.4}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scene, Simulator};

    #[test]
    fn load_cell_logs_noisy_force_at_100_hz() {
        let mut cell = LoadCell::new(1);
        let run = Simulator::new(&Scene::load("press").unwrap(), 1);
        let (mut rows, mut squares) = (0, 0.0);
        for sample in run {
            let Some(row) = cell.read(&sample) else { continue };
            let row: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            let seconds = sample.scan.time.0 as f64 * 1e-6;
            assert!((row[0] - 2.7 - seconds).abs() < 2e-4, "{row:?}");
            squares += (row[3] - sample.truth.force[2].unwrap()).powi(2);
            rows += 1;
        }
        let noise = (squares / f64::from(rows)).sqrt();
        assert!((190..=201).contains(&rows) && (0.004..0.008).contains(&noise), "{rows} {noise}");
    }
}

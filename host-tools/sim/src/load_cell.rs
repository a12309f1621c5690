//! Load cell under the finger: total force and moments, with noise, a rate and a clock of its own.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use taxel_files::trace::Sample;

use crate::seeds::{Purpose, stream};

/// Noise of each component, that of [Ospina2017]'s cell, in newtons.
const NOISE_N: f64 = 0.006;
/// Noise of each moment in newton millimetres; an assumption.
const NOISE_NMM: f64 = 0.1;
/// Depth under the middle of the skin of the origin of the moments, mm.
const DEPTH_MM: f64 = 25.0;
/// Time between two rows.
const PERIOD_US: u64 = 10_000;
/// Lead of its clock over the finger's in seconds, and its relative rate.
const AHEAD_S: f64 = 2.7;
const FAST: f64 = 5e-5;

/// A cell that logs 100 rows a second.
#[derive(Clone, Debug)]
pub struct LoadCell {
    rng: ChaCha8Rng,
    /// Noise of the moments; `None` with three axes.
    moments: Option<ChaCha8Rng>,
    next_us: u64,
}

impl LoadCell {
    /// Creates the cell of a run with this seed: of three axes, or of six.
    #[must_use]
    pub fn new(seed: u64, six_axes: bool) -> Self {
        let moments = six_axes.then(|| stream(seed, Purpose::ReferenceMoments));
        Self { rng: stream(seed, Purpose::Reference), moments, next_us: 0 }
    }

    /// Header of the log.
    #[must_use]
    pub fn header(&self) -> &'static str {
        match self.moments {
            None => "t_s,fx_n,fy_n,fz_n",
            Some(_) => "t_s,fx_n,fy_n,fz_n,mx_nmm,my_nmm,mz_nmm",
        }
    }

    /// Row of the log, if one is due at this sample and its force is known.
    pub fn read(&mut self, sample: &Sample) -> Option<String> {
        let now = sample.scan.time.0;
        let ([Some(x), Some(y), Some(z)], true) = (sample.truth.force, now >= self.next_us) else {
            return None;
        };
        self.next_us += PERIOD_US;
        let moment = about_origin(sample, [x, y, z]);
        let [x, y, z] = [x, y, z].map(|force| noisy(&mut self.rng, force, NOISE_N));
        let time = AHEAD_S + (1.0 + FAST) * now as f64 * 1e-6;
        let mut row = format!("{time:.5},{x:.4},{y:.4},{z:.4}");
        for moment in moment {
            if let Some(rng) = &mut self.moments {
                row += &format!(",{:.3}", noisy(rng, moment, NOISE_NMM));
            }
        }
        Some(row)
    }
}

fn noisy(rng: &mut ChaCha8Rng, value: f64, sigma: f64) -> f64 {
    let unit: f64 = StandardNormal.sample(rng);
    value + sigma * unit
}

/// Moments of a contact about the cell's origin, N·mm; those of its force in the middle of the
/// skin without a contact point.
fn about_origin(sample: &Sample, [fx, fy, fz]: [f64; 3]) -> [f64; 3] {
    let [x, y] = sample.truth.point.map(Option::unwrap_or_default);
    let torsion = sample.truth.torsion.unwrap_or_default();
    [y * fz + DEPTH_MM * fy, -x * fz - DEPTH_MM * fx, x * fy - y * fx + torsion]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scene, Simulator};

    #[test]
    fn load_cell_logs_noisy_force_at_100_hz() {
        let mut cell = LoadCell::new(1, false);
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

    #[test]
    fn six_axis_cell_adds_moments_about_its_origin() {
        let (mut three, mut six) = (LoadCell::new(1, false), LoadCell::new(1, true));
        let mut squares = Vec::new();
        for sample in Simulator::new(&Scene::load("shear").unwrap(), 1).take(3000) {
            let (Some(plain), Some(row)) = (three.read(&sample), six.read(&sample)) else {
                continue;
            };
            assert!(row.starts_with(&plain), "{plain} {row}");
            let row: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            let [fx, fy, fz] = sample.truth.force.map(Option::unwrap);
            let [x, y] = sample.truth.point.map(Option::unwrap_or_default);
            let moments = [y * fz + 25.0 * fy, -x * fz - 25.0 * fx, x * fy - y * fx];
            squares.extend(moments.iter().zip(&row[4..]).map(|(own, read)| (own - read).powi(2)));
        }
        let noise = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!(squares.len() > 1500 && (0.09..0.11).contains(&noise), "{noise}");
    }
}

//! Failure map of a force sensor fitted to loads of nearly one direction.
//!
//! The condition number of the calibration loads goes from 1 to 1e8.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use taxel_regress::least_squares;

use crate::counts::{Count, Map, Of, Point};

/// Bridge output per newton as a share of full scale, about that of [Ospina2017]'s sensor.
const GAIN: f64 = 0.05;
/// Standard deviation of an output as a share of full scale.
const NOISE: f64 = 6e-5;
const ROWS: usize = 2000;
/// Largest condition number of the working range, because calibration loads a sensor in all
/// directions.
const WITHIN: f64 = 10.0;

/// Judges the fit on loads of every direction; a refused fit counts as flagged.
pub(crate) fn map(device: u64) -> Map {
    let conditions = [1.0, 3.0, 1e1, 3e1, 1e2, 1e3, 1e4, 1e6, 1e8];
    let points = conditions.map(|condition| {
        let (count, within) = (judge(device, condition), condition <= WITHIN);
        let working = if within { count } else { Count::default() };
        Point { value: condition, within, count, working }
    });
    Map {
        of: Of::Finger,
        method: "force sensor's fit / N",
        sweep: "condition of the loads / 1",
        points: points.into(),
    }
}

fn judge(device: u64, condition: f64) -> Count {
    let mut rng = ChaCha8Rng::seed_from_u64(device);
    let mut gauss = || -> f64 { StandardNormal.sample(&mut rng) };
    let mut row = |shares: [f64; 3]| {
        let force = shares.map(|share| 0.5 * share * gauss());
        (force.map(|f| GAIN * f + NOISE * gauss()), force)
    };
    let one = 1.0 / condition;
    let (signals, forces): (Vec<_>, Vec<_>) = (0..ROWS).map(|_| row([1.0, 1.0, one])).unzip();
    let fitted = least_squares::fit("s0", &signals, &forces, NOISE);
    let mut count = Count::default();
    for _ in 0..ROWS {
        let (u, force) = row([1.0; 3]);
        match &fitted {
            Err(_) => count.add(None, NOISE / GAIN, true),
            Ok(fit) => {
                let off = |axis: usize| {
                    let found: f64 = fit.s[axis].iter().zip(u).map(|(s, u)| s * u).sum();
                    (found - force[axis]).powi(2)
                };
                let stated = fit.rms.iter().map(|rms| rms * rms).sum::<f64>().sqrt();
                count.add(Some((0..3).map(off).sum::<f64>().sqrt()), stated, false);
            }
        }
    }
    count
}

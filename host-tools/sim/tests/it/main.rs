//! The papers' five systems, end to end: scene, codes, the chip's arithmetic, the papers' figures.
//!
//! A user's calibration is fitted here to the trace of one seed, with noise, and judged on another
//! seed's.

mod array;
mod budget;
mod catalogue;
mod codes;
mod column;
mod effects;
mod finger;
mod line;
mod mems;
mod messages;
mod micro;
mod physics;
mod reference;

use nalgebra::{DMatrix, DVector};
use taxel::condition::{Bias, BiasTaker, Levels, Signals};
use taxel_files::trace::Sample;
use taxel_sim::scene::Changes;
use taxel_sim::{Scene, Simulator};

/// Number of unloaded frames at the beginning of every scene from which a bias is taken.
const UNLOADED: u16 = 100;

/// Frames of a built-in scene.
fn run(name: &str, seed: u64) -> Vec<Sample> {
    Simulator::new(&Scene::load(name).unwrap(), seed).collect()
}

/// Frames of a built-in scene with changes, each `KEY=VALUE`.
fn changed(name: &str, set: &[&str], seed: u64) -> Vec<Sample> {
    let set = set.iter().map(|change| (*change).to_owned()).collect();
    let scene = Scene::load_changed(name, &Changes { reference: false, set });
    Simulator::new(&scene.unwrap(), seed).collect()
}

/// Seeds of devices that were not used during development.
const HELD_OUT: [u64; 5] = [11, 12, 13, 14, 15];

/// Frames of a built-in scene on another device than its own.
fn run_on(device: u64, name: &str, seed: u64) -> Vec<Sample> {
    let mut scene = Scene::load(name).unwrap();
    scene.device.seed = device;
    Simulator::new(&scene, seed).collect()
}

/// Root mean square.
fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
}

/// Bias from the unloaded beginning of a trace.
fn bias(samples: &[Sample]) -> Bias {
    bias_over(UNLOADED, samples)
}

/// Bias from the first `frames` frames of a trace.
fn bias_over(frames: u16, samples: &[Sample]) -> Bias {
    let mut taker = BiasTaker::new(frames);
    let levels = samples.iter().map(|sample| Levels::read(&sample.scan.codes));
    let mut outcomes = levels.filter_map(|levels| taker.add(&levels, &Bias::default()));
    outcomes.next().unwrap().unwrap().bias
}

/// Signals of the chip for every frame, with the frame itself.
fn signals(samples: &[Sample]) -> Vec<(Signals, &Sample)> {
    signals_with(&bias(samples), samples)
}

/// Signals as in [`signals`], with a known bias.
fn signals_with<'a>(bias: &Bias, samples: &'a [Sample]) -> Vec<(Signals, &'a Sample)> {
    let signals = |sample: &Sample| bias.apply(&Levels::read(&sample.scan.codes), None);
    samples.iter().map(|sample| (signals(sample), sample)).collect()
}

/// Force of a sample, known because the trace is simulated.
fn force(sample: &Sample) -> [f64; 3] {
    sample.truth.force.map(Option::unwrap)
}

/// Parts of a trace with contact.
fn contacts<T>(rows: &[T], touched: impl Fn(&T) -> bool) -> Vec<&[T]> {
    let runs = rows.chunk_by(|a, b| touched(a) == touched(b));
    runs.filter(|run| touched(&run[0])).collect()
}

/// Least squares: the weights of `terms` that fit `value`.
fn fit<const N: usize>(rows: impl IntoIterator<Item = ([f64; N], f64)>) -> [f64; N] {
    let (terms, values): (Vec<[f64; N]>, Vec<f64>) = rows.into_iter().unzip();
    let mut matrix = DMatrix::from_fn(terms.len(), N, |row, column| terms[row][column]);
    // Columns are scaled, because powers differ by orders of magnitude.
    let scales: [f64; N] = std::array::from_fn(|column| matrix.column(column).norm());
    matrix.column_iter_mut().zip(scales).for_each(|(mut column, scale)| column /= scale);
    let solution = matrix.svd(true, true).solve(&DVector::from_vec(values), 1e-12).unwrap();
    std::array::from_fn(|i| solution[i] / scales[i])
}

/// Slope and intercept of the straight line through (x, y).
fn line(points: impl IntoIterator<Item = (f64, f64)>) -> [f64; 2] {
    fit(points.into_iter().map(|(x, y)| ([x, 1.0], y)))
}

/// Asserts that `found` is within `percent` of the paper's value.
fn meets(what: &str, found: f64, paper: f64, percent: f64) {
    let off = 100.0 * (found / paper - 1.0);
    assert!(off.abs() <= percent, "{what}: {found:.5}, the paper has {paper} ({off:+.2} %)");
}

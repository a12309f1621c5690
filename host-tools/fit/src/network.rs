//! From rows in their own units to f32 weights: thinning, scaling, starts, training, folding.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use taxel::estimate::net::Layers;

use crate::correlation::independent_share;
use crate::error::FitError;
use crate::levenberg::{self, Decay, State};
use crate::mlp::{self, Rows, Shape};

/// A recording at kilohertz repeats itself from row to row; every k-th row, so that about this many are
/// left, says the same in a fraction of the time.
const MOST_ROWS: usize = 4096;
/// Steps that each start is given before the best of them goes on.
const START_STEPS: usize = 25;

/// While the net takes shape every row counts.
const EXPLORE: Decay = Decay::Evidence { per_row: 1.0 };
/// How a net is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetOptions {
    /// Seed of the starting weights: the same seed and recordings give the same net.
    pub seed: u64,
    /// Starts, of which the best goes on.
    pub starts: usize,
    /// Most steps in all.
    pub steps: usize,
}

impl Default for NetOptions {
    fn default() -> Self {
        Self { seed: 0, starts: 3, steps: 300 }
    }
}

/// How the inputs of a net relate to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inputs {
    /// Channels of one kind, with one unit and one noise: they are scaled together, so that a channel
    /// that hardly moves is not blown up until its noise and drift weigh as much as the others' signal.
    Alike,
    /// Quantities of different kinds: each is scaled by its own spread.
    Unlike,
}

/// How far a fit has come.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// What is being fitted.
    pub part: String,
    /// Steps done.
    pub step: usize,
    /// Most steps there will be.
    pub of: usize,
    /// RMS error of the outputs so far, as a share of the targets' spread.
    pub error: f64,
}

/// A trained net y = V·tanh(W·x + a) + L·x + b in f32, scaling folded in, laid out as [`Layers`] take it.
#[derive(Clone, Debug, PartialEq)]
pub struct Net {
    /// W, a row a unit.
    pub hidden: Vec<f32>,
    /// a.
    pub hidden_bias: Vec<f32>,
    /// V, a row an output.
    pub output: Vec<f32>,
    /// L, a row an output, if there is a skip path.
    pub skip: Vec<f32>,
    /// b.
    pub output_bias: Vec<f32>,
    /// Accepted steps of the start that was kept.
    pub steps: usize,
    /// How many of its parameters the data determine.
    pub effective: f64,
    /// Rows it was trained on after thinning.
    pub rows: usize,
}

impl Net {
    /// The outputs for one row, by the arithmetic of the chip.
    #[must_use]
    pub fn outputs(&self, x: &[f32]) -> Vec<f32> {
        let layers = Layers {
            hidden: &self.hidden,
            hidden_bias: &self.hidden_bias,
            output: &self.output,
            skip: &self.skip,
            output_bias: &self.output_bias,
        };
        outputs(layers, x)
    }
}

/// The outputs of a net for one row of inputs, by the arithmetic of the chip.
pub(crate) fn outputs(layers: Layers<'_>, x: &[f32]) -> Vec<f32> {
    let mut units = vec![0.0; layers.hidden_bias.len()];
    let mut y = layers.output_bias.to_vec();
    layers.outputs(x, &mut units, &mut y);
    y
}

/// Mean and spread of a column, to bring it to about one.
struct Scale {
    mean: f64,
    spread: f64,
}

fn scale(column: impl Iterator<Item = f64> + Clone) -> Scale {
    let n = column.clone().count().max(1) as f64;
    let mean = column.clone().sum::<f64>() / n;
    let spread = (column.map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    Scale { mean, spread }
}

/// Trains a net of `hidden` units from the rows `x` to the rows `y`.
///
/// An input that never changes gets no weight. When `stop` becomes true, the best net so far is
/// returned.
///
/// # Errors
/// Fewer rows than would determine it, a target that never changes, or stopped before the first step.
pub fn fit(
    part: &str,
    x: &[Vec<f64>],
    y: &[Vec<f64>],
    hidden: usize,
    (inputs, options): (Inputs, NetOptions),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Net, FitError> {
    let shape = Shape {
        inputs: x.first().map_or(0, Vec::len),
        hidden,
        outputs: y.first().map_or(0, Vec::len),
    };
    if shape.inputs == 0 || shape.hidden == 0 || shape.outputs == 0 {
        let problem = "a net needs inputs, hidden units and outputs".into();
        return Err(FitError::Shape { part: part.into(), problem });
    }
    // A row gives `outputs` equations; with fewer than two an unknown the fit means nothing.
    let least = (2 * shape.parameters()).div_ceil(shape.outputs);
    if x.len() < least {
        return Err(FitError::TooFewRows { part: part.into(), rows: x.len(), least });
    }
    let thin = x.len().div_ceil(MOST_ROWS);
    let x: Vec<&[f64]> = x.iter().step_by(thin).map(Vec::as_slice).collect();
    let y: Vec<&[f64]> = y.iter().step_by(thin).map(Vec::as_slice).collect();
    let inputs = input_scales(&x, shape.inputs, inputs);
    let mut targets: Vec<Scale> =
        (0..shape.outputs).map(|k| scale(y.iter().map(move |row| row[k]))).collect();
    if targets.iter().any(|target| target.spread == 0.0) {
        return Err(FitError::NoLoad { part: part.into() });
    }
    let scaled = |value: f64, scale: &Scale| {
        if scale.spread > 0.0 { (value - scale.mean) / scale.spread } else { 0.0 }
    };
    let mut rows = Rows {
        x: DMatrix::from_fn(x.len(), shape.inputs + 1, |row, i| {
            inputs.get(i).map_or(1.0, |scale| scaled(x[row][i], scale))
        }),
        y: DMatrix::from_fn(y.len(), shape.outputs, |row, k| scaled(y[row][k], &targets[k])),
    };

    let total = options.starts.saturating_sub(1) * START_STEPS + options.steps;
    let mut before = 0;
    let mut go_on = |state: &State, before: usize| {
        let error = (state.squares.sum() / (shape.outputs * x.len()) as f64).sqrt();
        progress(Progress { part: part.into(), step: before + state.steps, of: total, error });
        !stop.load(Ordering::Relaxed)
    };
    let mut best: Option<State> = None;
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    for _ in 0..options.starts.max(1) {
        let start = State::new(shape, &rows, start(shape, &mut rng));
        let limit = START_STEPS.min(options.steps);
        let state =
            levenberg::train(shape, &rows, start, EXPLORE, limit, &mut |s| go_on(s, before));
        before += state.steps;
        if state.steps > 0
            && best.as_ref().is_none_or(|best| state.squares.sum() < best.squares.sum())
        {
            best = Some(state);
        }
    }
    let best = best.ok_or(FitError::Stopped)?;
    before -= best.steps;
    // Counting every row first lets the net leave the plateau on which it is a linear map; the
    // decay that the independent rows ask for would hold it there.
    let first = options.steps * 2 / 3;
    let mut best = levenberg::train(shape, &rows, best, EXPLORE, first, &mut |s| go_on(s, before));
    balance(shape, &mut best, &mut rows, &mut targets);
    // Then the decay is set by the rows that say something new.
    let errors = mlp::outputs(shape, best.parameters.as_slice(), rows.x.as_view()) - &rows.y;
    let settle = Decay::Evidence { per_row: independent_share(&errors) };
    let best =
        levenberg::train(shape, &rows, best, settle, options.steps, &mut |s| go_on(s, before));
    Ok(fold(shape, &best, &inputs, &targets, rows.x.nrows()))
}

fn input_scales(x: &[&[f64]], count: usize, inputs: Inputs) -> Vec<Scale> {
    let mut scales: Vec<Scale> =
        (0..count).map(|i| scale(x.iter().map(move |row| row[i]))).collect();
    if inputs == Inputs::Alike {
        let squares: f64 = scales.iter().map(|scale| scale.spread.powi(2)).sum();
        let common = (squares / count as f64).sqrt();
        scales.iter_mut().filter(|s| s.spread > 0.0).for_each(|s| s.spread = common);
    }
    scales
}

/// Scales each target so that what is left of its error is the same for all of them: one noise β then
/// fits every output, and an output that can be known better (f_z) is held to it.
fn balance(shape: Shape, state: &mut State, rows: &mut Rows, targets: &mut [Scale]) {
    let all = state.squares.mean();
    for (k, target) in targets.iter_mut().enumerate() {
        let factor = (all / state.squares[k].max(1e-6 * all)).sqrt();
        let at = shape.hidden_parameters() + k * (shape.hidden + 1);
        state.parameters.rows_mut(at, shape.hidden + 1).scale_mut(factor);
        rows.y.column_mut(k).scale_mut(factor);
        target.spread /= factor;
    }
}

/// Small random weights: sums of about unit size, outputs that begin small.
fn start(shape: Shape, rng: &mut ChaCha8Rng) -> DVector<f64> {
    let hidden = (3.0 / (shape.inputs + 1) as f64).sqrt();
    let output = (1.0 / (shape.hidden + 1) as f64).sqrt();
    DVector::from_fn(shape.parameters(), |p, _| {
        let size = if p < shape.hidden_parameters() { hidden } else { output };
        size * rng.random_range(-1.0..1.0)
    })
}

/// Folds the scaling of inputs and targets into the weights:
/// w·(x − m)/s + a = (w/s)·x + (a − Σ w·m/s), and y·s + m for the outputs.
fn fold(shape: Shape, state: &State, inputs: &[Scale], targets: &[Scale], rows: usize) -> Net {
    let (hidden, output) = state.parameters.as_slice().split_at(shape.hidden_parameters());
    let mut net = Net {
        hidden: Vec::new(),
        hidden_bias: Vec::new(),
        output: Vec::new(),
        skip: Vec::new(),
        output_bias: Vec::new(),
        steps: state.steps,
        effective: state.effective,
        rows,
    };
    for unit in hidden.chunks_exact(shape.inputs + 1) {
        let mut bias = unit[shape.inputs];
        for (weight, scale) in unit.iter().zip(inputs) {
            let weight = if scale.spread > 0.0 { weight / scale.spread } else { 0.0 };
            bias -= weight * scale.mean;
            net.hidden.push(weight as f32);
        }
        net.hidden_bias.push(bias as f32);
    }
    for (weights, scale) in output.chunks_exact(shape.hidden + 1).zip(targets) {
        net.output.extend(weights[..shape.hidden].iter().map(|w| (w * scale.spread) as f32));
        net.output_bias.push((weights[shape.hidden] * scale.spread + scale.mean) as f32);
    }
    net
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNLIKE: (Inputs, NetOptions) =
        (Inputs::Unlike, NetOptions { seed: 0, starts: 3, steps: 300 });

    /// A smooth function of three inputs of very different size, in two outputs.
    fn rows(count: usize) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
        let x: Vec<Vec<f64>> = (0..count)
            .map(|i| i as f64)
            .map(|i| {
                vec![100.0 + 20.0 * (0.11 * i).sin(), 1e-3 * (0.37 * i).cos(), (0.23 * i).sin()]
            })
            .collect();
        let y = x
            .iter()
            .map(|x| {
                vec![5.0 + (x[0] / 20.0).sin() + 500.0 * x[1], 2.0 * (x[2] - 800.0 * x[1]).tanh()]
            })
            .collect();
        (x, y)
    }

    fn fit_quietly(x: &[Vec<f64>], y: &[Vec<f64>], options: NetOptions) -> Result<Net, FitError> {
        fit("net", x, y, 6, (Inputs::Unlike, options), &mut |_| {}, &AtomicBool::new(false))
    }

    #[test]
    fn folded_f32_weights_follow_the_function_in_its_own_units() {
        let (x, y) = rows(600);
        let net = fit_quietly(&x, &y, NetOptions::default()).unwrap();
        for (x, y) in x.iter().zip(&y) {
            let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
            for (found, wanted) in net.outputs(&x).iter().zip(y) {
                assert!((f64::from(*found) - wanted).abs() < 0.05, "{found} {wanted}");
            }
        }
    }

    #[test]
    fn inputs_alike_are_scaled_together_and_others_each_by_itself() {
        let rows: [&[f64]; 2] = [&[1.0, 70.0, 5.0], &[3.0, 84.0, 5.0]];
        let spreads =
            |inputs| input_scales(&rows, 3, inputs).iter().map(|s| s.spread).collect::<Vec<_>>();
        let common = (50.0f64 / 3.0).sqrt();
        assert_eq!(spreads(Inputs::Alike), [common, common, 0.0]);
        assert_eq!(spreads(Inputs::Unlike), [1.0, 7.0, 0.0]);
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_and_another_seed_another_net() {
        let (x, y) = rows(200);
        let net = |seed| fit_quietly(&x, &y, NetOptions { seed, starts: 2, steps: 30 }).unwrap();
        assert_eq!(net(1), net(1));
        assert_ne!(net(1).hidden, net(2).hidden);
    }

    #[test]
    fn stopping_returns_the_best_so_far() {
        let (x, y) = rows(200);
        let stop = AtomicBool::new(false);
        let mut last = 0;
        let mut progress = |p: Progress| {
            last = p.step;
            stop.store(p.step >= 5, Ordering::Relaxed);
        };
        let net = fit("net", &x, &y, 6, UNLIKE, &mut progress, &stop).unwrap();
        assert_eq!((net.steps, last), (5, 5));
    }

    #[test]
    fn stopped_before_the_first_step_there_is_nothing_to_keep() {
        let (x, y) = rows(200);
        let stop = AtomicBool::new(true);
        let error = fit("net", &x, &y, 6, UNLIKE, &mut |_| {}, &stop).unwrap_err();
        assert_eq!(error, FitError::Stopped);
    }

    #[test]
    fn an_input_that_never_changes_gets_no_weight() {
        let (mut x, y) = rows(200);
        x.iter_mut().for_each(|row| row[2] = 7.0);
        let net = fit_quietly(&x, &y, NetOptions { steps: 20, ..NetOptions::default() }).unwrap();
        assert!(net.hidden.chunks_exact(3).all(|unit| unit[2] == 0.0));
    }

    #[test]
    fn a_dozen_rows_and_a_constant_target_are_refused() {
        let (x, y) = rows(12);
        assert!(matches!(
            fit_quietly(&x, &y, NetOptions::default()),
            Err(FitError::TooFewRows { rows: 12, .. })
        ));
        let (x, mut y) = rows(200);
        y.iter_mut().for_each(|row| row[1] = 0.0);
        assert!(matches!(fit_quietly(&x, &y, NetOptions::default()), Err(FitError::NoLoad { .. })));
    }
}

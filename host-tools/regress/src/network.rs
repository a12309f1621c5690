//! Training of a net: from rows in their own units to f32 weights.

mod trainer;

use std::sync::atomic::AtomicBool;

use nalgebra::DMatrix;
use taxel::estimate::net::Layers;

use crate::correlation::independent_share;
use crate::error::FitError;
use crate::levenberg::Decay;
use crate::mlp::{self, Shape};
use crate::scaling::{Inputs, Scaling, thinned};
use trainer::Trainer;

/// Most rows of a net's training.
pub const MOST_ROWS: usize = 4096;
/// Decay of the first phase: every row counts.
const EXPLORE: Decay = Decay::Evidence { per_row: 1.0 };

/// Options of the training of a net.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetOptions {
    /// Seed of the starting weights: the same seed and recordings give the same net.
    pub seed: u64,
    /// Number of starts; the best is continued.
    pub starts: usize,
    /// Most steps in total.
    pub steps: usize,
}

impl Default for NetOptions {
    fn default() -> Self {
        Self { seed: 0, starts: 3, steps: 300 }
    }
}

/// Architecture of a net besides its inputs and outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Build {
    /// Hidden tanh units; none make it linear.
    pub hidden: usize,
    /// Linear path from inputs to outputs.
    pub skip: bool,
}

/// Progress of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Part that is being fitted.
    pub part: String,
    /// Steps done.
    pub step: usize,
    /// Most steps of the fit.
    pub of: usize,
    /// RMS error of the outputs so far, as a share of the targets' spread.
    pub error: f64,
}

/// A trained net y = V·tanh(W·x + a) + L·x + b in f32, laid out as [`Layers`] expects.
///
/// The scaling of inputs and targets is folded into the weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Net {
    /// Weights W, a row a unit.
    pub hidden: Vec<f32>,
    /// Biases a.
    pub hidden_bias: Vec<f32>,
    /// Weights V, a row an output.
    pub output: Vec<f32>,
    /// Weights L, a row an output; empty without a skip path.
    pub skip: Vec<f32>,
    /// Biases b.
    pub output_bias: Vec<f32>,
    /// Accepted steps of the start that was kept.
    pub steps: usize,
    /// Number of parameters that the data determine.
    pub effective: f64,
    /// Rows used for training after thinning.
    pub rows: usize,
}

impl Net {
    /// Shape of the net: `net 16-16-3`, `skip 16-6-3`, `linear 16-3`.
    #[must_use]
    pub fn name(&self, inputs: usize) -> String {
        let (hidden, outputs) = (self.hidden_bias.len(), self.output_bias.len());
        shape_name(inputs, hidden, outputs, !self.skip.is_empty())
    }

    /// Builds a linear net from slopes (inputs × outputs) and levels of scaled data.
    pub(crate) fn linear(
        slope: &DMatrix<f64>,
        level: &[f64],
        scaling: &Scaling,
        rows: usize,
    ) -> Self {
        let mut net = Self {
            hidden: Vec::new(),
            hidden_bias: Vec::new(),
            output: Vec::new(),
            skip: Vec::new(),
            output_bias: Vec::new(),
            steps: 0,
            effective: slope.len() as f64,
            rows,
        };
        for ((slope, level), scale) in slope.column_iter().zip(level).zip(&scaling.targets) {
            let weights: Vec<f64> = slope.iter().map(|w| w * scale.spread).collect();
            let bias = level * scale.spread + scale.mean;
            net.output_bias.push(unscaled(&weights, bias, scaling, &mut net.skip));
        }
        net
    }

    /// Computes the outputs for one row, by the arithmetic of the chip.
    #[must_use]
    pub fn outputs(&self, x: &[f32]) -> Vec<f32> {
        outputs(self.layers(), x)
    }

    /// Borrows the weights as layers for the core.
    #[must_use]
    pub fn layers(&self) -> Layers<'_> {
        Layers {
            hidden: &self.hidden,
            hidden_bias: &self.hidden_bias,
            output: &self.output,
            skip: &self.skip,
            output_bias: &self.output_bias,
        }
    }
}

/// Computes the outputs of layers for one row of inputs, by the arithmetic of the chip.
pub fn outputs(layers: Layers<'_>, x: &[f32]) -> Vec<f32> {
    let mut y = layers.output_bias.to_vec();
    layers.outputs(x, &mut y);
    y
}

/// Trains a net from the rows `x` to the rows `y`.
///
/// The evidence of the independent rows sets the weight decay.
///
/// An input that never changes gets no weight. When `stop` becomes true, the best net so far is
/// returned.
///
/// # Errors
///
/// Too few rows to determine it, a target that never changes, or stopped before the first
/// step.
pub fn fit(
    part: &str,
    (x, y): (&[Vec<f64>], &[Vec<f64>]),
    build: Build,
    (inputs, options): (Inputs, NetOptions),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Net, FitError> {
    let shape = shape(part, x, y, build)?;
    // A row gives `outputs` equations; with fewer than two an unknown the fit is meaningless.
    let least = (2 * shape.parameters()).div_ceil(shape.outputs);
    if x.len() < least {
        return Err(FitError::TooFewRows { part: part.into(), rows: x.len(), least });
    }
    let x: Vec<&[f64]> = thinned(x, MOST_ROWS).map(Vec::as_slice).collect();
    let y: Vec<&[f64]> = thinned(y, MOST_ROWS).map(Vec::as_slice).collect();
    let mut trainer = Trainer::new(part, shape, Scaling::of(&x, &y, inputs), (&x, &y), options)?;
    let state = trainer.explore(EXPLORE, progress, stop)?;
    // Set the decay by the number of independent rows. Counting every row first lets the net leave
    // the plateau on which it is a linear map; this decay would hold it there.
    let rows = &trainer.rows;
    let errors = mlp::outputs(shape, state.parameters.as_slice(), rows.x.as_view()) - &rows.y;
    let settle = Decay::Evidence { per_row: independent_share(&errors) };
    let state = trainer.settle(state, settle, progress, stop);
    Ok(trainer.fold(&state))
}

/// Trains a net on the outputs `y` of another model for the inputs `x`.
///
/// There is no noise to guard against. The decay only keeps irrelevant weights small; it is
/// relative to a noise of one (targets have the spread one).
///
/// # Errors
///
/// As [`fit`].
pub fn imitate(
    part: &str,
    (x, y): (&[Vec<f64>], &[Vec<f64>]),
    (build, decay): (Build, f64),
    (inputs, options): (Inputs, NetOptions),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Net, FitError> {
    let shape = shape(part, x, y, build)?;
    let x: Vec<&[f64]> = x.iter().map(Vec::as_slice).collect();
    let y: Vec<&[f64]> = y.iter().map(Vec::as_slice).collect();
    let mut trainer = Trainer::new(part, shape, Scaling::of(&x, &y, inputs), (&x, &y), options)?;
    let state = trainer.explore(Decay::Fixed(decay), progress, stop)?;
    let state = trainer.settle(state, Decay::Fixed(decay), progress, stop);
    Ok(trainer.fold(&state))
}

/// Name of a shape: `net 16-16-3`, `skip 16-6-3`, `linear 16-3`.
pub fn shape_name(inputs: usize, hidden: usize, outputs: usize, skip: bool) -> String {
    match (hidden, skip) {
        (0, _) => format!("linear {inputs}-{outputs}"),
        (hidden, false) => format!("net {inputs}-{hidden}-{outputs}"),
        (hidden, true) => format!("skip {inputs}-{hidden}-{outputs}"),
    }
}

fn shape(part: &str, x: &[Vec<f64>], y: &[Vec<f64>], build: Build) -> Result<Shape, FitError> {
    let inputs = x.first().map_or(0, Vec::len);
    let outputs = y.first().map_or(0, Vec::len);
    if inputs == 0 || outputs == 0 || (build.hidden == 0 && !build.skip) {
        let problem = "a net needs inputs, outputs, and hidden units or a skip path".into();
        return Err(FitError::Shape { part: part.into(), problem });
    }
    Ok(Shape { inputs, hidden: build.hidden, outputs, skip: build.skip })
}

/// Converts weights of scaled inputs to weights of the inputs, appended to `into`.
///
/// Returns the matching bias.
fn unscaled(weights: &[f64], mut bias: f64, scaling: &Scaling, into: &mut Vec<f32>) -> f32 {
    for (weight, scale) in weights.iter().zip(&scaling.inputs) {
        let weight = if scale.spread > 0.0 { weight / scale.spread } else { 0.0 };
        bias -= weight * scale.mean;
        into.push(weight as f32);
    }
    bias as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::Ordering;

    const SIX: Build = Build { hidden: 6, skip: false };
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
        fit("net", (x, y), SIX, (Inputs::Unlike, options), &mut |_| {}, &AtomicBool::new(false))
    }

    #[test]
    fn folded_f32_weights_match_function() {
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
    fn skip_path_fits_linear_function_alone_or_with_units() {
        let (x, _) = rows(600);
        let y: Vec<Vec<f64>> =
            x.iter().map(|x| vec![3.0 + 0.5 * x[0] - 2000.0 * x[1] + x[2]]).collect();
        let data = (x.as_slice(), y.as_slice());
        let options = (Inputs::Unlike, NetOptions::default());
        for hidden in [0, 4] {
            let build = Build { hidden, skip: true };
            let stop = AtomicBool::new(false);
            let net = fit("net", data, build, options, &mut |_| {}, &stop).unwrap();
            assert_eq!((net.skip.len(), net.hidden_bias.len()), (3, hidden));
            for (x, y) in x.iter().zip(&y) {
                let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
                assert!((f64::from(net.outputs(&x)[0]) - y[0]).abs() < 0.01, "{hidden}");
            }
        }
        let neither = Build { hidden: 0, skip: false };
        let refused = fit("net", data, neither, options, &mut |_| {}, &AtomicBool::new(false));
        assert!(matches!(refused, Err(FitError::Shape { .. })));
    }

    #[test]
    fn fit_is_deterministic_for_each_seed() {
        let (x, y) = rows(200);
        let net = |seed| fit_quietly(&x, &y, NetOptions { seed, starts: 2, steps: 30 }).unwrap();
        assert_eq!(net(1), net(1));
        assert_ne!(net(1).hidden, net(2).hidden);
    }

    #[test]
    fn stopping_fit_returns_best_net_so_far() {
        let (x, y) = rows(200);
        let stop = AtomicBool::new(false);
        let mut last = 0;
        let mut progress = |p: Progress| {
            last = p.step;
            stop.store(p.step >= 5, Ordering::Relaxed);
        };
        let net = fit("net", (&x, &y), SIX, UNLIKE, &mut progress, &stop).unwrap();
        assert_eq!((net.steps, last), (5, 5));
    }

    #[test]
    fn fit_stopped_before_first_step_returns_error() {
        let (x, y) = rows(200);
        let stop = AtomicBool::new(true);
        let error = fit("net", (&x, &y), SIX, UNLIKE, &mut |_| {}, &stop).unwrap_err();
        assert_eq!(error, FitError::Stopped);
    }

    #[test]
    fn constant_input_gets_no_weight() {
        let (mut x, y) = rows(200);
        x.iter_mut().for_each(|row| row[2] = 7.0);
        let net = fit_quietly(&x, &y, NetOptions { steps: 20, ..NetOptions::default() }).unwrap();
        assert!(net.hidden.chunks_exact(3).all(|unit| unit[2] == 0.0));
    }

    #[test]
    fn dozen_rows_and_constant_target_are_refused() {
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

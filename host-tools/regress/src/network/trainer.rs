//! Training of a net from random weights: starts, balanced targets, folding.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::DVector;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Net, NetOptions, Progress, unscaled};
use crate::error::FitError;
use crate::levenberg::{self, Decay, State};
use crate::mlp::{Rows, Shape};
use crate::scaling::Scaling;

/// Steps of each start before the best one continues.
const START_STEPS: usize = 25;

/// Scaled rows and the number of steps done.
pub(super) struct Trainer<'p> {
    part: &'p str,
    shape: Shape,
    pub rows: Rows,
    scaling: Scaling,
    options: NetOptions,
    before: usize,
}

impl<'p> Trainer<'p> {
    pub fn new(
        part: &'p str,
        shape: Shape,
        scaling: Scaling,
        (x, y): (&[&[f64]], &[&[f64]]),
        options: NetOptions,
    ) -> Result<Self, FitError> {
        if scaling.a_target_rests() {
            return Err(FitError::NoLoad { part: part.into() });
        }
        let x = scaling.inputs(x);
        let rows = Rows { x: x.insert_column(shape.inputs, 1.0), y: scaling.targets(y) };
        Ok(Self { part, shape, rows, scaling, options, before: 0 })
    }

    fn train(
        &self,
        state: State,
        decay: Decay,
        until: usize,
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> State {
        let NetOptions { starts, steps, .. } = self.options;
        let of = starts.saturating_sub(1) * START_STEPS + steps;
        let values = self.rows.y.len() as f64;
        levenberg::train(self.shape, &self.rows, state, decay, until, &mut |state| {
            let error = (state.squares.sum() / values).sqrt();
            let step = self.before + state.steps;
            progress(Progress { part: self.part.into(), step, of, error });
            !stop.load(Ordering::Relaxed)
        })
    }

    /// Trains the best of several starts for two thirds of the steps and balances its targets'
    /// errors.
    pub fn explore(
        &mut self,
        decay: Decay,
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> Result<State, FitError> {
        let mut best: Option<State> = None;
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed);
        for _ in 0..self.options.starts.max(1) {
            let start = State::new(self.shape, &self.rows, start(self.shape, &mut rng));
            let limit = START_STEPS.min(self.options.steps);
            let state = self.train(start, decay, limit, progress, stop);
            self.before += state.steps;
            if state.steps > 0
                && best.as_ref().is_none_or(|best| state.squares.sum() < best.squares.sum())
            {
                best = Some(state);
            }
        }
        let best = best.ok_or(FitError::Stopped)?;
        self.before -= best.steps;
        let mut best = self.train(best, decay, self.options.steps * 2 / 3, progress, stop);
        self.balance(&mut best);
        Ok(best)
    }

    /// Trains for the remaining steps.
    pub fn settle(
        &self,
        state: State,
        decay: Decay,
        progress: &mut dyn FnMut(Progress),
        stop: &AtomicBool,
    ) -> State {
        self.train(state, decay, self.options.steps, progress, stop)
    }

    /// Scales each target so that the remaining errors are equal.
    ///
    /// One noise β then fits every output, and a more predictable output (f_z) is held to it.
    fn balance(&mut self, state: &mut State) {
        let all = state.squares.mean();
        for (k, target) in self.scaling.targets.iter_mut().enumerate() {
            let factor = (all / state.squares[k].max(1e-6 * all)).sqrt();
            let at = self.shape.hidden_parameters() + k * self.shape.seen();
            state.parameters.rows_mut(at, self.shape.seen()).scale_mut(factor);
            self.rows.y.column_mut(k).scale_mut(factor);
            state.squares[k] *= factor * factor;
            target.spread /= factor;
        }
    }

    /// Folds the scaling of inputs and targets into the weights.
    ///
    /// w·(x − m)/s + a = (w/s)·x + (a − Σ w·m/s), and y·s + m for the outputs.
    pub fn fold(&self, state: &State) -> Net {
        let Shape { inputs, hidden: units, .. } = self.shape;
        let (hidden, output) = state.parameters.as_slice().split_at(self.shape.hidden_parameters());
        let mut net = Net {
            hidden: Vec::new(),
            hidden_bias: Vec::new(),
            output: Vec::new(),
            skip: Vec::new(),
            output_bias: Vec::new(),
            steps: state.steps,
            effective: state.effective,
            rows: self.rows.x.nrows(),
        };
        for unit in hidden.chunks_exact(inputs + 1) {
            let bias = unscaled(&unit[..inputs], unit[inputs], &self.scaling, &mut net.hidden);
            net.hidden_bias.push(bias);
        }
        for (weights, scale) in output.chunks_exact(self.shape.seen()).zip(&self.scaling.targets) {
            let (of_units, rest) = weights.split_at(units);
            let (of_inputs, bias) = rest.split_at(rest.len() - 1);
            net.output.extend(of_units.iter().map(|w| (w * scale.spread) as f32));
            let bias = bias[0] * scale.spread + scale.mean;
            let of_inputs: Vec<f64> = of_inputs.iter().map(|w| w * scale.spread).collect();
            net.output_bias.push(unscaled(&of_inputs, bias, &self.scaling, &mut net.skip));
        }
        net
    }
}

/// Draws small random weights: sums of about unit size, outputs that begin small.
fn start(shape: Shape, rng: &mut ChaCha8Rng) -> DVector<f64> {
    let hidden = (3.0 / (shape.inputs + 1) as f64).sqrt();
    let output = (1.0 / shape.seen() as f64).sqrt();
    DVector::from_fn(shape.parameters(), |p, _| {
        let size = if p < shape.hidden_parameters() { hidden } else { output };
        size * rng.random_range(-1.0..1.0)
    })
}

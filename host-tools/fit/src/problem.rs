//! A net's training as a problem of about unit size: scaling, starts, balance of the targets, folding.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::levenberg::{self, Decay, State};
use crate::mlp::{Rows, Shape};
use crate::network::{Inputs, Meter, Net};

/// Inputs and targets of one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row<'r> {
    pub x: &'r [f64],
    pub y: &'r [f64],
}

/// Rows brought to about one.
pub(crate) struct Problem {
    shape: Shape,
    rows: Rows,
    inputs: Vec<Scale>,
    targets: Vec<Scale>,
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

impl Problem {
    /// None if a target never changes.
    pub(crate) fn new(shape: Shape, inputs: Inputs, rows: &[Row<'_>]) -> Option<Self> {
        let inputs = input_scales(rows, shape.inputs, inputs);
        let targets: Vec<Scale> =
            (0..shape.outputs).map(|k| scale(rows.iter().map(move |row| row.y[k]))).collect();
        if targets.iter().any(|target| target.spread == 0.0) {
            return None;
        }
        let scaled = |value: f64, scale: &Scale| {
            if scale.spread > 0.0 { (value - scale.mean) / scale.spread } else { 0.0 }
        };
        let rows = Rows {
            x: DMatrix::from_fn(rows.len(), shape.inputs + 1, |row, i| {
                inputs.get(i).map_or(1.0, |scale| scaled(rows[row].x[i], scale))
            }),
            y: DMatrix::from_fn(rows.len(), shape.outputs, |row, k| {
                scaled(rows[row].y[k], &targets[k])
            }),
        };
        Some(Self { shape, rows, inputs, targets })
    }

    /// Small random weights: sums of about unit size, outputs that begin small.
    pub(crate) fn start(&self, rng: &mut ChaCha8Rng) -> State {
        let shape = self.shape;
        let hidden = (3.0 / (shape.inputs + 1) as f64).sqrt();
        let output = (1.0 / (shape.hidden + 1) as f64).sqrt();
        let parameters = DVector::from_fn(shape.parameters(), |p, _| {
            let size = if p < shape.hidden_parameters() { hidden } else { output };
            size * rng.random_range(-1.0..1.0)
        });
        State::new(shape, &self.rows, parameters)
    }

    /// At most so many `steps` more.
    pub(crate) fn train(
        &self,
        state: State,
        decay: Decay,
        steps: usize,
        meter: &mut Meter<'_>,
    ) -> State {
        let (before, until) = (state.steps, state.steps + steps);
        let mut go_on = |state: &State| {
            let error = (state.squares.sum() / self.rows.y.len() as f64).sqrt();
            meter.show(state.steps - before, error)
        };
        let state = levenberg::train(self.shape, &self.rows, state, decay, until, &mut go_on);
        meter.pass(steps);
        state
    }

    /// Lets the net take shape under the decay that the evidence asks for: two thirds of the `steps`
    /// with the targets as they are, the rest with their errors balanced.
    pub(crate) fn explore(
        &mut self,
        state: State,
        per_row: f64,
        steps: usize,
        meter: &mut Meter<'_>,
    ) -> State {
        let evidence = Decay::Evidence { per_row };
        let last = steps / 3;
        let mut state = self.train(state, evidence, steps - last, meter);
        self.balance(&mut state);
        self.train(state, evidence, last, meter)
    }

    /// Scales each target so that what is left of its error is the same for all of them: one noise β
    /// then fits every output, and an output that can be known better (f_z) is held to it.
    fn balance(&mut self, state: &mut State) {
        let shape = self.shape;
        let all = state.squares.mean();
        for (k, target) in self.targets.iter_mut().enumerate() {
            let factor = (all / state.squares[k].max(1e-6 * all)).sqrt();
            let at = shape.hidden_parameters() + k * (shape.hidden + 1);
            state.parameters.rows_mut(at, shape.hidden + 1).scale_mut(factor);
            self.rows.y.column_mut(k).scale_mut(factor);
            target.spread /= factor;
        }
    }

    /// Folds the scaling of inputs and targets into the weights:
    /// w·(x − m)/s + a = (w/s)·x + (a − Σ w·m/s), and y·s + m for the outputs.
    pub(crate) fn net(&self, state: &State, strength: f64) -> Net {
        let shape = self.shape;
        let (hidden, output) = state.parameters.as_slice().split_at(shape.hidden_parameters());
        let mut net = Net {
            hidden: Vec::new(),
            hidden_bias: Vec::new(),
            output: Vec::new(),
            output_bias: Vec::new(),
            steps: state.steps,
            effective: state.effective,
            strength,
            rows: self.rows.x.nrows(),
        };
        for unit in hidden.chunks_exact(shape.inputs + 1) {
            let mut bias = unit[shape.inputs];
            for (weight, scale) in unit.iter().zip(&self.inputs) {
                let weight = if scale.spread > 0.0 { weight / scale.spread } else { 0.0 };
                bias -= weight * scale.mean;
                net.hidden.push(weight as f32);
            }
            net.hidden_bias.push(bias as f32);
        }
        for (weights, scale) in output.chunks_exact(shape.hidden + 1).zip(&self.targets) {
            net.output.extend(weights[..shape.hidden].iter().map(|w| (w * scale.spread) as f32));
            net.output_bias.push((weights[shape.hidden] * scale.spread + scale.mean) as f32);
        }
        net
    }
}

fn input_scales(rows: &[Row<'_>], count: usize, inputs: Inputs) -> Vec<Scale> {
    let mut scales: Vec<Scale> =
        (0..count).map(|i| scale(rows.iter().map(move |row| row.x[i]))).collect();
    if inputs == Inputs::Alike {
        let squares: f64 = scales.iter().map(|scale| scale.spread.powi(2)).sum();
        let common = (squares / count as f64).sqrt();
        scales.iter_mut().filter(|s| s.spread > 0.0).for_each(|s| s.spread = common);
    }
    scales
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_alike_are_scaled_together_and_others_each_by_itself() {
        let row = |x| Row { x, y: &[] };
        let rows = [row(&[1.0, 70.0, 5.0]), row(&[3.0, 84.0, 5.0])];
        let spreads =
            |inputs| input_scales(&rows, 3, inputs).iter().map(|s| s.spread).collect::<Vec<_>>();
        let common = (50.0f64 / 3.0).sqrt();
        assert_eq!(spreads(Inputs::Alike), [common, common, 0.0]);
        assert_eq!(spreads(Inputs::Unlike), [1.0, 7.0, 0.0]);
    }
}

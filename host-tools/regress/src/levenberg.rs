//! Levenberg–Marquardt training ([DeMaria2011]) with a weight decay estimated from the data.
//!
//! Minimised is F(w) = β/2 Σ_rows |y − target|² + ½ Σ_g α_g |w_g|². The noise precision β and the
//! decay α_g of each group of weights are re-estimated during training from the evidence (MacKay
//! 1992; with Levenberg–Marquardt Foresee and Hagan 1997, which is MATLAB's `trainbr`). The data
//! determine γ_g = W_g − α_g·tr_g(A⁻¹) of the W_g weights of a group, with A = β·J^T J + α. Then
//! α_g = γ_g/|w_g|² and β = (n − γ)/Σ e². No rows are held back for validation.

use nalgebra::{Cholesky, DVector, Dyn};

use crate::mlp::{self, Quadratic, Rows, Shape};

/// Accepted steps between two estimates of decay and noise.
const EVIDENCE_EVERY: usize = 5;
/// Relative improvement of F below which a step is no progress.
///
/// So many such steps in a row end the training. With a hundred times this share training ended on
/// plateaus, up to 15 % above the minimum behind them.
const LITTLE: f64 = 1e-7;
const LITTLE_STEPS: usize = 10;
/// Rejected steps in a row after which training ends.
const TRIES: usize = 30;

/// Source of the weight decay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decay {
    /// Estimated from the evidence.
    Evidence {
        /// Independent errors per row.
        ///
        /// The rows of one press repeat each other's error. Counting all rows would overestimate
        /// how certain the data are.
        per_row: f64,
    },
    /// α = this for every parameter, β = 1.
    Fixed(f64),
}

/// State of a training.
#[derive(Clone, Debug)]
pub struct State {
    /// Weights and biases.
    pub parameters: DVector<f64>,
    /// α of each parameter.
    decay: DVector<f64>,
    /// β.
    precision: f64,
    damping: f64,
    /// Accepted steps.
    pub steps: usize,
    /// Σ_rows (y_k − target_k)² of each output.
    pub squares: DVector<f64>,
    /// Number of parameters that the data determine.
    pub effective: f64,
    /// Whether no step improves the objective any more.
    pub converged: bool,
}

impl State {
    /// Starts a training at `parameters`.
    #[must_use]
    pub fn new(shape: Shape, rows: &Rows, parameters: DVector<f64>) -> Self {
        Self {
            decay: DVector::from_element(parameters.len(), 0.01),
            precision: 1.0,
            damping: 1e-2,
            steps: 0,
            squares: mlp::squares(shape, parameters.as_slice(), rows),
            effective: parameters.len() as f64,
            converged: false,
            parameters,
        }
    }

    fn objective(&self, squares: &DVector<f64>, parameters: &DVector<f64>) -> f64 {
        let decay: f64 = parameters.iter().zip(&self.decay).map(|(w, a)| a * w * w).sum();
        0.5 * (self.precision * squares.sum() + decay)
    }
}

/// Trains until `until` steps are done, nothing improves, or `go_on` returns false.
pub fn train(
    shape: Shape,
    rows: &Rows,
    mut state: State,
    decay: Decay,
    until: usize,
    go_on: &mut dyn FnMut(&State) -> bool,
) -> State {
    let groups = groups(shape);
    let mut little = 0;
    state.converged = false;
    while state.steps < until && !state.converged && go_on(&state) {
        let model = mlp::quadratic(shape, state.parameters.as_slice(), rows);
        match decay {
            Decay::Evidence { per_row } => {
                if state.steps > 0 && state.steps.is_multiple_of(EVIDENCE_EVERY) {
                    weigh(&mut state, &model, &groups, rows.y.len() as f64 * per_row);
                }
            }
            Decay::Fixed(alpha) => state.decay.fill(alpha),
        }
        match step(shape, rows, &mut state, &model) {
            Some(share) if share < LITTLE => little += 1,
            Some(_) => little = 0,
            None => state.converged = true,
        }
        state.converged |= little >= LITTLE_STEPS;
    }
    state
}

/// Takes one accepted step and returns its relative improvement of F.
///
/// The damping follows Nielsen's rule. It is eased by how well the quadratic model predicted the
/// gain, and doubles ever faster while steps are rejected.
fn step(shape: Shape, rows: &Rows, state: &mut State, model: &Quadratic) -> Option<f64> {
    let now = state.objective(&model.squares, &state.parameters);
    let gradient = &model.gradient * state.precision + state.decay.component_mul(&state.parameters);
    let mut growth = 2.0;
    for _ in 0..TRIES {
        let mut matrix = &model.curvature * state.precision;
        for (i, alpha) in state.decay.iter().enumerate() {
            matrix[(i, i)] += alpha + state.damping;
        }
        if let Some(factor) = Cholesky::new(matrix) {
            let delta = -factor.solve(&gradient);
            let next = &state.parameters + &delta;
            let squares = mlp::squares(shape, next.as_slice(), rows);
            let gain = now - state.objective(&squares, &next);
            let foretold = 0.5 * (state.damping * delta.norm_squared() - delta.dot(&gradient));
            if gain > 0.0 && foretold > 0.0 {
                let ease = 1.0 - (2.0 * gain / foretold - 1.0).powi(3);
                state.damping = (state.damping * ease.max(1.0 / 3.0)).max(1e-12);
                state.parameters = next;
                state.squares = squares;
                state.steps += 1;
                return Some(gain / now);
            }
        }
        state.damping *= growth;
        growth *= 2.0;
    }
    None
}

/// Groups of parameters that share a decay.
///
/// Groups are the hidden weights, the hidden biases, and each output's weights of units and of the
/// skip path. Output biases have no decay.
fn groups(shape: Shape) -> Vec<Vec<usize>> {
    let (inputs, hidden) = (shape.inputs + 1, shape.hidden);
    let first_output = shape.hidden_parameters();
    let (biases, weights) = (0..first_output).partition(|p| p % inputs == shape.inputs);
    let outputs = (0..shape.outputs).map(|k| first_output + k * shape.seen());
    let of_output =
        |at: usize| [(at..at + hidden).collect(), (at + hidden..at + shape.seen() - 1).collect()];
    let groups = [weights, biases].into_iter().chain(outputs.flat_map(of_output));
    groups.filter(|group: &Vec<usize>| !group.is_empty()).collect()
}

/// Re-estimates decay and noise from the evidence of `n` independent errors.
fn weigh(state: &mut State, model: &Quadratic, groups: &[Vec<usize>], n: f64) {
    let mut matrix = &model.curvature * state.precision;
    for (i, alpha) in state.decay.iter().enumerate() {
        matrix[(i, i)] += alpha;
    }
    let Some(factor) = Cholesky::new(matrix) else { return };
    let variance = inverse_diagonal(&factor);
    state.effective = 0.0;
    for group in groups {
        let norm: f64 = group.iter().map(|i| state.parameters[*i].powi(2)).sum();
        let undetermined: f64 = group.iter().map(|i| variance[*i] * state.decay[*i]).sum();
        let determined = (group.len() as f64 - undetermined).max(1e-3);
        state.effective += determined;
        let alpha = (determined / norm.max(1e-12)).clamp(1e-6, 1e9);
        group.iter().for_each(|i| state.decay[*i] = alpha);
    }
    state.precision = (n - state.effective).max(1.0) / model.squares.sum().max(1e-12 * n);
}

/// Diagonal of A⁻¹: the squared norms of the columns of L⁻¹, with A = L·L^T.
fn inverse_diagonal(factor: &Cholesky<f64, Dyn>) -> DVector<f64> {
    let l = factor.l_dirty();
    let size = l.nrows();
    let mut diagonal = DVector::zeros(size);
    let mut column = DVector::zeros(size);
    for j in 0..size {
        column.fill(0.0);
        column[j] = 1.0;
        for k in j..size {
            column[k] /= l[(k, k)];
            let value: f64 = column[k];
            let mut below = column.rows_range_mut(k + 1..);
            below.axpy(-value, &l.view_range(k + 1.., k), 1.0);
        }
        diagonal[j] = column.rows_range(j..).norm_squared();
    }
    diagonal
}

#[cfg(test)]
mod independent;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    pub(super) const SHAPE: Shape = Shape { inputs: 2, hidden: 3, outputs: 2, skip: false };

    /// Sixty rows of a smooth function that three units cannot follow exactly.
    pub(super) fn rows() -> Rows {
        let x = DMatrix::from_fn(60, 3, |row, column| match column {
            0 => (0.7 * row as f64).sin(),
            1 => (1.3 * row as f64 + 0.4).cos(),
            _ => 1.0,
        });
        let y = DMatrix::from_fn(60, 2, |row, k| {
            let (a, b) = (x[(row, 0)], x[(row, 1)]);
            if k == 0 { (2.0 * a).sin() + 0.5 * a * b } else { (3.0 * b).tanh() - 0.3 * a * a }
        });
        Rows { x, y }
    }

    pub(super) fn start(shape: Shape, seed: usize) -> DVector<f64> {
        DVector::from_fn(shape.parameters(), |p, _| {
            (1.0 + (2.0 + 0.1 * seed as f64) * p as f64).sin()
        })
    }

    /// Minimum found by `scipy.optimize.least_squares(method="lm")`: 0.614 121 42.
    ///
    /// Best of 200 starts on the same residuals with √0.01·w appended.
    #[test]
    fn training_reaches_minimum_of_scipy() {
        let rows = rows();
        let cost = (0..20)
            .map(|seed| {
                let state = State::new(SHAPE, &rows, start(SHAPE, seed));
                let state = train(SHAPE, &rows, state, Decay::Fixed(0.01), 500, &mut |_| true);
                state.objective(&state.squares, &state.parameters)
            })
            .fold(f64::INFINITY, f64::min);
        assert!((cost / 0.614_121_42 - 1.0).abs() < 1e-4, "{cost}");
    }

    #[test]
    fn inverse_diagonal_matches_full_inverse() {
        let rows = rows();
        let model = mlp::quadratic(SHAPE, start(SHAPE, 1).as_slice(), &rows);
        let matrix = model.curvature + nalgebra::DMatrix::identity(17, 17);
        let expected = matrix.clone().try_inverse().unwrap().diagonal();
        let found = inverse_diagonal(&Cholesky::new(matrix).unwrap());
        assert!((found - expected).norm() < 1e-9);
    }

    #[test]
    fn evidence_gives_noise_fewer_parameters_than_a_signal() {
        let signal = rows();
        let mut noise = signal.clone();
        noise.y.iter_mut().enumerate().for_each(|(i, y)| *y = (12.9898 * (i * i) as f64).sin());
        let effective = |rows: &Rows| {
            let state = State::new(SHAPE, rows, start(SHAPE, 3));
            train(SHAPE, rows, state, Decay::Evidence { per_row: 1.0 }, 100, &mut |_| true)
                .effective
        };
        assert!(effective(&noise) < 0.7 * effective(&signal));
    }
}

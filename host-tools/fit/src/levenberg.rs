//! Levenberg–Marquardt training (the method of 002) with a weight decay that the data choose.
//!
//! Minimised is F(w) = ½ Σ_k β_k Σ_rows (y_k − target_k)² + ½ Σ_g α_g |w_g|². The noise precision β_k of
//! each output and the decay α_g of each group of weights are re-estimated on the way from the
//! evidence (MacKay 1992; Foresee and Hagan 1997, the `trainbr` of MATLAB): γ_g, the number of weights
//! of the group that the data determine, is W_g − α_g·tr(A⁻¹)_g with A = J^T β J + α; then
//! α_g = γ_g/|w_g|² and β_k = (n − γ/O)/Σ e_k². Nothing is held back for it.

use nalgebra::{Cholesky, DVector, Dyn};

use crate::mlp::{self, Quadratic, Rows, Shape};

/// How to train.
#[derive(Clone, Copy, Debug)]
pub struct Training {
    /// Most accepted steps.
    pub max_steps: usize,
    /// Steps between two estimates of decay and noise.
    pub evidence_every: usize,
    /// Independent rows per row: rows of one slow movement repeat each other's error.
    pub independent: f64,
    /// Stop once a step improves F by less than this share.
    pub tolerance: f64,
    pub per_output: bool,
}

/// Where training stands.
#[derive(Clone, Debug)]
pub struct State {
    /// Weights.
    pub parameters: DVector<f64>,
    /// α of each parameter.
    pub decay: DVector<f64>,
    /// β of each output.
    pub precision: DVector<f64>,
    /// Accepted steps.
    pub steps: usize,
    /// Σ_rows (y_k − target_k)².
    pub squares: DVector<f64>,
    /// Weights that the data determine.
    pub effective: f64,
}

/// Groups of parameters that share a decay: first parameter and count.
pub fn groups(shape: Shape, ard: bool) -> Vec<Vec<usize>> {
    let (n, h) = (shape.inputs + 1, shape.hidden);
    let first = shape.hidden_parameters();
    let mut groups = Vec::new();
    if ard {
        for i in 0..shape.inputs {
            groups.push((0..h).map(|u| u * n + i).collect());
        }
    } else {
        groups.push((0..h * n).filter(|p| p % n != n - 1).collect());
    }
    groups.push((0..h).map(|u| u * n + n - 1).collect());
    for k in 0..shape.outputs {
        groups.push((first + k * (h + 1)..first + k * (h + 1) + h).collect());
    }
    groups
}

/// Trains from `state` on.
pub fn train(
    shape: Shape,
    rows: &Rows,
    mut state: State,
    groups: &[Vec<usize>],
    training: Training,
    progress: &mut dyn FnMut(&State) -> bool,
) -> State {
    let n = rows.x.nrows() as f64 * training.independent;
    let mut damping = 1e-2;
    let mut growth = 2.0;
    let mut small = 0;
    for step in 0..training.max_steps {
        let beta: Vec<f64> = state.precision.iter().map(|b| b * training.independent).collect();
        let model = mlp::quadratic(shape, state.parameters.as_slice(), rows, &beta);
        state.squares = model.squares.clone();
        if step > 2 && step % training.evidence_every == 0 {
            evidence(&mut state, &model, groups, n, shape.outputs, training);
        }
        let gradient = &model.gradient + state.decay.component_mul(&state.parameters);
        let objective = |squares: &DVector<f64>, w: &DVector<f64>| {
            0.5 * squares.iter().zip(&beta).map(|(s, b)| s * b).sum::<f64>()
                + 0.5 * w.iter().zip(&state.decay).map(|(w, a)| a * w * w).sum::<f64>()
        };
        let now = objective(&model.squares, &state.parameters);
        let mut improved = None;
        for _ in 0..20 {
            let mut a = model.curvature.clone();
            for (i, alpha) in state.decay.iter().enumerate() {
                a[(i, i)] += alpha + damping;
            }
            let Some(factor) = Cholesky::new(a) else {
                damping *= growth;
                growth *= 2.0;
                continue;
            };
            let delta = factor.solve(&(-&gradient));
            let next = &state.parameters + &delta;
            let squares = mlp::squares(shape, next.as_slice(), rows);
            let then = objective(&squares, &next);
            let predicted = 0.5 * (damping * delta.norm_squared() - delta.dot(&gradient));
            let gain = (now - then) / predicted;
            if then < now && gain > 0.0 {
                damping = (damping * (1.0f64 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0)).max(1e-12);
                growth = 2.0;
                improved = Some((next, squares, (now - then) / now));
                break;
            }
            damping *= growth;
            growth *= 2.0;
        }
        let Some((next, squares, share)) = improved else { break };
        state.parameters = next;
        state.squares = squares;
        state.steps += 1;
        if !progress(&state) {
            break;
        }
        small = if share < training.tolerance { small + 1 } else { 0 };
        if small > 2 * training.evidence_every {
            break;
        }
    }
    state
}

fn evidence(state: &mut State, model: &Quadratic, groups: &[Vec<usize>], n: f64, outputs: usize, training: Training) {
    let mut a = model.curvature.clone();
    for (i, alpha) in state.decay.iter().enumerate() {
        a[(i, i)] += alpha;
    }
    let Some(factor) = Cholesky::new(a) else { return };
    let variance = inverse_diagonal(&factor);
    let mut effective = 0.0;
    for group in groups {
        let norm: f64 = group.iter().map(|i| state.parameters[*i].powi(2)).sum();
        let trace: f64 = group.iter().map(|i| variance[*i] * state.decay[*i]).sum();
        let gamma = (group.len() as f64 - trace).max(1e-3);
        effective += gamma;
        let alpha = (gamma / norm).clamp(1e-6, 1e9);
        for i in group {
            state.decay[*i] = alpha;
        }
    }
    state.effective = effective;
    let total = model.rows as f64;
    if training.per_output {
        for (beta, squares) in state.precision.iter_mut().zip(&model.squares) {
            let share = ((n - effective / outputs as f64) / n).max(0.1);
            *beta = share * total / squares.max(1e-12);
        }
    } else {
        let share = ((n - effective / outputs as f64) / n).max(0.1);
        state.precision.fill(share * total * outputs as f64 / model.squares.sum().max(1e-12));
    }
}

/// Diagonal of A⁻¹ from the Cholesky factor: the squared norms of the columns of L⁻¹.
fn inverse_diagonal(factor: &Cholesky<f64, Dyn>) -> DVector<f64> {
    let l = factor.l_dirty();
    let size = l.nrows();
    let mut diagonal = DVector::zeros(size);
    let mut column = DVector::zeros(size);
    for j in 0..size {
        column.fill(0.0);
        column[j] = 1.0;
        for k in j..size {
            let value: f64 = column[k] / l[(k, k)];
            column[k] = value;
            if value != 0.0 {
                for i in k + 1..size {
                    column[i] -= l[(i, k)] * value;
                }
            }
        }
        diagonal[j] = column.rows(j, size - j).norm_squared();
    }
    diagonal
}


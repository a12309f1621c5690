//! Net with one hidden layer of tanh units and linear outputs ([DeMaria2011]), in f64, for
//! training.
//!
//! A linear skip path is optional. The module gives values and the Gauss–Newton matrix of the
//! squared error, at the cost of a single Gram matrix.
//!
//! Unit h of a row x̃ = (x, 1) is t_h = tanh(w_h·x̃). Output k is y_k = v_k·z with z = (t, x̃), or
//! (t, 1) without the skip path. With g_h = 1 − t_h² the derivatives are ∂y_k/∂w_h = v_kh·g_h·x̃
//! and ∂y_k/∂v_k = z. The factors that differ between outputs do not depend on the row. J^T J for
//! any number of outputs therefore follows from the Gram matrix of the features φ = (g_1·x̃, …,
//! g_H·x̃, z). It takes one product instead of one an output.

use nalgebra::{DMatrix, DMatrixView, DVector};

/// Rows with features in memory at once.
const CHUNK: usize = 512;

/// Sizes of a net: inputs, hidden units, outputs, and whether it has a skip path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of inputs N.
    pub inputs: usize,
    /// Number of hidden units H.
    pub hidden: usize,
    /// Number of outputs O.
    pub outputs: usize,
    /// Whether the outputs also see the inputs.
    pub skip: bool,
}

impl Shape {
    /// Number of weights and biases of all units and outputs.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.hidden_parameters() + self.outputs * self.seen()
    }

    /// Number of inputs of an output: units, inputs if there is a skip path, one.
    #[must_use]
    pub fn seen(&self) -> usize {
        self.hidden + if self.skip { self.inputs } else { 0 } + 1
    }

    /// Number of parameters of the hidden layer.
    ///
    /// They come first, one unit after another, each with its bias last. The outputs follow in the
    /// same layout.
    #[must_use]
    pub fn hidden_parameters(&self) -> usize {
        self.hidden * (self.inputs + 1)
    }
}

/// Rows to fit: inputs and targets, a row a moment.
#[derive(Clone, Debug)]
pub struct Rows {
    /// Inputs with a last column of ones.
    pub x: DMatrix<f64>,
    /// Targets, a column an output.
    pub y: DMatrix<f64>,
}

/// Quadratic model of ½ Σ_rows |y − target|² around some parameters.
#[derive(Clone, Debug)]
pub struct Quadratic {
    /// Σ_rows (y_k − target_k)² of each output k.
    pub squares: DVector<f64>,
    /// Gradient J^T e.
    pub gradient: DVector<f64>,
    /// Gauss–Newton matrix J^T J.
    pub curvature: DMatrix<f64>,
}

/// W of the hidden layer, inputs + 1 × hidden: unit h is column h.
fn hidden_weights(shape: Shape, parameters: &[f64]) -> DMatrixView<'_, f64> {
    let weights = &parameters[..shape.hidden_parameters()];
    DMatrixView::from_slice(weights, shape.inputs + 1, shape.hidden)
}

/// V, skip path and b of the outputs, seen × outputs: output k is column k.
fn output_weights(shape: Shape, parameters: &[f64]) -> DMatrixView<'_, f64> {
    let weights = &parameters[shape.hidden_parameters()..];
    DMatrixView::from_slice(weights, shape.seen(), shape.outputs)
}

/// Outputs for every row of `x`, whose last column is ones.
#[must_use]
pub fn outputs(shape: Shape, parameters: &[f64], x: DMatrixView<'_, f64>) -> DMatrix<f64> {
    seen(shape, parameters, x) * output_weights(shape, parameters)
}

/// z of every row: hidden activations, inputs if there is a skip path, ones.
fn seen(shape: Shape, parameters: &[f64], x: DMatrixView<'_, f64>) -> DMatrix<f64> {
    let mut seen = DMatrix::from_element(x.nrows(), shape.seen(), 1.0);
    let mut tanhs = seen.columns_mut(0, shape.hidden);
    tanhs.gemm(1.0, &x, &hidden_weights(shape, parameters), 0.0);
    tanhs.apply(|sum| *sum = sum.tanh());
    if shape.skip {
        seen.columns_mut(shape.hidden, shape.inputs).copy_from(&x.columns(0, shape.inputs));
    }
    seen
}

/// Σ_rows (y_k − target_k)² of each output.
#[must_use]
pub fn squares(shape: Shape, parameters: &[f64], rows: &Rows) -> DVector<f64> {
    let mut error = outputs(shape, parameters, rows.x.as_view());
    error -= &rows.y;
    DVector::from_iterator(shape.outputs, error.column_iter().map(|e| e.norm_squared()))
}

/// Computes the quadratic model around `parameters`.
#[must_use]
pub fn quadratic(shape: Shape, parameters: &[f64], rows: &Rows) -> Quadratic {
    let (inputs, hidden, seen_count) = (shape.inputs + 1, shape.hidden, shape.seen());
    let features = shape.hidden_parameters() + seen_count;
    let v = output_weights(shape, parameters);
    let unit_weights = v.rows(0, hidden);

    let mut squares = DVector::zeros(shape.outputs);
    let mut gradient = DVector::zeros(shape.parameters());
    let mut gram = DMatrix::zeros(features, features);
    for start in (0..rows.x.nrows()).step_by(CHUNK) {
        let count = CHUNK.min(rows.x.nrows() - start);
        let x = rows.x.rows(start, count);
        let t = seen(shape, parameters, x.as_view());
        let mut error = &t * v;
        error -= rows.y.rows(start, count);

        let mut phi = DMatrix::zeros(count, features);
        // dE/d(w_h·x̃) of each row and unit.
        let mut slope = &error * unit_weights.transpose();
        for h in 0..hidden {
            let g = t.column(h).map(|t| 1.0 - t * t);
            slope.column_mut(h).component_mul_assign(&g);
            for i in 0..inputs {
                let mut column = phi.column_mut(h * inputs + i);
                column.copy_from(&x.column(i));
                column.component_mul_assign(&g);
            }
        }
        phi.columns_mut(shape.hidden_parameters(), seen_count).copy_from(&t);
        accumulate_gram(&mut gram, &phi);

        let to_w = x.transpose() * &slope;
        let mut head = gradient.rows_mut(0, shape.hidden_parameters());
        head += DVector::from_column_slice(to_w.as_slice());
        for k in 0..shape.outputs {
            let e = error.column(k);
            squares[k] += e.norm_squared();
            let at = shape.hidden_parameters() + k * seen_count;
            let mut tail = gradient.rows_mut(at, seen_count);
            tail.gemv_tr(1.0, &t, &e, 1.0);
        }
    }
    let curvature = curvature(shape, &gram, unit_weights.as_view());
    Quadratic { squares, gradient, curvature }
}

/// Adds φ^T φ: only the blocks on and above the diagonal are computed.
fn accumulate_gram(gram: &mut DMatrix<f64>, phi: &DMatrix<f64>) {
    const BLOCKS: usize = 4;
    let transposed = phi.transpose();
    let features = gram.nrows();
    let edge = |block: usize| block * features / BLOCKS;
    for column in 0..BLOCKS {
        let (from, to) = (edge(column), edge(column + 1));
        gram.view_mut((0, from), (to, to - from)).gemm(
            1.0,
            &transposed.rows(0, to),
            &phi.columns(from, to - from),
            1.0,
        );
    }
}

/// J^T J from the upper blocks of the features' Gram matrix; `v` are the weights of units alone.
fn curvature(shape: Shape, gram: &DMatrix<f64>, v: DMatrixView<'_, f64>) -> DMatrix<f64> {
    let (inputs, seen) = (shape.inputs + 1, shape.seen());
    let first_output = shape.hidden_parameters();
    let between = v * v.transpose();
    let mut curvature = DMatrix::zeros(shape.parameters(), shape.parameters());
    for column in 0..first_output {
        for row in 0..=column {
            curvature[(row, column)] =
                between[(row / inputs, column / inputs)] * gram[(row, column)];
        }
    }
    for k in 0..shape.outputs {
        let at = first_output + k * seen;
        for j in 0..seen {
            for row in 0..first_output {
                curvature[(row, at + j)] = v[(row / inputs, k)] * gram[(row, first_output + j)];
            }
            for i in 0..=j {
                curvature[(at + i, at + j)] = gram[(first_output + i, first_output + j)];
            }
        }
    }
    curvature.fill_lower_triangle_with_upper_triangle();
    curvature
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Derivative of every output of every row by every parameter, by central differences.
    fn jacobian(shape: Shape, parameters: &[f64], rows: &Rows) -> DMatrix<f64> {
        let step = 1e-6;
        let moved = |p: usize, by: f64| {
            let mut parameters = parameters.to_vec();
            parameters[p] += by;
            outputs(shape, &parameters, rows.x.as_view())
        };
        let columns: Vec<DVector<f64>> = (0..shape.parameters())
            .map(|p| (moved(p, step) - moved(p, -step)) / (2.0 * step))
            .map(|d| DVector::from_column_slice(d.as_slice()))
            .collect();
        DMatrix::from_columns(&columns)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn gradient_and_curvature_match_finite_differences(
            inputs in 1usize..5,
            hidden in 0usize..6,
            outputs in 1usize..4,
            skip in proptest::bool::ANY,
            seed in 0.0..100.0f64,
        ) {
            let shape = Shape { inputs, hidden, outputs, skip };
            let value = |i: usize| (seed + 12.9898 * (i * i) as f64).sin();
            let rows = Rows {
                x: DMatrix::from_fn(700, inputs + 1, |r, c| if c == inputs { 1.0 } else { value(r * 7 + c) }),
                y: DMatrix::from_fn(700, outputs, |r, c| value(r * 3 + c + 1)),
            };
            let parameters: Vec<f64> = (0..shape.parameters()).map(|p| value(p + 5)).collect();
            let j = jacobian(shape, &parameters, &rows);
            let error = super::outputs(shape, &parameters, rows.x.as_view()) - &rows.y;
            let error = DVector::from_column_slice(error.as_slice());
            let model = quadratic(shape, &parameters, &rows);
            prop_assert!((model.squares.sum() - error.norm_squared()).abs() < 1e-9 * error.norm_squared());
            prop_assert!((model.gradient - j.transpose() * &error).norm() < 1e-4 * j.norm() );
            let expected = j.transpose() * &j;
            prop_assert!((model.curvature - &expected).norm() < 1e-6 * expected.norm());
        }
    }
}

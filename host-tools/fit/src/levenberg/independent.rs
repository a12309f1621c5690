//! Against somebody else's Levenberg–Marquardt (MINPACK's, the crate `levenberg-marquardt`), with residuals
//! and Jacobian written out row by row.

use std::time::{Duration, Instant};

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra_of_minpack::{DMatrix, DVector, Dyn, Owned};

use super::{Decay, State, train};
use crate::mlp::{Rows, Shape};

const DECAY: f64 = 0.01;

/// Residuals y − target of every row and output, then √α·w of every parameter.
struct Problem<'r> {
    shape: Shape,
    rows: &'r Rows,
    parameters: DVector<f64>,
}

impl Problem<'_> {
    fn units(&self, row: usize) -> Vec<f64> {
        let inputs = self.shape.inputs + 1;
        let of = |unit: usize| -> f64 {
            (0..inputs).map(|i| self.parameters[unit * inputs + i] * self.rows.x[(row, i)]).sum()
        };
        (0..self.shape.hidden).map(|unit| of(unit).tanh()).collect()
    }

    /// Where output k's weights begin.
    fn output(&self, k: usize) -> usize {
        self.shape.hidden * (self.shape.inputs + 1) + k * (self.shape.hidden + 1)
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, parameters: &DVector<f64>) {
        self.parameters.copy_from(parameters);
    }

    fn params(&self) -> DVector<f64> {
        self.parameters.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let mut residuals = Vec::new();
        for row in 0..self.rows.x.nrows() {
            let units = self.units(row);
            for k in 0..self.shape.outputs {
                let at = self.output(k);
                let sum: f64 = (0..units.len()).map(|h| self.parameters[at + h] * units[h]).sum();
                let y = sum + self.parameters[at + units.len()];
                residuals.push(y - self.rows.y[(row, k)]);
            }
        }
        residuals.extend(self.parameters.iter().map(|w| DECAY.sqrt() * w));
        Some(DVector::from_vec(residuals))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let (outputs, inputs) = (self.shape.outputs, self.shape.inputs + 1);
        let errors = self.rows.x.nrows() * outputs;
        let weights = self.parameters.len();
        let mut jacobian = DMatrix::zeros(errors + weights, weights);
        for row in 0..self.rows.x.nrows() {
            let units = self.units(row);
            for k in 0..outputs {
                let (e, at) = (row * outputs + k, self.output(k));
                for (h, t) in units.iter().enumerate() {
                    jacobian[(e, at + h)] = *t;
                    let slope = self.parameters[at + h] * (1.0 - t * t);
                    for i in 0..inputs {
                        jacobian[(e, h * inputs + i)] = slope * self.rows.x[(row, i)];
                    }
                }
                jacobian[(e, at + units.len())] = 1.0;
            }
        }
        (0..weights).for_each(|w| jacobian[(errors + w, w)] = DECAY.sqrt());
        Some(jacobian)
    }
}

/// ½ Σ e² + ½ α Σ w² at the minimum that each finds from the same start, and the time each took.
fn race(shape: Shape, rows: &Rows, seed: usize, steps: usize) -> [(f64, Duration); 2] {
    let start = super::tests::start(shape, seed);
    let begin = Instant::now();
    let state = State::new(shape, rows, start.clone());
    let own = train(shape, rows, state, Decay::Fixed(DECAY), steps, &mut |_| true);
    let own = (own.objective(&own.squares, &own.parameters), begin.elapsed());
    let begin = Instant::now();
    let parameters = DVector::from_column_slice(start.as_slice());
    let (_, report) = LevenbergMarquardt::new().minimize(Problem { shape, rows, parameters });
    [own, (report.objective_function, begin.elapsed())]
}

/// The decay makes outputs of one size have one best answer that both come to from most starts.
#[test]
fn minpack_finds_the_same_minimum() {
    let rows = super::tests::rows();
    let shape = super::tests::SHAPE;
    let found: Vec<[(f64, Duration); 2]> =
        (0..8).map(|seed| race(shape, &rows, seed, 500)).collect();
    let best = |which: usize| found.iter().map(|f| f[which].0).fold(f64::INFINITY, f64::min);
    assert!((best(0) / best(1) - 1.0).abs() < 0.01, "{found:?}");
    let time = |which: usize| found.iter().map(|f| f[which].1).sum::<Duration>();
    println!("own {:?}, MINPACK {:?}", time(0), time(1));
}

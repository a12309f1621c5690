//! Against somebody else's Levenberg–Marquardt (MINPACK's, the crate `levenberg-marquardt`), with residuals
//! and Jacobian written out row by row.

use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra_of_minpack::{DMatrix, DVector, Dyn, Owned};

use super::{Decay, State, train};
use crate::mlp::{Rows, Shape};
use crate::scaling::{Inputs, Scaling};

type Parameters = nalgebra::DVector<f64>;

const DECAY: f64 = 0.01;
/// Share by which MINPACK still wants the objective or the parameters to change: SciPy's own.
const TOLERANCE: f64 = 1e-8;
/// Steps that the own training is given: more than it takes.
const STEPS: usize = 2000;

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

/// Where one start led: ½ Σ e² + ½ α Σ w² at the minimum, and the time that it took.
type Found = (f64, Duration);

/// The own training, MINPACK from the same start, and MINPACK from where the own training ended.
fn race(shape: Shape, rows: &Rows, start: &Parameters) -> [Found; 3] {
    let begin = Instant::now();
    let state = State::new(shape, rows, start.clone());
    let own = train(shape, rows, state, Decay::Fixed(DECAY), STEPS, &mut |_| true);
    let found = (own.objective(&own.squares, &own.parameters), begin.elapsed());
    let minpack = |from: &Parameters| {
        let begin = Instant::now();
        let parameters = DVector::from_column_slice(from.as_slice());
        let problem = Problem { shape, rows, parameters };
        let (_, report) = LevenbergMarquardt::new().with_tol(TOLERANCE).minimize(problem);
        (report.objective_function, begin.elapsed())
    };
    [found, minpack(start), minpack(&own.parameters)]
}

/// The best of all starts is that of MINPACK within 1 %, and from where the own training ended MINPACK finds nothing
/// that is 1 % better. From one start the two may well go to different minima.
fn same_minimum(shape: Shape, rows: &Rows, starts: &[Parameters]) {
    let found: Vec<[Found; 3]> = starts.iter().map(|start| race(shape, rows, start)).collect();
    let [own, minpack] =
        [0, 1].map(|which| found.iter().map(|f| f[which].0).fold(f64::INFINITY, f64::min));
    let time = |which: usize| found.iter().map(|f| f[which].1).sum::<Duration>();
    let Shape { inputs, hidden, outputs, .. } = shape;
    println!(
        "{inputs}-{hidden}-{outputs}: own {own:.5} in {:.0?}, MINPACK {minpack:.5} in {:.0?}",
        time(0),
        time(1)
    );
    assert!((own / minpack - 1.0).abs() < 0.01, "{found:?}");
    for [(own, _), _, (further, _)] in &found {
        assert!(own / further - 1.0 < 0.01, "MINPACK goes on from {own} to {further}");
    }
}

#[test]
fn minpack_finds_the_same_minimum_of_a_small_net() {
    let starts: Vec<Parameters> =
        (0..8).map(|seed| super::tests::start(super::tests::SHAPE, seed)).collect();
    same_minimum(super::tests::SHAPE, &super::tests::rows(), &starts);
}

#[test]
fn minpack_finds_the_same_minimum_of_nets_of_a_fingers_size() {
    for hidden in [4, 8] {
        let shape = Shape { inputs: 16, hidden, outputs: 1, skip: false };
        let starts: Vec<Parameters> = (0..8)
            .map(|seed| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                Parameters::from_fn(shape.parameters(), |p, _| {
                    let hidden = p < shape.hidden_parameters();
                    let seen = if hidden { 17.0 / 3.0 } else { shape.seen() as f64 };
                    rng.random_range(-1.0..1.0) / seen.sqrt()
                })
            })
            .collect();
        same_minimum(shape, &touches(300), &starts);
    }
}

/// Normal forces on a made-up matrix of taxels: a contact that wanders, presses and is sheared, seen by sixteen of them.
fn touches(count: usize) -> Rows {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut row = || {
        let [x, y] = [0; 2].map(|_| rng.random_range(-3.0..3.0));
        let fz: f64 = rng.random_range(0.1..2.0);
        let [fx, fy] = [0; 2].map(|_| fz * rng.random_range(-0.4..0.4));
        let signals = (0..16).map(|k| {
            let [dx, dy] =
                [(k % 4, x), (k / 4, y)].map(|(at, c)| (2.0 * f64::from(at) - 3.0 - c) / 2.5);
            let sinks = (-0.5 * (dx * dx + dy * dy)).exp() * (fz + 0.8 * (fx * dx + fy * dy));
            sinks - 0.15 * sinks * sinks + rng.random_range(-0.005..0.005)
        });
        (signals.collect(), vec![fz])
    };
    let (x, y): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (0..count).map(|_| row()).unzip();
    let scaling = Scaling::of(&x, &y, Inputs::Alike);
    Rows { x: scaling.inputs(&x).insert_column(16, 1.0), y: scaling.targets(&y) }
}

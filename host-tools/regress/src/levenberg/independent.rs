//! Comparison with MINPACK's Levenberg–Marquardt on the same problems, from the same eight starts.
//!
//! Residuals are y − target of every row and output, then √α·w of every parameter.

use nalgebra::{Cholesky, DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Decay, State, tests, train};
use crate::mlp::{self, Rows, Shape};
use crate::scaling::{Inputs, Scaling};

const DECAY: f64 = 0.01;
/// Step limit of our training: more than it needs.
const STEPS: usize = 2000;

/// ½ Σ e² + ½ α Σ w² at the best minimum of `lmder` from the eight starts, tolerance 1e-8.
///
/// Computed with the crate `levenberg-marquardt` 0.15, for the small net and for nets of four and
/// eight units on [`touches`].
const MINPACK: [f64; 3] = [0.614_121_418, 0.101_732_577, 0.084_136_856];

/// Asserts that the best of all starts is within 1 % of MINPACK's minimum.
///
/// A further Gauss–Newton step from each end must gain less than 1 %. From a single start the two
/// may well reach different minima.
fn same_minimum(shape: Shape, rows: &Rows, starts: &[DVector<f64>], minpack: f64) {
    let mut best = f64::INFINITY;
    for start in starts {
        let state = State::new(shape, rows, start.clone());
        let end = train(shape, rows, state, Decay::Fixed(DECAY), STEPS, &mut |_| true);
        let found = end.objective(&end.squares, &end.parameters);
        best = best.min(found);
        let model = mlp::quadratic(shape, end.parameters.as_slice(), rows);
        let gradient = model.gradient + DECAY * &end.parameters;
        let count = gradient.len();
        let curvature = model.curvature + DECAY * DMatrix::identity(count, count);
        let gain = 0.5 * gradient.dot(&Cholesky::new(curvature).unwrap().solve(&gradient));
        assert!(gain < 0.01 * found, "{gain} is left to gain of {found}");
    }
    println!("{shape:?}: own {best:.9}, MINPACK {minpack}");
    assert!((best / minpack - 1.0).abs() < 0.01, "{best} where MINPACK finds {minpack}");
}

#[test]
fn small_net_reaches_the_minimum_of_minpack() {
    let starts: Vec<DVector<f64>> = (0..8).map(|seed| tests::start(tests::SHAPE, seed)).collect();
    same_minimum(tests::SHAPE, &tests::rows(), &starts, MINPACK[0]);
}

#[test]
fn finger_nets_reach_the_minimum_of_minpack() {
    for (hidden, minpack) in [(4, MINPACK[1]), (8, MINPACK[2])] {
        let shape = Shape { inputs: 16, hidden, outputs: 1, skip: false };
        let starts: Vec<DVector<f64>> = (0..8)
            .map(|seed| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                DVector::from_fn(shape.parameters(), |p, _| {
                    let hidden = p < shape.hidden_parameters();
                    let seen = if hidden { 17.0 / 3.0 } else { shape.seen() as f64 };
                    rng.random_range(-1.0..1.0) / seen.sqrt()
                })
            })
            .collect();
        same_minimum(shape, &touches(300), &starts, minpack);
    }
}

/// Normal forces on a made-up matrix of sixteen taxels under a moving, pressing and sheared
/// contact.
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

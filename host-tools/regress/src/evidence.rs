//! Linear map without an offset: robust weighted least squares, its decay from the evidence.
//!
//! The weights w of one target have the prior N(0, 1/α) and the rows the noise 1/β; both come from
//! the evidence (MacKay 1992), where correlated errors count once. Directions that the inputs do
//! not show keep no weight. Rows far from the line count less (Huber 1964).

use nalgebra::{Cholesky, DMatrix, DVector, SymmetricEigen};

use crate::correlation::independent_share;
use crate::folds::stretches;
use crate::quantile::median;
use crate::training::Recorded;

/// Rounds of weighting: the scale of the residuals and the rows' weights settle together.
const ROUNDS: usize = 5;
/// Most steps of α and β, and their relative change below which they stand.
const STEPS: usize = 100;
const LITTLE: f64 = 1e-6;
/// Residual, in standard deviations, from which a row counts less.
const HUBER: f64 = 2.5;
/// Least decay and least noise relative to the scaled rows: exact data leave neither.
const FLOOR: f64 = 1e-12;

/// A fitted map and its error.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Weights, outputs × inputs.
    pub weights: DMatrix<f64>,
    /// RMS error of each output on stretches left out of the fit.
    pub held_out: Vec<f64>,
    /// Number of weights that the data determine, over all outputs.
    pub effective: f64,
}

/// X^T X, X^T y and the stretch's rows.
struct Sums {
    gram: DMatrix<f64>,
    cross: DVector<f64>,
    squares: f64,
    rows: f64,
}

/// Fits the map to the rows of some recordings, in the order of time.
///
/// `None` if there are fewer than four rows for each input.
#[must_use]
pub fn fit(recordings: &[Recorded]) -> Option<Line> {
    let x: Vec<&[f64]> = recordings.iter().flat_map(|r| &r.0).map(Vec::as_slice).collect();
    let y: Vec<&[f64]> = recordings.iter().flat_map(|r| &r.1).map(Vec::as_slice).collect();
    let (inputs, outputs) = (x.first()?.len(), y.first()?.len());
    if x.len() < 4 * inputs {
        return None;
    }
    let targets: Vec<&[Vec<f64>]> = recordings.iter().map(|r| r.1.as_slice()).collect();
    let (_, stretch) = stretches(&targets);
    let scale: Vec<f64> = (0..inputs)
        .map(|j| (x.iter().map(|row| row[j] * row[j]).sum::<f64>() / x.len() as f64).sqrt())
        .collect();
    let scaled =
        DMatrix::from_fn(
            x.len(),
            inputs,
            |i, j| {
                if scale[j] > 0.0 { x[i][j] / scale[j] } else { 0.0 }
            },
        );
    let mut line =
        Line { weights: DMatrix::zeros(outputs, inputs), held_out: Vec::new(), effective: 0.0 };
    for (k, mut weights) in line.weights.row_iter_mut().enumerate() {
        let target = DVector::from_fn(x.len(), |i, _| y[i][k]);
        let fit = one(&scaled, &target, &stretch)?;
        for ((weight, fitted), scale) in weights.iter_mut().zip(&fit.weights).zip(&scale) {
            *weight = if *scale > 0.0 { fitted / scale } else { 0.0 };
        }
        line.held_out.push(fit.held_out);
        line.effective += fit.effective;
    }
    Some(line)
}

struct One {
    weights: DVector<f64>,
    held_out: f64,
    effective: f64,
}

fn one(x: &DMatrix<f64>, y: &DVector<f64>, stretch: &[usize]) -> Option<One> {
    let mut weights = DVector::from_element(x.nrows(), 1.0);
    let (mut solved, mut share) = (None, 1.0);
    for _ in 0..ROUNDS {
        let all = sums(x, y, &weights, |_| true);
        let (found, ratio, effective) = evidence(&all, share);
        let residual = x * &found - y;
        share =
            independent_share(&DMatrix::from_column_slice(residual.len(), 1, residual.as_slice()));
        let sigma = 1.4826 * median(residual.iter().map(|r| r.abs()).collect());
        weights = residual.map(|r| (HUBER * sigma / r.abs().max(f64::MIN_POSITIVE)).min(1.0));
        solved = Some((found, ratio, effective));
    }
    let (found, ratio, effective) = solved?;
    let all = sums(x, y, &weights, |_| true);
    let (mut squares, count) = (0.0, x.nrows() as f64);
    for part in 0..=stretch.iter().copied().max()? {
        let own = sums(x, y, &weights, |i| stretch[i] == part);
        let mut gram = &all.gram - &own.gram;
        (0..gram.nrows()).for_each(|j| gram[(j, j)] += ratio);
        let others = Cholesky::new(gram)?.solve(&(&all.cross - &own.cross));
        let rows = (0..x.nrows()).filter(|i| stretch[*i] == part);
        squares += rows.map(|i| (x.row(i).transpose().dot(&others) - y[i]).powi(2)).sum::<f64>();
    }
    Some(One { weights: found, held_out: (squares / count).sqrt(), effective })
}

fn sums(
    x: &DMatrix<f64>,
    y: &DVector<f64>,
    weights: &DVector<f64>,
    of: impl Fn(usize) -> bool,
) -> Sums {
    let inputs = x.ncols();
    let mut sums = Sums {
        gram: DMatrix::zeros(inputs, inputs),
        cross: DVector::zeros(inputs),
        squares: 0.0,
        rows: 0.0,
    };
    for i in (0..x.nrows()).filter(|i| of(*i)) {
        let row = x.row(i).transpose();
        sums.gram.ger(weights[i], &row, &row, 1.0);
        sums.cross.axpy(weights[i] * y[i], &row, 1.0);
        sums.squares += weights[i] * y[i] * y[i];
        sums.rows += weights[i];
    }
    sums
}

/// Weights, the ratio α/β and the number of determined weights; a `share` of the rows is
/// independent.
fn evidence(all: &Sums, share: f64) -> (DVector<f64>, f64, f64) {
    let eigen = SymmetricEigen::new(all.gram.clone());
    let along = eigen.eigenvectors.tr_mul(&all.cross);
    let (mut alpha, mut beta) = (1.0, 1.0 / (all.squares / all.rows).max(f64::MIN_POSITIVE));
    let (mut weights, mut effective) = (along.clone(), 0.0);
    for _ in 0..STEPS {
        effective = 0.0;
        let mut left = all.squares;
        for (i, (power, cross)) in eigen.eigenvalues.iter().zip(along.iter()).enumerate() {
            let (power, cross) = (share * power.max(0.0), share * cross);
            weights[i] = beta * cross / (beta * power + alpha);
            effective += beta * power / (beta * power + alpha);
            left += (weights[i] * power / share - 2.0 * along[i]) * weights[i];
        }
        let left = left.max(FLOOR * all.squares);
        let free = (share * all.rows - effective).max(1.0);
        let before = [alpha, beta];
        beta = free / (share * left).max(f64::MIN_POSITIVE);
        alpha = (effective / weights.norm_squared().max(f64::MIN_POSITIVE)).max(FLOOR * beta);
        let moved = |now: f64, before: f64| (now / before - 1.0).abs() > LITTLE;
        if !moved(alpha, before[0]) && !moved(beta, before[1]) {
            break;
        }
    }
    (&eigen.eigenvectors * weights, alpha / (beta * share), effective)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const W: [[f64; 3]; 2] = [[2.0, -1.0, 0.5], [0.3, 4.0, -2.0]];

    /// Presses with noisy references; the fourth input shows noise only.
    fn recording(noise: f64, wild: usize) -> Recorded {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for i in 0..2000 {
            let t = f64::from(i) * 0.05;
            let load = t.sin().abs();
            let mut row = vec![load, load * (0.7 * t).cos(), load * (1.3 * t).sin()];
            let mut of = |w: [f64; 3]| {
                let sum: f64 = row.iter().zip(w).map(|(x, w)| x * w).sum();
                let wrong = wild > 0 && (i as usize).is_multiple_of(wild);
                let error = noise * 3f64.sqrt() * rng.random_range(-1.0..1.0);
                sum + error + if wrong { 5.0 } else { 0.0 }
            };
            let targets = W.map(&mut of).to_vec();
            row.push(1e-6 * rng.random_range(-1.0..1.0));
            x.push(row);
            y.push(targets);
        }
        (x, y)
    }

    fn farthest(line: &Line) -> f64 {
        let each = W.iter().enumerate().flat_map(|(k, row)| {
            row.iter().enumerate().map(move |(j, w)| (line.weights[(k, j)] - w).abs())
        });
        each.fold(0.0, f64::max)
    }

    #[test]
    fn map_is_found_and_noise_is_its_held_out_error() {
        let line = fit(&[recording(0.05, 0)]).unwrap();
        assert!(farthest(&line) < 0.01, "{}", line.weights);
        assert!(line.held_out.iter().all(|e| (0.045..0.055).contains(e)), "{line:?}");
        // The noise channel's weight, times its size, is nothing.
        assert!((0..2).all(|k| (1e-6 * line.weights[(k, 3)]).abs() < 0.01), "{}", line.weights);
        assert!((5.0..8.1).contains(&line.effective), "{line:?}");
        assert!(farthest(&fit(&[recording(0.0, 0)]).unwrap()) < 1e-6);
    }

    #[test]
    fn wild_rows_hardly_move_the_map() {
        let line = fit(&[recording(0.05, 20)]).unwrap();
        assert!(farthest(&line) < 0.05, "{}", line.weights);
    }

    #[test]
    fn few_rows_determine_nothing() {
        let (x, y) = recording(0.0, 0);
        assert_eq!(fit(&[(x[..15].to_vec(), y[..15].to_vec())]), None);
        assert_eq!(fit(&[]), None);
    }
}

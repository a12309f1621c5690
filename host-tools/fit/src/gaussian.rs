//! Gaussian-process regression: a straight line everywhere, bent near what was recorded.
//!
//! The covariance of two rows is k(x, x') = ρ·[c·(x·x' + 1) + (1 + |x − x'|²/ℓ²)^(−½)] in units of the
//! noise: a linear model that is all but free, and a rational quadratic (Rasmussen & Williams 2006,
//! eq. (4.19), α = ½) that bends it where there are rows to bend it to. Far from every row the bend fades
//! and the straight line is left: that is how it meets a state of the sensor that no recording showed.
//!
//! Reach ℓ and size ρ of the bend are chosen by leaving stretches out: with K⁻¹ at hand what the other
//! rows say of a stretch B follows without another fit, e_B = ((K⁻¹)_BB)⁻¹·(K⁻¹y)_B (the block form of
//! eq. (5.12)). Of the priors within a standard error of the best the smoothest is taken (Breiman et al.
//! 1984, §3.4.3): recordings of another day differ more than stretches of one, and what bends less errs
//! less there.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::error::FitError;

/// Rows on which the choice is made; its price grows with their cube.
pub(crate) const CHOICE_ROWS: usize = 600;
/// Rows that the predictions rest on.
pub(crate) const ROWS: usize = 1500;
/// How free the straight line is beside the bend: rows are scaled to about one, so that slopes of ten
/// spreads a spread are still ordinary.
const LINE: f64 = 100.0;
/// Reaches ℓ that are tried, in spreads of the inputs: from a gentle bend of the whole to neighbours.
const REACHES: [f64; 9] = [25.6, 12.8, 6.4, 3.2, 1.6, 0.8, 0.4, 0.2, 0.1];
/// Sizes ρ that are tried; at 1e7 the noise is all but nothing beside the bend.
const SIZES: [f64; 4] = [1e1, 1e3, 1e5, 1e7];
/// A prediction is made for so many rows at once.
const CHUNK: usize = 256;

/// Scaled rows: inputs, targets, and the stretch that each belongs to (0, 1, …).
pub(crate) struct Rows {
    pub x: DMatrix<f64>,
    pub y: DMatrix<f64>,
    pub stretch: Vec<usize>,
}

impl Rows {
    /// Inputs and targets of each stretch.
    pub fn by_stretch(&self) -> Vec<(DMatrix<f64>, DMatrix<f64>)> {
        let stretches = self.stretch.iter().max().map_or(0, |last| last + 1);
        (0..stretches)
            .map(|stretch| self.of(stretch))
            .map(|own| (self.x.select_rows(&own), self.y.select_rows(&own)))
            .collect()
    }

    fn of(&self, stretch: usize) -> Vec<usize> {
        (0..self.stretch.len()).filter(|row| self.stretch[*row] == stretch).collect()
    }
}

/// How well a model foretells the stretches left out: ln of the mean square error, stretch × output.
#[derive(Clone, Debug)]
pub(crate) struct Scores(pub DMatrix<f64>);

impl Scores {
    /// From the errors of each stretch.
    pub fn of(errors: &[DMatrix<f64>]) -> Self {
        let outputs = errors.first().map_or(0, |errors| errors.ncols());
        Self(DMatrix::from_fn(errors.len(), outputs, |stretch, k| {
            let errors = errors[stretch].column(k);
            // An error of a ten-thousandth of the spread is none: no reference is better.
            (errors.norm_squared() / errors.len() as f64).max(1e-8).ln()
        }))
    }

    /// RMS error of each scaled target on the stretches left out.
    pub fn error(&self) -> Vec<f64> {
        self.0.column_iter().map(|s| s.map(f64::exp).mean().sqrt()).collect()
    }
}

/// Of some trials, simplest first, the first one whose score for an output is within a standard error of
/// the best one's.
pub(crate) fn simplest<'s>(
    trials: impl Iterator<Item = &'s Scores> + Clone,
    output: usize,
) -> Option<usize> {
    let mean = |scores: &Scores| scores.0.column(output).mean();
    let best = trials.clone().min_by(|a, b| mean(a).total_cmp(&mean(b)))?;
    let own = best.0.column(output);
    let least = own.mean() + (own.variance() / own.len() as f64).sqrt();
    trials.into_iter().position(|scores| mean(scores) <= least)
}

/// The bend of a covariance; the line beside it is [`LINE`] times as free.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Bend {
    reach: f64,
    size: f64,
}

impl Bend {
    fn of(self, square: f64) -> f64 {
        self.size / (1.0 + square / (self.reach * self.reach)).sqrt()
    }

    fn line(self) -> f64 {
        LINE * self.size
    }

    /// Covariances from dot products and squared distances.
    fn covariance(self, dots: &DMatrix<f64>, squares: &DMatrix<f64>) -> DMatrix<f64> {
        dots.zip_map(squares, |dot, square| self.line() * (dot + 1.0) + self.of(square))
    }
}

/// How a bend did on the stretches left out.
struct Trial {
    bend: Bend,
    scores: Scores,
}

/// A model; every output has the bend that suits it.
pub(crate) struct Model {
    rows: DMatrix<f64>,
    /// Bends and the weights of the rows, rows × outputs, zero for outputs with another bend.
    members: Vec<(Bend, DMatrix<f64>)>,
    /// Slope of each scaled target by each scaled input, inputs × outputs.
    slope: DMatrix<f64>,
    /// The targets at the inputs' mean.
    level: DVector<f64>,
    /// How it did on each stretch left out.
    pub left_out: Scores,
}

/// Fits line and bend: the choice by some rows, the model to others. `progress` is told how many bends
/// were tried, of how many.
///
/// # Errors
/// Stopped before anything was chosen.
pub(crate) fn fit(
    choice: &Rows,
    rows: &Rows,
    progress: &mut dyn FnMut(usize, usize),
    stop: &AtomicBool,
) -> Result<Model, FitError> {
    let (dots, squares) = pairs(&choice.x, &choice.x);
    let bends = SIZES.iter().flat_map(|size| REACHES.map(|reach| Bend { reach, size: *size }));
    let mut trials = Vec::new();
    for (tried, bend) in bends.enumerate() {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        trials.extend(attempt(choice, bend, &dots, &squares));
        progress(tried + 1, SIZES.len() * REACHES.len());
    }
    let outputs = rows.y.ncols();
    let chosen: Vec<usize> = (0..outputs)
        .map(|k| simplest(trials.iter().map(|trial| &trial.scores), k))
        .collect::<Option<_>>()
        .ok_or(FitError::Stopped)?;
    let mut left_out = trials[0].scores.clone();
    for (k, chosen) in chosen.iter().enumerate() {
        left_out.0.set_column(k, &trials[*chosen].scores.0.column(k));
    }
    let mut model = Model {
        rows: rows.x.clone(),
        members: Vec::new(),
        slope: DMatrix::zeros(rows.x.ncols(), outputs),
        level: DVector::zeros(outputs),
        left_out,
    };
    let (dots, squares) = pairs(&rows.x, &rows.x);
    for (i, trial) in trials.iter().enumerate() {
        let own: Vec<bool> = chosen.iter().map(|chosen| *chosen == i).collect();
        if !own.contains(&true) {
            continue;
        }
        let Some(factor) = factor(trial.bend, &dots, &squares) else { continue };
        let mut weights = factor.solve(&rows.y);
        weights
            .column_iter_mut()
            .zip(&own)
            .filter(|(_, own)| !**own)
            .for_each(|(mut w, _)| w.fill(0.0));
        model.slope += rows.x.tr_mul(&weights) * trial.bend.line();
        model.level += weights.row_sum().transpose() * trial.bend.line();
        model.members.push((trial.bend, weights));
    }
    Ok(model)
}

fn attempt(rows: &Rows, bend: Bend, dots: &DMatrix<f64>, squares: &DMatrix<f64>) -> Option<Trial> {
    let factor = factor(bend, dots, squares)?;
    let weights = factor.solve(&rows.y);
    let n = rows.x.nrows();
    let mut inverse = DMatrix::identity(n, n);
    factor.l_dirty().solve_lower_triangular_mut(&mut inverse);
    let stretches = rows.stretch.iter().max()? + 1;
    let errors = (0..stretches).map(|stretch| {
        let own = rows.of(stretch);
        let columns = inverse.select_columns(&own);
        let block = Cholesky::new(columns.tr_mul(&columns))?;
        Some(block.solve(&weights.select_rows(&own)))
    });
    Some(Trial { bend, scores: Scores::of(&errors.collect::<Option<Vec<_>>>()?) })
}

fn factor(bend: Bend, dots: &DMatrix<f64>, squares: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let mut covariance = bend.covariance(dots, squares);
    for i in 0..covariance.nrows() {
        // A distance from itself is rounded; it is none.
        covariance[(i, i)] = bend.line() * (dots[(i, i)] + 1.0) + bend.size + 1.0;
    }
    Cholesky::new(covariance)
}

/// Dot products and squared distances of the rows of `a` and `b`.
fn pairs(a: &DMatrix<f64>, b: &DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
    let dots = a * b.transpose();
    let square =
        |x: &DMatrix<f64>| -> Vec<f64> { x.row_iter().map(|r| r.norm_squared()).collect() };
    let (of_a, of_b) = (square(a), square(b));
    let squares = DMatrix::from_fn(a.nrows(), b.nrows(), |i, j| {
        (of_a[i] + of_b[j] - 2.0 * dots[(i, j)]).max(0.0)
    });
    (dots, squares)
}

impl Model {
    /// The scaled targets for scaled inputs, row for row.
    pub fn outputs(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut y = x * &self.slope;
        y.row_iter_mut().for_each(|mut row| row += self.level.transpose());
        for start in (0..x.nrows()).step_by(CHUNK) {
            let count = CHUNK.min(x.nrows() - start);
            let (_, squares) = pairs(&x.rows(start, count).into_owned(), &self.rows);
            for (bend, weights) in &self.members {
                let mut rows = y.rows_mut(start, count);
                rows += squares.map(|square| bend.of(square)) * weights;
            }
        }
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two inputs that wander, a target that bends in one of them.
    fn rows(count: usize, bent: f64) -> Rows {
        let t = |row: usize| row as f64 * 0.1;
        let x = DMatrix::from_fn(count, 2, |row, i| {
            if i == 0 { (0.9 * t(row)).sin() } else { (1.7 * t(row)).cos() }
        });
        let y = DMatrix::from_fn(count, 1, |row, _| {
            x[(row, 0)] - 0.5 * x[(row, 1)] + bent * (3.0 * x[(row, 0)]).sin() + 0.2
        });
        Rows { x, y, stretch: (0..count).map(|row| row * 8 / count).collect() }
    }

    fn model(rows: &Rows) -> Model {
        fit(rows, rows, &mut |_, _| {}, &AtomicBool::new(false)).unwrap()
    }

    #[test]
    fn it_bends_where_there_are_rows_and_is_a_line_far_from_them() {
        let train = rows(300, 0.3);
        let model = model(&train);
        let error = model.outputs(&train.x) - &train.y;
        assert!(error.amax() < 0.02, "{}", error.amax());
        // Far out in a direction that no row took, three points of a line lie on a line.
        let far = DMatrix::from_row_slice(3, 2, &[300.0, 0.0, 400.0, 0.0, 500.0, 0.0]);
        let y = model.outputs(&far);
        let slope = model.slope[(0, 0)];
        assert!((y[2] - y[0] - 200.0 * slope).abs() < 0.5, "{y} {slope}");
    }

    #[test]
    fn what_a_stretch_left_out_gets_is_what_a_fit_without_it_says() {
        let all = rows(160, 0.3);
        let bend = Bend { reach: 0.8, size: 1e2 };
        let (dots, squares) = pairs(&all.x, &all.x);
        let trial = attempt(&all, bend, &dots, &squares).unwrap();
        let keep: Vec<usize> = (0..160).filter(|row| all.stretch[*row] != 3).collect();
        let left: Vec<usize> = (0..160).filter(|row| all.stretch[*row] == 3).collect();
        let (kx, ky) = (all.x.select_rows(&keep), all.y.select_rows(&keep));
        let (dots, squares) = pairs(&kx, &kx);
        let weights = factor(bend, &dots, &squares).unwrap().solve(&ky);
        let lx = all.x.select_rows(&left);
        let (dots, squares) = pairs(&lx, &kx);
        let error = bend.covariance(&dots, &squares) * weights - all.y.select_rows(&left);
        let direct = (error.norm_squared() / left.len() as f64).ln();
        assert!((trial.scores.0[(3, 0)] - direct).abs() < 1e-6);
    }

    #[test]
    fn of_what_does_as_well_the_simplest_is_taken() {
        let scores =
            |at: f64| Scores(DMatrix::from_column_slice(4, 1, &[at, at + 1.0, at, at + 1.0]));
        // A standard error of four such stretches is 0.29.
        let trials = [scores(1.0), scores(0.25), scores(0.0)];
        assert_eq!(simplest(trials.iter(), 0), Some(1));
        assert_eq!(simplest(trials[..0].iter(), 0), None);
    }

    #[test]
    fn stopped_at_once_there_is_nothing_to_keep() {
        let all = rows(100, 0.0);
        let stopped = fit(&all, &all, &mut |_, _| {}, &AtomicBool::new(true));
        assert!(matches!(stopped, Err(FitError::Stopped)));
    }
}

//! Gaussian-process regression: a straight line everywhere, bent near what was recorded.
//!
//! The covariance of two rows is k(x, x') = ρ·[c·(x·x' + 1) + (1 + |x − x'|²/ℓ²)^(−½)] in units of the
//! noise: a linear model that is all but free, and a rational quadratic (Rasmussen & Williams 2006,
//! eq. (4.19), α = ½) that bends it where there are rows to bend it to. Far from every row the bend fades
//! and the straight line is left: that is how it meets a state of the sensor that no recording showed.
//!
//! Reach ℓ and size ρ of the bend are chosen by leaving stretches out: with K⁻¹ at hand what the other
//! rows say of a stretch B follows without another fit, e_B = ((K⁻¹)_BB)⁻¹·(K⁻¹y)_B (the block form of
//! eq. (5.12)).

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::error::FitError;

/// Rows on which the choice is made; its price grows with their cube.
pub(crate) const CHOICE_ROWS: usize = 700;
/// Rows that the predictions rest on.
pub(crate) const ROWS: usize = 2000;
/// How free the straight line is beside the bend: rows are scaled to about one, so that slopes of ten
/// spreads a spread are still ordinary.
const LINE: f64 = 100.0;
/// Reaches ℓ that are tried, in spreads of the inputs: from neighbours to a gentle bend of the whole.
const REACHES: [f64; 9] = [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6];
/// Sizes ρ that are tried; at 1e7 the noise is all but nothing beside the bend.
const SIZES: [f64; 4] = [1e1, 1e3, 1e5, 1e7];
/// Priors of a plain linear model that are tried.
const LINES: [f64; 6] = [1e-2, 1e-1, 1e0, 1e1, 1e3, 1e5];
/// Most members of a committee.
const COMMITTEE: usize = 6;
/// A prediction is made for so many rows at once.
const CHUNK: usize = 256;

/// Scaled rows: inputs, targets, and the stretch that each belongs to (0, 1, …).
pub(crate) struct Rows {
    pub x: DMatrix<f64>,
    pub y: DMatrix<f64>,
    pub stretch: Vec<usize>,
}

/// One covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Prior {
    line: f64,
    bend: Option<Bend>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Bend {
    reach: f64,
    size: f64,
}

impl Prior {
    /// Covariances from dot products and squared distances.
    fn covariance(self, dots: &DMatrix<f64>, squares: &DMatrix<f64>) -> DMatrix<f64> {
        dots.zip_map(squares, |dot, square| {
            self.line * (dot + 1.0) + self.bend.map_or(0.0, |bend| bend.of(square))
        })
    }
}

impl Bend {
    fn of(self, square: f64) -> f64 {
        self.size / (1.0 + square / (self.reach * self.reach)).sqrt()
    }
}

/// How well a prior foretells the stretches left out: ln of the mean square error, stretch × output.
struct Trial {
    prior: Prior,
    scores: DMatrix<f64>,
}

impl Trial {
    fn score(&self, output: usize) -> f64 {
        self.scores.column(output).mean()
    }
}

/// A model: the mean of a committee of priors that the stretches left out cannot tell apart.
pub(crate) struct Model {
    rows: DMatrix<f64>,
    members: Vec<(Bend, DMatrix<f64>)>,
    /// Slope of each scaled target by each scaled input, inputs × outputs.
    pub slope: DMatrix<f64>,
    /// The targets at the inputs' mean.
    pub level: DVector<f64>,
    /// ln of the mean square error of each stretch left out, by the best prior alone: stretch × output.
    pub left_out: DMatrix<f64>,
}

/// Fits line and bend. `progress` is told how many priors were tried, of how many.
///
/// # Errors
/// Stopped before anything was chosen.
pub(crate) fn fit(
    choice: &Rows,
    rows: &Rows,
    progress: &mut dyn FnMut(usize, usize),
    stop: &AtomicBool,
) -> Result<Model, FitError> {
    let priors: Vec<Prior> = REACHES
        .iter()
        .flat_map(|reach| SIZES.map(|size| (*reach, size)))
        .map(|(reach, size)| Prior { line: LINE * size, bend: Some(Bend { reach, size }) })
        .collect();
    committee(choice, rows, &priors, progress, stop)
}

/// Fits the line alone; its decay is chosen in the same way.
///
/// # Errors
/// As [`fit`].
pub(crate) fn fit_line(choice: &Rows, rows: &Rows, stop: &AtomicBool) -> Result<Model, FitError> {
    let priors = LINES.map(|line| Prior { line, bend: None });
    committee(choice, rows, &priors, &mut |_, _| {}, stop)
}

fn committee(
    choice: &Rows,
    rows: &Rows,
    priors: &[Prior],
    progress: &mut dyn FnMut(usize, usize),
    stop: &AtomicBool,
) -> Result<Model, FitError> {
    let (dots, squares) = pairs(&choice.x, &choice.x);
    let mut trials = Vec::new();
    for (tried, prior) in priors.iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        trials.extend(attempt(choice, *prior, &dots, &squares));
        progress(tried + 1, priors.len());
    }
    let outputs = rows.y.ncols();
    let chosen: Vec<Vec<usize>> = (0..outputs).map(|k| as_good_as_the_best(&trials, k)).collect();
    if chosen.iter().any(Vec::is_empty) {
        return Err(FitError::Stopped);
    }
    let mut left_out = DMatrix::zeros(trials[0].scores.nrows(), outputs);
    for (k, chosen) in chosen.iter().enumerate() {
        left_out.set_column(k, &trials[chosen[0]].scores.column(k));
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
        let share = |k: usize| {
            let own = &chosen[k];
            if own.contains(&i) { 1.0 / own.len() as f64 } else { 0.0 }
        };
        if (0..outputs).all(|k| share(k) == 0.0) {
            continue;
        }
        let Some(factor) = factor(trial.prior, &dots, &squares) else { continue };
        let mut weights = factor.solve(&rows.y);
        weights.column_iter_mut().enumerate().for_each(|(k, mut w)| w.scale_mut(share(k)));
        model.slope += rows.x.transpose() * &weights * trial.prior.line;
        model.level += weights.row_sum().transpose() * trial.prior.line;
        if let Some(bend) = trial.prior.bend {
            model.members.push((bend, weights));
        }
    }
    Ok(model)
}

/// The best trials for an output, best first: those whose stretches left out are not worse than the best
/// one's by more than the standard error of the difference. Which of them is right the recordings do not
/// say; their mean is safer than any.
fn as_good_as_the_best(trials: &[Trial], output: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..trials.len()).collect();
    order.sort_by(|a, b| trials[*a].score(output).total_cmp(&trials[*b].score(output)));
    let Some(best) = order.first().map(|best| trials[*best].scores.column(output)) else {
        return order;
    };
    order.retain(|i| {
        let worse = trials[*i].scores.column(output) - best;
        worse.mean() <= (worse.variance() / worse.len() as f64).sqrt()
    });
    order.truncate(COMMITTEE);
    order
}

fn attempt(
    rows: &Rows,
    prior: Prior,
    dots: &DMatrix<f64>,
    squares: &DMatrix<f64>,
) -> Option<Trial> {
    let factor = factor(prior, dots, squares)?;
    let weights = factor.solve(&rows.y);
    let n = rows.x.nrows();
    let mut inverse = DMatrix::identity(n, n);
    factor.l_dirty().solve_lower_triangular_mut(&mut inverse);
    let stretches = rows.stretch.iter().max()? + 1;
    let mut scores = DMatrix::zeros(stretches, rows.y.ncols());
    for stretch in 0..stretches {
        let own: Vec<usize> = (0..n).filter(|row| rows.stretch[*row] == stretch).collect();
        let columns = inverse.select_columns(&own);
        let block = Cholesky::new(columns.transpose() * &columns)?;
        let errors = block.solve(&weights.select_rows(&own));
        for (k, errors) in errors.column_iter().enumerate() {
            // An error of a ten-thousandth of the spread is none: no reference is better.
            scores[(stretch, k)] = (errors.norm_squared() / own.len() as f64).max(1e-8).ln();
        }
    }
    Some(Trial { prior, scores })
}

fn factor(prior: Prior, dots: &DMatrix<f64>, squares: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let mut covariance = prior.covariance(dots, squares);
    covariance.fill_diagonal(0.0);
    for i in 0..covariance.nrows() {
        let own = prior.line * (dots[(i, i)] + 1.0) + prior.bend.map_or(0.0, |bend| bend.size);
        covariance[(i, i)] = own + 1.0;
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
        if self.members.is_empty() {
            return y;
        }
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

    /// RMS error of each scaled target on the stretches left out.
    pub fn left_out_error(&self) -> Vec<f64> {
        self.left_out.column_iter().map(|s| s.map(f64::exp).mean().sqrt()).collect()
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
        let prior = Prior { line: 1e3, bend: Some(Bend { reach: 0.8, size: 1e2 }) };
        let (dots, squares) = pairs(&all.x, &all.x);
        let trial = attempt(&all, prior, &dots, &squares).unwrap();
        let keep: Vec<usize> = (0..160).filter(|row| all.stretch[*row] != 3).collect();
        let left: Vec<usize> = (0..160).filter(|row| all.stretch[*row] == 3).collect();
        let (kx, ky) = (all.x.select_rows(&keep), all.y.select_rows(&keep));
        let (dots, squares) = pairs(&kx, &kx);
        let weights = factor(prior, &dots, &squares).unwrap().solve(&ky);
        let lx = all.x.select_rows(&left);
        let (dots, squares) = pairs(&lx, &kx);
        let error = prior.covariance(&dots, &squares) * weights - all.y.select_rows(&left);
        let direct = (error.norm_squared() / left.len() as f64).ln();
        assert!((trial.scores[(3, 0)] - direct).abs() < 1e-6);
    }

    #[test]
    fn a_line_is_found_to_be_one() {
        let all = rows(300, 0.0);
        let line = fit_line(&all, &all, &AtomicBool::new(false)).unwrap();
        assert!((line.slope[(0, 0)] - 1.0).abs() < 1e-3 && (line.slope[(1, 0)] + 0.5).abs() < 1e-3);
        assert!(line.left_out_error()[0] < 1e-3);
        let bent = rows(300, 0.3);
        let line = fit_line(&bent, &bent, &AtomicBool::new(false)).unwrap();
        assert!(line.left_out_error()[0] > 10.0 * model(&bent).left_out_error()[0]);
    }

    #[test]
    fn stopped_at_once_there_is_nothing_to_keep() {
        let all = rows(100, 0.0);
        let stopped = fit(&all, &all, &mut |_, _| {}, &AtomicBool::new(true));
        assert!(matches!(stopped, Err(FitError::Stopped)));
    }
}

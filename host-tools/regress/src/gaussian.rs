//! Gaussian-process regression: a straight line everywhere, bent near recorded rows.
//!
//! The covariance of two rows is k(x, x') = ρ·[c·(x·x' + 1) + (1 + |Px − Px'|²/ℓ²)^(−½)] in units
//! of the noise. The first term is a nearly free linear model. The second, a rational quadratic
//! (Rasmussen & Williams 2006, eq. (4.19), α = ½), bends the line near the rows. Far from every row
//! the bend fades and the straight line is left; it covers sensor states that no recording showed.
//! P weights each principal direction of the inputs by the share of its power that is signal
//! ([`Rows::heard`]). Thirty channels hold a few directions of signal; in the others two rows of
//! one load differ by noise.
//!
//! Reach ℓ and size ρ of the bend are judged by leaving stretches out. K⁻¹ gives the error on a
//! stretch B without another fit, e_B = ((K⁻¹)_BB)⁻¹·(K⁻¹y)_B (the block form of eq. (5.12)).
//! Stretches of one recording cannot separate priors of nearly equal score. All priors within a
//! standard error of the best (Breiman et al. 1984, §3.4.3) therefore take part, as one covariance
//! with the mean of their bends.

use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SymmetricEigen};

use crate::error::FitError;

/// Rows used for the choice of priors; its cost grows with their cube.
pub(crate) const CHOICE_ROWS: usize = 600;
/// Rows used for the predictions.
pub(crate) const ROWS: usize = 1500;
/// Prior variance of the straight line relative to the bend.
///
/// Rows are scaled to about one, so that slopes of ten spreads a spread are still ordinary.
const LINE: f64 = 100.0;
/// Reaches ℓ tried, in spreads of the inputs: from a gentle bend of the whole to neighbours.
const REACHES: [f64; 9] = [25.6, 12.8, 6.4, 3.2, 1.6, 0.8, 0.4, 0.2, 0.1];
/// Sizes ρ tried; at 1e5 the noise is negligible relative to the bend.
const SIZES: [f64; 3] = [1e1, 1e3, 1e5];
/// Rows predicted at once.
const CHUNK: usize = 256;

/// Scaled rows in the order of time: inputs, targets, and the stretch of each (0, 1, …).
pub(crate) struct Rows {
    pub x: DMatrix<f64>,
    pub y: DMatrix<f64>,
    pub stretch: Vec<usize>,
}

/// Principal directions of the inputs, each scaled by the share of its power that is signal.
pub(crate) type Directions = DMatrix<f64>;

impl Rows {
    /// Inputs and targets of each stretch.
    pub fn by_stretch(&self) -> Vec<(DMatrix<f64>, DMatrix<f64>)> {
        let stretches = self.stretch.iter().max().map_or(0, |last| last + 1);
        (0..stretches)
            .map(|stretch| self.of(stretch))
            .map(|own| (self.x.select_rows(&own), self.y.select_rows(&own)))
            .collect()
    }

    /// Principal directions of the inputs, each weighted by its share of signal.
    ///
    /// Noise is the jitter from row to row. Second differences, which cancel slow motion, have six
    /// times its power. Returns the identity if successive rows differ too much to separate signal
    /// and noise.
    pub fn heard(&self) -> Directions {
        let (n, width) = self.x.shape();
        let all = DMatrix::identity(width, width);
        if n < 3 {
            return all;
        }
        let eigen = SymmetricEigen::new(self.x.tr_mul(&self.x) / n as f64);
        let along = &self.x * &eigen.eigenvectors;
        let jitter = along.rows(0, n - 2) - along.rows(1, n - 2) * 2.0 + along.rows(2, n - 2);
        let signal = |i: usize| {
            // The median is robust to the few jumps between presses or recordings. The median of a
            // squared normal variable is 0.4549 of its mean.
            let mut squares: Vec<f64> = jitter.column(i).iter().map(|j| j * j).collect();
            let (_, median, _) = squares.select_nth_unstable_by(n / 2 - 1, f64::total_cmp);
            let power = eigen.eigenvalues[i];
            if power > 0.0 { (1.0 - *median / (6.0 * 0.4549 * power)).max(0.0) } else { 0.0 }
        };
        let signals: Vec<f64> = (0..width).map(signal).collect();
        if signals.iter().all(|signal| *signal < 0.5) {
            return all;
        }
        let mut heard = eigen.eigenvectors.clone();
        heard.column_iter_mut().zip(signals).for_each(|(mut column, signal)| column *= signal);
        heard
    }

    fn of(&self, stretch: usize) -> Vec<usize> {
        (0..self.stretch.len()).filter(|row| self.stretch[*row] == stretch).collect()
    }
}

/// Scores of a model on the held-out stretches: ln of the mean square error, stretch × output.
#[derive(Clone, Debug)]
pub(crate) struct Scores(pub DMatrix<f64>);

impl Scores {
    /// Computes the scores from the errors of each stretch.
    pub fn of(errors: &[DMatrix<f64>]) -> Self {
        let outputs = errors.first().map_or(0, |errors| errors.ncols());
        Self(DMatrix::from_fn(errors.len(), outputs, |stretch, k| {
            let errors = errors[stretch].column(k);
            // Errors below a ten-thousandth of the spread count as that, because no reference is
            // better.
            (errors.norm_squared() / errors.len() as f64).max(1e-8).ln()
        }))
    }

    /// RMS error of each scaled target on the held-out stretches.
    pub fn error(&self) -> Vec<f64> {
        self.0.column_iter().map(|s| s.map(f64::exp).mean().sqrt()).collect()
    }

    /// RMS error of each scaled target on a usual stretch: the geometric mean over stretches.
    ///
    /// One stretch far beyond all others does not dominate it.
    pub fn usual(&self) -> Vec<f64> {
        self.0.column_iter().map(|s| s.mean().exp().sqrt()).collect()
    }
}

/// Indices of the trials within a standard error of the best one's score for an output.
pub(crate) fn good<'s>(
    trials: impl Iterator<Item = &'s Scores> + Clone,
    output: usize,
) -> Vec<usize> {
    let mean = |scores: &Scores| scores.0.column(output).mean();
    let Some(best) = trials.clone().min_by(|a, b| mean(a).total_cmp(&mean(b))) else {
        return Vec::new();
    };
    let own = best.0.column(output);
    let least = own.mean() + (own.variance() / own.len() as f64).sqrt();
    let within = trials.enumerate().filter(|(_, scores)| mean(scores) <= least);
    within.map(|(number, _)| number).collect()
}

/// Reach and size of a covariance's bend.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Bend {
    reach: f64,
    size: f64,
}

/// Components of a covariance: bends of one size and several reaches, and a line.
///
/// The line has [`LINE`] times the bends' variance.
#[derive(Clone, Debug, PartialEq)]
struct Prior {
    reaches: Vec<f64>,
    size: f64,
}

impl Prior {
    /// Mean of several bends. The size is the geometric mean, so that the largest does not
    /// dominate.
    fn of_all(bends: &[Bend]) -> Self {
        let logarithms = bends.iter().map(|bend| bend.size.ln()).sum::<f64>();
        let size = (logarithms / bends.len().max(1) as f64).exp();
        Self { reaches: bends.iter().map(|bend| bend.reach).collect(), size }
    }

    fn of(&self, square: f64) -> f64 {
        let bend = |reach: &f64| 1.0 / (1.0 + square / (reach * reach)).sqrt();
        let bends = self.reaches.iter().map(bend).sum::<f64>();
        self.size * bends / self.reaches.len().max(1) as f64
    }

    fn line(&self) -> f64 {
        LINE * self.size
    }

    /// Factors the covariance of rows from dot products and squared distances, noise included.
    fn factor(&self, dots: &DMatrix<f64>, squares: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
        let line = self.line();
        let mut covariance =
            dots.zip_map(squares, |dot, square| line * (dot + 1.0) + self.of(square));
        for i in 0..covariance.nrows() {
            // The distance from itself is rounded, but must be zero.
            covariance[(i, i)] = line * (dots[(i, i)] + 1.0) + self.of(0.0) + 1.0;
        }
        Cholesky::new(covariance)
    }
}

/// A bend with its scores on the held-out stretches.
struct Trial {
    bend: Bend,
    scores: Scores,
}

/// Predictor of some outputs.
struct Member {
    prior: Prior,
    /// Weights of the rows, rows × outputs, zero for the outputs of other members.
    weights: DMatrix<f64>,
}

/// Fitted Gaussian process; every output has its own bends.
pub(crate) struct Model {
    heard: Directions,
    /// Rows projected on these directions.
    rows: DMatrix<f64>,
    members: Vec<Member>,
    /// Slope of each scaled target by each scaled input, inputs × outputs.
    slope: DMatrix<f64>,
    /// The targets at the inputs' mean.
    level: DVector<f64>,
    /// Scores on each held-out stretch.
    pub left_out: Scores,
}

/// Fits line and bend: chooses the priors on `choice` and fits the model to `rows`.
///
/// Distances are taken in the directions `heard`. `progress` gets the bends tried and their total.
///
/// # Errors
///
/// Stopped before the end, because every step of it takes long and a part of it is no model.
pub(crate) fn fit(
    choice: &Rows,
    rows: &Rows,
    heard: Directions,
    progress: &mut dyn FnMut(usize, usize),
    stop: &AtomicBool,
) -> Result<Model, FitError> {
    let projected = &choice.x * &heard;
    let (products, apart) = (dots(&choice.x, &choice.x), squares(&projected, &projected));
    let bends = SIZES.iter().flat_map(|size| REACHES.map(|reach| Bend { reach, size: *size }));
    let mut trials = Vec::new();
    for (tried, bend) in bends.enumerate() {
        ended(stop)?;
        trials.extend(attempt(choice, bend, &products, &apart));
        progress(tried + 1, SIZES.len() * REACHES.len());
    }
    ended(stop)?;
    let outputs = rows.y.ncols();
    let mut model = Model {
        rows: &rows.x * &heard,
        heard,
        members: Vec::new(),
        slope: DMatrix::zeros(rows.x.ncols(), outputs),
        level: DVector::zeros(outputs),
        left_out: trials.first().ok_or(FitError::Stopped)?.scores.clone(),
    };
    let mut chosen: Vec<(Prior, Vec<usize>)> = Vec::new();
    for k in 0..outputs {
        let good = good(trials.iter().map(|trial| &trial.scores), k);
        let mut scores = DVector::zeros(model.left_out.0.nrows());
        good.iter().for_each(|i| scores += trials[*i].scores.0.column(k) / good.len() as f64);
        model.left_out.0.set_column(k, &scores);
        let bends: Vec<Bend> = good.iter().map(|i| trials[*i].bend).collect();
        let prior = Prior::of_all(&bends);
        match chosen.iter_mut().find(|(other, _)| *other == prior) {
            Some((_, outputs)) => outputs.push(k),
            None => chosen.push((prior, vec![k])),
        }
    }
    let (products, apart) = (dots(&rows.x, &rows.x), squares(&model.rows, &model.rows));
    for (prior, outputs) in chosen {
        ended(stop)?;
        let Some(factor) = prior.factor(&products, &apart) else { continue };
        let mut weights = factor.solve(&rows.y);
        for (k, mut column) in weights.column_iter_mut().enumerate() {
            if !outputs.contains(&k) {
                column.fill(0.0);
            }
        }
        model.slope += rows.x.tr_mul(&weights) * prior.line();
        model.level += weights.row_sum().transpose() * prior.line();
        model.members.push(Member { prior, weights });
    }
    Ok(model)
}

/// Returns an error once the fit is stopped.
fn ended(stop: &AtomicBool) -> Result<(), FitError> {
    if stop.load(Ordering::Relaxed) { Err(FitError::Stopped) } else { Ok(()) }
}

fn attempt(rows: &Rows, bend: Bend, dots: &DMatrix<f64>, squares: &DMatrix<f64>) -> Option<Trial> {
    let factor = Prior::of_all(&[bend]).factor(dots, squares)?;
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

/// Dot products of the rows of `a` and `b`.
fn dots(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    a * b.transpose()
}

/// Squared distances of the rows of `a` and `b`.
fn squares(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let square =
        |x: &DMatrix<f64>| -> Vec<f64> { x.row_iter().map(|r| r.norm_squared()).collect() };
    let (of_a, of_b, dots) = (square(a), square(b), dots(a, b));
    DMatrix::from_fn(a.nrows(), b.nrows(), |i, j| (of_a[i] + of_b[j] - 2.0 * dots[(i, j)]).max(0.0))
}

impl Model {
    /// Predicts the scaled targets for scaled inputs, row for row.
    pub fn outputs(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut y = self.line(x);
        (0..x.nrows()).step_by(CHUNK).for_each(|start| self.bend(x, start, &mut y));
        y
    }

    /// Predicts as [`Self::outputs`], until the fit is stopped.
    ///
    /// # Errors
    ///
    /// Stopped before the last row.
    pub fn outputs_until(
        &self,
        x: &DMatrix<f64>,
        stop: &AtomicBool,
    ) -> Result<DMatrix<f64>, FitError> {
        let mut y = self.line(x);
        for start in (0..x.nrows()).step_by(CHUNK) {
            ended(stop)?;
            self.bend(x, start, &mut y);
        }
        Ok(y)
    }

    /// Predicts the straight line's share.
    fn line(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut y = x * &self.slope;
        y.row_iter_mut().for_each(|mut row| row += self.level.transpose());
        y
    }

    /// Adds the bend to the predictions of a chunk of rows.
    fn bend(&self, x: &DMatrix<f64>, start: usize, y: &mut DMatrix<f64>) {
        let count = CHUNK.min(x.nrows() - start);
        let apart = squares(&(x.rows(start, count) * &self.heard), &self.rows);
        for member in &self.members {
            let mut rows = y.rows_mut(start, count);
            rows += apart.map(|square| member.prior.of(square)) * &member.weights;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two varying inputs and a target that bends in one of them.
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
        fit(rows, rows, rows.heard(), &mut |_, _| {}, &AtomicBool::new(false)).unwrap()
    }

    #[test]
    fn process_bends_near_rows_and_is_linear_far_away() {
        let train = rows(300, 0.3);
        let model = model(&train);
        let error = model.outputs(&train.x) - &train.y;
        assert!(error.amax() < 0.02, "{}", error.amax());
        // Three points far out in an unrecorded direction lie on a line.
        let far = DMatrix::from_row_slice(3, 2, &[300.0, 0.0, 400.0, 0.0, 500.0, 0.0]);
        let y = model.outputs(&far);
        let slope = model.slope[(0, 0)];
        assert!((y[2] - y[0] - 200.0 * slope).abs() < 0.5, "{y} {slope}");
    }

    #[test]
    fn block_formula_matches_refit_without_stretch() {
        let all = rows(160, 0.3);
        let bend = Bend { reach: 0.8, size: 1e2 };
        let trial = attempt(&all, bend, &dots(&all.x, &all.x), &squares(&all.x, &all.x)).unwrap();
        let keep: Vec<usize> = (0..160).filter(|row| all.stretch[*row] != 3).collect();
        let left: Vec<usize> = (0..160).filter(|row| all.stretch[*row] == 3).collect();
        let (kx, ky) = (all.x.select_rows(&keep), all.y.select_rows(&keep));
        let prior = Prior::of_all(&[bend]);
        let weights = prior.factor(&dots(&kx, &kx), &squares(&kx, &kx)).unwrap().solve(&ky);
        let lx = all.x.select_rows(&left);
        let between = dots(&lx, &kx).zip_map(&squares(&lx, &kx), |dot, square| {
            prior.line() * (dot + 1.0) + prior.of(square)
        });
        let error = between * weights - all.y.select_rows(&left);
        let direct = (error.norm_squared() / left.len() as f64).ln();
        assert!((trial.scores.0[(3, 0)] - direct).abs() < 1e-6);
    }

    #[test]
    fn priors_within_standard_error_are_kept() {
        let scores =
            |at: f64| Scores(DMatrix::from_column_slice(4, 1, &[at, at + 1.0, at, at + 1.0]));
        // The standard error of four such stretches is 0.29.
        let trials = [scores(1.0), scores(0.25), scores(0.0)];
        assert_eq!(good(trials.iter(), 0), [1, 2]);
        assert!(good(trials[..0].iter(), 0).is_empty());
    }

    #[test]
    fn heard_drops_noise_unless_rows_are_shuffled() {
        let hiss = |i: usize| 0.2 * (12.9898 * (i * i) as f64).sin();
        let mut rows = rows(600, 0.3);
        for _ in 0..3 {
            let width = rows.x.ncols();
            rows.x = rows.x.insert_column(width, 0.0);
        }
        for (i, value) in rows.x.iter_mut().enumerate() {
            *value += hiss(i);
        }
        let power = |channel: usize| rows.heard().row(channel).norm();
        assert!(
            (0..2).all(|i| power(i) > 0.9) && (2..5).all(|i| power(i) < 0.5),
            "{}",
            rows.heard()
        );
        let shuffled: Vec<usize> = (0..600).map(|i| (i * 389) % 600).collect();
        rows.x = rows.x.select_rows(&shuffled);
        assert_eq!(rows.heard(), DMatrix::identity(5, 5));
    }

    #[test]
    fn fit_stopped_at_once_returns_error() {
        let all = rows(100, 0.0);
        let stopped = fit(&all, &all, all.heard(), &mut |_, _| {}, &AtomicBool::new(true));
        assert!(matches!(stopped, Err(FitError::Stopped)));
    }
}

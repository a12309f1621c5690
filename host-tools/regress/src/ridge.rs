//! Ridge regression by normal equations, with the decay chosen by held-out stretches.

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::gaussian::{Rows, Scores, good};

/// Decays tried, strongest first, relative to a noise of one; rows are scaled to about one.
const DECAYS: [f64; 6] = [1e2, 1e1, 1e0, 1e-1, 1e-3, 1e-5];

/// Singular values below this share of the largest count as zero.
const SINGULAR: f64 = 1e-9;

/// Slopes and levels of scaled targets over scaled inputs.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    /// Slopes, inputs × outputs.
    pub slope: DMatrix<f64>,
    /// Targets at the inputs' mean.
    pub level: DVector<f64>,
    /// Scores on each held-out stretch.
    pub left_out: Scores,
}

/// X̃ᵀX̃ and X̃ᵀY of some rows; the last column of X̃ is ones.
#[derive(Clone)]
pub(crate) struct Sums {
    pub gram: DMatrix<f64>,
    pub cross: DMatrix<f64>,
}

impl Sums {
    pub fn of(x: &DMatrix<f64>, y: &DMatrix<f64>) -> Self {
        let x = x.clone().insert_column(x.ncols(), 1.0);
        Self { gram: x.tr_mul(&x), cross: x.tr_mul(y) }
    }

    pub fn with(&self, part: &Self) -> Self {
        Self { gram: &self.gram + &part.gram, cross: &self.cross + &part.cross }
    }

    pub fn without(&self, part: &Self) -> Self {
        Self { gram: &self.gram - &part.gram, cross: &self.cross - &part.cross }
    }

    /// Solves for the slopes, with the levels as a last row.
    pub fn solve(&self, decay: f64) -> Option<DMatrix<f64>> {
        let mut matrix = self.gram.clone();
        (0..matrix.nrows()).for_each(|i| matrix[(i, i)] += decay);
        Some(Cholesky::new(matrix)?.solve(&self.cross))
    }
}

/// Outputs of a linear model with its levels as a last row.
pub(crate) fn outputs(line: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
    let mut y = x * line.rows(0, x.ncols());
    y.row_iter_mut().for_each(|mut row| row += line.row(x.ncols()));
    y
}

/// Fits a ridge regression to scaled rows.
pub(crate) fn fit(rows: &Rows) -> Option<Line> {
    let parts: Vec<(DMatrix<f64>, DMatrix<f64>)> = rows.by_stretch();
    let all = Sums::of(&rows.x, &rows.y);
    let sums: Vec<Sums> = parts.iter().map(|(x, y)| Sums::of(x, y)).collect();
    let trials: Vec<Scores> = DECAYS
        .iter()
        .map(|decay| {
            let errors = parts.iter().zip(&sums).map(|((x, y), own)| {
                let line = all.without(own).solve(*decay)?;
                Some(outputs(&line, x) - y)
            });
            errors.collect::<Option<Vec<_>>>().map(|errors| Scores::of(&errors))
        })
        .collect::<Option<_>>()?;
    let mut line = DMatrix::zeros(rows.x.ncols() + 1, rows.y.ncols());
    let mut left_out = trials.first()?.clone();
    for k in 0..rows.y.ncols() {
        // The strongest decay within a standard error of the best.
        let chosen = *good(trials.iter(), k).first()?;
        line.set_column(k, &all.solve(DECAYS[chosen])?.column(k));
        left_out.0.set_column(k, &trials[chosen].0.column(k));
    }
    let level = line.row(rows.x.ncols()).transpose();
    Some(Line { slope: line.remove_row(rows.x.ncols()), level, left_out })
}

/// Slopes and levels by plain least squares; `None` if the rows do not determine them.
pub(crate) fn without_decay(rows: &Rows) -> Option<(DMatrix<f64>, DVector<f64>)> {
    // A constant channel is scaled to zero and gets no weight.
    let idle: Vec<usize> =
        (0..rows.x.ncols()).filter(|i| rows.x.column(*i).amax() == 0.0).collect();
    let x = rows.x.clone().insert_column(rows.x.ncols(), 1.0).remove_columns_at(&idle);
    let svd = x.svd(true, true);
    if svd.singular_values.min() < SINGULAR * svd.singular_values.max() {
        return None;
    }
    let mut line = svd.solve(&rows.y, 0.0).ok()?;
    for i in idle {
        line = line.insert_row(i, 0.0);
    }
    let level = line.row(rows.x.ncols()).transpose();
    Some((line.remove_row(rows.x.ncols()), level))
}

/// Negative residual, outputs − targets, of a ridge fit through all rows.
pub(crate) fn residual(rows: &Rows, decay: f64) -> Option<DMatrix<f64>> {
    let line = Sums::of(&rows.x, &rows.y).solve(decay)?;
    Some(outputs(&line, &rows.x) - &rows.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(bent: f64) -> Rows {
        let x = DMatrix::from_fn(400, 2, |row, i| {
            let t = row as f64 * 0.1;
            if i == 0 { (0.9 * t).sin() } else { (1.7 * t).cos() }
        });
        let y = DMatrix::from_fn(400, 1, |row, _| {
            x[(row, 0)] - 0.5 * x[(row, 1)] + bent * (3.0 * x[(row, 0)]).sin() + 0.2
        });
        Rows { x, y, stretch: (0..400).map(|row| row * 8 / 400).collect() }
    }

    #[test]
    fn ridge_fits_line_and_leaves_bend_as_error() {
        let line = fit(&rows(0.0)).unwrap();
        assert!((line.slope[(0, 0)] - 1.0).abs() < 1e-3 && (line.slope[(1, 0)] + 0.5).abs() < 1e-3);
        assert!((line.level[0] - 0.2).abs() < 1e-3 && line.left_out.error()[0] < 1e-3);
        assert!(fit(&rows(0.3)).unwrap().left_out.error()[0] > 0.05);
    }

    #[test]
    fn fit_without_decay_is_exact_but_refuses_duplicates() {
        let mut rows = rows(0.0);
        rows.x = rows.x.insert_column(1, 0.0);
        let (slope, level) = without_decay(&rows).unwrap();
        let expected = [1.0, 0.0, -0.5];
        assert!(slope.iter().zip(expected).all(|(found, wanted)| (found - wanted).abs() < 1e-9));
        assert!((level[0] - 0.2).abs() < 1e-9);
        let twin = rows.x.column(0) * 3.0;
        rows.x.set_column(1, &twin);
        assert!(without_decay(&rows).is_none());
    }
}

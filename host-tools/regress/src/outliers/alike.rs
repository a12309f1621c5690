//! Wrong rows found by comparison with the most similar rows.

use nalgebra::{Cholesky, DMatrix};

use super::NEIGHBOURS;
use crate::polynomial::Expansion;
use crate::quantile::{median, quantile};
use crate::scaling::Scale;
use crate::training::Recorded;

/// Most similar rows to compare with; rows of the recording for each of them; fewest of them.
const LIKE: usize = 24;
const ROWS_A_LIKE: usize = 8;
const LEAST_LIKE: usize = 8;
/// Fewest sound rows for this comparison.
const LEAST_ROWS: usize = ROWS_A_LIKE * LEAST_LIKE;
/// Most rows among which similar ones are sought.
const SOUGHT: usize = 3000;
/// Least distance of similar rows in time, as a share of the recording.
///
/// A run of wrong rows must not confirm itself.
const APART: f64 = 0.1;
/// Least distance of a wrong row from similar ones, in their deviations …
const OUTLIER: f64 = 8.0;
/// … as a share of the spread …
const GROSS: f64 = 0.3;
/// … and in multiples of the law's usual residual.
const MISFIT: f64 = 6.0;
/// Largest residual of the law, as a share of the spread, at which a target is judged.
const UNEXPLAINED: f64 = 0.1;
/// Least jump at an end of a wrong run, as a share of the run's error.
const JUMP: f64 = 0.7;
/// Least distance of an examined input from its median, in its usual widths.
const FAR: f64 = 0.9;
/// Rows at either end that count as the end of the recording.
const END: usize = 3;
/// Most terms of the law, and fewest rows for each of them.
const MOST_TERMS: usize = 200;
const ROWS_A_TERM: usize = 4;
/// Decay of the law, with rows scaled to about one.
const DECAY: f64 = 1.0;
/// Most passes; each leaves out the rows found before.
const PASSES: usize = 8;

/// Adds the wrong rows of a recording to those `known`.
///
/// Short runs within the recording are added only if it is `loose`.
pub(super) fn wrong((x, y): &Recorded, known: Vec<bool>, loose: bool) -> Vec<bool> {
    let mut wrong = known;
    for _ in 0..PASSES {
        let sound: Vec<usize> = (0..x.len()).filter(|row| !wrong[*row]).collect();
        if sound.len() < LEAST_ROWS {
            break;
        }
        let found = Pass::new(x, y, &sound).found(loose);
        if found.is_empty() {
            break;
        }
        found.into_iter().for_each(|row| wrong[row] = true);
    }
    wrong
}

/// Rows of a recording, scaled by the rows considered sound so far.
pub(super) struct Pass<'s> {
    sound: &'s [usize],
    /// Number of similar rows that a row is compared with.
    like: usize,
    /// Sound rows with which others are compared.
    sought: Vec<usize>,
    /// Inputs and targets of each row.
    inputs: Vec<Vec<f64>>,
    pub targets: Vec<Vec<f64>>,
    /// Values of the sought rows in each input, then in each target.
    columns: Vec<Vec<f64>>,
    /// Spread of the targets, in their own units.
    pub spread: Vec<f64>,
    /// Residuals of the law.
    pub left: Vec<Vec<f64>>,
    /// Usual residual of each target: standard deviation of most rows.
    pub misfit: Vec<f64>,
    /// Least residual at which a target stands out.
    least: Vec<f64>,
    /// Median, spread and usual width of each input.
    usual: Vec<[f64; 3]>,
}

impl<'s> Pass<'s> {
    pub fn new(x: &[Vec<f64>], y: &[Vec<f64>], sound: &'s [usize]) -> Self {
        let step = sound.len().div_ceil(SOUGHT);
        let sought: Vec<usize> = sound.iter().copied().step_by(step).collect();
        let of = |rows: &[Vec<f64>], k: usize| -> Vec<f64> {
            sought.iter().map(|row| rows[*row][k]).collect()
        };
        let scaled = |rows: &[Vec<f64>], alike: bool| {
            let width = rows[sound[0]].len();
            let spread = |k| Scale::of(of(rows, k).iter().copied()).spread;
            let spreads: Vec<f64> = (0..width).map(spread).collect();
            let common = (spreads.iter().map(|s| s * s).sum::<f64>() / width.max(1) as f64).sqrt();
            let size: Vec<f64> = spreads
                .iter()
                .map(|s| if *s > 0.0 { 1.0 / if alike { common } else { *s } } else { 0.0 })
                .collect();
            let middle: Vec<f64> = (0..width).map(|k| median(of(rows, k))).collect();
            let row = |row: &Vec<f64>| -> Vec<f64> {
                (0..width).map(|k| (row[k] - middle[k]) * size[k]).collect()
            };
            rows.iter().map(row).collect::<Vec<_>>()
        };
        let widths = (0..x[sound[0]].len()).map(|k| width(&of(x, k))).filter(|width| *width > 0.0);
        let (low, high) = widths.fold((f64::INFINITY, 0.0), |(l, h), w| (w.min(l), w.max(h)));
        let (inputs, targets) = (scaled(x, high <= 100.0 * low), scaled(y, false));
        let usual = (0..inputs[0].len()).map(|k| {
            let column = of(&inputs, k);
            [median(column.clone()), Scale::of(column.iter().copied()).spread, width(&column)]
        });
        let usual: Vec<[f64; 3]> = usual.collect();
        let left = left(&inputs, &targets, &sought, &usual);
        let misfit = (0..targets[0].len()).map(|k| {
            let sizes: Vec<f64> = sought.iter().map(|row| left[*row][k].abs()).collect();
            // 60 % of a normal variable lie within 0.84 deviations; wrong rows lie beyond these.
            quantile(sizes, 0.6) / 0.84
        });
        let misfit: Vec<f64> = misfit.collect();
        let least = misfit.iter().map(|misfit| {
            if *misfit > UNEXPLAINED { f64::INFINITY } else { GROSS.max(MISFIT * misfit) }
        });
        let least = least.collect();
        let spread =
            (0..targets[0].len()).map(|k| Scale::of(of(y, k).iter().copied()).spread).collect();
        let like = (sound.len() / ROWS_A_LIKE).min(LIKE);
        let columns = (0..inputs[0].len()).map(|k| of(&inputs, k));
        let columns = columns.chain((0..targets[0].len()).map(|k| of(&targets, k))).collect();
        Self { sound, like, sought, inputs, targets, columns, spread, left, misfit, least, usual }
    }

    fn found(&self, loose: bool) -> Vec<usize> {
        let off = |row: &usize| self.left[*row].iter().zip(&self.least).any(|(l, m)| l.abs() > *m);
        let (off, on): (Vec<usize>, Vec<usize>) = self.sound.iter().partition(|row| off(row));
        let inputs: Vec<usize> = (0..self.usual.len()).collect();
        let like =
            |row: usize| self.stands_out(row, &inputs, &|row| self.left[row].clone(), &self.least);
        let out: Vec<usize> = off.iter().copied().filter(|row| like(*row)).collect();
        let mut found = self.jumping(&out, &|row| self.left[row].clone(), loose);
        for (k, [middle, spread, width]) in self.usual.iter().enumerate() {
            if *spread == 0.0 {
                continue;
            }
            let value = |row: usize| vec![self.inputs[row][k] / spread];
            let others: Vec<usize> = (0..self.columns.len()).filter(|other| *other != k).collect();
            let far = |row: &&usize| (self.inputs[**row][k] - middle).abs() > FAR * width;
            let looked = off.iter().filter(|row| !found.contains(row)).chain(on.iter().filter(far));
            let out =
                looked.copied().filter(|row| self.stands_out(*row, &others, &value, &[GROSS]));
            let mut out: Vec<usize> = out.collect();
            out.sort_unstable();
            found.extend(self.jumping(&out, &value, loose));
        }
        found
    }

    /// Whether a row's values are far from those of the rows most similar in `columns`.
    fn stands_out(
        &self,
        row: usize,
        columns: &[usize],
        value: &dyn Fn(usize) -> Vec<f64>,
        least: &[f64],
    ) -> bool {
        let Some(others) = self.most_similar(row, columns) else { return false };
        let values: Vec<Vec<f64>> = others.iter().map(|(_, at)| value(self.sought[*at])).collect();
        let far = |(k, (own, least)): (usize, (&f64, &f64))| {
            let theirs: Vec<f64> = values.iter().map(|values| values[k]).collect();
            let middle = median(theirs.clone());
            let deviation = 1.4826 * median(theirs.iter().map(|v| (v - middle).abs()).collect());
            let off = (own - middle).abs();
            // Most rows are no outliers at any distance, which costs more to find.
            off > least.max(OUTLIER * deviation)
                && off > OUTLIER * deviation * self.farther(&others, columns)
        };
        value(row).iter().zip(least).enumerate().any(far)
    }

    /// Squared distances and places among the sought rows of the rows most similar in `columns`.
    ///
    /// `None` if there are too few rows at other moments.
    fn most_similar(&self, row: usize, columns: &[usize]) -> Option<Vec<(f64, usize)>> {
        let mut squares = vec![0.0; self.sought.len()];
        let own = [&self.inputs[row][..], &self.targets[row]].concat();
        for k in columns {
            for (square, other) in squares.iter_mut().zip(&self.columns[*k]) {
                *square += (own[*k] - other).powi(2);
            }
        }
        let apart = (APART * self.inputs.len() as f64) as usize;
        let mut nearest: Vec<(f64, usize)> = Vec::with_capacity(self.like + 2);
        for (at, (square, other)) in squares.into_iter().zip(&self.sought).enumerate() {
            let nears = nearest.get(self.like).is_none_or(|(most, _)| square < *most);
            if nears && other.abs_diff(row) > apart {
                let rank = nearest.partition_point(|(nearer, _)| *nearer <= square);
                nearest.insert(rank, (square, at));
                nearest.truncate(self.like + 1);
            }
        }
        (nearest.len() > self.like).then(|| {
            nearest.truncate(self.like);
            nearest
        })
    }

    /// Distance of a row from similar ones over theirs from their middle, at least 1.
    fn farther(&self, others: &[(f64, usize)], columns: &[usize]) -> f64 {
        let from_it = median(others.iter().map(|(square, _)| square.sqrt()).collect());
        let mut squares = vec![0.0; others.len()];
        for k in columns {
            let theirs: Vec<f64> = others.iter().map(|(_, at)| self.columns[*k][*at]).collect();
            let middle = median(theirs.clone());
            for (square, value) in squares.iter_mut().zip(theirs) {
                *square += (value - middle).powi(2);
            }
        }
        let from_middle = median(squares.into_iter().map(f64::sqrt).collect());
        (from_it / from_middle.max(1e-12)).max(1.0)
    }

    /// Keeps the rows of runs that begin or end with a jump.
    fn jumping(&self, out: &[usize], value: &dyn Fn(usize) -> Vec<f64>, loose: bool) -> Vec<usize> {
        // Positions among the sound rows; one row between two of them belongs to the run.
        let places: Vec<usize> =
            out.iter().filter_map(|row| self.sound.binary_search(row).ok()).collect();
        let runs = places.chunk_by(|a, b| b - a <= 2);
        let jumps = |run: &&[usize]| {
            let (first, last) = (run[0], run[run.len() - 1]);
            let at_end = first < END || last + END >= self.sound.len();
            if run.len() <= NEIGHBOURS && !loose && !at_end {
                return false;
            }
            let before = &self.sound[first.saturating_sub(END)..first];
            let after = &self.sound[last + 1..(last + 1 + END).min(self.sound.len())];
            let ends = [value(self.sound[first]), value(self.sound[last])];
            (0..ends[0].len()).any(|k| {
                let beside: Vec<f64> =
                    before.iter().chain(after).map(|row| value(*row)[k]).collect();
                let rest = median(beside);
                let inside = run.iter().map(|at| (value(self.sound[*at])[k] - rest).abs());
                let off = median(inside.collect());
                // In a loose recording the next row may be wrong as well.
                let from = |beside: &[usize], nearest: Option<&usize>, end: f64| match nearest {
                    None => 0.0,
                    Some(_) if loose => {
                        (end - median(beside.iter().map(|row| value(*row)[k]).collect())).abs()
                    }
                    Some(row) => (end - value(*row)[k]).abs(),
                };
                let begins = from(before, before.last(), ends[0][k]);
                let jump = begins.max(from(after, after.first(), ends[1][k]));
                off > GROSS && jump >= JUMP * off
            })
        };
        let sound = runs.filter(jumps).flatten().map(|at| self.sound[*at]);
        sound.collect()
    }
}

/// Residuals of a quadratic law, or of a linear one for few rows.
///
/// Wrong rows do not move the law, because it is reweighted iteratively: Huber's weights, then
/// Tukey's.
fn left(
    inputs: &[Vec<f64>],
    targets: &[Vec<f64>],
    fitted: &[usize],
    usual: &[[f64; 3]],
) -> Vec<Vec<f64>> {
    let width = usual.len();
    let terms = width * (width + 3) / 2;
    let bent = terms <= MOST_TERMS && fitted.len() >= ROWS_A_TERM * terms;
    let expansion = if bent { Expansion::Quadratic } else { Expansion::None };
    let terms = |row: &Vec<f64>| {
        let near = row
            .iter()
            .zip(usual)
            .map(|(x, [middle, _, width])| x.clamp(middle - 2.0 * width, middle + 2.0 * width));
        let mut terms = expansion.terms(&near.collect::<Vec<_>>());
        terms.push(1.0);
        terms
    };
    let all: Vec<Vec<f64>> = inputs.iter().map(terms).collect();
    let matrix = |rows: &[Vec<f64>]| {
        DMatrix::from_fn(fitted.len(), rows[0].len(), |i, k| rows[fitted[i]][k])
    };
    let (x, y) = (matrix(&all), matrix(targets));
    let mut weights = vec![1.0; fitted.len()];
    let mut law = DMatrix::zeros(x.ncols(), y.ncols());
    for round in 0..6 {
        let mut weighed = x.clone();
        weighed.row_iter_mut().zip(&weights).for_each(|(mut row, weight)| row *= *weight);
        let mut gram = x.tr_mul(&weighed);
        (0..gram.nrows()).for_each(|i| gram[(i, i)] += DECAY);
        let Some(factor) = Cholesky::new(gram) else { break };
        law = factor.solve(&weighed.tr_mul(&y));
        let error = &y - &x * &law;
        let sizes: Vec<f64> = error
            .column_iter()
            .map(|e| 1.4826 * median(e.iter().map(|e| e.abs()).collect()) + 1e-9)
            .collect();
        for (weight, error) in weights.iter_mut().zip(error.row_iter()) {
            let off = error.iter().zip(&sizes).map(|(e, size)| e.abs() / size).fold(0.0, f64::max);
            let tukey = (1.0 - (off / 6.0).min(1.0).powi(2)).powi(2);
            *weight = if round < 3 { (1.5 / off).min(1.0) } else { tukey.max(1e-6) };
        }
    }
    let columns: Vec<&[f64]> = (0..law.ncols())
        .map(|k| {
            let rows = law.nrows();
            &law.as_slice()[k * rows..(k + 1) * rows]
        })
        .collect();
    let of = |(terms, targets): (&Vec<f64>, &Vec<f64>)| {
        let said = columns.iter().map(|law| law.iter().zip(terms).map(|(l, t)| l * t).sum::<f64>());
        targets.iter().zip(said).map(|(target, said)| target - said).collect()
    };
    all.iter().zip(targets).map(of).collect()
}

/// Width of the range that holds nine of ten values.
fn width(values: &[f64]) -> f64 {
    quantile(values.to_vec(), 0.95) - quantile(values.to_vec(), 0.05)
}

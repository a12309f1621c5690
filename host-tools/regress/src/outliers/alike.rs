//! The wrong rows that the rows most like them tell.

use nalgebra::{Cholesky, DMatrix};

use super::NEIGHBOURS;
use crate::polynomial::Expansion;
use crate::quantile::{median, quantile};
use crate::scaling::Scale;
use crate::training::Recorded;

/// Rows most like one that it is compared with, of every so many that there are; and fewest that tell anything.
const LIKE: usize = 24;
const ROWS_A_LIKE: usize = 8;
const LEAST_LIKE: usize = 8;
/// Fewest rows in which outliers are found by the rows like them.
const LEAST_ROWS: usize = ROWS_A_LIKE * LEAST_LIKE;
/// Rows that they are sought among.
const SOUGHT: usize = 3000;
/// Rows before and after that are not: a share of the recording, for a run must not bear itself out.
const APART: f64 = 0.1;
/// A row is wrong if it stands out of those like it by so many of their deviations …
const OUTLIER: f64 = 8.0;
/// … by this share of the spread …
const GROSS: f64 = 0.3;
/// … and by so many times what the law leaves of most rows.
const MISFIT: f64 = 6.0;
/// A target of which the law leaves more than this share of the spread is not judged by.
const UNEXPLAINED: f64 = 0.1;
/// A run of wrong rows begins or ends with a jump of this share of how far it is off.
const JUMP: f64 = 0.7;
/// An input is looked at if it is so many times its usual width off its median.
const FAR: f64 = 0.9;
/// Rows at the end that have none beside them on one side.
const END: usize = 3;
/// Terms of the law, at most; and rows for each of them, at least.
const MOST_TERMS: usize = 200;
const ROWS_A_TERM: usize = 4;
/// Decay of the law, rows being scaled to about one.
const DECAY: f64 = 1.0;
/// What is found shows more: each time with what was found left out.
const PASSES: usize = 8;

/// Adds the wrong rows of a recording to those `known`; those that the rows beside them can tell only if it is `loose`.
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

/// The rows of a recording, scaled by those that are still taken for sound.
pub(super) struct Pass<'s> {
    sound: &'s [usize],
    /// Number of similar rows that a row is compared with.
    like: usize,
    /// Of the sound rows those that others are compared with.
    sought: Vec<usize>,
    /// Inputs and targets of each row.
    inputs: Vec<Vec<f64>>,
    pub targets: Vec<Vec<f64>>,
    /// Spread of the targets, in their own units.
    pub spread: Vec<f64>,
    /// What the law leaves of the targets.
    pub left: Vec<Vec<f64>>,
    /// How far most rows lie off the law.
    pub misfit: Vec<f64>,
    /// A target stands out by this at least.
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
            // Of a normal variable 60 % lie within 0.84 of its deviations; the wrong rows are no part of these.
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
        Self { sound, like, sought, inputs, targets, spread, left, misfit, least, usual }
    }

    fn found(&self, loose: bool) -> Vec<usize> {
        let off = |row: &usize| self.left[*row].iter().zip(&self.least).any(|(l, m)| l.abs() > *m);
        let (off, on): (Vec<usize>, Vec<usize>) = self.sound.iter().partition(|row| off(row));
        let all: Vec<usize> = (0..self.usual.len()).collect();
        let like = |row: usize| {
            self.stands_out(row, (&all, false), &|row| self.left[row].clone(), &self.least)
        };
        let out: Vec<usize> = off.iter().copied().filter(|row| like(*row)).collect();
        let mut found = self.jumping(&out, &|row| self.left[row].clone(), loose);
        for (k, [middle, spread, width]) in self.usual.iter().enumerate() {
            if *spread == 0.0 {
                continue;
            }
            let value = |row: usize| vec![self.inputs[row][k] / spread];
            let others: Vec<usize> = all.iter().copied().filter(|other| *other != k).collect();
            let far = |row: &&usize| (self.inputs[**row][k] - middle).abs() > FAR * width;
            let looked = off.iter().filter(|row| !found.contains(row)).chain(on.iter().filter(far));
            let out = looked
                .copied()
                .filter(|row| self.stands_out(*row, (&others, true), &value, &[GROSS]));
            let mut out: Vec<usize> = out.collect();
            out.sort_unstable();
            found.extend(self.jumping(&out, &value, loose));
        }
        found
    }

    /// Whether a row's values are far from those of the rows most like it in some inputs and, perhaps, the targets.
    fn stands_out(
        &self,
        row: usize,
        (inputs, targets): (&[usize], bool),
        value: &dyn Fn(usize) -> Vec<f64>,
        least: &[f64],
    ) -> bool {
        let place = |row: usize| {
            let inputs = inputs.iter().map(move |k| self.inputs[row][*k]);
            inputs.chain(self.targets[row].iter().copied().take(if targets {
                usize::MAX
            } else {
                0
            }))
        };
        let distance = |a: usize, b: usize| -> f64 {
            place(a).zip(place(b)).map(|(a, b)| (a - b).powi(2)).sum()
        };
        let apart = (APART * self.inputs.len() as f64) as usize;
        let others = self.sought.iter().copied().filter(|other| other.abs_diff(row) > apart);
        let mut others: Vec<(f64, usize)> =
            others.map(|other| (distance(row, other), other)).collect();
        if others.len() <= self.like {
            return false;
        }
        others.select_nth_unstable_by(self.like, |a, b| a.0.total_cmp(&b.0));
        others.truncate(self.like);
        // How far it is from them, and they from their middle.
        let from_it = median(others.iter().map(|(square, _)| square.sqrt()).collect());
        let like: Vec<Vec<f64>> = others.iter().map(|(_, other)| place(*other).collect()).collect();
        let middle: Vec<f64> =
            (0..like[0].len()).map(|k| median(like.iter().map(|l| l[k]).collect())).collect();
        let from_middle = like
            .iter()
            .map(|like| like.iter().zip(&middle).map(|(l, m)| (l - m).powi(2)).sum::<f64>().sqrt());
        let farther = (from_it / median(from_middle.collect()).max(1e-12)).max(1.0);
        let values: Vec<Vec<f64>> = others.iter().map(|(_, other)| value(*other)).collect();
        value(row).iter().zip(least).enumerate().any(|(k, (own, least))| {
            let theirs: Vec<f64> = values.iter().map(|values| values[k]).collect();
            let middle = median(theirs.clone());
            let deviation = 1.4826 * median(theirs.iter().map(|v| (v - middle).abs()).collect());
            (own - middle).abs() > least.max(OUTLIER * deviation * farther)
        })
    }

    /// Of rows that stand out those in runs that begin or end with a jump.
    fn jumping(&self, out: &[usize], value: &dyn Fn(usize) -> Vec<f64>, loose: bool) -> Vec<usize> {
        // By their place among the sound rows; one between two of them belongs to the run.
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
                // Of a loose recording the next row may be wrong as well.
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

/// What a law of products, or a line where rows are few, leaves of the targets; wrong rows among those that it is
/// fitted to do not move it (iteratively reweighted: Huber's weights, then Tukey's).
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

/// What nine of ten values lie within.
fn width(values: &[f64]) -> f64 {
    quantile(values.to_vec(), 0.95) - quantile(values.to_vec(), 0.05)
}

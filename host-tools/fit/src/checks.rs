//! What recordings cannot bear: rows that are wrong, and channels that say the same.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::gaussian::Rows;
use crate::line;
use crate::model::Recorded;
use crate::scaling::{Inputs, Scaling};

/// Decay of the lines below, rows being scaled to about one.
const DECAY: f64 = 1e-3;
/// A row is wrong if it stands out of its neighbours by so many of their own deviations …
const OUTLIER: f64 = 8.0;
/// … and by this share of the target's spread.
const GROSS: f64 = 0.05;
/// Neighbours on either side that it is compared with (Hampel's identifier).
const NEIGHBOURS: usize = 3;
/// More rows than this are no outliers but what the recording is.
const MOST: f64 = 0.15;
/// Channels whose combination is weaker than this share of the strongest say the same.
const SAME: f64 = 1e-6;
/// A channel has part in a combination with a weight of this at least.
const PART: f64 = 0.2;

fn scaled(recordings: &[Recorded]) -> (Scaling, Rows) {
    let x: Vec<&[f64]> = recordings.iter().flat_map(|r| &r.0).map(Vec::as_slice).collect();
    let y: Vec<&[f64]> = recordings.iter().flat_map(|r| &r.1).map(Vec::as_slice).collect();
    let scaling = Scaling::of(&x, &y, Inputs::Unlike);
    let number = recordings.iter().enumerate();
    let stretch = number.flat_map(|(i, r)| std::iter::repeat_n(i, r.0.len())).collect();
    let rows = Rows { x: scaling.inputs(&x), y: scaling.targets(&y), stretch };
    (scaling, rows)
}

/// Takes out rows that stand alone: their error against a straight line is far off that of the rows before
/// and after. What bends, drifts or lags does so over many rows and stays. Returns how many were taken.
pub(crate) fn remove_outliers(recordings: &mut [Recorded]) -> usize {
    let (_, rows) = scaled(recordings);
    line::residual(&rows, DECAY).map_or(0, |residual| remove(recordings, &residual))
}

/// The same by the error against a law that the rows obey: a line would take a law's own jumps for outliers.
pub(crate) fn remove_outliers_of(
    recordings: &mut [Recorded],
    law: impl Fn(&[f64]) -> Vec<f64>,
) -> usize {
    let (scaling, rows) = scaled(recordings);
    let said: Vec<Vec<f64>> = recordings.iter().flat_map(|(x, _)| x).map(|x| law(x)).collect();
    let residual = scaling.targets(&said) - rows.y;
    remove(recordings, &residual)
}

fn remove(recordings: &mut [Recorded], residual: &DMatrix<f64>) -> usize {
    let mut wrong = vec![false; residual.nrows()];
    let mut first = 0;
    for (x, _) in recordings.iter() {
        for error in residual.rows(first, x.len()).column_iter() {
            let error: Vec<f64> = error.iter().copied().collect();
            let near: Vec<Option<[f64; 3]>> = (0..error.len()).map(|i| around(&error, i)).collect();
            let off = error.iter().zip(&near).filter_map(|(e, near)| Some((e - (*near)?[1]).abs()));
            let limit = (OUTLIER * 1.4826 * median(off.collect())).max(GROSS);
            for (i, (e, near)) in error.iter().zip(near).enumerate() {
                wrong[first + i] |=
                    near.is_some_and(|[low, _, high]| *e < low - limit || *e > high + limit);
            }
        }
        first += x.len();
    }
    let count = wrong.iter().filter(|wrong| **wrong).count();
    if count as f64 > MOST * wrong.len() as f64 {
        return 0;
    }
    let mut wrong = wrong.iter();
    for (x, y) in recordings {
        let keep: Vec<bool> = wrong.by_ref().take(x.len()).map(|wrong| !wrong).collect();
        let (mut of_x, mut of_y) = (keep.iter(), keep.iter());
        x.retain(|_| of_x.next() == Some(&true));
        y.retain(|_| of_y.next() == Some(&true));
    }
    count
}

/// Of the errors about a row, itself left out: the second lowest, the median and the second highest, so
/// that another outlier among them does no harm. `None` for the ends, which have no row on one side.
fn around(error: &[f64], row: usize) -> Option<[f64; 3]> {
    let before = error.get(row.checked_sub(NEIGHBOURS)?..row)?;
    let after = error.get(row + 1..row + 1 + NEIGHBOURS)?;
    let mut near = [before, after].concat();
    near.sort_by(f64::total_cmp);
    Some([near[1], median(near.clone()), near[near.len() - 2]])
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[middle],
        _ => 0.5 * (values[middle - 1] + values[middle]),
    }
}

/// How evenly the channels move, each scaled by its own spread; those that do not move at all are left out.
pub(crate) struct Conditioning {
    /// Condition number of the data.
    pub number: f64,
    /// Numbers of the channels that have part in the combination that moves least.
    pub weakest: Vec<usize>,
}

impl Conditioning {
    /// The combination says nothing that the other channels do not.
    pub fn is_collinear(&self) -> bool {
        self.number > 1.0 / SAME
    }
}

/// `None` where fewer than two channels move.
pub(crate) fn conditioning(recordings: &[Recorded]) -> Option<Conditioning> {
    let (scaling, rows) = scaled(recordings);
    let moving: Vec<usize> =
        (0..scaling.inputs.len()).filter(|i| scaling.inputs[*i].spread > 0.0).collect();
    if moving.len() < 2 {
        return None;
    }
    let x: DMatrix<f64> = rows.x.select_columns(&moving);
    let eigen = SymmetricEigen::new(x.tr_mul(&x));
    let (least, most) = (eigen.eigenvalues.imin(), eigen.eigenvalues.max());
    let ratio = (eigen.eigenvalues[least].max(0.0) / most).sqrt();
    let weights = eigen.eigenvectors.column(least);
    let part = moving.iter().zip(weights.iter()).filter(|(_, w)| w.abs() > PART);
    let weakest = part.map(|(i, _)| *i).collect();
    Some(Conditioning { number: 1.0 / ratio.max(1e-15), weakest })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three channels and a bent force that wanders.
    fn recording(rows: usize) -> Recorded {
        let x: Vec<Vec<f64>> = (0..rows)
            .map(|row| row as f64 * 0.05)
            .map(|t| vec![30.0 * t.sin(), 20.0 * (1.7 * t).cos(), 4.0 * (0.6 * t).sin()])
            .collect();
        let y = x.iter().map(|x| vec![0.1 * x[0] + (x[1] / 8.0).tanh()]).collect();
        (x, y)
    }

    #[test]
    fn rows_that_stand_alone_are_taken_out_and_no_others() {
        let mut good = [recording(800)];
        assert_eq!(remove_outliers(&mut good), 0);
        let mut bad = [recording(800)];
        let clean = bad[0].clone();
        for row in (7..800).step_by(20) {
            bad[0].1[row][0] += if row % 40 == 7 { 3.0 } else { -2.0 };
        }
        assert_eq!(remove_outliers(&mut bad), 40);
        let kept: Vec<usize> = (0..800).filter(|row| row % 20 != 7).collect();
        assert_eq!(bad[0].0, kept.iter().map(|row| clean.0[*row].clone()).collect::<Vec<_>>());
        assert_eq!(bad[0].1, kept.iter().map(|row| clean.1[*row].clone()).collect::<Vec<_>>());
    }

    #[test]
    fn a_channel_that_repeats_others_is_found_with_them() {
        let mut recording = recording(300);
        let even = conditioning(std::slice::from_ref(&recording)).unwrap();
        assert!(even.number < 2.0 && !even.is_collinear(), "{}", even.number);
        recording.0.iter_mut().for_each(|x| x[2] = 0.5 * x[0] - 3.0);
        let found = conditioning(&[recording]).unwrap();
        assert!(found.weakest == [0, 2] && found.is_collinear(), "{:?}", found.weakest);
    }
}

//! Detection of outlier rows: a loose contact, a stuck reference.
//!
//! A row that stands alone is found by the rows before and after it (Hampel's identifier). A run of wrong rows, or one
//! at the end of a recording, has nothing right beside it: it is found by the rows of other moments that are most like
//! it. What the law of all rows leaves of its targets, or one of its inputs, lies farther off theirs than
//!
//! - they lie apart, by far, and the more so the farther from them it is: where a law is bad or no press like it was
//!   recorded, sound rows lie off just so;
//! - the law leaves of most rows: a target that it does not explain tells nothing.
//!
//! And it begins or ends with a jump, for a press that is unlike all others grows out of the rows about it. Each
//! recording is judged by itself: another day's may well say something else.
//!
//! A reference that stays at zero over whole presses never jumps: it is told by standing still (`still`).

mod alike;
mod still;

use nalgebra::DMatrix;

use crate::duplicate_channels::scaled;
use crate::error::FitError;
use crate::quantile::median;
use crate::ridge;
use crate::training::Recorded;

/// Decay of the line below, rows being scaled to about one.
const DECAY: f64 = 1e-3;
/// A row is wrong if it stands out of its neighbours by so many of their own deviations …
const OUTLIER: f64 = 8.0;
/// … and by this share of the target's spread.
const GROSS: f64 = 0.05;
/// Neighbours on either side that it is compared with (Hampel's identifier).
const NEIGHBOURS: usize = 3;
/// If more rows than this stand alone, that is what the recordings are.
const ALONE: f64 = 0.15;
/// A recording with more wrong rows than this is none to fit to.
const MOST: f64 = 0.2;
/// Where so many rows stand alone, others that only the rows like them tell do so as well.
const LOOSE: f64 = 0.01;

/// Expected targets for a row of inputs.
type Law<'l> = &'l dyn Fn(&[f64]) -> Vec<f64>;

/// The wrong rows of some recordings.
pub struct Outliers {
    /// Flag of every row of each recording.
    pub wrong: Vec<Vec<bool>>,
    /// Warnings about them, in full sentences.
    pub told: Vec<String>,
}

impl Outliers {
    /// Finds them; `law` is what the rows obey, if that is known: a line would take a law's own jumps for outliers.
    ///
    /// # Errors
    /// A recording of which too many rows are wrong.
    pub fn find(
        recordings: &[Recorded],
        names: &[String],
        law: Option<Law<'_>>,
    ) -> Result<Self, FitError> {
        let still: Vec<Vec<bool>> = recordings.iter().map(still::wrong).collect();
        let wrong = wrong(recordings, law, &still);
        let mut said = Vec::new();
        for ((wrong, still), name) in wrong.iter().zip(&still).zip(names) {
            said.extend(told(wrong, still, name)?);
        }
        Ok(Self { wrong, told: said })
    }

    /// The recordings without them.
    pub fn remove_from(&self, recordings: &mut [Recorded]) {
        for (wrong, (x, y)) in self.wrong.iter().zip(recordings) {
            keep_sound(x, wrong);
            keep_sound(y, wrong);
        }
    }
}

/// Keeps the rows that are not flagged in `wrong`.
pub fn keep_sound<'w, R>(rows: &mut Vec<R>, wrong: impl IntoIterator<Item = &'w bool>) {
    let mut wrong = wrong.into_iter();
    rows.retain(|_| wrong.next() == Some(&false));
}

fn count(wrong: &[bool]) -> usize {
    wrong.iter().filter(|wrong| **wrong).count()
}

/// Warnings about a recording with `wrong` rows, in some of which the reference stands `still`.
fn told(wrong: &[bool], still: &[bool], name: &str) -> Result<Vec<String>, FitError> {
    let rows = wrong.len();
    let percent = |count: usize| 1e2 * count as f64 / rows as f64;
    let still = count(still);
    let others = count(wrong) - still;
    let mut found = Vec::new();
    if still > 0 {
        found.push((
            format!(
                "in {still} of {rows} rows ({:.0} %) the reference stays at zero while the inputs say that something presses",
                percent(still)
            ),
            "look for a load cell that came off",
        ));
    }
    if others > 0 {
        found.push((
            format!(
                "{others} of {rows} rows ({:.0} %) stand far out of the rows before and after them or of those like them",
                percent(others)
            ),
            "look for a loose contact",
        ));
    }
    if percent(still + others) > 1e2 * MOST {
        let problems: Vec<String> = found.iter().map(|(found, _)| found.clone()).collect();
        let mends: Vec<&str> = found.iter().map(|(_, mend)| *mend).collect();
        return Err(FitError::Mismatch {
            recording: name.to_owned(),
            problem: format!("{}, which is more than can be left out", problems.join(", and ")),
            mend: format!("{} and record again", mends.join(" and ")),
        });
    }
    let told = |(found, mend)| format!("{name}: {found}, and were left out; {mend}");
    Ok(found.into_iter().map(told).collect())
}

/// Flags of the wrong rows of each recording.
fn wrong(recordings: &[Recorded], law: Option<Law<'_>>, still: &[Vec<bool>]) -> Vec<Vec<bool>> {
    let (scaling, rows) = scaled(recordings);
    let residual = match law {
        Some(law) => {
            let said: Vec<Vec<f64>> =
                recordings.iter().flat_map(|(x, _)| x).map(|x| law(x)).collect();
            Some(scaling.targets(&said) - rows.y)
        }
        None => ridge::residual(&rows, DECAY),
    };
    let Some(residual) = residual else {
        return still.to_vec();
    };
    let alone = alone(recordings, &residual);
    let all: usize = alone.iter().map(Vec::len).sum();
    let usual = alone.iter().map(|a| count(a)).sum::<usize>() as f64 > ALONE * all as f64;
    let judged = recordings.iter().zip(alone).zip(still).map(|((recorded, alone), still)| {
        let loose = count(&alone) as f64 > LOOSE * alone.len() as f64;
        let known = alone.into_iter().zip(still).map(|(alone, still)| alone && !usual || *still);
        let known = known.collect();
        alike::wrong(recorded, known, loose)
    });
    judged.collect()
}

/// The rows whose error is far off that of the rows before and after. What bends, drifts or lags does so over many
/// rows and stays.
fn alone(recordings: &[Recorded], residual: &DMatrix<f64>) -> Vec<Vec<bool>> {
    let mut first = 0;
    let each = recordings.iter().map(|(x, _)| {
        let mut wrong = vec![false; x.len()];
        for error in residual.rows(first, x.len()).column_iter() {
            let error: Vec<f64> = error.iter().copied().collect();
            let near: Vec<Option<[f64; 3]>> = (0..error.len()).map(|i| around(&error, i)).collect();
            let off = error.iter().zip(&near).filter_map(|(e, near)| Some((e - (*near)?[1]).abs()));
            let limit = (OUTLIER * 1.4826 * median(off.collect())).max(GROSS);
            for (wrong, (e, near)) in wrong.iter_mut().zip(error.iter().zip(near)) {
                *wrong |= near.is_some_and(|[low, _, high]| *e < low - limit || *e > high + limit);
            }
        }
        first += x.len();
        wrong
    });
    each.collect()
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

#[cfg(test)]
mod tests;

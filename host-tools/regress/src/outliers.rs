//! Detection of outlier rows: a loose contact, a stuck reference.
//!
//! A single wrong row is found by comparison with the rows before and after it (Hampel's
//! identifier). A run of wrong rows, or one at the end of a recording, has no sound neighbours. It
//! is found by comparison with the most similar rows of other moments. A wrong row's residual of
//! the law fitted to all rows, or one of its inputs, differs from theirs by more than
//!
//! - a multiple of their scatter, which grows with their distance: where a law is bad or no similar
//!   press was recorded, sound rows differ as much;
//! - a multiple of the law's usual residual: a target that the law does not explain gives no
//!   evidence.
//!
//! A wrong run also begins or ends with a jump, because a sound press unlike all others grows out
//! of the rows around it. Each recording is judged separately, because another day's may well
//! differ.
//!
//! A reference that stays at zero over whole presses never jumps: it is found by standing still
//! (`still`).

mod alike;
mod still;

use nalgebra::DMatrix;

use crate::duplicate_channels::scaled;
use crate::error::FitError;
use crate::quantile::median;
use crate::ridge;
use crate::training::Recorded;

/// Decay of the ridge fit, with rows scaled to about one.
const DECAY: f64 = 1e-3;
/// Least distance of a wrong row from its neighbours, in their own deviations …
const OUTLIER: f64 = 8.0;
/// … and as a share of the target's spread.
const GROSS: f64 = 0.05;
/// Neighbours on either side of a compared row (Hampel's identifier).
const NEIGHBOURS: usize = 3;
/// Largest share of single outliers; beyond it they are the nature of the recordings.
const ALONE: f64 = 0.15;
/// Largest share of wrong rows in a usable recording.
const MOST: f64 = 0.2;
/// Share of single outliers above which a recording is loose, with shorter wrong runs.
const LOOSE: f64 = 0.01;

/// Expected targets for a row of inputs.
type Law<'l> = &'l dyn Fn(&[f64]) -> Vec<f64>;

/// Wrong rows of some recordings.
pub struct Outliers {
    /// Flag of every row of each recording.
    pub wrong: Vec<Vec<bool>>,
    /// Warnings about the wrong rows, in full sentences.
    pub told: Vec<String>,
}

impl Outliers {
    /// Finds the wrong rows; `law` is the known relation of the rows, if there is one.
    ///
    /// Without it, a fitted line would take the law's own jumps for outliers.
    ///
    /// # Errors
    ///
    /// A recording with too many wrong rows.
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

    /// Removes the wrong rows from the recordings.
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

/// Warnings about a recording with `wrong` rows, including those where the reference stands
/// `still`.
fn told(wrong: &[bool], still: &[bool], name: &str) -> Result<Vec<String>, FitError> {
    let rows = wrong.len();
    let percent = |count: usize| 1e2 * count as f64 / rows as f64;
    let still = count(still);
    let others = count(wrong) - still;
    let mut found = Vec::new();
    if still > 0 {
        found.push((
            format!(
                "in {still} of {rows} rows ({:.0} %) the reference stays at zero while the inputs show a load",
                percent(still)
            ),
            "look for a load cell that came off",
        ));
    }
    if others > 0 {
        found.push((
            format!(
                "{others} of {rows} rows ({:.0} %) stand far out from their neighbours or from similar rows",
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

/// Flags rows with an error far from that of the rows before and after.
///
/// Bends, drift and lag extend over many rows and stay.
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

/// Second lowest, median and second highest error of the neighbours of a row.
///
/// Another outlier among them does no harm. `None` at the ends, which lack rows on one side.
fn around(error: &[f64], row: usize) -> Option<[f64; 3]> {
    let before = error.get(row.checked_sub(NEIGHBOURS)?..row)?;
    let after = error.get(row + 1..row + 1 + NEIGHBOURS)?;
    let mut near = [before, after].concat();
    near.sort_by(f64::total_cmp);
    Some([near[1], median(near.clone()), near[near.len() - 2]])
}

#[cfg(test)]
mod tests;

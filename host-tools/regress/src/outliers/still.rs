//! Rows in which the reference stays at zero while something presses: a load cell that came off.
//!
//! Such a stretch begins and ends unloaded, without a jump, and may be a good part of a recording.
//! Its targets are equal to the last digit, at zero, in row after row. Meanwhile a law of the other
//! rows predicts a load from the inputs, with zero at both ends. A held slide stands still as well,
//! but under a load. The inputs of a skin that creeps back after a press begin far from zero.

use std::ops::Range;

use super::alike::Pass;
use crate::quantile::{median, quantile};
use crate::training::Recorded;

/// Fewest rows in a stretch.
const LEAST: usize = 8;
/// Fewest rows for the fit of the law, and their least share of the recording.
///
/// A reference with coarse steps stands still by nature.
const LEAST_MOVING: usize = 64;
const MOVING: f64 = 0.1;
/// Largest reading that counts as zero, as a share of the target's usual magnitude.
const ZERO: f64 = 0.02;
/// Largest residual of the law, as a share of the spread, at which a target is used.
const UNEXPLAINED: f64 = 0.3;
/// Least load predicted by the law, in multiples of its usual residual, …
const MISFIT: f64 = 6.0;
/// … and as a share of the target's range elsewhere. At the ends it is at most half as much.
const MOVED: f64 = 0.3;
/// Least residual of a wrong row in such a stretch, in usual residuals.
const OFF: f64 = 3.0;
/// Rows on either side of the median that removes spikes.
const BESIDE: usize = 2;

/// Flags the rows of a recording in which the reference is stuck.
pub(super) fn wrong((x, y): &Recorded) -> Vec<bool> {
    let mut wrong = vec![false; x.len()];
    let zero: Vec<f64> = (0..y.first().map_or(0, Vec::len))
        .map(|k| ZERO * quantile(y.iter().map(|y| y[k].abs()).collect(), 0.95))
        .collect();
    let mut stretches = Vec::new();
    let mut first = 0;
    for same in y.chunk_by(|a, b| a == b) {
        let rests = same[0].iter().zip(&zero).all(|(y, zero)| y.abs() <= *zero);
        if same.len() >= LEAST && rests {
            stretches.push(first..first + same.len());
        }
        first += same.len();
    }
    let outside = |stretches: &[Range<usize>]| -> Vec<usize> {
        let mut stands = vec![false; x.len()];
        stretches.iter().cloned().for_each(|rows| stands[rows].fill(true));
        (0..x.len()).filter(|row| !stands[*row]).collect()
    };
    let moving = outside(&stretches);
    if stretches.is_empty()
        || moving.len() < LEAST_MOVING
        || (moving.len() as f64) < MOVING * x.len() as f64
    {
        return wrong;
    }
    let pass = Pass::new(x, y, &moving);
    let told: Vec<usize> =
        (0..pass.misfit.len()).filter(|k| pass.misfit[*k] < UNEXPLAINED).collect();
    // Least load of a stuck reference, for each target.
    let far: Vec<f64> = (0..pass.misfit.len())
        .map(|k| {
            let elsewhere = || moving.iter().map(|row| pass.targets[*row][k]).collect();
            let [least, most] = [0.05, 0.95].map(|share| quantile(elsewhere(), share));
            (MOVED * (most - least)).max(MISFIT * pass.misfit[k])
        })
        .collect();
    let pressed = |rows: &Range<usize>, k: usize| {
        // Residual of the law, with spikes smoothed away.
        let off: Vec<f64> = rows
            .clone()
            .map(|row| {
                let near =
                    row.saturating_sub(BESIDE).max(rows.start)..(row + BESIDE + 1).min(rows.end);
                median(near.map(|row| pass.left[row][k].abs()).collect())
            })
            .collect();
        let ends = off[0].max(off[off.len() - 1]);
        off.iter().copied().fold(0.0, f64::max) > far[k] && ends < 0.5 * far[k]
    };
    stretches.retain(|rows| told.iter().any(|k| pressed(rows, *k)));
    if stretches.is_empty() {
        return wrong;
    }
    // Refit with the sound rests included, which improves predictions at rest.
    let sound = outside(&stretches);
    let surer = Pass::new(x, y, &sound);
    for row in stretches.into_iter().flatten() {
        let off = |k: &usize| {
            surer.left[row][*k].abs() * surer.spread[*k] > OFF * pass.misfit[*k] * pass.spread[*k]
        };
        wrong[row] = told.iter().any(off);
    }
    wrong
}

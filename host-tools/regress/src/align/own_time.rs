//! Detection of a misaligned reference among rows that share one time column.

use super::search::{MOST_RATES, Trace, rates};
use super::{Alignment, LEAST_CORRELATION, LEAST_ROWS, Series, align, refine, refine_from};
use crate::quantile::{median, quantile};

/// Correlation of a repeating load above which drift is not searched for.
const GOOD_CORRELATION: f64 = 0.9;

/// Finds the alignment of a reference that fits much better at other times.
///
/// Returned if the residual of a linear fit falls to less than half there, and the shift exceeds
/// two rows at the first or last row.
#[must_use]
pub fn misaligned(sensor: Series<'_>, targets: &[Vec<f64>]) -> Option<Alignment> {
    let reference = Series { times: sensor.times, rows: targets };
    if sensor.times.len() < LEAST_ROWS
        || sensor.times.len() != sensor.rows.len()
        || sensor.times.windows(2).any(|pair| pair[1] <= pair[0])
    {
        return None;
    }
    // Clips spikes first, because a loose contact in both would be aligned with itself.
    let (own, theirs) = (steadied(sensor.rows), steadied(targets));
    let (sensor, reference) =
        (Series { rows: &own, ..sensor }, Series { rows: &theirs, ..reference });
    let here = || Some(refine_from(sensor, &Trace::new(reference)?, 0.0, 0.0, 0));
    // A repeating load leaves the offset open; assume that both clocks began together.
    let drifted = || {
        let good = here()?.correlation > GOOD_CORRELATION;
        if good { None } else { drifting(sensor, reference) }
    };
    let found = align([""; 2], sensor, reference).ok().or_else(drifted)?;
    let here = here()?;
    let (first, last) = (*sensor.times.first()?, *sensor.times.last()?);
    let row = (last - first) / sensor.times.len() as f64;
    let off = [first, last].into_iter().map(|t| (found.time(t) - t).abs()).fold(0.0, f64::max);
    let left = |alignment: &Alignment| 1.0 - alignment.correlation.powi(2);
    (off > 2.0 * row && left(&found) < 0.5 * left(&here)).then_some(found)
}

/// Replaces each column by its median of five rows.
///
/// The median is clamped to half the column's 5–95 % width beyond either quantile.
fn steadied(rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    const BESIDE: usize = 2;
    let mut steady = rows.to_vec();
    for k in 0..rows.first().map_or(0, Vec::len) {
        let column: Vec<f64> = rows.iter().map(|row| row[k]).collect();
        let [low, high] = [0.05, 0.95].map(|share| quantile(column.clone(), share));
        let beyond = if high > low { 0.5 * (high - low) } else { f64::MAX };
        for (at, row) in steady.iter_mut().enumerate() {
            let near = at.saturating_sub(BESIDE)..(at + BESIDE + 1).min(rows.len());
            let middle = median(rows[near].iter().map(|row| row[k]).collect());
            row[k] = middle.clamp(low - beyond, high + beyond);
        }
    }
    steady
}

/// Finds the best alignment of clocks that began together.
fn drifting(sensor: Series<'_>, reference: Series<'_>) -> Option<Alignment> {
    let other = Trace::new(reference)?;
    let first = *sensor.times.first()?;
    let from = rates(MOST_RATES).map(|rate| refine_from(sensor, &other, -rate * first, rate, 0));
    let best = from.max_by(|a, b| a.correlation.total_cmp(&b.correlation))?;
    let refined = refine(sensor, &other, best.offset, best.rate);
    (refined.correlation >= LEAST_CORRELATION).then_some(refined)
}

/// Formats the warning about a reference realigned by [`misaligned`].
///
/// `first` is the time at which the recording begins, in seconds.
pub fn off_time(recording: &str, found: &Alignment, first: f64) -> String {
    format!(
        "{recording}: the reference fits far better {:+.3} s off at a rate {:+.2} % off and was read there, within \
         {:.1} ms; log it with its own times and give it with --reference",
        found.time(first) - first,
        1e2 * found.rate,
        1e3 * found.residual
    )
}

//! Alignment in time of a reference logged by another clock.
//!
//! Sensor and reference respond to the same load. The first principal component of each one's
//! columns is cross-correlated at every offset and at rates up to ± 5 % apart. Gauss–Newton refines
//! the best of these: the reference read at t′ = offset + rate·t should be linear in the sensor's
//! channels. Slopes, offset and rate are one least-squares problem a step.

mod own_time;
mod search;
mod stamps;

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::error::FitError;
use search::{Trace, search};

pub use own_time::misaligned;
pub use own_time::off_time;
pub use stamps::told_apart;

/// Fewest rows of sensor and of reference.
const LEAST_ROWS: usize = 32;
/// Lowest correlation of a common load.
const LEAST_CORRELATION: f64 = 0.5;
/// Share of the best correlation at which a second offset makes the alignment ambiguous.
const AMBIGUOUS: f64 = 0.97;
/// Most Gauss–Newton steps, and most rows that they use.
const STEPS: usize = 20;
const MOST_ROWS: usize = 6000;
/// Number of segments in which the remaining misalignment is measured.
const SEGMENTS: usize = 8;
/// Longest gap of the reference that is bridged, in median steps.
const GAP: f64 = 5.0;
/// Steps this many times shorter than the median are those of a burst.
const BURST: f64 = 3.0;

/// Rows with their times in seconds.
#[derive(Clone, Copy, Debug)]
pub struct Series<'s> {
    /// Times, rising.
    pub times: &'s [f64],
    /// Columns of each row.
    pub rows: &'s [Vec<f64>],
}

/// Time of the reference: t′ = `offset` + (1 + `rate`)·t for the sensor's time t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Offset in seconds.
    pub offset: f64,
    /// Relative rate by which the reference's clock runs faster.
    pub rate: f64,
    /// RMS misalignment left in segments of the recording, in seconds.
    pub residual: f64,
    /// Correlation of the reference with its linear prediction from the sensor's channels.
    pub correlation: f64,
}

impl Alignment {
    /// The reference's time at a time of the sensor.
    #[must_use]
    pub fn time(&self, t: f64) -> f64 {
        self.offset + (1.0 + self.rate) * t
    }

    /// The sensor's time at a time of the reference.
    #[must_use]
    pub fn own_time(&self, t: f64) -> f64 {
        (t - self.offset) / (1.0 + self.rate)
    }
}

/// Finds offset and rate; the names appear in error messages.
///
/// # Errors
/// Too low a correlation, or a repeating load that several offsets fit.
pub fn align(
    [sensor_name, reference_name]: [&str; 2],
    sensor: Series<'_>,
    reference: Series<'_>,
) -> Result<Alignment, FitError> {
    let refused = |name: &str, problem: String, mend: &str| FitError::Unaligned {
        recording: name.to_owned(),
        problem,
        mend: mend.to_owned(),
    };
    for (name, series) in [(sensor_name, sensor), (reference_name, reference)] {
        if series.times.len() < LEAST_ROWS || series.times.len() != series.rows.len() {
            let rows = series.times.len();
            let problem = format!("{rows} rows with a time where {LEAST_ROWS} are needed");
            return Err(refused(
                name,
                problem,
                "name the time column t_s or t_us, and record for longer",
            ));
        }
        if let Some(pair) = series.times.windows(2).find(|pair| pair[1] <= pair[0]) {
            let problem = format!("after {} s comes {} s", pair[0], pair[1]);
            return Err(refused(name, problem, "log the time of each row, rising"));
        }
    }
    let changing = |name, series| {
        let never = || refused(name, "it never changes".into(), "record presses with both");
        Trace::new(series).ok_or_else(never)
    };
    let own = changing(sensor_name, sensor)?;
    let other = changing(reference_name, reference)?;
    let coarse = search(&own, &other);
    if coarse.correlation < LEAST_CORRELATION {
        return Err(refused(
            reference_name,
            format!(
                "sensor and reference correlate by {:.2} at best (the sensor's times run {}, the reference's {})",
                coarse.correlation,
                span(sensor.times),
                span(reference.times)
            ),
            "check that both saw the same presses",
        ));
    }
    if coarse.second > AMBIGUOUS * coarse.correlation {
        return Err(refused(
            reference_name,
            "the load repeats itself, so that several offsets would do".into(),
            "tap the sensor a few times at uneven intervals before and after",
        ));
    }
    Ok(refine(sensor, &other, coarse.offset, coarse.rate))
}

/// Returns the error of a reference without a row near any of the sensor's `times`.
pub fn apart(name: &str, times: &[f64], reference: &[f64]) -> FitError {
    FitError::Unaligned {
        recording: name.to_owned(),
        problem: format!(
            "no row of it belongs to the sensor's: by its clock those run {}, and its own {}",
            span(times),
            span(reference)
        ),
        mend: "give the log of the same presses, without gaps".to_owned(),
    }
}

fn span(times: &[f64]) -> String {
    match times {
        [first, .., last] => format!("from {first:.1} to {last:.1} s"),
        _ => "nowhere".to_owned(),
    }
}

/// Interpolates a reference at times of its own clock by cubics through four readings (Catmull and
/// Rom 1974); `None` where no row is near.
///
/// A straight line between readings cuts the tops off short presses: with 20 of them in a press, by
/// half a percent of its force. It stays straight beside a gap and where readings come in bursts.
#[must_use]
pub fn resample(reference: Series<'_>, times: &[f64]) -> Vec<Option<Vec<f64>>> {
    let Series { times: known, rows } = reference;
    let usual = median_step(known);
    let even = |i: usize| {
        let step = known.get(i + 1).map_or(f64::MAX, |next| next - known[i]);
        (usual / BURST..GAP * usual).contains(&step)
    };
    let found = places(known, times).into_iter().map(|place| {
        let (before, share) = place?;
        if share == 0.0 {
            return rows.get(before).cloned();
        }
        let (after, left) = (before + 1, 1.0 - share);
        let curved = before > 0 && (before - 1..=after).all(even);
        let step = known[after] - known[before];
        // Slopes at both ends, each over the readings to its sides.
        let slope = |i: usize, k: usize| {
            step * (rows[i + 1][k] - rows[i - 1][k]) / (known[i + 1] - known[i - 1])
        };
        let between = |k: usize| {
            let (low, high) = (rows[before][k], rows[after][k]);
            let straight = left * low + share * high;
            if !curved {
                return straight;
            }
            let (first, last) = (slope(before, k) - (high - low), slope(after, k) - (high - low));
            straight + share * left * (left * first - share * last)
        };
        Some((0..rows[before].len()).map(between).collect())
    });
    found.collect()
}

/// Positions of times among `known` ones; `None` beyond the ends and in gaps.
///
/// A position is the index of the row before and the share of the way to the next.
pub fn places(known: &[f64], times: &[f64]) -> Vec<Option<(usize, f64)>> {
    let longest = GAP * median_step(known);
    let place = |t: f64| {
        let next = known.partition_point(|known| *known < t);
        if known.get(next) == Some(&t) {
            return Some((next, 0.0));
        }
        let before = next.checked_sub(1)?;
        let (a, b) = (known[before], *known.get(next)?);
        (b - a <= longest).then(|| (before, (t - a) / (b - a)))
    };
    times.iter().map(|t| place(*t)).collect()
}

/// Median step between times; zero without one.
#[must_use]
pub fn median_step(times: &[f64]) -> f64 {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or_default()
}

/// Correlation of the reference's first principal component with the sensor's channels, which
/// explain it linearly, where both are known; `None` if the reference never changes.
#[must_use]
pub fn correlation(sensor: Series<'_>, reference: Series<'_>, at: &Alignment) -> Option<f64> {
    let other = Trace::new(reference)?;
    Some(refine_from(sensor, &other, at.offset, at.rate, 0).correlation)
}

fn refine(sensor: Series<'_>, other: &Trace<'_>, offset: f64, rate: f64) -> Alignment {
    refine_from(sensor, other, offset, rate, STEPS)
}

/// Runs Gauss–Newton from a start; with no steps, evaluates the start.
fn refine_from(
    sensor: Series<'_>,
    other: &Trace<'_>,
    offset: f64,
    rate: f64,
    steps: usize,
) -> Alignment {
    let every = sensor.times.len().div_ceil(MOST_ROWS);
    let picked: Vec<usize> = (0..sensor.times.len()).step_by(every).collect();
    let half = 0.5 * median_step(other.times);
    let middle = 0.5 * (sensor.times[0] + sensor.times[sensor.times.len() - 1]);
    let mut found = Alignment { offset, rate, residual: 0.0, correlation: 0.0 };
    let mut width = sensor.rows[0].len();
    for step in 0..=steps {
        // Rows (x, 1, y′, y′·(t − middle)) → y.
        let rows: Vec<(f64, DVector<f64>, f64, f64)> = picked
            .iter()
            .filter_map(|row| {
                let t = sensor.times[*row];
                let at = found.time(t);
                let (y, low, high) = (other.at(at)?, other.at(at - half)?, other.at(at + half)?);
                let x = DVector::from_column_slice(&sensor.rows[*row]);
                Some((t - middle, x, y, (high - low) / (2.0 * half)))
            })
            .collect();
        let Some(first) = rows.first() else { return found };
        width = first.1.len();
        let solved = solve(&rows, width, step < steps);
        let Some((solution, error)) = solved else { return found };
        let y: DVector<f64> = DVector::from_iterator(rows.len(), rows.iter().map(|r| r.2));
        let about = y.add_scalar(-y.mean()).norm_squared();
        found.correlation =
            (1.0 - error.norm_squared() / about.max(f64::MIN_POSITIVE)).max(0.0).sqrt();
        if step == steps {
            found.residual = local(&rows, &error);
            break;
        }
        // y(t′ + δ) = y + y′·δ is to be w·x + b; δ = d₀ + d₁·(t − middle).
        let (d0, d1) = (-solution[width + 1], -solution[width + 2]);
        found.rate += d1;
        found.offset += d0 - d1 * middle;
    }
    debug_assert!(width > 0);
    found
}

type AlignedRow = (f64, DVector<f64>, f64, f64);

/// Solves least squares of y by (x, 1) and, if `moving`, by y′ and y′·t.
///
/// Returns the solution and the errors.
fn solve(rows: &[AlignedRow], width: usize, moving: bool) -> Option<(DVector<f64>, DVector<f64>)> {
    let columns = width + 1 + if moving { 2 } else { 0 };
    let matrix = DMatrix::from_fn(rows.len(), columns, |row, column| {
        let (t, x, _, slope) = &rows[row];
        match column {
            i if i < width => x[i],
            i if i == width => 1.0,
            i if i == width + 1 => *slope,
            _ => slope * t,
        }
    });
    let y = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.2));
    // Scales the columns to about one size. A decay of a millionth handles duplicate channels.
    let sizes: Vec<f64> = matrix.column_iter().map(|c| c.norm().max(f64::MIN_POSITIVE)).collect();
    let mut scaled = matrix;
    scaled.column_iter_mut().zip(&sizes).for_each(|(mut c, size)| c /= *size);
    let mut gram = scaled.tr_mul(&scaled);
    (0..columns).for_each(|i| gram[(i, i)] += 1e-6);
    let mut solution = Cholesky::new(gram)?.solve(&scaled.tr_mul(&y));
    let error = &scaled * &solution - y;
    solution.iter_mut().zip(&sizes).for_each(|(s, size)| *s /= size);
    Some((solution, error))
}

/// Root mean square over segments of the shift that would reduce each one's error.
fn local(rows: &[AlignedRow], error: &DVector<f64>) -> f64 {
    let length = rows.len().div_ceil(SEGMENTS).max(1);
    let shifts: Vec<f64> = rows
        .chunks(length)
        .zip(error.as_slice().chunks(length))
        .map(|(rows, error)| {
            let slopes: f64 = rows.iter().map(|row| row.3 * row.3).sum();
            let product: f64 = rows.iter().zip(error).map(|(row, e)| row.3 * e).sum();
            if slopes > 0.0 { product / slopes } else { 0.0 }
        })
        .collect();
    (shifts.iter().map(|s| s * s).sum::<f64>() / shifts.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests;

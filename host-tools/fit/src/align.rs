//! A reference that was logged by another clock, brought onto the sensor's time.
//!
//! Sensor and reference answer to the same load. What each of them shows most of (the first principal
//! component of its columns) is cross-correlated at every offset and at rates up to ± 5 % apart. From the
//! best of these Gauss–Newton goes on: the reference read at t′ = offset + rate·t shall be linear in the
//! sensor's channels, so that slopes, offset and rate are one least-squares problem a step.

mod search;

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::error::FitError;
use crate::outliers::median;
use search::{MOST_RATES, Trace, rates, search};

/// Fewest rows of either.
const LEAST_ROWS: usize = 32;
/// A correlation below this is no common load.
const LEAST_CORRELATION: f64 = 0.5;
/// Of a load that repeats itself, one above this is not looked at for drift.
const GOOD_CORRELATION: f64 = 0.9;
/// A second offset that does nearly as well as the best: a load that repeats itself.
const AMBIGUOUS: f64 = 0.97;
/// Gauss–Newton steps, and rows that they look at.
const STEPS: usize = 20;
const MOST_ROWS: usize = 6000;
/// Segments in which what is left of the misalignment is measured.
const SEGMENTS: usize = 8;
/// A gap of more than so many rows in the reference is not bridged.
const GAP: f64 = 5.0;

/// Rows with their times in seconds.
#[derive(Clone, Copy, Debug)]
pub struct Series<'s> {
    /// Times, rising.
    pub times: &'s [f64],
    /// Columns of each row.
    pub rows: &'s [Vec<f64>],
}

/// Where the reference's time lies: t′ = `offset` + (1 + `rate`)·t for the sensor's time t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Seconds.
    pub offset: f64,
    /// How much faster the reference's clock runs, as a share.
    pub rate: f64,
    /// What is left in stretches of the recording, root mean square, in seconds.
    pub residual: f64,
    /// Correlation of the reference with what a line through the sensor's channels says of it.
    pub correlation: f64,
}

impl Alignment {
    /// The reference's time at a time of the sensor.
    #[must_use]
    pub fn time(&self, t: f64) -> f64 {
        self.offset + (1.0 + self.rate) * t
    }
}

/// Finds offset and rate; the names are for messages.
///
/// # Errors
/// Too little in common, or a load that repeats itself so that several offsets do.
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
            return Err(refused(name, problem, "sort the rows by their time"));
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

/// Of a reference that has no row near any of the sensor's `times`, which are the reference's own.
pub(crate) fn apart(name: &str, times: &[f64], reference: &[f64]) -> FitError {
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

/// Whether a reference on the sensor's own times would fit much better at other ones: its alignment, if what
/// a line leaves of it falls to less than a half, and it is off by more than two rows somewhere.
#[must_use]
pub fn misaligned(sensor: Series<'_>, targets: &[Vec<f64>]) -> Option<Alignment> {
    let reference = Series { times: sensor.times, rows: targets };
    if sensor.times.len() < LEAST_ROWS
        || sensor.times.len() != sensor.rows.len()
        || sensor.times.windows(2).any(|pair| pair[1] <= pair[0])
    {
        return None;
    }
    // What a loose contact makes of both would be laid onto each other.
    let (own, theirs) = (steadied(sensor.rows), steadied(targets));
    let (sensor, reference) =
        (Series { rows: &own, ..sensor }, Series { rows: &theirs, ..reference });
    let here = || Some(refine_from(sensor, &Trace::new(reference)?, 0.0, 0.0, 0));
    // A load that repeats itself leaves the offset open: both began at one time then.
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

/// Each column without spikes: the median of five rows, within half of its usual width about that.
fn steadied(rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    const BESIDE: usize = 2;
    let mut steady = rows.to_vec();
    for k in 0..rows.first().map_or(0, Vec::len) {
        let mut sorted: Vec<f64> = rows.iter().map(|row| row[k]).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let [low, high] =
            [0.05, 0.95].map(|share| sorted[(share * (rows.len() - 1) as f64) as usize]);
        let beyond = if high > low { 0.5 * (high - low) } else { f64::MAX };
        for (at, row) in steady.iter_mut().enumerate() {
            let near = at.saturating_sub(BESIDE)..(at + BESIDE + 1).min(rows.len());
            let middle = median(rows[near].iter().map(|row| row[k]).collect());
            row[k] = middle.clamp(low - beyond, high + beyond);
        }
    }
    steady
}

/// The best alignment of clocks that began together.
fn drifting(sensor: Series<'_>, reference: Series<'_>) -> Option<Alignment> {
    let other = Trace::new(reference)?;
    let first = *sensor.times.first()?;
    let from = rates(MOST_RATES).map(|rate| refine_from(sensor, &other, -rate * first, rate, 0));
    let best = from.max_by(|a, b| a.correlation.total_cmp(&b.correlation))?;
    let refined = refine(sensor, &other, best.offset, best.rate);
    (refined.correlation >= LEAST_CORRELATION).then_some(refined)
}

/// What is to be said of a reference that [`misaligned`] found to be so and that was read where it fits, of a
/// recording that begins at `first`.
pub(crate) fn off_time(recording: &str, found: &Alignment, first: f64) -> String {
    format!(
        "{recording}: the reference fits far better {:+.3} s off at a rate {:+.2} % off and was read there, within \
         {:.1} ms; log it with its own times and give it with --reference",
        found.time(first) - first,
        1e2 * found.rate,
        1e3 * found.residual
    )
}

/// The rows of a reference at some times of its own clock; `None` where it has none nearby.
#[must_use]
pub fn resample(reference: Series<'_>, times: &[f64]) -> Vec<Option<Vec<f64>>> {
    let found = places(reference.times, times).into_iter().map(|place| {
        let (before, share) = place?;
        let between = |(a, b): (&f64, &f64)| if share == 0.0 { *a } else { a + share * (b - a) };
        let after = &reference.rows[(before + 1).min(reference.rows.len() - 1)];
        Some(reference.rows[before].iter().zip(after).map(between).collect())
    });
    found.collect()
}

/// Where some times lie among `known` ones: behind which, and by what share of the way to the next. `None` beyond the
/// ends and in gaps.
pub(crate) fn places(known: &[f64], times: &[f64]) -> Vec<Option<(usize, f64)>> {
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

fn median_step(times: &[f64]) -> f64 {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or_default()
}

fn refine(sensor: Series<'_>, other: &Trace<'_>, offset: f64, rate: f64) -> Alignment {
    refine_from(sensor, other, offset, rate, STEPS)
}

/// Gauss–Newton from a start; with no steps, what the start is worth.
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

/// Least squares of y by (x, 1) and, if `moving`, by y′ and y′·t; the solution and the errors.
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
    // Columns of about one size, and a decay of a millionth for channels that say the same.
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

/// Root mean square over segments of the shift that each would still like.
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
mod tests {
    use super::*;

    /// Presses of uneven length at uneven intervals, seen at a time of the true clock.
    fn force(t: f64) -> f64 {
        let press = |at: f64, length: f64, peak: f64| {
            let share = (t - at) / length;
            if (0.0..1.0).contains(&share) {
                peak * (std::f64::consts::PI * share).sin()
            } else {
                0.0
            }
        };
        (0..24)
            .map(f64::from)
            .map(|i| {
                press(
                    2.0 + 2.3 * i + 0.6 * (5.0 * i * i).sin(),
                    1.0 + 0.4 * (3.0 * i).cos(),
                    1.0 + 0.5 * (7.0 * i).sin(),
                )
            })
            .sum()
    }

    fn noise(i: usize) -> f64 {
        (12.9898 * (i * i) as f64).sin()
    }

    /// A sensor of three channels at 200 Hz for a minute.
    fn sensor() -> (Vec<f64>, Vec<Vec<f64>>) {
        let times: Vec<f64> = (0..12_000).map(|i| i as f64 * 0.005).collect();
        let rows = times.iter().enumerate().map(|(i, t)| {
            let f = force(*t);
            vec![
                5.0 - 2.0 * f + 0.02 * noise(i),
                0.4 * f + 0.1 * f * f + 0.02 * noise(i + 7),
                0.02 * noise(i + 3),
            ]
        });
        (times.clone(), rows.collect())
    }

    /// A load cell at 80 Hz whose clock shows `offset` + (1 + `rate`)·t.
    fn load_cell(offset: f64, rate: f64, load: impl Fn(f64) -> f64) -> (Vec<f64>, Vec<Vec<f64>>) {
        let times: Vec<f64> = (0..4700).map(|i| offset + 0.4 + i as f64 * 0.0125).collect();
        let rows = times
            .iter()
            .enumerate()
            .map(|(i, t)| vec![load((t - offset) / (1.0 + rate)) + 0.005 * noise(i)]);
        (times.clone(), rows.collect())
    }

    fn aligned(offset: f64, rate: f64) -> Result<Alignment, FitError> {
        let (st, sx) = sensor();
        let (rt, ry) = load_cell(offset, rate, force);
        align(
            ["skin.csv", "cell.csv"],
            Series { times: &st, rows: &sx },
            Series { times: &rt, rows: &ry },
        )
    }

    #[test]
    fn offset_and_rate_are_found_to_a_millisecond() {
        for (offset, rate) in [(0.0, 0.0), (3.7, 0.0), (-1234.5, 0.03), (8.0, -0.03)] {
            let found = aligned(offset, rate).unwrap();
            for t in [2.0, 30.0, 55.0] {
                let off = found.time(t) - (offset + (1.0 + rate) * t);
                assert!(off.abs() < 1e-3, "{offset} {rate}: {off} s at {t}: {found:?}");
            }
            assert!(found.residual < 2e-3 && found.correlation > 0.99, "{found:?}");
        }
    }

    #[test]
    fn a_load_that_repeats_itself_and_one_that_is_not_there_are_refused() {
        let (st, _) = sensor();
        let wave = |t: f64| (2.0 * std::f64::consts::PI * t).sin();
        let sx: Vec<Vec<f64>> = st.iter().map(|t| vec![wave(*t)]).collect();
        let (rt, ry) = load_cell(0.0, 0.0, wave);
        let of = |sx: &[Vec<f64>], ry: &[Vec<f64>]| {
            align(
                ["skin.csv", "cell.csv"],
                Series { times: &st, rows: sx },
                Series { times: &rt, rows: ry },
            )
            .unwrap_err()
            .to_string()
        };
        assert!(of(&sx, &ry).contains("cell.csv: the load repeats itself"), "{}", of(&sx, &ry));
        let hiss: Vec<Vec<f64>> = (0..ry.len()).map(|i| vec![noise(i)]).collect();
        assert!(of(&sensor().1, &hiss).contains("correlate by"), "{}", of(&sensor().1, &hiss));
        let still = vec![vec![2.5]; ry.len()];
        assert!(of(&sensor().1, &still).contains("never changes"));
    }

    #[test]
    fn a_reference_on_the_right_times_is_left_and_one_off_by_three_percent_is_told() {
        let (times, rows) = sensor();
        let series = Series { times: &times, rows: &rows };
        let at = |rate: f64| -> Vec<Vec<f64>> {
            times.iter().map(|t| vec![force(t * (1.0 + rate))]).collect()
        };
        assert_eq!(misaligned(series, &at(0.0)), None);
        let found = misaligned(series, &at(0.03)).unwrap();
        assert!((found.time(50.0) - 50.0 / 1.03).abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn of_a_load_that_repeats_itself_the_rate_is_found_from_a_common_beginning() {
        let wave = |t: f64| (2.0 * std::f64::consts::PI * t).sin();
        let (times, _) = sensor();
        let rows: Vec<Vec<f64>> = times.iter().map(|t| vec![wave(*t)]).collect();
        let series = Series { times: &times, rows: &rows };
        let at = |rate: f64| -> Vec<Vec<f64>> {
            times.iter().map(|t| vec![wave(t * (1.0 + rate))]).collect()
        };
        assert_eq!(misaligned(series, &at(0.0)), None);
        for rate in [0.03, -0.03] {
            let found = misaligned(series, &at(rate)).unwrap();
            assert!((found.time(50.0) - 50.0 / (1.0 + rate)).abs() < 2e-3, "{found:?}");
        }
    }

    #[test]
    fn rows_are_read_between_neighbours_and_gaps_are_not_bridged() {
        let times = [0.0, 1.0, 2.0, 3.0, 20.0, 21.0];
        let rows: Vec<Vec<f64>> = times.iter().map(|t| vec![10.0 * t]).collect();
        let found =
            resample(Series { times: &times, rows: &rows }, &[-0.1, 0.0, 1.25, 9.0, 21.0, 21.1]);
        let expected = [None, Some(vec![0.0]), Some(vec![12.5]), None, Some(vec![210.0]), None];
        assert_eq!(found, expected);
    }
}

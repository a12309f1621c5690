//! Coverage of the uncertainty that the reference finger states, under disturbances, and the error
//! of what it gives over the share that it gives.
//!
//! The finger states a standard deviation with every value. Of a normal distribution 68.3 % lie
//! within one of them, 95 % within 1.96 and 99.7 % within three.

mod chart;
mod conditions;

use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use taxel::finger::Estimate;
use taxel::frame::Status;
use taxel_calibrate::evaluate::{FLAGS, Only};
use taxel_files::trace::{Sample, Truth};

pub use chart::{write_coverage, write_risk};
use conditions::{CONDITIONS, Condition, recorded};

use crate::effects::values;
use crate::effort::{Waiting, on_all_cores};
use crate::reference::{calibrated, estimates};

/// Devices of which each is calibrated on its own recordings.
const DEVICES: [u64; 3] = [1, 2, 3];
/// Seed of noise, lamps and random presses; no calibration has it.
const SEED: u64 = 45;
/// Least load in newtons of a judged row.
const LEAST_N: f64 = 0.1;
/// Number of times that presses are drawn for an interval.
const RESAMPLES: usize = 400;
/// Widths in stated standard deviations, with their shares of a normal distribution in per cent
/// and how far from these a coverage may be.
pub(crate) const WIDTHS: [(f64, f64, f64); 3] =
    [(1.0, 68.3, 6.0), (1.96, 95.0, 3.0), (3.0, 99.7, 0.4)];
pub(crate) const QUANTITIES: [&str; 5] = ["F_x", "F_y", "F_z", "x", "y"];
pub(crate) const PARTS: [(Only, &str); 2] = [(Only::Matrix, "matrix"), (Only::Both, "both")];

/// Coverage of one quantity in one condition.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Covered {
    /// Disturbance.
    pub condition: String,
    /// Part of the finger: `matrix` or `both`.
    pub part: String,
    /// Quantity: `F_x`, `F_y`, `F_z`, `x` or `y`.
    pub quantity: String,
    /// Rows with a load.
    pub rows: usize,
    /// Share of them without a value or with a flag, in per cent.
    pub flagged: f64,
    /// Share of the others within one stated standard deviation, in per cent, and the interval in
    /// which it is with 95 % confidence.
    pub within_1: f64,
    /// Lower end.
    pub low_1: f64,
    /// Upper end.
    pub high_1: f64,
    /// Share within 1.96 of them.
    pub within_2: f64,
    /// Lower end.
    pub low_2: f64,
    /// Upper end.
    pub high_2: f64,
    /// Share within three of them.
    pub within_3: f64,
    /// Lower end.
    pub low_3: f64,
    /// Upper end.
    pub high_3: f64,
    /// Share of all rows off by more than three without a flag, in per cent.
    pub undetected: f64,
}

impl Covered {
    /// Coverages of the three [`WIDTHS`], each with its interval, in per cent.
    pub(crate) fn within(&self) -> [[f64; 3]; 3] {
        [
            [self.within_1, self.low_1, self.high_1],
            [self.within_2, self.low_2, self.high_2],
            [self.within_3, self.low_3, self.high_3],
        ]
    }
}

/// Error of the share of values with the smallest stated uncertainties, as calibrated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Risk {
    /// Part of the finger: `matrix` or `both`.
    pub part: String,
    /// Quantity: `F_x`, `F_y`, `F_z`, `x` or `y`.
    pub quantity: String,
    /// Share of the values in per cent.
    pub given: usize,
    /// Root mean square of their errors in N or mm.
    pub rmse: f64,
    /// Root mean square of the share with the smallest errors, which nobody knows.
    pub best: f64,
}

/// Error and stated standard deviation of a value, and the press that it is of.
#[derive(Clone, Copy, Debug)]
struct Value {
    press: usize,
    error: f64,
    sigma: f64,
}

/// Judged rows of one quantity.
#[derive(Clone, Debug, Default)]
struct Rows {
    rows: usize,
    presses: usize,
    values: Vec<Value>,
}

/// Measures every condition; takes some minutes.
///
/// # Errors
/// The fit failed or was stopped.
pub fn measure(waiting: Waiting<'_>) -> anyhow::Result<(Vec<Covered>, Vec<Risk>)> {
    (waiting.progress)(0.0, "calibrating");
    let records = on_all_cores(&DEVICES, |device| calibrated(*device, false, waiting.stop))?;
    let begun = AtomicUsize::new(0);
    let judged = on_all_cores(&CONDITIONS, |condition| {
        let share = begun.fetch_add(1, Ordering::Relaxed) as f64 / CONDITIONS.len() as f64;
        (waiting.progress)(share, condition.name);
        let mut parts: [[Rows; 5]; 2] = Default::default();
        for (device, record) in DEVICES.iter().zip(&records) {
            anyhow::ensure!(!waiting.stop.load(Ordering::Relaxed), "stopped");
            let recording = recorded(*device, condition, record)?;
            for ((part, _), rows) in PARTS.into_iter().zip(&mut parts) {
                add(rows, &recording.samples, &estimates(part, record, &recording));
            }
        }
        Ok(parts)
    })?;
    let (mut covered, mut risks) = (Vec::new(), Vec::new());
    for (c, (condition, parts)) in CONDITIONS.iter().zip(&judged).enumerate() {
        for ((_, part), rows) in PARTS.into_iter().zip(parts) {
            for (quantity, rows) in QUANTITIES.into_iter().zip(rows) {
                covered.push(rows.covered(condition.name, part, quantity));
                if c == 0 {
                    risks.extend(rows.risks(part, quantity));
                }
            }
        }
    }
    Ok((covered, risks))
}

/// Adds the rows of a recording to those of each quantity.
fn add(rows: &mut [Rows; 5], samples: &[Sample], estimates: &[Estimate]) {
    let mut touched = false;
    for (sample, estimate) in samples.iter().zip(estimates) {
        let begins = sample.truth.contact == Some(true) && !touched;
        touched = sample.truth.contact == Some(true);
        let truths = truths(&sample.truth);
        let load = truths.iter().take(3).map(|f| f.unwrap_or(0.0).powi(2)).sum::<f64>().sqrt();
        let flagged = FLAGS.iter().any(|flag: &Status| estimate.status.contains(*flag));
        let given = values(&estimate.force, &estimate.point);
        let stated = estimate.uncertainty.as_ref().ok();
        let sigmas = stated.map_or([None; 5], |stated| values(&stated.force, &stated.point));
        for (k, rows) in rows.iter_mut().enumerate() {
            rows.presses += usize::from(begins);
            if load < LEAST_N {
                continue;
            }
            rows.rows += 1;
            if let (false, Some(given), Some(truth), Some(sigma)) =
                (flagged, given[k], truths[k], sigmas[k])
            {
                let press = rows.presses.saturating_sub(1);
                rows.values.push(Value { press, error: given - truth, sigma });
            }
        }
    }
}

fn truths(truth: &Truth) -> [Option<f64>; 5] {
    let ([fx, fy, fz], [x, y]) = (truth.force, truth.point);
    [fx, fy, fz, x, y]
}

impl Rows {
    fn covered(&self, condition: &str, part: &str, quantity: &str) -> Covered {
        let counts = |width: f64| {
            let mut counts = vec![[0.0; 2]; self.presses];
            for value in &self.values {
                if let Some([all, within]) = counts.get_mut(value.press) {
                    *all += 1.0;
                    *within += f64::from(value.error.abs() <= width * value.sigma);
                }
            }
            counts
        };
        let [one, two, three] = WIDTHS.map(|(width, ..)| interval(&counts(width)));
        let of_rows = |count: usize| 100.0 * count as f64 / self.rows.max(1) as f64;
        let beyond = self.values.iter().filter(|v| v.error.abs() > 3.0 * v.sigma).count();
        Covered {
            condition: condition.into(),
            part: part.into(),
            quantity: quantity.into(),
            rows: self.rows,
            flagged: of_rows(self.rows - self.values.len()),
            within_1: one[0],
            low_1: one[1],
            high_1: one[2],
            within_2: two[0],
            low_2: two[1],
            high_2: two[2],
            within_3: three[0],
            low_3: three[1],
            high_3: three[2],
            undetected: of_rows(beyond),
        }
    }

    fn risks(&self, part: &str, quantity: &str) -> Vec<Risk> {
        let sorted = |key: fn(&Value) -> f64| {
            let mut values = self.values.clone();
            values.sort_by(|a, b| key(a).total_cmp(&key(b)));
            values
        };
        let (by_sigma, by_error) = (sorted(|v| v.sigma), sorted(|v| v.error.abs()));
        let rmse = |values: &[Value], given: usize| {
            let first = values.get(..values.len() * given / 100).unwrap_or_default();
            let squares: f64 = first.iter().map(|v| v.error * v.error).sum();
            (squares / first.len().max(1) as f64).sqrt()
        };
        let risk = |given| Risk {
            part: part.into(),
            quantity: quantity.into(),
            given,
            rmse: rmse(&by_sigma, given),
            best: rmse(&by_error, given),
        };
        (5..=100).step_by(5).map(risk).collect()
    }
}

/// Share in per cent of counts by press, and its interval of 95 %: whole presses are drawn
/// again and again, because the rows of a press err alike.
fn interval(counts: &[[f64; 2]]) -> [f64; 3] {
    let share = |[all, within]: [f64; 2]| 100.0 * within / all.max(1.0);
    let sum = |sum: [f64; 2], count: &[f64; 2]| [sum[0] + count[0], sum[1] + count[1]];
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut drawn: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let of =
                (0..counts.len()).filter_map(|_| counts.get(rng.random_range(0..counts.len())));
            share(of.fold([0.0; 2], sum))
        })
        .collect();
    drawn.sort_by(f64::total_cmp);
    let at = |part: usize| drawn.get(RESAMPLES * part / 1000).copied().unwrap_or_default();
    [share(counts.iter().fold([0.0; 2], sum)), at(25), at(975)]
}

/// Draws the table of the page: in each condition the quantity that is worst.
#[must_use]
pub fn section(rows: &[Covered]) -> String {
    let mut table = "| reference finger | part | within 1 σ | within 1.96 σ | within 3 σ | \
                     withheld or flagged | beyond 3 σ without a flag |\n|---|---|---|---|---|---|---|\n\
                     | *aim* | | *68 ± 6 %* | *95 ± 3 %* | *99.3 %* | | *1 %* |"
        .to_owned();
    for Condition { name, .. } in &CONDITIONS {
        for (_, part) in PARTS {
            let own: Vec<&Covered> =
                rows.iter().filter(|row| row.condition == *name && row.part == part).collect();
            let _ = write!(table, "\n| {name} | {part} |");
            for (i, (_, normal, _)) in WIDTHS.into_iter().enumerate() {
                let all = own.iter().map(|row| row.within()[i]);
                let off = |[share, ..]: &[f64; 3]| (share - normal).abs();
                let worst = all.max_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or_default();
                let [share, low, high] = worst;
                let _ = write!(table, " {share:.1} ({low:.1} to {high:.1}) |");
            }
            let most = |of: fn(&Covered) -> f64| own.iter().map(|row| of(row)).fold(0.0, f64::max);
            let (flagged, undetected) = (most(|row| row.flagged), most(|row| row.undetected));
            let _ = write!(table, " {flagged:.1} % | {undetected:.2} % |");
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table;

    #[test]
    fn interval_is_wide_where_presses_differ() {
        let equal = [[100.0, 68.0]; 50];
        let [share, low, high] = interval(&equal);
        assert!((share - 68.0).abs() < 1e-9 && high - low < 1e-9);
        let halves: Vec<[f64; 2]> =
            (0..50).map(|i| [100.0, if i % 2 == 0 { 100.0 } else { 0.0 }]).collect();
        let [share, low, high] = interval(&halves);
        assert!((share - 50.0).abs() < 1e-9 && low < 40.0 && high > 60.0, "{low} {high}");
    }

    #[test]
    fn coverage_counts_stated_deviations_and_rows_without_value() {
        let value = |press, error| Value { press, error, sigma: 0.01 };
        let values = vec![value(0, 0.005), value(0, -0.015), value(1, 0.02), value(1, 0.04)];
        let rows = Rows { rows: 8, presses: 2, values };
        let covered = rows.covered("c", "both", "F_z");
        assert_eq!([covered.within_1, covered.within_2, covered.within_3], [25.0, 50.0, 75.0]);
        assert_eq!((covered.flagged, covered.undetected), (50.0, 12.5));
        let risks = rows.risks("both", "F_z");
        assert!(risks.iter().all(|risk| risk.best <= risk.rmse + 1e-12));
    }

    #[test]
    fn tables_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("coverage.csv");
        let row = Covered { condition: "a, b".into(), within_2: 94.5, ..Covered::default() };
        table::write(std::slice::from_ref(&row), &path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(table::parse::<Covered>(&text).unwrap(), [row]);
        assert!(table::parse::<Risk>(&text).is_err());
    }
}

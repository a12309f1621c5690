//! Spreading of time stamps that several rows share, from a rounded clock or rows in bursts.

use std::borrow::Cow;

use super::LEAST_ROWS;
use crate::quantile::median;

/// Most rows a stamp may share, as a multiple of the median count, plus one row.
const ALIKE: f64 = 2.0;
/// Fewest different stamps that determine the rate of the rows.
const LEAST_STAMPS: usize = 8;
/// Longest interval over which a stamp's rows are spread, in median steps a row.
const GAP: f64 = 3.0;

/// Returns times that rise from row to row.
///
/// Rows of one stamp are spread evenly up to the next.
///
/// # Errors
///
/// The reason why the rows' times cannot be determined, as part of a sentence about the
/// recording.
pub fn told_apart(times: &[f64]) -> Result<Cow<'_, [f64]>, String> {
    let rows = times.len();
    if rows < LEAST_ROWS {
        return Err(format!("{rows} rows with a time where {LEAST_ROWS} are needed"));
    }
    if let Some(pair) = times.windows(2).find(|pair| pair[1] < pair[0]) {
        return Err(format!("after {} s comes {} s", pair[0], pair[1]));
    }
    let shared: Vec<&[f64]> = times.chunk_by(|a, b| a == b).collect();
    if shared.len() == rows {
        return Ok(Cow::Borrowed(times));
    }
    let usual = median(shared.iter().map(|rows| rows.len() as f64).collect());
    let most = shared.iter().max_by_key(|rows| rows.len()).map_or(0, |rows| rows.len());
    if shared.len() < LEAST_STAMPS {
        return Err(format!("its {rows} rows have {} different times", shared.len()));
    }
    if most as f64 > ALIKE * usual + 1.0 {
        let at = shared.iter().find(|rows| rows.len() == most).map_or(0.0, |rows| rows[0]);
        return Err(format!("{most} rows have one time, {at} s"));
    }
    let steps = || shared.windows(2).map(|pair| (pair[1][0] - pair[0][0]) / pair[0].len() as f64);
    let step = median(steps().collect());
    let own = steps().map(|own| own.min(GAP * step)).chain([step]);
    let apart = shared.iter().zip(own);
    let apart =
        apart.flat_map(|(rows, step)| (0..rows.len()).map(move |i| rows[0] + i as f64 * step));
    Ok(Cow::Owned(apart.collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_times_and_bursts_are_spread_evenly() {
        let clock = |digits: f64| -> Vec<f64> {
            (0..400).map(|i| (f64::from(i) * 0.02 * digits).floor() / digits).collect()
        };
        for digits in [10.0, 2.0, 1.0] {
            let times = clock(digits);
            let apart = told_apart(&times).unwrap();
            assert!(apart.windows(2).all(|pair| pair[0] < pair[1]), "{digits}");
            let off = apart.iter().enumerate().map(|(i, t)| (t - i as f64 * 0.02).abs());
            assert!(off.fold(0.0, f64::max) < 0.011, "{digits}");
        }
        let mut twice = clock(1000.0);
        twice[100] = twice[99];
        let apart = told_apart(&twice).unwrap();
        assert!((apart[100] - (twice[99] + 0.02)).abs() < 1e-9, "{}", apart[100]);
        assert_eq!(apart[101], twice[101]);
    }

    #[test]
    fn rising_times_stay_unchanged() {
        let times: Vec<f64> = (0..40).map(f64::from).collect();
        assert!(matches!(told_apart(&times), Ok(Cow::Borrowed(_))));
    }

    #[test]
    fn unusable_times_are_refused_with_reason() {
        let hangs: Vec<f64> = (0..400).map(|i| f64::from(if i < 200 { i } else { 200 })).collect();
        assert_eq!(told_apart(&hangs).unwrap_err(), "200 rows have one time, 200 s");
        assert_eq!(told_apart(&[1.0; 50]).unwrap_err(), "its 50 rows have 1 different times");
        let few = told_apart(&[1.0, 2.0]).unwrap_err();
        assert_eq!(few, "2 rows with a time where 32 are needed");
        let mut back: Vec<f64> = (0..40).map(f64::from).collect();
        back[7] = 5.5;
        assert_eq!(told_apart(&back).unwrap_err(), "after 6 s comes 5.5 s");
    }
}

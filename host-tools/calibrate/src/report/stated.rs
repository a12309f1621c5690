//! Coverage of the stated errors: share of values within one, two and three of them.

use serde::Serialize;

use super::judge::Trial;

/// Shares of a normal distribution within one, two and three standard deviations.
pub(crate) const NORMAL: [f64; 3] = [0.683, 0.954, 0.997];

/// Coverage of one quantity by the standard deviations that its values state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stated {
    /// Name of the reference column.
    pub target: String,
    /// Unit of the median.
    pub unit: &'static str,
    /// Number of values, flagged ones left out.
    pub rows: usize,
    /// Number of flagged values.
    pub flagged: usize,
    /// Median of the stated standard deviations.
    pub median: f64,
    /// Standard deviation of the labels' own noise, which is added to the stated one.
    pub label_noise: f64,
    /// Shares of the values within one, two and three standard deviations.
    pub within: [f64; 3],
}

/// Counts the values of all trials that state an error.
pub(crate) fn stated(trials: &[Trial]) -> Vec<Stated> {
    let all = || trials.iter().flat_map(|trial| &trial.series);
    let mut found: Vec<Stated> = Vec::new();
    for first in all() {
        let target = first.kind.name();
        if found.iter().any(|stated| stated.target == target) {
            continue;
        }
        let (mut ratios, mut sigmas, mut flagged) = (Vec::new(), Vec::new(), 0);
        let mut label_noise: f64 = 0.0;
        for series in all().filter(|series| series.kind == first.kind) {
            label_noise = label_noise.max(series.label_noise);
            for (i, row) in series.rows.iter().enumerate() {
                let (Some(estimate), Some(sigma)) = (series.estimate[i], series.sigma[i]) else {
                    continue;
                };
                if row.flagged {
                    flagged += 1;
                    continue;
                }
                ratios
                    .push((estimate - series.reference[i]).abs() / sigma.hypot(series.label_noise));
                sigmas.push(sigma);
            }
        }
        if ratios.is_empty() {
            continue;
        }
        let within = [1.0, 2.0, 3.0].map(|times| {
            ratios.iter().filter(|ratio| **ratio <= times).count() as f64 / ratios.len() as f64
        });
        let unit = first.kind.unit();
        let median = taxel_regress::quantile::median(sigmas);
        found.push(Stated {
            target,
            unit,
            rows: ratios.len(),
            flagged,
            median,
            label_noise,
            within,
        });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::series::{Kind, Row, Series};
    use super::*;

    #[test]
    fn stated_errors_are_counted_without_flagged_rows() {
        let row = |flagged| Row { press: Some(0), flagged, ..Row::default() };
        let series = Series {
            time: vec![0.0; 5],
            reference: vec![1.0; 5],
            estimate: vec![Some(1.05), Some(1.15), Some(1.25), Some(1.35), Some(9.0)],
            sigma: vec![Some(0.1); 5],
            rows: [false, false, false, false, true].map(row).to_vec(),
            ..Series::empty(Kind::Force(2))
        };
        let trial = |series| Trial::new("a.csv".into(), 1.0, 5, vec![series]);
        let found = stated(&[trial(series.clone())]);
        assert_eq!((found[0].rows, found[0].flagged), (4, 1));
        assert_eq!(found[0].within, [0.25, 0.5, 0.75]);
        // The labels' noise widens what is stated: 0.3 to 0.32.
        let noisy = stated(&[trial(Series { label_noise: 0.3, ..series.clone() })]);
        assert_eq!(noisy[0].within, [0.75, 1.0, 1.0]);
        let silent = Series { sigma: vec![None; 5], ..series };
        assert!(stated(&[trial(silent)]).is_empty());
    }
}

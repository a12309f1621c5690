//! Error figures of an estimate.

use std::collections::BTreeMap;

/// Figures of one target over a recording, in the target's own unit. Error is estimate − reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// Root mean square error.
    pub rmse: f64,
    /// Standard deviation of the error.
    pub sigma: f64,
    /// Largest absolute error.
    pub max: f64,
    /// Mean error.
    pub bias: f64,
    /// Number of judged rows.
    pub n: usize,
}

/// Error figures of one reference column.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetMetrics {
    /// Name of the reference column.
    pub target: String,
    /// The figures; `None` if no row had an estimate.
    pub figures: Option<Figures>,
    /// Share of the estimates with a stated error that are off by no more than it.
    pub within: Option<f64>,
    /// Share of the estimates with a stated error that are off by more than three times it.
    pub beyond: Option<f64>,
    /// Rows with a reference but without an estimate, by reason.
    pub withheld: BTreeMap<String, usize>,
}

/// Collector of the errors of one target.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    errors: Vec<f64>,
    /// Rows with a stated error, and those among them that are off by no more than it and by more
    /// than three times it.
    stated: usize,
    within: usize,
    beyond: usize,
    withheld: BTreeMap<String, usize>,
}

impl Errors {
    /// Adds the error of a row.
    pub fn add(&mut self, error: f64) {
        self.errors.push(error);
    }

    /// Adds the error of a row whose estimate states a standard deviation.
    pub fn add_stated(&mut self, error: f64, sigma: f64) {
        self.add(error);
        self.stated += 1;
        self.within += usize::from(error.abs() <= sigma);
        self.beyond += usize::from(error.abs() > 3.0 * sigma);
    }

    /// Counts a row without an estimate, by its reason.
    pub fn withhold(&mut self, reason: impl Into<String>) {
        *self.withheld.entry(reason.into()).or_default() += 1;
    }

    /// Rows seen, with an estimate or without.
    pub fn rows(&self) -> usize {
        self.errors.len() + self.withheld.values().sum::<usize>()
    }

    /// Computes the figures of the target of this name.
    pub fn into_metrics(self, target: impl Into<String>) -> TargetMetrics {
        let share = |of: usize| (self.stated > 0).then(|| of as f64 / self.stated as f64);
        TargetMetrics {
            target: target.into(),
            figures: figures(&self.errors),
            within: share(self.within),
            beyond: share(self.beyond),
            withheld: self.withheld,
        }
    }
}

/// Computes the figures of some errors; `None` for none.
#[must_use]
pub fn figures(errors: &[f64]) -> Option<Figures> {
    let n = errors.len();
    if n == 0 {
        return None;
    }
    let bias = errors.iter().sum::<f64>() / n as f64;
    let mean_square =
        |about: f64| errors.iter().map(|e| (e - about).powi(2)).sum::<f64>() / n as f64;
    Some(Figures {
        rmse: mean_square(0.0).sqrt(),
        sigma: mean_square(bias).sqrt(),
        max: errors.iter().fold(0.0, |max, e| max.max(e.abs())),
        bias,
        n,
    })
}

/// Whether errors are less than others by more than one standard error of the mean difference.
///
/// Both must come from the same recordings or presses. A smaller gain may be chance; a single pair
/// is never sure.
pub fn surely_less(errors: &[f64], than: &[f64]) -> bool {
    let n = errors.len() as f64;
    let gained: Vec<f64> = than.iter().zip(errors).map(|(than, error)| than - error).collect();
    let mean = gained.iter().sum::<f64>() / n;
    let variance = gained.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (n - 1.0);
    mean > (variance / n).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn figures_match_hand_worked_example() {
        let figures = figures(&[1.0, -2.0, 4.0]).unwrap();
        assert_eq!((figures.max, figures.bias, figures.n), (4.0, 1.0, 3));
        assert!((figures.rmse - 7f64.sqrt()).abs() < 1e-12);
        assert!((figures.sigma - 6f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn errors_give_no_figures_without_rows() {
        let mut errors = Errors::default();
        errors.withhold("saturated");
        errors.withhold("saturated");
        let metrics = errors.into_metrics("fz_n");
        assert_eq!(metrics.figures, None);
        assert_eq!(metrics.withheld["saturated"], 2);
    }

    #[test]
    fn surely_less_requires_more_than_standard_error() {
        let than = [0.1, 0.2, 0.3];
        assert!(surely_less(&[0.08, 0.17, 0.26], &than));
        assert!(!surely_less(&[0.01, 0.25, 0.31], &than));
        assert!(!surely_less(&than, &than) && !surely_less(&[0.0], &[1.0]));
    }

    #[test]
    fn errors_within_one_and_beyond_three_sigma_are_counted() {
        let mut errors = Errors::default();
        errors.add(9.0);
        assert_eq!(errors.clone().into_metrics("fz_n").beyond, None);
        for error in [-0.31, 0.29, 0.0, -0.1] {
            errors.add_stated(error, 0.1);
        }
        let metrics = errors.into_metrics("fz_n");
        assert_eq!((metrics.within, metrics.beyond), (Some(0.5), Some(0.25)));
        assert_eq!(metrics.figures.unwrap().n, 5);
    }

    proptest! {
        #[test]
        fn mean_square_is_bias_plus_variance(errors in prop::collection::vec(-10.0..10.0f64, 1..50)) {
            let f = figures(&errors).unwrap();
            prop_assert!((f.rmse.powi(2) - f.bias.powi(2) - f.sigma.powi(2)).abs() < 1e-9);
            prop_assert!(f.rmse <= f.max + 1e-12);
        }
    }
}

//! Error figures of one quantity over one recording.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use taxel_regress::metrics;

use super::series::Series;

/// Classes of the reference within which loading and unloading are compared.
const CLASSES: usize = 20;
/// Fewest rows of each direction in a class.
const LEAST_ROWS: usize = 5;
/// Resolution in standard deviations of the noise: 99.7 % of rows lie within.
const TOLD_APART: f64 = 3.0;

/// Figures of one quantity, in its own unit. Error is estimate − reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Name of the reference column.
    pub target: String,
    /// Unit of the other fields, unless they state another one.
    pub unit: &'static str,
    /// Number of judged rows.
    pub rows: usize,
    /// Number of rows without an estimate.
    pub withheld: usize,
    /// Mean error.
    pub bias: f64,
    /// Standard deviation of the error.
    pub sigma: f64,
    /// Root mean square error.
    pub rmse: f64,
    /// Largest absolute error.
    pub max: f64,
    /// Largest minus smallest reference.
    pub span: f64,
    /// Root mean square error in percent of the span.
    pub percent: Option<f64>,
    /// Largest hysteresis in percent of the span.
    ///
    /// The difference of the mean error between rising and falling reference.
    pub hysteresis_percent: Option<f64>,
    /// Crosstalk from each other component of the same force, in percent.
    pub crosstalk_percent: Vec<(String, f64)>,
    /// Standard deviation from row to row, without slow changes.
    pub noise: Option<f64>,
    /// Resolution: three times the noise.
    pub resolution: Option<f64>,
    /// Dynamic range: span over resolution.
    pub dynamic_range: Option<f64>,
}

/// Computes the figures of `series`; `others` are the components measured with it.
pub(crate) fn figures(series: &Series, others: &[&Series]) -> Option<Figures> {
    let errors: Vec<f64> = series.errors().map(|(_, error)| error).collect();
    let found = metrics::figures(&errors)?;
    let span = series.span();
    let percent = |value: f64| (span > 0.0).then(|| 100.0 * value / span);
    let noise = noise(series);
    let resolution = noise.map(|noise| TOLD_APART * noise);
    Some(Figures {
        target: series.kind.name(),
        unit: series.kind.unit(),
        rows: found.n,
        withheld: series.estimate.len() - found.n,
        bias: found.bias,
        sigma: found.sigma,
        rmse: found.rmse,
        max: found.max,
        span,
        percent: percent(found.rmse),
        hysteresis_percent: hysteresis(series).and_then(percent),
        crosstalk_percent: crosstalk(series, others),
        noise,
        resolution,
        dynamic_range: resolution.filter(|r| *r > 0.0).map(|r| span / r),
    })
}

/// Noise from second differences, which cancel slow motion.
///
/// Their variance is six times that of white noise. Rows in which the estimate stands still (no
/// contact: zero by definition) are not used.
fn noise(series: &Series) -> Option<f64> {
    let errors: Vec<Option<f64>> =
        series.reference.iter().zip(&series.estimate).map(|(r, e)| e.map(|e| e - r)).collect();
    let moves = |i: usize| series.estimate[i] != series.estimate[i + 1];
    let squares: Vec<f64> = (0..errors.len().saturating_sub(2))
        .filter(|i| moves(*i) && moves(i + 1))
        .filter_map(|i| Some((errors[i]? - 2.0 * errors[i + 1]? + errors[i + 2]?).powi(2) / 6.0))
        .collect();
    // The median is robust to the few jumps at the edges of contacts. The median of a squared
    // normal variable is 0.4549 of its mean.
    median(squares).map(|median| (median / 0.4549).sqrt())
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Largest difference of the mean errors at one reference between rising and falling reference.
fn hysteresis(series: &Series) -> Option<f64> {
    let (low, _) = super::series::extent(series.reference.iter().copied());
    let width = series.span() / CLASSES as f64;
    if width <= 0.0 {
        return None;
    }
    let mut sums = [[(0usize, 0.0); 2]; CLASSES];
    // The direction over a fixed number of rows would be that of noise. It is taken over as many
    // rows as the reference needs to change by a tenth of a class, at most a hundred.
    for (row, (reference, estimate)) in series.reference.iter().zip(&series.estimate).enumerate() {
        let Some(estimate) = estimate else { continue };
        let moved = (1..100).find_map(|step| {
            let before = series.reference[row.saturating_sub(step)];
            let after = series.reference[(row + step).min(series.reference.len() - 1)];
            let moved = after - before;
            (moved.abs() > 0.1 * width).then_some(moved)
        });
        let Some(moved) = moved else { continue };
        let class = (((reference - low) / width) as usize).min(CLASSES - 1);
        let sum = &mut sums[class][usize::from(moved > 0.0)];
        // Average the error, not the estimate, because rows may lie unevenly within their class.
        *sum = (sum.0 + 1, sum.1 + estimate - reference);
    }
    let differences = sums.iter().filter_map(|[(m, down), (n, up)]| {
        let enough = *m >= LEAST_ROWS && *n >= LEAST_ROWS;
        enough.then(|| (up / *n as f64 - down / *m as f64).abs())
    });
    differences.reduce(f64::max)
}

/// Slopes of the error over each other component, fitted together with the component itself.
fn crosstalk(series: &Series, others: &[&Series]) -> Vec<(String, f64)> {
    let aligned = |other: &&&Series| other.reference.len() == series.reference.len();
    let others: Vec<&&Series> = others.iter().filter(aligned).collect();
    let rows: Vec<usize> =
        (0..series.estimate.len()).filter(|row| series.estimate[*row].is_some()).collect();
    if others.is_empty() || rows.is_empty() {
        return Vec::new();
    }
    let columns = others.len() + 2;
    let mut x = DMatrix::from_fn(rows.len(), columns, |i, j| match j {
        0 => 1.0,
        1 => series.reference[rows[i]],
        j => others[j - 2].reference[rows[i]],
    });
    let sizes: Vec<f64> = x.column_iter_mut().map(|mut column| column.normalize_mut()).collect();
    let y = DVector::from_iterator(
        rows.len(),
        rows.iter().map(|row| series.estimate[*row].unwrap_or_default() - series.reference[*row]),
    );
    // A component that is always zero has no direction, and the decomposition would not converge.
    if sizes.contains(&0.0) {
        return Vec::new();
    }
    // If the components rise and fall together, the cause is ambiguous.
    let svd = (x.transpose() * &x).svd(true, true);
    let (most, least) = (svd.singular_values.max(), svd.singular_values.min());
    if least.is_nan() || least <= 1e-6 * most {
        return Vec::new();
    }
    let Ok(slopes) = svd.solve(&(x.transpose() * y), 0.0) else { return Vec::new() };
    let slopes = slopes.iter().zip(sizes).skip(2).map(|(slope, size)| slope / size);
    others.iter().zip(slopes).map(|(other, s)| (other.kind.name(), 100.0 * s)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::series::Kind;
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn series(axis: usize, reference: Vec<f64>, estimate: Vec<f64>) -> Series {
        let time = (0..reference.len()).map(|i| i as f64 * 1e-3).collect();
        let estimate = estimate.into_iter().map(Some).collect();
        Series { time, reference, estimate, ..Series::empty(Kind::Force(axis)) }
    }

    /// Up and down ten times between 0 and 1.
    fn triangle() -> Vec<f64> {
        (0..4000).map(|i| (f64::from(i % 400) / 200.0 - 1.0).abs()).collect()
    }

    #[test]
    fn hysteresis_is_backlash_without_offset() {
        let up = triangle();
        let late: Vec<f64> = (0..up.len())
            .map(|i| up[i] + if up[(i + 1) % up.len()] > up[i] { -0.02 } else { 0.02 })
            .collect();
        let found = figures(&series(2, up.clone(), late), &[]).unwrap();
        assert!((found.hysteresis_percent.unwrap() - 4.0).abs() < 0.2, "{found:?}");
        let shifted = up.iter().map(|f| f + 0.3).collect();
        let found = figures(&series(2, up, shifted), &[]).unwrap();
        assert!(found.hysteresis_percent.unwrap() < 1e-9, "{found:?}");
        assert!((found.bias - 0.3).abs() < 1e-12 && found.sigma < 1e-9);
    }

    #[test]
    fn crosstalk_excludes_own_component() {
        let z = triangle();
        let x: Vec<f64> = (0..z.len()).map(|i| (i as f64 * 0.05).sin()).collect();
        let said = x.iter().zip(&z).map(|(x, z)| 1.1 * x - 0.07 * z).collect();
        let other = series(2, z.clone(), z.clone());
        let found = figures(&series(0, x.clone(), said), &[&other]).unwrap();
        assert_eq!(found.crosstalk_percent.len(), 1);
        let (name, percent) = &found.crosstalk_percent[0];
        assert_eq!(name, "fz_n");
        assert!((percent + 7.0).abs() < 0.01, "{percent}");
        // Components that change together give no crosstalk figure, because the cause is ambiguous.
        let twin = series(2, x.clone(), x.clone());
        let found = figures(&series(0, x.clone(), x.clone()), &[&twin]).unwrap();
        assert!(found.crosstalk_percent.is_empty(), "{found:?}");
        // A component that is always zero gives none either.
        let (rests, said) = (vec![0.0; x.len()], x.clone());
        let still = series(2, rests.clone(), rests.clone());
        for (reference, other) in [(x.clone(), still), (rests, series(2, x.clone(), x))] {
            let found = figures(&series(0, reference, said.clone()), &[&other]).unwrap();
            assert!(found.crosstalk_percent.is_empty(), "{found:?}");
        }
    }

    #[test]
    fn noise_excludes_drift_and_jumps() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let truth = triangle();
        let sigma = 2e-3;
        // The sum of twelve uniform numbers is nearly normal.
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let said: Vec<f64> = truth
            .iter()
            .enumerate()
            .map(|(i, f)| 0.9 * f + 1e-4 * i as f64 + sigma * normal() + f64::from(i > 2000))
            .collect();
        let found = figures(&series(2, truth, said), &[]).unwrap();
        let noise = found.noise.unwrap();
        assert!((noise - sigma).abs() < 0.05 * sigma, "{noise}");
        assert!((found.dynamic_range.unwrap() - 1.0 / (3.0 * noise)).abs() < 1e-9);
    }

    #[test]
    fn figures_are_none_without_estimates() {
        let mut none = series(2, vec![1.0, 2.0], vec![0.0, 0.0]);
        none.estimate = vec![None, None];
        assert_eq!(figures(&none, &[]), None);
        let constant = figures(&series(2, vec![1.0; 9], vec![1.0; 9]), &[]).unwrap();
        assert_eq!((constant.percent, constant.hysteresis_percent), (None, None));
    }
}

//! Number of independent rows in a recording.
//!
//! The rows of one press repeat each other's error. The evidence for a weight decay supposes
//! independent errors; with every row counted it overestimates how certain the data are.

use nalgebra::DMatrix;

/// Sokal's window, in correlation times: the sum of correlations ends once it spans so many.
///
/// Beyond it there is only noise to add.
const WINDOW: f64 = 5.0;

/// Share of independent rows among `errors`: 1/τ, at least one row.
///
/// Rows are in the order of time, a column an output. The integrated autocorrelation time is τ = 1
/// + 2 Σ_t ρ(t) (Sokal 1997, "Monte Carlo methods in statistical mechanics", §3).
#[must_use]
pub fn independent_share(errors: &DMatrix<f64>) -> f64 {
    let rows = errors.nrows();
    let mut centred = errors.clone();
    for mut column in centred.column_iter_mut() {
        let mean = column.mean();
        column.add_scalar_mut(-mean);
    }
    let variances: Vec<f64> = centred.column_iter().map(|e| e.norm_squared()).collect();
    let live = variances.iter().filter(|v| **v > 0.0).count();
    if live == 0 || rows < 2 {
        return 1.0;
    }
    let correlation = |lag: usize| {
        let sum: f64 = (centred.column_iter().zip(&variances))
            .filter(|(_, variance)| **variance > 0.0)
            .map(|(e, variance)| e.rows_range(lag..).dot(&e.rows_range(..rows - lag)) / variance)
            .sum();
        sum / live as f64
    };
    let mut time = 1.0;
    for lag in 1..rows {
        time += 2.0 * correlation(lag);
        if lag as f64 >= WINDOW * time {
            break;
        }
    }
    1.0 / time.clamp(1.0, rows as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn noise(rows: usize, repeat: usize) -> DMatrix<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut value = [0.0; 2];
        DMatrix::from_row_iterator(
            rows,
            2,
            (0..rows)
                .flat_map(|row| {
                    if row % repeat == 0 {
                        value = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
                    }
                    value
                })
                .collect::<Vec<_>>(),
        )
    }

    #[test]
    fn independent_errors_count_fully() {
        let share = independent_share(&noise(4000, 1));
        assert!(share > 0.85, "{share}");
    }

    #[test]
    fn repeated_error_counts_about_once() {
        for repeat in [5, 20, 50] {
            // A run of n equal values has correlations 1 − t/n, so that τ = n.
            let share = independent_share(&noise(8000, repeat)) * repeat as f64;
            assert!((0.7..1.4).contains(&share), "{repeat}: {share}");
        }
    }

    #[test]
    fn zero_errors_cause_no_division_by_zero() {
        assert_eq!(independent_share(&DMatrix::zeros(100, 3)), 1.0);
        assert_eq!(independent_share(&DMatrix::zeros(0, 3)), 1.0);
    }
}

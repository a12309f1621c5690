//! Median and quantiles.

/// Median of some values: the mean of the middle two for an even number, zero for none.
pub fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    let even = values.len().is_multiple_of(2);
    let (below, high, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let high = *high;
    match below.iter().copied().max_by(f64::total_cmp) {
        Some(low) if even => 0.5 * (low + high),
        _ => high,
    }
}

/// Quantile at a share from 0 to 1 by the nearest rank; zero for no values.
pub fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let at = (share * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_quantile_use_nearest_rank() {
        assert_eq!(
            [median(vec![3.0, 1.0, 2.0]), median(vec![4.0, 1.0]), median(vec![])],
            [2.0, 2.5, 0.0]
        );
        let tens: Vec<f64> = (0..11).map(|i| f64::from(10 * i)).collect();
        assert_eq!(
            [0.0, 0.44, 0.46, 1.0].map(|share| quantile(tens.clone(), share)),
            [0.0, 40.0, 50.0, 100.0]
        );
    }
}

//! Range of signals in which a fit is valid.

use taxel::calibration::Range;

/// Extrapolation margin: share of the trained range by which inputs may exceed it.
///
/// A press of the same kind falls between the training presses and may move a channel a little
/// further than any of them. A load well beyond them moves the nearest channels in proportion. A
/// quarter accepts the first and rejects the second, before tanh units outside their trained range
/// decide the output.
const MARGIN: f32 = 0.25;
/// Least margin in standard deviations of the noise, for channels that hardly change in training.
const NOISES: f32 = 10.0;

/// Range of one channel in training, margin included.
pub fn trained_range(values: impl Iterator<Item = f32>, noise: f32) -> Range {
    let [low, high] = extremes(values);
    let margin = (MARGIN * (high - low)).max(NOISES * noise);
    [low - margin, high + margin]
}

/// Lowest and highest value.
pub fn extremes(values: impl Iterator<Item = f32>) -> Range {
    values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
}

/// Largest absolute value in any of the ranges.
#[must_use]
pub fn largest(ranges: &[Range]) -> f32 {
    ranges.as_flattened().iter().fold(0.0, |most, end| most.max(end.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn margin_is_quarter_of_span_beyond_noise() {
        assert_eq!(trained_range([0.0, -1.0, 0.5].into_iter(), 0.01), [-1.375, 0.875]);
        assert_eq!(trained_range([0.0, 0.0].into_iter(), 0.125), [-1.25, 1.25]);
    }
}

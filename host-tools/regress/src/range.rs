//! The range of signals in which a fit may be trusted.

use taxel::calibration::Range;

/// Extrapolation margin: share of the trained range by which inputs may exceed it.
///
/// A press of the same kind lands between the places where the training presses did and may move a
/// channel a little further than any of them; a load well beyond them moves the nearest channels in
/// proportion. A quarter lets the first pass and stops the second before tanh units that were never
/// tried decide.
const MARGIN: f32 = 0.25;
/// A channel that hardly moved in training still may show its noise.
const NOISES: f32 = 10.0;

/// Range of one channel in training, margin included.
pub fn trained_range(values: impl Iterator<Item = f32>, noise: f32) -> Range {
    let [low, high] = extremes(values);
    let margin = (MARGIN * (high - low)).max(NOISES * noise);
    [low - margin, high + margin]
}

/// The lowest and the highest value.
pub fn extremes(values: impl Iterator<Item = f32>) -> Range {
    values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
}

/// The largest value, of either sign, that lies in one of the ranges.
#[must_use]
pub fn largest(ranges: &[Range]) -> f32 {
    ranges.as_flattened().iter().fold(0.0, |most, end| most.max(end.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_margin_is_a_quarter_of_the_span_but_never_within_the_noise() {
        assert_eq!(trained_range([0.0, -1.0, 0.5].into_iter(), 0.01), [-1.375, 0.875]);
        assert_eq!(trained_range([0.0, 0.0].into_iter(), 0.125), [-1.25, 1.25]);
    }
}

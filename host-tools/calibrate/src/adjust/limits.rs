//! Thresholds of the adjustment.

/// Fewest presses: halves judge each other, and the error of a mean needs three.
pub(super) const LEAST_PRESSES: usize = 3;
/// Longest gap in microseconds within a press; the finger is at rest from so long after a load.
pub(super) const SETTLE_US: u64 = 20_000;
/// Shortest contact of a weight, microseconds; a shorter one is a press by hand.
pub(super) const WEIGHT_US: u64 = 300_000;
/// Least ratio of a taxel's signal in an earlier press to that under a weight on a pressed skin.
pub(super) const HARDER: f32 = 1.2;
/// Share of a press left out at either end, while the weight moves.
pub(super) const SETTLING: f64 = 0.2;
/// Smallest relative change of the light that counts as ageing: LEDs of 2 K more lose as much.
pub(super) const FADED: f64 = 0.01;
/// Largest standard deviation of the light's change over the taxels, as a share of its mean.
///
/// LEDs of one finger age alike: tests have 0.11 at most. Two simulated fingers differ by 0.21.
pub(super) const OTHER_FINGER: f64 = 0.12;
/// Largest relative change that counts as ageing; a larger one has another cause.
pub(super) const AGED: f64 = 0.5;
/// Standard deviation of the skin's stiffness, or of the gain of a row of S.
pub(super) const COMMON: f64 = 0.2;
/// Standard errors beyond which a mean difference over the presses is no chance.
pub(super) const SURE: f64 = 2.0;
/// RMS error, as a share of the one before, below which a quantity is better.
pub(super) const BETTER: f64 = 0.95;
/// RMS error, as a share of the one before, above which a quantity is worse.
pub(super) const WORSE: f64 = 1.05;
/// Limit of [`WORSE`] for a zero that ends contacts at rest.
///
/// A contact that never ends follows the beginning of each touch, which a sound finger's gate hides.
pub(super) const ZERO_WORSE: f64 = 1.1;
/// Multiple of the record's own residual from which what is left calls for a new fit.
pub(super) const LEFT: f64 = 5.0;

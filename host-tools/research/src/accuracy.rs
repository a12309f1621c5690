//! Claimed accuracy of a method over the load, from its errors on held-out recordings.
//!
//! The held-out recordings are of the same kind as the calibration recordings (`taxel calibrate
//! evaluate`).
//!
//! ```text
//! force, torsion    σ² = a² + (b·F)²     absolute and relative error, as on data sheets
//! place, share      σ² = a² + (b/F)²     error that falls with the load
//! no touch felt     σ  = c               error of a touch below the detection threshold
//! ```
//! The errors are not normal: three times the claimed accuracy covers the recordings' errors,
//! however long their tail. All recordings are of one skin, so the error of an unknown skin comes
//! on top as a share of the load.

/// Error on a recording that no fit has seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Unseen {
    /// Normal force in newtons.
    pub load: f64,
    /// True where the finger detects the contact.
    pub felt: bool,
    pub error: f64,
}

/// Claimed standard deviation as a function of the load.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accuracy {
    floor: f64,
    slope: f64,
    unfelt: f64,
    /// Function of the load that multiplies the slope.
    over: fn(f64) -> f64,
    /// Share of the load that recordings of one skin cannot show.
    share: f64,
}

/// Largest number of rows to fit; rows of one press are alike.
const ROWS: usize = 8192;
/// Rounds of the maximum-likelihood search, and steps to either side in each.
const ROUNDS: usize = 8;
const PLACES: i32 = 10;
/// Share of errors allowed beyond three times the claimed accuracy.
///
/// The claim grows where normal errors would exceed this share or the errors have a longer tail.
const BEYOND: f64 = 2e-4;
/// Smallest load in newtons; the detection threshold is higher.
const LEAST_N: f64 = 1e-3;

impl Accuracy {
    /// Fits the law by maximum likelihood for normal errors, then widens it to cover the errors.
    pub(crate) fn of(unseen: &[Unseen], over: fn(f64) -> f64) -> Self {
        let felt: Vec<(f64, f64)> = unseen
            .iter()
            .filter(|unseen| unseen.felt)
            .map(|unseen| (over(unseen.load.max(LEAST_N)).powi(2), unseen.error * unseen.error))
            .collect();
        let [floor, slope] = likeliest(&felt);
        let wider = covering(felt.iter().map(|(x, error)| error / (floor + slope * x)), 1.0);
        let [floor, slope] = [floor, slope].map(|variance| (variance * wider).sqrt());
        let unfelt = unseen.iter().filter(|unseen| !unseen.felt);
        let unfelt: Vec<f64> = unfelt.map(|unseen| unseen.error * unseen.error).collect();
        let least = mean(unfelt.iter().copied());
        let unfelt = covering(unfelt.into_iter(), least).sqrt();
        Self { floor, slope, unfelt, over, share: 0.0 }
    }

    /// Returns the accuracy of verdicts, which are right or wrong: a wrong one always fails.
    pub(crate) fn of_verdicts() -> Self {
        Self { floor: 0.33, slope: 0.0, unfelt: 0.33, over: |load| load, share: 0.0 }
    }

    /// Adds an error in proportion to the load.
    pub(crate) fn with_share(self, share: f64) -> Self {
        Self { share, ..self }
    }

    /// Returns one standard deviation under a load in newtons.
    pub(crate) fn at(&self, load: f64, felt: bool) -> f64 {
        let sloped = self.slope * (self.over)(load.max(LEAST_N));
        if felt { self.floor.hypot(sloped).hypot(self.share * load) } else { self.unfelt }
    }
}

/// Fits a² and b² of v = a² + b²·x to pairs of x and squared error.
///
/// The fit is by maximum likelihood. The division of v between its two terms fixes the scale in
/// closed form. The search is therefore one-dimensional and covers the whole line, because stepwise
/// descent ends in laws that are tiny where few rows are.
fn likeliest(rows: &[(f64, f64)]) -> [f64; 2] {
    let rows: Vec<(f64, f64)> =
        rows.iter().copied().step_by(rows.len().div_ceil(ROWS).max(1)).collect();
    let usual = mean(rows.iter().map(|(x, _)| *x)).max(f64::MIN_POSITIVE);
    let shaped = |balance: f64| {
        let share = 1.0 / (1.0 + (-balance).exp());
        move |x: f64| (1.0 - share) + share * x / usual
    };
    let scale = |balance: f64| {
        let shape = shaped(balance);
        mean(rows.iter().map(|(x, error)| error / shape(*x)))
    };
    let unlikely = |balance: f64| {
        let shape = shaped(balance);
        mean(rows.iter().map(|(x, _)| shape(*x).ln())) + scale(balance).max(f64::MIN_POSITIVE).ln()
    };
    // Search range: from the first term alone to the second alone, each down to a millionth.
    let (mut best, mut width) = (0.0, 14.0);
    for _ in 0..ROUNDS {
        let around = (-PLACES..=PLACES).map(|i| best + width * f64::from(i) / f64::from(PLACES));
        let all: Vec<f64> = around.map(|balance| balance.clamp(-14.0, 14.0)).collect();
        let least = all.iter().copied().min_by(|a, b| unlikely(*a).total_cmp(&unlikely(*b)));
        (best, width) = (least.unwrap_or(best), width / f64::from(PLACES) * 2.0);
    }
    let share = 1.0 / (1.0 + (-best).exp());
    let scale = scale(best);
    [scale * (1.0 - share), scale * share / usual]
}

/// Returns a ninth of the square that a share [`BEYOND`] exceeds, but at least `least`.
fn covering(squares: impl Iterator<Item = f64>, least: f64) -> f64 {
    let mut squares: Vec<f64> = squares.collect();
    squares.sort_by(f64::total_cmp);
    let at = ((1.0 - BEYOND) * squares.len() as f64) as usize;
    let widest = squares.get(at.min(squares.len().saturating_sub(1)));
    widest.map_or(least, |square| (square / 9.0).max(least))
}

fn mean(of: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = of.fold((0.0, 0usize), |(sum, count), x| (sum + x, count + 1));
    sum / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn claimed_accuracy_recovers_law_of_errors() {
        // Errors of ±σ have the mean square of normal errors.
        let loads = (0..400).map(|i| 0.05 + 0.005 * f64::from(i % 400));
        let of = |over: fn(f64) -> f64, floor: f64, slope: f64| {
            let unseen: Vec<Unseen> = loads
                .clone()
                .map(|load| Unseen { load, felt: true, error: floor.hypot(slope * over(load)) })
                .chain([Unseen { load: 0.01, felt: false, error: 0.01 }])
                .collect();
            Accuracy::of(&unseen, over)
        };
        for (over, floor, slope) in
            [(f64::recip as fn(f64) -> f64, 0.01, 0.006), (|load| load, 0.002, 0.004)]
        {
            let found = of(over, floor, slope);
            for load in [0.05, 0.5, 2.0] {
                let known = floor.hypot(slope * over(load));
                assert!((found.at(load, true) / known - 1.0).abs() < 1e-3, "{found:?}");
            }
            assert!((found.at(0.01, false) - 0.01).abs() < 1e-9);
        }
    }

    fn steady(errors: impl Iterator<Item = (f64, f64)>) -> Accuracy {
        let unseen: Vec<Unseen> =
            errors.map(|(load, error)| Unseen { load, felt: true, error }).collect();
        Accuracy::of(&unseen, |load| load)
    }

    #[test]
    fn few_tiny_errors_do_not_lower_the_law() {
        let usual = (0..2000).map(|i| (0.05 + 0.001 * f64::from(i), 0.02));
        let tiny = (0..200).map(|i| (1e-3 + 1e-6 * f64::from(i), 1e-7));
        let found = steady(tiny.chain(usual));
        for load in [0.5, 1.0, 2.0] {
            assert!(found.at(load, true) > 0.015, "{load}: {found:?}");
        }
    }

    #[test]
    fn three_sigma_covers_tail_of_errors() {
        // One error in a hundred is ten times as large.
        let found = steady((0..5000).map(|i| (1.0, if i % 100 == 0 { 0.1 } else { 0.01 })));
        assert!(3.0 * found.at(1.0, true) >= 0.1 && found.at(1.0, true) < 0.04, "{found:?}");
    }

    #[test]
    fn share_of_load_adds_to_claimed_accuracy() {
        let found = steady((0..2000).map(|_| (1.0, 0.01))).with_share(0.05);
        assert!((found.at(2.0, true) - 0.1f64.hypot(0.01)).abs() < 1e-3, "{found:?}");
    }

    #[test]
    fn wrong_verdict_is_a_failure() {
        assert!(3.0 * Accuracy::of_verdicts().at(1.0, true) < 1.0);
    }
}

//! The accuracy that a method states: what it leaves on recordings of the kind that the finger is calibrated
//! on, but that the fit has not seen (`taxel calibrate evaluate`), by the load.
//!
//! ```text
//! force, torsion    σ² = a² + (b·F)²     as data sheets say it: so many mN and so many per cent
//! place             σ² = a² + (b/F)²     a moment over the load
//! no touch felt     σ  = c               what a touch that is taken for none is off by
//! ```

/// An error on a recording that no fit has seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Unseen {
    /// Normal force in newtons.
    pub load: f64,
    /// The finger feels the touch.
    pub felt: bool,
    pub error: f64,
}

/// One standard deviation, by the load.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accuracy {
    floor: f64,
    slope: f64,
    unfelt: f64,
    /// What the slope is over.
    over: fn(f64) -> f64,
}

/// Rounds of a maximum-likelihood fit of the variance; two more change nothing in four digits.
const ROUNDS: usize = 30;
/// Loads are no smaller, in newtons: those that are felt are above.
const LEAST_N: f64 = 1e-3;

impl Accuracy {
    /// Maximum likelihood for normal errors: least squares of the squares, weighted by what they scatter.
    pub(crate) fn of(unseen: &[Unseen], over: fn(f64) -> f64) -> Self {
        let square = |load: f64| over(load.max(LEAST_N)).powi(2);
        let felt: Vec<(f64, f64)> = unseen
            .iter()
            .filter(|unseen| unseen.felt)
            .map(|unseen| (square(unseen.load), unseen.error * unseen.error))
            .collect();
        let mean = |of: &mut dyn Iterator<Item = f64>| {
            let (sum, count) = of.fold((0.0, 0usize), |(sum, count), x| (sum + x, count + 1));
            sum / count.max(1) as f64
        };
        let mut variance = [mean(&mut felt.iter().map(|(_, error)| *error)), 0.0];
        for _ in 0..ROUNDS {
            let mut sums = [0.0; 5];
            for (x, error) in &felt {
                let weight = (variance[0] + variance[1] * x).max(f64::MIN_POSITIVE).powi(-2);
                let terms = [1.0, *x, x * x, *error, x * error];
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
            }
            let [n, x, xx, e, xe] = sums;
            let determinant = n * xx - x * x;
            let solved = [(e * xx - xe * x) / determinant, (xe * n - e * x) / determinant];
            variance = match solved {
                [floor, slope] if floor > 0.0 && slope > 0.0 => solved,
                // One of the two alone.
                [_, slope] if slope > 0.0 => [0.0, xe / xx],
                _ => [e / n, 0.0],
            };
        }
        let unfelt = unseen.iter().filter(|unseen| !unseen.felt);
        let unfelt = mean(&mut unfelt.map(|unseen| unseen.error * unseen.error));
        let [floor, slope] = variance.map(f64::sqrt);
        Self { floor, slope, unfelt: unfelt.sqrt(), over }
    }

    /// One standard deviation under a load in newtons.
    pub(crate) fn at(&self, load: f64, felt: bool) -> f64 {
        let sloped = self.slope * (self.over)(load.max(LEAST_N));
        if felt { self.floor.hypot(sloped) } else { self.unfelt }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_comes_back_by_its_load() {
        // ±σ, which has the mean square that normal errors would have.
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
}

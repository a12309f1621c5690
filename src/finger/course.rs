//! Uncertainty of a force that changes quickly.
//!
//! Compensation of the lag leaves an error while the rate of the force changes, and for some lags
//! after it. How large it is nobody knows; the bend of the force's course, its second difference
//! with its values after one and two low-passes, tells about it.

use super::filters::steady;
use crate::estimate::fusion::Gaussian;
use crate::math::{at_least, at_most};
use crate::measured::Measured;
use crate::units::Micros;

/// Uncertainty of a force whose course bends: a share of the bend, less what its noise may bend,
/// which is a share of the standard deviation.
///
/// With these at most one in a hundred forces of a reference finger is off by more than three
/// standard deviations (`host-tools/research/data/ablation.csv`).
const BEND_ERROR: f32 = 0.9;
const STRAIGHT: f32 = 0.5;
/// Share of the low-passes' own with which a bend that is over fades: in three lags to a third.
const FADING: f32 = 1.0 / 3.0;
/// Largest share of a change that the low-passes of [`Course`] follow in one estimate. A ninth of a
/// change between rare estimates then counts as a bend.
const MOST_FOLLOWED: f32 = 2.0 / 3.0;

/// Course of the force during a contact, in newtons: its values after one and after two low-passes
/// with the time constant of the lag, and its bends, which fade.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Course {
    /// Low half of the time of the last estimate: 71 minutes suffice.
    time: u32,
    once: [f32; 3],
    twice: [f32; 3],
    bends: [f32; 3],
}

impl Course {
    /// Returns the course of a contact that begins at `time`, without a force before.
    pub(super) fn begin(time: Micros) -> Self {
        Self { time: time.0 as u32, ..Self::default() }
    }

    /// Adds the uncertainty that compensation of a `lag` in seconds leaves to a force estimated at
    /// `time`.
    #[inline(never)]
    pub(super) fn widen(&mut self, time: Micros, lag: f32, force: &mut [Measured<Gaussian>; 3]) {
        let time = time.0 as u32;
        let passed = steady(time.wrapping_sub(self.time)) as f32 * 1e-6;
        self.time = time;
        if lag == 0.0 {
            return;
        }
        let share = at_most(passed / (passed + lag), MOST_FOLLOWED);
        let left = 1.0 - FADING * share;
        let course = self.once.iter_mut().zip(&mut self.twice).zip(&mut self.bends);
        for (force, ((once, twice), bends)) in force.iter_mut().zip(course) {
            if let Ok(Gaussian { value, sigma }) = force {
                *once += share * (*value - *once);
                *twice += share * (*once - *twice);
                *bends = at_least((*value - 2.0 * *once + *twice).abs(), left * *bends);
                *sigma += BEND_ERROR * at_least(*bends - STRAIGHT * *sigma, 0.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measured::NoValue;
    use std::vec::Vec;

    const LAG: f32 = 4e-3;

    /// Standard deviations of a force of 1 N that begins at once, every `period` microseconds.
    fn widened(lag: f32, period: u64, estimates: u64) -> Vec<f32> {
        let mut course = Course::begin(Micros(1000));
        let sigma = |i: u64| {
            let mut force = [
                Err(NoValue::NotEstimated),
                Ok(Gaussian { value: 1.0, sigma: 0.01 }),
                Ok(Gaussian { value: -1.0, sigma: 0.01 }),
            ];
            course.widen(Micros(1000 + i * period), lag, &mut force);
            let [Err(NoValue::NotEstimated), Ok(y), Ok(z)] = force else { panic!("{force:?}") };
            assert!(y.sigma == z.sigma && y.value == 1.0, "{y:?}, {z:?}");
            y.sigma
        };
        (0..estimates).map(sigma).collect()
    }

    #[test]
    fn sigma_grows_where_the_course_of_the_force_bends() {
        // At 4 kHz: a jump, three lags later, and eighteen.
        let sigmas = widened(LAG, 250, 289);
        assert!((sigmas[0] - (0.01 + 0.9 * 0.995)).abs() < 1e-6, "{}", sigmas[0]);
        assert!((0.3..0.4).contains(&sigmas[48]), "{}", sigmas[48]);
        assert_eq!(sigmas[288], 0.01);
    }

    #[test]
    fn little_noise_and_steady_rates_widen_nothing() {
        let mut course = Course::begin(Micros(0));
        for i in 0..400 {
            let noise = [0.002, -0.002, 0.0, 0.001, -0.001][i % 5];
            let value = 0.002 * i as f32 + noise;
            let mut force = [Ok(Gaussian { value, sigma: 0.01 }); 3];
            course.widen(Micros(1000 * i as u64), LAG, &mut force);
            let [x, ..] = force.map(|force| force.expect("a force").sigma);
            assert!(i < 60 || x == 0.01, "{i}: {x}");
        }
    }

    #[test]
    fn jump_between_rare_estimates_widens_by_a_share_of_a_ninth() {
        let mut course = Course::begin(Micros(0));
        let mut force = [Ok(Gaussian { value: 1.0, sigma: 0.01 }); 3];
        course.widen(Micros(100_000), LAG, &mut force);
        let Ok(Gaussian { sigma, .. }) = force[0] else { panic!("{force:?}") };
        assert!((sigma - 0.01 - 0.9 * (1.0 / 9.0 - 0.005)).abs() < 1e-4, "{sigma}");
    }

    #[test]
    fn finger_without_lag_is_as_sure_of_quick_forces() {
        assert_eq!(widened(0.0, 250, 3), [0.01; 3]);
    }
}

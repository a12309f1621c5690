//! Compensation of the lag of skin and force sensors behind the force.
//!
//! A coating with two equal time constants of half its lag T follows the force by the transfer
//! function 1/(1 + Ts/2)² ([Ospina2017] eq. (1.25)). Its inverse 1 + Ts + T²s²/4 would amplify
//! noise without bound. Each signal passes three equal low-passes of first order instead, and their
//! outputs are combined so that the sum equals the inverse up to the second order in s, at any scan
//! rate. What is left of the error is about T³ times the third derivative of the force.

use serde::{Deserialize, Serialize};

use super::Signals;
use crate::math::at_most;
use crate::scan::{SENSORS, TAXELS};

/// Time constant of each low-pass: shares of the lag, and of the time between two scans, of which
/// no more than a lag counts. Smaller ones follow quicker and are noisier.
const SMOOTHED: [f32; 2] = [0.6, 0.65];

/// Least and longest lag in seconds. The longest is far beyond that of any coating of
/// [Ospina2017].
const RANGE: core::ops::RangeInclusive<f32> = 1e-4..=0.05;

/// Lags behind the force, in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LagCompensation {
    /// Lag of the skin over the taxels.
    pub taxels: f32,
    /// Lag of the force sensors.
    pub sensors: f32,
}

/// Outputs of the three low-passes of one signal.
type Smoothed = [f32; 3];

/// Low-passes of all signals; `None` for an absent one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LagState {
    /// Microseconds between the last two scans, and their coefficients.
    passed: u32,
    paces: [Option<Pace>; 2],
    taxels: Option<[Smoothed; TAXELS]>,
    bridges: [Option<[Smoothed; 3]>; SENSORS],
}

impl LagCompensation {
    /// Returns whether `lag` is zero, or between 0.1 and 50 ms.
    pub(crate) fn fits(lag: f32) -> bool {
        lag == 0.0 || RANGE.contains(&lag)
    }

    /// Advances the signals of a scan, `passed` microseconds after the last one. A signal that was
    /// absent before is taken to stand still.
    #[inline(never)]
    pub fn advance(&self, state: &mut LagState, passed: u32, signals: &mut Signals) {
        if passed != state.passed {
            state.passed = passed;
            let passed = passed as f32 * 1e-6;
            state.paces = [self.taxels, self.sensors].map(|lag| Pace::of(lag, passed));
        }
        let [taxels, bridges] = state.paces;
        follow(&mut state.taxels, &mut signals.taxels, taxels);
        for (state, bridge) in state.bridges.iter_mut().zip(&mut signals.bridges) {
            follow(state, bridge, bridges);
        }
    }
}

/// Coefficients of one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pace {
    /// Share by which each low-pass approaches its input.
    share: f32,
    /// Weights of the second and third low-pass' distance from their inputs.
    second: f32,
    third: f32,
}

impl Pace {
    /// Returns the coefficients for `passed` seconds; `None` without a lag.
    ///
    /// A low-pass with the time constant τ that is read every h seconds is 1 − τs + (τ² + τh/2)s² up
    /// to the second order. The weights a and b of u₁ + a(u₁ − u₂) + b(u₁ − 2u₂ + u₃), the outputs
    /// of the low-passes, follow from comparing its coefficients with those of the inverse.
    #[inline(never)]
    fn of(lag: f32, passed: f32) -> Option<Self> {
        let [of_lag, of_passed] = SMOOTHED;
        (lag > 0.0).then(|| {
            let per_constant = (of_lag * lag + of_passed * at_most(passed, lag)).recip();
            let (times, turns) = (lag * per_constant, passed * per_constant);
            let a = 1.0 + times;
            let b = 1.0 + times * (2.0 + 0.25 * times + 0.5 * turns);
            // After its step a low-pass is nearer to its input by its share.
            let left = (1.0 + turns).recip();
            Self { share: turns * left, second: (a + b) * left, third: b * left }
        })
    }
}

fn follow<const N: usize>(
    state: &mut Option<[Smoothed; N]>,
    signals: &mut Option<[f32; N]>,
    pace: Option<Pace>,
) {
    let before = state.is_some();
    match (signals, pace) {
        (Some(signals), Some(pace)) => {
            advance(before, state.get_or_insert([Smoothed::default(); N]), signals, pace);
        }
        _ => *state = None,
    }
}

/// Advances signals, which stood still if they were absent before.
#[inline(never)]
fn advance(before: bool, state: &mut [Smoothed], signals: &mut [f32], pace: Pace) {
    if !before {
        for (smoothed, x) in state.iter_mut().zip(&*signals) {
            *smoothed = [*x; 3];
        }
    }
    let Pace { share, second, third } = pace;
    for ([u1, u2, u3], x) in state.iter_mut().zip(signals) {
        *u1 += share * (*x - *u1);
        let to_second = *u1 - *u2;
        *u2 += share * to_second;
        let to_third = *u2 - *u3;
        *u3 += share * to_third;
        *x = *u1 + (second * to_second - third * to_third);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::random::noise;

    const LAG: LagCompensation = LagCompensation { taxels: 4e-3, sensors: 3e-3 };

    fn signals(taxel: f64, bridge: f64) -> Signals {
        Signals {
            taxels: Some([taxel as f32; TAXELS]),
            bridges: [Some([bridge as f32; 3]); SENSORS],
            ..Signals::default()
        }
    }

    /// A force after two low-passes that together take `lag`, in steps of 5 µs.
    struct Coating([f64; 2], f64);

    impl Coating {
        fn follow(&mut self, force: impl Fn(f64) -> f64, from: f64, hz: u64) -> f64 {
            let Self([once, twice], lag) = self;
            let steps = 200_000 / hz;
            for i in 0..steps {
                let share = 1.0 - (-5e-6 / (0.5 * *lag)).exp();
                *once += share * (force(from + 5e-6 * i as f64) - *once);
                *twice += share * (*once - *twice);
            }
            *twice
        }
    }

    /// Largest errors after `settled` seconds, of a force(t) that skin and sensors follow late.
    fn errors(force: impl Fn(f64) -> f64, hz: u64, settled: f64) -> [f64; 2] {
        let (mut state, mut most) = (LagState::default(), [0.0f64; 2]);
        let mut late = [4e-3, 3e-3].map(|lag| Coating([force(0.0); 2], lag));
        for i in 0..hz / 2 {
            let t = i as f64 / hz as f64;
            let [taxels, bridges] = late.each_mut().map(|late| late.follow(&force, t, hz));
            let mut own = signals(taxels, bridges);
            LAG.advance(&mut state, (1_000_000 / hz) as u32, &mut own);
            let now = force(t + 1.0 / hz as f64);
            if t > settled {
                let errors = [own.taxels.unwrap()[5], own.bridges[2].unwrap()[1]];
                for (most, found) in most.iter_mut().zip(errors) {
                    *most = most.max((f64::from(found) - now).abs());
                }
            }
        }
        most
    }

    #[test]
    fn steady_force_passes_unchanged_and_ramp_is_not_late() {
        for hz in [500, 1000, 4000, 8000] {
            assert_eq!(errors(|_| 0.25, hz, -1.0), [0.0; 2]);
            // Without compensation the ramp of one a second is 4e-3 and 3e-3 late.
            for error in errors(|t| t, hz, 0.1) {
                assert!(error < 1e-5, "{hz} Hz: {error}");
            }
        }
    }

    #[test]
    fn force_that_speeds_up_is_not_late() {
        for hz in [500, 1000, 4000, 8000] {
            // Without compensation t² is up to 4e-3 late, and by half its rate of change 8e-6.
            for error in errors(|t| t * t, hz, 0.1) {
                assert!(error < 1e-5, "{hz} Hz: {error}");
            }
        }
    }

    #[test]
    fn press_of_a_fifth_of_a_second_is_off_by_less_than_a_hundredth() {
        let press = |t: f64| {
            if (0.0..0.2).contains(&t) {
                (core::f64::consts::PI * t / 0.2).sin().powi(2)
            } else {
                0.0
            }
        };
        for hz in [500, 1000, 4000] {
            let [taxels, bridges] = errors(press, hz, -1.0);
            // Without compensation they are 0.063 and 0.047.
            assert!(taxels < 0.0083 && bridges < 0.0054, "{hz} Hz: {taxels} {bridges}");
        }
    }

    /// Growth of the noise of the taxels at a scan rate.
    fn grown(hz: u32) -> f64 {
        let mut state = LagState::default();
        let (mut before, mut after) = (0.0, 0.0);
        let mut random = 1u32;
        for _ in 0..20_000 {
            let x = f64::from(noise(&mut random));
            let mut own = signals(x, 0.0);
            LAG.advance(&mut state, 1_000_000 / hz, &mut own);
            before += x * x;
            after += f64::from(own.taxels.unwrap()[0]).powi(2);
        }
        (after / before).sqrt()
    }

    #[test]
    fn noise_grows_by_less_than_half() {
        for (hz, most) in [(500, 1.5), (1000, 1.5), (4000, 1.2)] {
            let grown = grown(hz);
            assert!(grown < most, "{hz} Hz: {grown}");
        }
    }

    #[test]
    fn lost_scans_and_absent_sensor_start_from_present_signals() {
        let mut state = LagState::default();
        let mut first = signals(0.1, 0.1);
        LAG.advance(&mut state, 1000, &mut first);
        let mut gone = Signals { bridges: [None; SENSORS], ..signals(0.1, 0.0) };
        LAG.advance(&mut state, 1000, &mut gone);
        // After a second without scans nothing is left of the signals before, or little of those
        // with the longest lag; after an hour nothing.
        let mut late = signals(0.9, 0.9);
        LAG.advance(&mut state, 1_000_000, &mut late);
        assert_eq!(late.bridges, [Some([0.9; 3]); SENSORS]);
        assert!((late.taxels.unwrap()[0] - 0.9).abs() < 5e-3);
        let slow = LagCompensation { taxels: *RANGE.end(), sensors: *RANGE.start() };
        for (passed, least) in [(1_000_000, 0.08), (u32::MAX, 1e-4)] {
            let mut state = LagState::default();
            slow.advance(&mut state, 1000, &mut signals(0.1, 0.1));
            let mut late = signals(0.9, 0.9);
            slow.advance(&mut state, passed, &mut late);
            assert!((late.taxels.unwrap()[0] - 0.9).abs() < least);
            assert!((late.bridges[0].unwrap()[0] - 0.9).abs() < 1e-3);
        }
    }

    #[test]
    fn without_lag_signals_pass_to_the_bit() {
        let none = LagCompensation::default();
        let mut state = LagState::default();
        for i in 0..10u32 {
            let x = f64::from(i).sqrt();
            let mut own = signals(x, -x);
            none.advance(&mut state, 250, &mut own);
            assert_eq!(own, signals(x, -x));
        }
    }
}

//! Compensation of the lag of skin and force sensors behind the force.
//!
//! A coating with the time constants T₁ and T₂ ([Ospina2017] eq. (1.25)) follows a slow force by
//! T = T₁ + T₂ late. Each signal is therefore advanced by its rate: x + T·ẋ. The rate is that of the
//! signal after two low-passes of first order, so that noise grows little. What is left of the error
//! is of the second order, about T² times the second derivative of the force.

use serde::{Deserialize, Serialize};

use super::Signals;
use crate::scan::{SENSORS, TAXELS};

/// Time constant of either low-pass, as a share of the lag. At half, the noise of a signal that is
/// scanned four times in a lag grows by half.
const SMOOTHED: f32 = 0.5;

/// Longest lag in seconds, far beyond that of any coating of [Ospina2017].
const LONGEST: f32 = 0.05;

/// Lags behind the force, in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LagCompensation {
    /// Lag of the skin over the taxels.
    pub taxels: f32,
    /// Lag of the force sensors.
    pub sensors: f32,
}

/// Outputs of the two low-passes of one signal.
type Smoothed = [f32; 2];

/// Low-passes of all signals; `None` for an absent one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LagState {
    taxels: Option<[Smoothed; TAXELS]>,
    bridges: [Option<[Smoothed; 3]>; SENSORS],
}

impl LagCompensation {
    /// Returns whether `lag` lies between zero and 50 ms.
    pub(crate) fn fits(lag: f32) -> bool {
        (0.0..=LONGEST).contains(&lag)
    }

    /// Advances the signals of a scan, `passed` microseconds after the last one. A signal that was
    /// absent before is taken to stand still.
    #[inline(never)]
    pub fn advance(&self, state: &mut LagState, passed: u32, signals: &mut Signals) {
        // Beyond a second a signal has been forgotten, and few digits suffice.
        let passed = passed.min(1_000_000) as f32 * 1e-6;
        let [taxels, bridges] = [self.taxels, self.sensors].map(|lag| share(lag, passed));
        advance(&mut state.taxels, &mut signals.taxels, taxels);
        for (state, bridge) in state.bridges.iter_mut().zip(&mut signals.bridges) {
            advance(state, bridge, bridges);
        }
    }
}

/// Returns the share by which a low-pass approaches its input in `passed` seconds; `None` without a
/// lag.
fn share(lag: f32, passed: f32) -> Option<f32> {
    (lag > 0.0).then(|| passed / (SMOOTHED * lag + passed))
}

fn advance<const N: usize>(
    state: &mut Option<[Smoothed; N]>,
    signals: &mut Option<[f32; N]>,
    share: Option<f32>,
) {
    match (signals, share) {
        (Some(signals), Some(share)) => {
            all(state.get_or_insert_with(|| signals.map(|x| [x; 2])), signals, share);
        }
        _ => *state = None,
    }
}

#[inline(never)]
fn all(state: &mut [Smoothed], signals: &mut [f32], share: f32) {
    for ([once, twice], x) in state.iter_mut().zip(signals) {
        *once += share * (*x - *once);
        *twice += share * (*once - *twice);
        // The lag times the rate of the second low-pass.
        *x += (*once - *twice) / SMOOTHED;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAG: LagCompensation = LagCompensation { taxels: 4e-3, sensors: 3e-3 };

    fn signals(taxel: f64, bridge: f64) -> Signals {
        Signals {
            taxels: Some([taxel as f32; TAXELS]),
            bridges: [Some([bridge as f32; 3]); SENSORS],
            ..Signals::default()
        }
    }

    /// Largest errors after `settled` seconds, of a force(t) that skin and sensors follow late.
    fn errors(force: impl Fn(f64) -> f64, hz: u64, settled: f64) -> [f64; 2] {
        let (mut state, mut most) = (LagState::default(), [0.0f64; 2]);
        for i in 0..hz / 2 {
            let us = i * 1_000_000 / hz;
            let t = us as f64 * 1e-6;
            let mut own = signals(force(t - 4e-3), force(t - 3e-3));
            LAG.advance(&mut state, (1_000_000 / hz) as u32, &mut own);
            if t > settled {
                let errors = [own.taxels.unwrap()[5], own.bridges[2].unwrap()[1]];
                for (most, found) in most.iter_mut().zip(errors) {
                    *most = most.max((f64::from(found) - force(t)).abs());
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
            for error in errors(|t| t, hz, 0.05) {
                assert!(error < 2e-6, "{hz} Hz: {error}");
            }
        }
    }

    #[test]
    fn press_of_a_fifth_of_a_second_is_off_by_a_hundredth() {
        let press = |t: f64| {
            if (0.0..0.2).contains(&t) {
                (core::f64::consts::PI * t / 0.2).sin().powi(2)
            } else {
                0.0
            }
        };
        for hz in [1000, 4000] {
            let [taxels, bridges] = errors(press, hz, -1.0);
            // Without compensation they are 0.063 and 0.047.
            assert!(taxels < 0.013 && bridges < 0.0075, "{hz} Hz: {taxels} {bridges}");
        }
    }

    #[test]
    fn noise_grows_by_half() {
        let mut state = LagState::default();
        let (mut before, mut after) = (0.0, 0.0);
        let mut random = 1u32;
        for _ in 0..20_000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let x = f64::from(random >> 8) / f64::from(1 << 24) - 0.5;
            let mut own = signals(x, 0.0);
            LAG.advance(&mut state, 1000, &mut own);
            before += x * x;
            after += f64::from(own.taxels.unwrap()[0]).powi(2);
        }
        let grown = (after / before).sqrt();
        assert!((1.4..1.5).contains(&grown), "{grown}");
    }

    #[test]
    fn lost_scans_and_absent_sensor_start_from_present_signals() {
        let mut state = LagState::default();
        let mut first = signals(0.1, 0.1);
        LAG.advance(&mut state, 1000, &mut first);
        let mut gone = Signals { bridges: [None; SENSORS], ..signals(0.1, 0.0) };
        LAG.advance(&mut state, 1000, &mut gone);
        // After a second without scans nothing is left of the signals before.
        let mut late = signals(0.9, 0.9);
        LAG.advance(&mut state, 1_000_000, &mut late);
        assert_eq!(late.bridges, [Some([0.9; 3]); SENSORS]);
        assert!((late.taxels.unwrap()[0] - 0.9).abs() < 5e-3);
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

//! Optional low-pass filter on the signals: less noise, more delay.
//!
//! The filter is a second-order Butterworth state-variable filter with trapezoidal integrators
//! (Zavalishin, *The Art of VA Filter Design*, 2012, §4). Unlike a direct form it keeps a steady
//! signal to the bit in single precision, however low its corner.

use core::f32::consts::{PI, SQRT_2};

use super::Signals;
use crate::math::tan;
use crate::scan::{SENSORS, TAXELS};

/// Filter coefficients of one corner frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    a: [f32; 3],
}

/// Integrators of one signal.
type Integrators = [f32; 2];

/// State of the filter for all signals; `None` for an absent one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LowPassState {
    taxels: Option<[Integrators; TAXELS]>,
    bridges: [Option<[Integrators; 3]>; SENSORS],
}

impl LowPass {
    /// Makes a filter with −3 dB at `hz`, for `scan_hz` scans a second. The corner is limited to a
    /// quarter of `scan_hz`.
    #[must_use]
    pub fn new(hz: u16, scan_hz: u16) -> Self {
        let corner = (f32::from(hz) / f32::from(scan_hz.max(1))).clamp(1e-5, 0.25);
        let g = tan(PI * corner);
        let a1 = 1.0 / (1.0 + g * (g + SQRT_2));
        Self { a: [a1, g * a1, g * g * a1] }
    }

    /// Smooths the signals of one scan. A signal that was absent before starts with its present
    /// value.
    pub fn smooth(&self, state: &mut LowPassState, signals: &mut Signals) {
        self.group(&mut state.taxels, &mut signals.taxels);
        for (state, bridge) in state.bridges.iter_mut().zip(&mut signals.bridges) {
            self.group(state, bridge);
        }
    }

    #[inline(never)]
    fn all(&self, state: &mut [Integrators], signals: &mut [f32]) {
        let [a1, a2, a3] = self.a;
        for ([first, second], x) in state.iter_mut().zip(signals) {
            let rest = *x - *second;
            let band = a1 * *first + a2 * rest;
            let low = *second + a2 * *first + a3 * rest;
            *first = 2.0 * band - *first;
            *second = 2.0 * low - *second;
            *x = low;
        }
    }

    fn group<const N: usize>(
        &self,
        state: &mut Option<[Integrators; N]>,
        signals: &mut Option<[f32; N]>,
    ) {
        let Some(signals) = signals else {
            *state = None;
            return;
        };
        self.all(state.get_or_insert_with(|| signals.map(|x| [0.0, x])), signals);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: u16 = 4000;

    fn signals(x: f32) -> Signals {
        Signals {
            taxels: Some([x; TAXELS]),
            bridges: [Some([x; 3]); SENSORS],
            ..Signals::default()
        }
    }

    fn after(filter: &LowPass, state: &mut LowPassState, mut signals: Signals) -> Signals {
        filter.smooth(state, &mut signals);
        signals
    }

    /// Amplitude of a sine of amplitude 1 after the filter.
    fn gain(corner: u16, hz: f32) -> f32 {
        let (filter, mut state) = (LowPass::new(corner, RATE), LowPassState::default());
        let rounds = 40 * usize::from(RATE) / usize::from(corner).min(hz as usize);
        let mut most = 0.0f32;
        for i in 0..rounds {
            let turn = (f64::from(hz) * i as f64 / f64::from(RATE)).fract();
            let x = (core::f64::consts::TAU * turn).sin() as f32;
            let y = after(&filter, &mut state, signals(x));
            if i > rounds / 2 {
                most = most.max(y.taxels.unwrap()[7]).max(y.bridges[2].unwrap()[1]);
            }
        }
        most
    }

    #[test]
    fn low_pass_has_requested_corner_and_slope() {
        for corner in [5u16, 20, 100, 400] {
            let hz = f32::from(corner);
            let half = gain(corner, hz);
            assert!((half - core::f32::consts::FRAC_1_SQRT_2).abs() < 0.01, "{corner} Hz: {half}");
            assert!(gain(corner, 0.2 * hz) > 0.99);
        }
        let (once, tenfold) = (gain(20, 100.0), gain(20, 1000.0));
        // The warp of the bilinear transform only increases the slope.
        assert!((0.03..0.05).contains(&once) && tenfold < 0.01 * once, "{once} {tenfold}");
    }

    #[test]
    fn slow_ramp_is_delayed_by_root_two_over_corner() {
        for corner in [20u16, 50, 200] {
            let (filter, mut state) = (LowPass::new(corner, RATE), LowPassState::default());
            let mut late = 0.0;
            for i in 0..4000u16 {
                let x = f32::from(i) / f32::from(RATE);
                late = x - after(&filter, &mut state, signals(x)).taxels.unwrap()[0];
            }
            let expected = SQRT_2 / (core::f32::consts::TAU * f32::from(corner));
            assert!((late / expected - 1.0).abs() < 0.02, "{corner} Hz: {late} s, not {expected}");
        }
    }

    #[test]
    fn steady_signal_passes_bit_for_bit() {
        for corner in [1, 50, 1000] {
            let (filter, mut state) = (LowPass::new(corner, RATE), LowPassState::default());
            for _ in 0..1000 {
                assert_eq!(after(&filter, &mut state, signals(-0.123)), signals(-0.123));
            }
        }
    }

    #[test]
    fn returning_channel_starts_at_present_value() {
        let (filter, mut state) = (LowPass::new(10, RATE), LowPassState::default());
        after(&filter, &mut state, signals(1.0));
        assert_eq!(after(&filter, &mut state, Signals::default()), Signals::default());
        assert_eq!(after(&filter, &mut state, signals(2.0)), signals(2.0));
    }
}

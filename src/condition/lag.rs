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
use crate::scan::{COLS, ROWS, SENSORS};

/// Time constant of each low-pass: shares of the lag, and of the time between two scans, of which
/// no more than a lag counts. Smaller ones follow quicker and are noisier.
const SMOOTHED: [f32; 2] = [0.6, 0.65];

/// Least time between two scans that are followed without need, in microseconds: more of them would
/// average noise no better.
const LEAST_US: u32 = 200;

/// Longest time between two scans that counts, in microseconds: no lag remembers more, and the sum
/// of two does not wrap.
const LONGEST_US: u32 = 1 << 30;

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

/// Signals that follow together: a row of taxels, or the three axes of a sensor and a zero.
type Group = [f32; COLS];

/// Outputs of the first low-pass of a group, and by how much it and the second one are ahead of the
/// next.
type Smoothed = [Group; 3];

/// Groups of a part, and parts of the signals: the rows of taxels in two, then the sensors in two.
const GROUPS: usize = 2;
pub(crate) const LAG_PARTS: usize = (ROWS + SENSORS) / GROUPS;

/// Low-passes of all signals, and the time in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LagState {
    now: u32,
    parts: [Part; LAG_PARTS],
}

/// Low-passes of a part's groups; `None` for an absent one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Part {
    /// When it was followed last.
    at: u32,
    /// Microseconds since it had been followed before and since the scan before, and the
    /// coefficients for them.
    passed: u32,
    scan: u32,
    pace: Option<Pace>,
    groups: [Option<Smoothed>; GROUPS],
}

impl LagCompensation {
    /// Returns whether `lag` is zero, or between 0.1 and 50 ms.
    pub(crate) fn fits(lag: f32) -> bool {
        lag == 0.0 || RANGE.contains(&lag)
    }

    /// Takes the lag off the signals of a scan, `passed` microseconds after the last one. A signal
    /// that was absent before is taken to stand still.
    #[inline(never)]
    pub fn advance(&self, state: &mut LagState, passed: u32, signals: &mut Signals) {
        let passed = passed.min(LONGEST_US);
        state.now = state.now.wrapping_add(passed);
        let LagState { now, parts: [first, second, sensors @ ..] } = state;
        let mut c = signals.taxels.as_mut().map(|c| c.as_chunks_mut().0);
        for (i, part) in [first, second].into_iter().enumerate() {
            let rows = c.as_mut().and_then(|c| c.chunks_exact_mut(GROUPS).nth(i));
            self.advance_rows(part, [*now, passed], rows);
        }
        for (part, bridges) in sensors.iter_mut().zip(signals.bridges.chunks_exact_mut(GROUPS)) {
            self.advance_sensors(part, [*now, passed], bridges);
        }
    }

    /// Leaves a scan out whose signals nobody needs, if the next one comes soon enough. Returns
    /// whether it did.
    pub(crate) fn skip(state: &mut LagState, passed: u32) -> bool {
        let (now, [part, ..]) = (state.now.wrapping_add(passed.min(LONGEST_US)), &state.parts);
        let skips = now.wrapping_sub(part.at) < LEAST_US;
        if skips {
            state.now = now;
        }
        skips
    }

    /// Follows one part of the signals of a scan, or none, `passed` microseconds after the last
    /// scan. A part counts as followed in the scans between.
    pub(crate) fn listen(
        &self,
        state: &mut LagState,
        passed: u32,
        signals: &Signals,
        part: Option<usize>,
    ) {
        let passed = passed.min(LONGEST_US);
        state.now = state.now.wrapping_add(passed);
        let Some(i) = part else { return };
        let Some(part) = state.parts.get_mut(i) else { return };
        if let Some(i) = i.checked_sub(ROWS / GROUPS) {
            let mut bridges = signals.bridges;
            if let Some(bridges) = bridges.chunks_exact_mut(GROUPS).nth(i) {
                self.advance_sensors(part, [state.now, passed], bridges);
            }
        } else {
            let mut c = signals.taxels;
            let rows = c.as_mut().and_then(|c| c.as_chunks_mut().0.chunks_exact_mut(GROUPS).nth(i));
            self.advance_rows(part, [state.now, passed], rows);
        }
    }

    #[inline(never)]
    fn advance_rows(&self, part: &mut Part, time: [u32; 2], rows: Option<&mut [Group]>) {
        part.set_pace(self.taxels, time);
        match rows {
            Some(rows) => {
                let groups = part.groups.iter_mut().zip(rows);
                groups.for_each(|(group, row)| follow(group, row, &part.pace));
            }
            None => part.groups = [None; GROUPS],
        }
    }

    #[inline(never)]
    fn advance_sensors(&self, part: &mut Part, time: [u32; 2], bridges: &mut [Option<[f32; 3]>]) {
        part.set_pace(self.sensors, time);
        for (sensor, bridge) in part.groups.iter_mut().zip(bridges) {
            match bridge {
                Some(bridge) => {
                    let [x, y, z] = *bridge;
                    let mut ahead = [x, y, z, 0.0];
                    follow(sensor, &mut ahead, &part.pace);
                    let [x, y, z, _] = ahead;
                    *bridge = [x, y, z];
                }
                None => *sensor = None,
            }
        }
    }
}

impl Part {
    /// Sets the coefficients for the time since it was followed last. The time constants are those
    /// of the time between two scans, so that a change of turns changes none of the differences.
    #[inline(always)]
    fn set_pace(&mut self, lag: f32, [now, scan]: [u32; 2]) {
        let passed = now.wrapping_sub(self.at);
        self.at = now;
        if passed != self.passed || scan != self.scan {
            (self.passed, self.scan) = (passed, scan);
            self.pace = Pace::of(lag, [passed, scan].map(|time| time as f32 * 1e-6));
        }
    }
}

/// Coefficients of one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pace {
    /// Share by which each low-pass approaches its input, and the rest.
    share: f32,
    keep: f32,
    /// Weights of the second and third low-pass' distance from their inputs.
    second: f32,
    third: f32,
}

impl Pace {
    /// Returns the coefficients for `passed` seconds, of low-passes for this time between two
    /// scans; `None` without a lag.
    ///
    /// A low-pass with the time constant τ that is read every h seconds is 1 − τs + (τ² + τh/2)s²
    /// up to the second order. The weights a and b of u₁ + a(u₁ − u₂) + b(u₁ − 2u₂ + u₃), the
    /// outputs of the low-passes, follow from comparing its coefficients with those of the inverse.
    #[cold]
    #[inline(never)]
    fn of(lag: f32, [passed, scan]: [f32; 2]) -> Option<Self> {
        let [of_lag, of_passed] = SMOOTHED;
        (lag > 0.0).then(|| {
            let per_constant = (of_lag * lag + of_passed * at_most(scan, lag)).recip();
            let (times, turns) = (lag * per_constant, passed * per_constant);
            let a = 1.0 + times;
            let b = 1.0 + times * (2.0 + 0.25 * times + 0.5 * turns);
            // After its step a low-pass is nearer to its input by its share.
            let left = (1.0 + turns).recip();
            Self { share: turns * left, keep: left, second: (a + b) * left, third: b * left }
        })
    }
}

/// Returns the low-passes of signals that stand still. Inlined it would slow down every scan.
#[cold]
#[inline(never)]
fn at_rest(now: &Group) -> Smoothed {
    [*now, [0.0; COLS], [0.0; COLS]]
}

/// Takes the lag off the signals of a group. They stood still if they were absent before.
#[inline(never)]
fn follow(smoothed: &mut Option<Smoothed>, now: &mut Group, pace: &Option<Pace>) {
    let Some(Pace { share, keep, second, third }) = pace else {
        *smoothed = None;
        return;
    };
    let [first, ahead, further] = smoothed.get_or_insert_with(|| at_rest(now));
    // Stage by stage, so that no operation waits for the one before.
    let step = of_both(now, first, |now, first| share * (now - first));
    *first = of_both(first, &step, |first, step| first + step);
    let to_second = of_both(ahead, &step, |ahead, step| ahead + step);
    *ahead = to_second.map(|to| keep * to);
    let to_third = of_both(further, &to_second, |further, to| further + share * to);
    *further = to_third.map(|to| keep * to);
    let more = of_both(&to_second, &to_third, |to, on| second * to - third * on);
    *now = of_both(first, &more, |first, more| first + more);
}

#[inline(always)]
fn of_both([a, b, c, d]: &Group, [e, f, g, h]: &Group, of: impl Fn(f32, f32) -> f32) -> Group {
    [of(*a, *e), of(*b, *f), of(*c, *g), of(*d, *h)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::random::noise;
    use crate::scan::TAXELS;

    const LAG: LagCompensation = LagCompensation { taxels: 4e-3, sensors: 3e-3 };

    fn signals(taxel: f64, bridge: f64) -> Signals {
        Signals {
            taxels: Some([taxel as f32; TAXELS]),
            bridges: [Some([bridge as f32; 3]); SENSORS],
            ..Signals::default()
        }
    }

    #[test]
    fn unneeded_scans_are_left_out_for_less_than_200_microseconds() {
        let mut state = LagState::default();
        let mut signals = signals(0.0, 0.0);
        LAG.advance(&mut state, 100, &mut signals);
        let skipped = [50, 50, 99, 1].map(|passed| LagCompensation::skip(&mut state, passed));
        assert_eq!(skipped, [true, true, true, false]);
        LAG.advance(&mut state, 1, &mut signals);
        assert!(LagCompensation::skip(&mut state, 125), "the time counts from the scan that ran");
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

    #[test]
    fn force_is_not_late_after_scans_that_were_skipped() {
        // A press of a second; in its first 50 ms a part is followed in every twelfth scan.
        let press = |t: f64| (core::f64::consts::PI * t).sin().powi(2);
        let (mut some, mut every, mut most) = (LagState::default(), LagState::default(), 0.0f64);
        let mut late = Coating([0.0; 2], 4e-3);
        for i in 0..800usize {
            let now = late.follow(press, i as f64 * 250e-6, 4000);
            let own_late = signals(now, now);
            let (mut own, mut other) = (own_late, own_late);
            LAG.advance(&mut every, 250, &mut own);
            if i < 200 {
                LAG.listen(&mut some, 250, &own_late, (i % 3 == 0).then_some(i / 3 % LAG_PARTS));
            } else {
                LAG.advance(&mut some, 250, &mut other);
            }
            if i >= 200 {
                let [own, other] = [own, other].map(|own| own.taxels.unwrap());
                for (own, other) in own.iter().zip(other) {
                    most = most.max(f64::from((own - other).abs()));
                }
            }
        }
        // Without a memory they would be 4e-3 apart at first.
        assert!(most < 1e-3, "{most}");
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

//! Detection of gross slip by vibration.
//!
//! A sliding contact sticks and slips hundreds of times a second.
//!
//! The detector uses a band of the signals in which grasping causes no motion.
//!
//! The inputs are conditioned signals before the low-pass filter, not codes. A code contains the
//! ambient light of its scan: a lamp's flicker of 100 or 120 Hz lies in the very band. The dark
//! code of the same scan removes it. A code's sign also depends on the board's wiring. Further
//! conditioning does not change the result. The bias is a constant, which a band-pass blocks. Full
//! scale and temperature gain are factors that hardly change in a second, and energy is compared
//! with its own floor. Only the least energy is absolute, far below a converter's step.
//!
//! Three sums of the matrix (all, right minus left, +y minus −y) and the three bridge outputs
//! summed over the sensors pass a band-pass. The energy of the band is compared with its own
//! earlier floor, and with the energy of the band below, which motion fills first.
//!
//! Faulty channels are left out. Whenever they change, the detector hears nothing for 0.2 s, until
//! its filters have settled.
//!
//! The band needs 600 samples a second, not one in every scan. The sums are therefore averaged over
//! the scans of 1.5 ms. The channels are then filtered in turn, so that no scan bears the
//! cost of all.

use crate::condition::{Health, Signals};
use crate::math::{at_least, at_most, tan};
use crate::scan::COLS;
use crate::units::Micros;

/// Second-order band-pass of unit gain, direct form II transposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BandPass {
    /// Feed-forward coefficient b₀ = −b₂, with b₁ = 0.
    pub ahead: f32,
    /// Feedback coefficients a₁, a₂, with a₀ = 1.
    pub back: [f32; 2],
}

/// State of a [`BandPass`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BandPassState([f32; 2]);

impl BandPass {
    /// Makes a filter at `centre` with the quality `q`.
    ///
    /// `centre` is a fraction of the sample rate between 0.001 and 0.24 (bilinear transform of
    /// s/q/(s² + s/q + 1)).
    #[must_use]
    pub fn new(centre: f32, q: f32) -> Self {
        let k = tan(core::f32::consts::PI * centre.clamp(0.001, 0.24));
        let q = q.clamp(0.1, 20.0);
        let norm = 1.0 / (1.0 + k / q + k * k);
        Self {
            ahead: k / q * norm,
            back: [2.0 * (k * k - 1.0) * norm, (1.0 - k / q + k * k) * norm],
        }
    }

    /// Filters one sample.
    #[inline(always)]
    pub fn filter(&self, state: &mut BandPassState, x: f32) -> f32 {
        let ([a1, a2], [s1, s2]) = (self.back, state.0);
        let x = self.ahead * x;
        let y = x + s1;
        state.0 = [s2 - a1 * y, -x - a2 * y];
        y
    }
}

/// Number of watched channels: three of the matrix, three of the bridges.
const CHANNELS: usize = 6;
/// Longest time between two samples of a channel in microseconds, if the scans come faster.
const SAMPLE_US: u32 = 1500;

/// Coefficients of the vibration detector for one scan rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Scans averaged into a sample.
    pub scans: u16,
    /// Channels filtered in each scan, so that all are filtered before the next sample.
    pub at_once: usize,
    /// Band of the vibration, and the band below. The first is applied twice, so that steady motion
    /// leaves nothing in it. A steep fall from the band below to it means motion, not rubbing.
    pub bands: [BandPass; 2],
    /// Weight of a sample in the running mean of the energies, and in the floor.
    pub forget: [f32; 2],
    /// Energy over the floor at which vibration begins, and below which it ends.
    pub loud: [f32; 2],
    /// Samples that a vibration must last; a knock is shorter.
    pub lasting: u16,
    /// Samples until the floor is known.
    pub warm_up: u16,
}

impl Vibration {
    /// Makes a detector for scans that are `interval_us` apart.
    ///
    /// The band is at 150 Hz, where the sensors of [Ospina2017] still respond and a hand's own
    /// motion has ended. Below 600 scans a second it is near a quarter of the rate.
    #[must_use]
    pub fn every(interval_us: u32) -> Self {
        let interval_us = interval_us.clamp(1, 1_000_000);
        // An interval may be some microseconds longer than the last.
        let scans = ((SAMPLE_US + interval_us / 8) / interval_us).max(1);
        let rate = 1e6 / (interval_us * scans) as f32;
        let centre = at_most(150.0 / rate, 0.24);
        Self {
            scans: scans as u16,
            at_once: CHANNELS.div_ceil(scans as usize),
            bands: [BandPass::new(centre, 1.0), BandPass::new(0.25 * centre, 1.0)],
            // Time constants: 10 ms and 1 s.
            forget: [at_most(100.0 / rate, 0.5), at_most(1.0 / rate, 0.05)],
            loud: [12.0, 4.0],
            lasting: (0.01 * rate) as u16,
            warm_up: (0.2 * rate) as u16,
        }
    }
}

/// State of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Channel {
    /// Last sample.
    sample: f32,
    filters: [BandPassState; 3],
    energy: [f32; 2],
    floor: f32,
    lasted: u16,
}

/// Sums of the signals over the scans of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    /// Quadrants of the matrix: −x −y, +x −y, −x +y, +x +y.
    quadrants: [[f32; 2]; 2],
    bridges: [f32; 3],
    scans: u16,
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, signals: &Signals) {
        if let Some(c) = &signals.taxels {
            let halves = c.as_chunks::<{ 2 * COLS }>().0;
            for ([left, right], half) in self.quadrants.iter_mut().zip(halves) {
                let [a, b, c, d, e, f, g, h] = half;
                *left += (a + b) + (e + f);
                *right += (c + d) + (g + h);
            }
        }
        for u in signals.bridges.iter().flatten() {
            self.bridges.iter_mut().zip(u).for_each(|(sum, u)| *sum += u);
        }
        self.scans += 1;
    }

    /// Takes the faulty channels of added signals out again.
    fn leave_out(&mut self, Signals { taxels, bridges, health }: &Signals) {
        if let Some(taxels) = taxels {
            let quadrants = self.quadrants.as_flattened_mut();
            for (k, c) in taxels.iter().enumerate() {
                if (health.saturated | health.dead) >> k & 1 == 1
                    && let Some(quadrant) = quadrants.get_mut(k / (2 * COLS) * 2 + k % COLS / 2)
                {
                    *quadrant -= c;
                }
            }
        }
        for (i, u) in bridges.iter().enumerate() {
            if health.bridge_faults >> i & 1 == 1
                && let Some(u) = u
            {
                self.bridges.iter_mut().zip(u).for_each(|(sum, u)| *sum -= u);
            }
        }
    }

    /// Returns the means of the channels: the matrix, its right minus left half, its +y minus −y
    /// half, and the bridges.
    #[inline(never)]
    fn samples(&self) -> [f32; CHANNELS] {
        let [[a, b], [c, d]] = self.quadrants;
        let [x, y, z] = self.bridges;
        let share = 1.0 / f32::from(self.scans);
        [a + b + c + d, (b + d) - (a + c), (c + d) - (a + b), x, y, z].map(|sum| share * sum)
    }
}

/// State of the detector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VibrationState {
    sums: Sums,
    channels: [Channel; CHANNELS],
    /// Channels whose last sample is not filtered yet.
    pending: usize,
    /// Whether one of the filtered channels is loud.
    loud: bool,
    samples: u16,
    /// Samples until the filters have settled.
    settling: u16,
    vibrates: bool,
    health: Health,
}

impl VibrationState {
    /// Leaves faulty channels out. What they read is no vibration, nor is the jump at the beginning
    /// and end of a fault: the filters settle first.
    #[cold]
    #[inline(never)]
    fn leave_out(&mut self, signals: &Signals, settling: u16) {
        if core::mem::replace(&mut self.health, signals.health) != signals.health {
            self.settling = settling;
        }
        self.sums.leave_out(signals);
    }

    /// Returns whether the last sample vibrated.
    #[must_use]
    pub fn vibrates(&self) -> bool {
        self.vibrates
    }
}

/// Least energy of the floor: a twentieth of a 12-bit step, squared.
const QUIET: f32 = 1.5e-10;
/// Least energy of a vibration relative to the band two octaves below. An edge in a force has a
/// spectrum that falls like 1/f², a corner 1/f⁴. In energy, each octave wide, two octaves up that
/// is a quarter and a sixty-fourth. Rubbing has more than this there.
const STEEP: f32 = 0.1;

impl Vibration {
    /// Processes one scan and returns whether the finger vibrates.
    pub fn update(&self, state: &mut VibrationState, signals: &Signals) -> bool {
        state.sums.add(signals);
        if signals.health != Health::SOUND || state.health != Health::SOUND {
            state.leave_out(signals, self.warm_up);
        }
        if state.sums.scans >= self.scans {
            let samples = state.sums.samples();
            state.channels.iter_mut().zip(samples).for_each(|(channel, x)| channel.sample = x);
            (state.sums, state.pending, state.loud) = (Sums::default(), CHANNELS, false);
        }
        if state.pending > 0 {
            self.listen_in_turn(state);
        }
        state.vibrates
    }

    #[inline(never)]
    fn listen_in_turn(&self, state: &mut VibrationState) {
        let warm = state.samples >= self.warm_up;
        // The floor follows quickly at first, then slowly, and not at all during a vibration.
        let share = match self.forget {
            [fast, _] if !warm => fast,
            _ if state.vibrates || state.settling > 0 => 0.0,
            [_, slow] => slow,
        };
        for _ in 0..self.at_once.min(state.pending) {
            state.pending -= 1;
            let Some(channel) = state.channels.get_mut(state.pending) else { break };
            state.loud |= self.listen(channel, share, state.vibrates);
        }
        if state.pending == 0 {
            state.samples = state.samples.saturating_add(1);
            state.vibrates = warm && state.loud && state.settling == 0;
            state.settling = state.settling.saturating_sub(1);
        }
    }

    #[inline(always)]
    fn listen(&self, channel: &mut Channel, share: f32, was: bool) -> bool {
        let [fast, _] = self.forget;
        let ([band, below], [once, twice, low]) = (&self.bands, &mut channel.filters);
        let passed = band.filter(once, channel.sample);
        let (high, low) = (band.filter(twice, passed), below.filter(low, channel.sample));
        let heard = high * high;
        channel.energy[0] += fast * (heard - channel.energy[0]);
        channel.energy[1] += fast * (low * low - channel.energy[1]);
        let floor = at_least(channel.floor, QUIET);
        channel.floor += share * (at_most(heard, 4.0 * floor) - channel.floor);
        let [begin, end] = self.loud;
        let [energy, below] = channel.energy;
        let loud = energy > if was { end } else { begin } * floor && energy > STEEP * below;
        channel.lasted = if loud { channel.lasted.saturating_add(1) } else { 0 };
        channel.lasted > self.lasting
    }
}

/// Vibration detector that derives the scan rate from the scans' times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VibrationDetector {
    /// Time of the last scan, its lower half.
    time_us: u32,
    interval_us: u32,
    /// Interval between the last two scans.
    before_us: u32,
    detector: Option<Vibration>,
    state: VibrationState,
}

impl VibrationDetector {
    /// Processes one scan and returns whether it vibrates. A change of rate restarts the detector.
    pub fn update(&mut self, time: Micros, signals: &Signals) -> bool {
        let now = time.0 as u32;
        let interval = now.wrapping_sub(self.time_us);
        self.time_us = now;
        // A lost scan or a restarted clock changes one interval; a new rate changes two.
        let differs = |from: u32| interval.abs_diff(from) > from / 8;
        let new = differs(self.interval_us) && !differs(self.before_us) && interval > 0;
        self.before_us = interval;
        if new {
            self.tune(interval);
        }
        let Self { detector, state, .. } = self;
        detector.as_ref().is_some_and(|detector| detector.update(state, signals))
    }

    #[cold]
    #[inline(never)]
    fn tune(&mut self, interval_us: u32) {
        self.interval_us = interval_us;
        self.detector = Some(Vibration::every(interval_us));
        self.state = VibrationState::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::TAXELS;

    fn signals(level: f32) -> Signals {
        Signals { taxels: Some([level; TAXELS]), ..Signals::default() }
    }

    /// Uniform noise of unit variance, always the same.
    fn noise(i: u32) -> f32 {
        let x = i.wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(2_246_822_519);
        (f64::from(x) / f64::from(u32::MAX) - 0.5) as f32 * 3.46
    }

    #[test]
    fn band_passes_its_centre_and_damps_slow_signals() {
        let band = BandPass::new(0.15, 1.0);
        let gain = |fraction: f32| {
            let mut state = BandPassState::default();
            let y: std::vec::Vec<f32> = (0..4000)
                .map(|i| {
                    band.filter(&mut state, (core::f32::consts::TAU * fraction * i as f32).sin())
                })
                .collect();
            (y[2000..].iter().map(|y| y * y).sum::<f32>() / 1000.0).sqrt()
        };
        assert!((gain(0.15) - 1.0).abs() < 0.01, "{}", gain(0.15));
        assert!(gain(0.005) < 0.05 && gain(0.45) < 0.4);
    }

    #[test]
    fn rubbing_is_detected_in_20_ms_a_press_is_not() {
        for interval_us in [125, 250, 500, 1000, 1400] {
            let detector = Vibration::every(interval_us);
            let mut state = VibrationState::default();
            let mut first = None;
            for i in 0..3_000_000 / interval_us {
                let t = i as f32 * 1e-6 * interval_us as f32;
                // A press of half a newton's light within 50 ms, from 1 s on; rubbing of a
                // thousandth of the range at 150 Hz from 2 s on.
                let press = -0.1 * ((t - 1.0) / 0.05).clamp(0.0, 1.0);
                let rub = (core::f32::consts::TAU * 150.0 * t).sin();
                let rub = if t > 2.0 { 1e-3 * rub } else { 0.0 };
                let heard = detector.update(&mut state, &signals(press + rub + 5e-5 * noise(i)));
                if heard {
                    first = first.or(Some(t));
                }
            }
            let first = first.unwrap();
            assert!((2.0..2.02).contains(&first), "{interval_us} us: {first}");
            assert!(state.vibrates());
        }
    }

    #[test]
    fn faulty_channel_is_no_vibration_nor_is_its_return() {
        for (interval_us, from, fault_s) in [(250, 1.0, 0.1), (250, 1.0, 3.0), (1000, 0.0, 10.0)] {
            let detector = Vibration::every(interval_us);
            let mut state = VibrationState::default();
            let (until, end) = (from + fault_s, from + fault_s + 3.0);
            let mut rubs = 0;
            for i in 0..(1e6 * end) as u32 / interval_us {
                let t = i as f32 * 1e-6 * interval_us as f32;
                let faulty = (from..until).contains(&t);
                // Rubbing in the last second of the fault and of the run.
                let rubbed = (from + 1.0..until).contains(&t) && t > until - 1.0 || t > end - 1.0;
                let rub = if rubbed { 5e-4 * (942.0 * t).sin() } else { 0.0 };
                let mut signals = signals(5e-5 * noise(i) + rub);
                if faulty {
                    signals.taxels.as_mut().unwrap()[5] = 0.3 * noise(i + 77);
                    signals.health.dead = 1 << 5;
                }
                if detector.update(&mut state, &signals) {
                    assert!(rubbed, "{fault_s}: {t}");
                    rubs += 1;
                }
            }
            let least = if fault_s > 1.0 { 1.9e6 } else { 0.95e6 } as u32 / interval_us;
            assert!(rubs > least, "{fault_s}: {rubs}");
        }
    }

    #[test]
    fn rubbing_stays_detected_however_long_it_lasts() {
        let (detector, mut state) = (Vibration::every(1000), VibrationState::default());
        let scans = (0..30_000u32).filter(|i| {
            let rub = if *i < 1000 { 0.0 } else { 1e-3 * (0.942 * *i as f32).sin() };
            detector.update(&mut state, &signals(rub + 5e-5 * noise(*i)))
        });
        let scans: std::vec::Vec<u32> = scans.collect();
        assert!((1000..1020).contains(&scans[0]) && scans.len() > 28_980, "{}", scans.len());
    }

    #[test]
    fn light_rubbing_is_heard_after_a_loose_contact() {
        let (detector, mut state) = (Vibration::every(1000), VibrationState::default());
        let mut first = None;
        for i in 0..7000u32 {
            let rub = if i < 6500 { 0.0 } else { 3e-4 * (0.942 * i as f32).sin() };
            let mut signals = signals(-0.1 + rub + 5e-5 * noise(i));
            // A channel fails and returns every 20 ms.
            if (1000..6000).contains(&i) && i / 20 % 2 == 0 {
                signals.health.dead = 1 << 5;
            }
            if detector.update(&mut state, &signals) {
                first = first.or(Some(i));
            }
        }
        assert!((6500..6530).contains(&first.unwrap()), "{first:?}");
    }

    #[test]
    fn fast_scans_filter_few_channels_each_and_all_in_time() {
        for (interval_us, at_once) in [(125, 1), (250, 1), (333, 2), (500, 2), (1000, 6)] {
            let detector = Vibration::every(interval_us);
            assert_eq!(detector.at_once, at_once, "{interval_us} us");
            let mut state = VibrationState::default();
            let scans = 100 * u32::from(detector.scans);
            // The channels of the last sample need some scans more.
            for _ in 0..scans + (CHANNELS / at_once) as u32 - 1 {
                detector.update(&mut state, &signals(0.1));
            }
            assert_eq!(state.samples, 100, "{interval_us} us");
        }
    }

    #[test]
    fn clock_restart_and_new_rate_are_handled() {
        let mut listener = VibrationDetector::default();
        for interval_us in [250, 1000, 1000] {
            let heard = (0..4000u64).filter(|i| {
                listener.update(Micros(interval_us * i), &signals(5e-5 * noise(*i as u32)))
            });
            assert_eq!(heard.count(), 0, "{interval_us} us");
            assert_eq!(u64::from(listener.interval_us), interval_us);
        }
    }

    #[test]
    fn noise_alone_is_not_detected_for_ten_minutes() {
        let detector = Vibration::every(1000);
        let mut state = VibrationState::default();
        assert!((0..600_000).all(|i| !detector.update(&mut state, &signals(5e-5 * noise(i)))));
    }

    #[test]
    fn rubbing_of_any_two_quadrants_is_detected() {
        let heard = |quadrants: [f32; 4]| {
            let (detector, mut state) = (Vibration::every(1000), VibrationState::default());
            let scans = (0..1000u32).filter(|i| {
                let rub = if *i > 800 { 1e-3 * (0.942 * *i as f32).sin() } else { 0.0 };
                let mut signals = signals(5e-5 * noise(*i));
                for (k, c) in signals.taxels.as_mut().unwrap().iter_mut().enumerate() {
                    *c += rub * quadrants[k / (2 * COLS) * 2 + k % COLS / 2];
                }
                detector.update(&mut state, &signals)
            });
            scans.count()
        };
        assert_eq!(heard([0.0; 4]), 0);
        let against = [[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]];
        let beside = [[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]];
        let across = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0]];
        for quadrants in [against, beside, across].as_flattened() {
            assert!(heard(*quadrants) > 150, "{quadrants:?}: {}", heard(*quadrants));
        }
    }

    #[test]
    fn noise_that_grows_slowly_is_no_vibration() {
        let (detector, mut state) = (Vibration::every(1000), VibrationState::default());
        for i in 0..60_000 {
            let noisy = 5e-5 * (1.0 + i as f32 / 10_000.0) * noise(i);
            assert!(!detector.update(&mut state, &signals(noisy)), "{i}");
        }
    }
}

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

use super::contact_point::halves;
use crate::condition::Signals;
use crate::math::tan;
use crate::units::Micros;

/// Second-order filter section, direct form II transposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Biquad {
    /// Feed-forward coefficients b₀, b₁, b₂.
    pub ahead: [f32; 3],
    /// Feedback coefficients a₁, a₂, with a₀ = 1.
    pub back: [f32; 2],
}

/// State of a [`Biquad`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BiquadState([f32; 2]);

impl Biquad {
    /// Makes a band-pass of unit gain at `centre` with the quality `q`.
    ///
    /// `centre` is a fraction of the scan rate between 0.001 and 0.24 (bilinear transform of
    /// s/q/(s² + s/q + 1)).
    #[must_use]
    pub fn band_pass(centre: f32, q: f32) -> Self {
        let k = tan(core::f32::consts::PI * centre.clamp(0.001, 0.24));
        let q = q.clamp(0.1, 20.0);
        let norm = 1.0 / (1.0 + k / q + k * k);
        Self {
            ahead: [k / q * norm, 0.0, -k / q * norm],
            back: [2.0 * (k * k - 1.0) * norm, (1.0 - k / q + k * k) * norm],
        }
    }

    /// Filters one sample.
    pub fn filter(&self, state: &mut BiquadState, x: f32) -> f32 {
        let ([b0, b1, b2], [a1, a2], [s1, s2]) = (self.ahead, self.back, state.0);
        let y = b0 * x + s1;
        state.0 = [b1 * x - a1 * y + s2, b2 * x - a2 * y];
        y
    }
}

/// Number of watched channels: three of the matrix, three of the bridges.
const CHANNELS: usize = 6;

/// Coefficients of the vibration detector for one scan rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Band of the vibration, and the band below. The first is applied twice, so that steady motion
    /// leaves nothing in it. A steep fall from the band below to it means motion, not rubbing.
    pub bands: [Biquad; 2],
    /// Weight of a scan in the running mean of the energies, and in the floor.
    pub forget: [f32; 2],
    /// Energy over the floor at which vibration begins, and below which it ends.
    pub loud: [f32; 2],
    /// Scans that a vibration must last; a knock is shorter.
    pub lasting: u16,
}

impl Vibration {
    /// Makes a detector for `rate` scans a second.
    ///
    /// The band is at 150 Hz, where the sensors of [Ospina2017] still respond and a hand's own
    /// motion has ended. Below 600 scans a second it is near a quarter of the rate.
    #[must_use]
    pub fn at(rate: f32) -> Self {
        let rate = rate.clamp(1.0, 1e6);
        let centre = (150.0 / rate).min(0.24);
        Self {
            bands: [Biquad::band_pass(centre, 1.0), Biquad::band_pass(0.25 * centre, 1.0)],
            // Time constants: 10 ms and 1 s.
            forget: [(100.0 / rate).min(0.5), (1.0 / rate).min(0.05)],
            loud: [12.0, 4.0],
            lasting: (0.01 * rate) as u16,
        }
    }
}

/// State of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Channel {
    filters: [BiquadState; 3],
    energy: [f32; 2],
    floor: f32,
    lasted: u16,
}

/// State of the detector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VibrationState {
    channels: [Channel; CHANNELS],
    frames: u16,
    vibrates: bool,
}

impl VibrationState {
    /// Returns whether the last scan vibrated.
    #[must_use]
    pub fn vibrates(&self) -> bool {
        self.vibrates
    }
}

/// Scans until the floor is known.
const WARM_UP: u16 = 200;
/// Least energy of the floor: a twentieth of a 12-bit step, squared.
const QUIET: f32 = 1.5e-10;
/// Least energy of a vibration relative to the band two octaves below. An edge in a force has a
/// spectrum that falls like 1/f², a corner 1/f⁴. In energy, each octave wide, two octaves up that
/// is a quarter and a sixty-fourth. Rubbing has more than this there.
const STEEP: f32 = 0.1;

impl Vibration {
    /// Processes one scan and returns whether it vibrates.
    pub fn update(&self, state: &mut VibrationState, signals: &Signals) -> bool {
        let optical = signals.taxels.as_ref().map_or([0.0; 3], halves);
        let mut bridges = [0.0; 3];
        for u in signals.bridges.iter().flatten() {
            bridges.iter_mut().zip(u).for_each(|(sum, u)| *sum += u);
        }
        let warm = state.frames >= WARM_UP;
        let was = state.vibrates;
        let mut loud = false;
        for (channel, x) in state.channels.iter_mut().zip(optical.into_iter().chain(bridges)) {
            loud |= self.listen(channel, x, warm, was);
        }
        state.frames = state.frames.saturating_add(1);
        state.vibrates = warm && loud;
        state.vibrates
    }

    fn listen(&self, channel: &mut Channel, x: f32, warm: bool, was: bool) -> bool {
        let [fast, slow] = self.forget;
        let ([band, below], [once, twice, low]) = (&self.bands, &mut channel.filters);
        let passed = band.filter(once, x);
        let (high, low) = (band.filter(twice, passed), below.filter(low, x));
        let heard = high * high;
        channel.energy[0] += fast * (heard - channel.energy[0]);
        channel.energy[1] += fast * (low * low - channel.energy[1]);
        // Not `max` and `min`, which are calls where the processor has no instruction for them.
        let floor = if channel.floor > QUIET { channel.floor } else { QUIET };
        // The floor follows quickly at first, then slowly, and not at all during a vibration.
        if !was {
            let share = if warm { slow } else { fast };
            let most = 4.0 * floor;
            let heard = if heard < most { heard } else { most };
            channel.floor += share * (heard - channel.floor);
        }
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
    time: Option<Micros>,
    interval_us: u64,
    /// Interval between the last two scans.
    before_us: u64,
    detector: Option<Vibration>,
    state: VibrationState,
}

impl VibrationDetector {
    /// Processes one scan and returns whether it vibrates. A change of rate restarts the detector.
    pub fn hear(&mut self, time: Micros, signals: &Signals) -> bool {
        let interval = self.time.map_or(0, |last| time.0.saturating_sub(last.0));
        self.time = Some(time);
        // A lost scan or a restarted clock changes one interval; a new rate changes two.
        let differs = |from: u64| interval.abs_diff(from) > from / 8;
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
    fn tune(&mut self, interval_us: u64) {
        let rate = 1e6 / interval_us.clamp(1, 1_000_000) as f32;
        self.interval_us = interval_us;
        self.detector = Some(Vibration::at(rate));
        self.state = VibrationState::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::TAXELS;

    const RATE: f32 = 1000.0;

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
        let band = Biquad::band_pass(0.15, 1.0);
        let gain = |fraction: f32| {
            let mut state = BiquadState::default();
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
        let detector = Vibration::at(RATE);
        let mut state = VibrationState::default();
        let mut first = None;
        for i in 0..3000u32 {
            let t = i as f32 / RATE;
            // A press of half a newton's light within 50 ms, from 1 s on; rubbing of a thousandth
            // of the range at 150 Hz from 2 s on.
            let press = -0.1 * ((t - 1.0) / 0.05).clamp(0.0, 1.0);
            let rub = if t > 2.0 { 1e-3 * (core::f32::consts::TAU * 150.0 * t).sin() } else { 0.0 };
            let heard = detector.update(&mut state, &signals(press + rub + 5e-5 * noise(i)));
            if heard {
                first = first.or(Some(t));
            }
        }
        let first = first.unwrap();
        assert!((2.0..2.02).contains(&first), "{first}");
        assert!(state.vibrates());
    }

    #[test]
    fn clock_restart_and_new_rate_are_handled() {
        let mut listener = VibrationDetector::default();
        for interval_us in [250, 1000, 1000] {
            let heard = (0..4000u64).filter(|i| {
                listener.hear(Micros(interval_us * i), &signals(5e-5 * noise(*i as u32)))
            });
            assert_eq!(heard.count(), 0, "{interval_us} us");
            assert_eq!(listener.interval_us, interval_us);
        }
    }

    #[test]
    fn noise_alone_is_not_detected_for_ten_minutes() {
        let detector = Vibration::at(RATE);
        let mut state = VibrationState::default();
        assert!((0..600_000).all(|i| !detector.update(&mut state, &signals(5e-5 * noise(i)))));
    }
}

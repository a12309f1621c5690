//! Columns of phototransistors: from photocurrents to amplified voltages on four loads.
//!
//! A column's light is in fractions of full scale on 1 kΩ amplified sixteenfold, so that one is a
//! photocurrent of 206 µA. A mean pair has 155 µA at the peak of its curve and 60 µA at rest.
//! [DeMaria2011] does not print its own values; the following comes from data sheets. An SFH 4050
//! gives 9 mW/sr at 100 mA on its axis. At 45° it is assumed to give 0.7 of that, and at 1.9 mA in
//! proportion to the current: 0.12 mW/sr. The mirrored path of the peak is 2 mm at 45°, with nine
//! tenths reflected, which makes 1.4 mW/cm². An SFH 3010 gives at least 70 µA for it (25 µA in
//! 0.5 mW/cm²). The pairs here have about twice the minimum.

use scan_plan::finger::{REFERENCE, shot_noise};
use taxel::scan::COLS;

use crate::scene::{Effect, Scene};

/// Range of the converter in volts.
const RANGE_V: f64 = REFERENCE.converter.range_v;
/// Load on which a light of one reads as one.
const LOAD_OHM: f64 = 1000.0;
const AMPLIFIED: f64 = 16.0;
/// Photocurrent in amperes of a light of one.
pub const UNIT_A: f64 = RANGE_V / (LOAD_OHM * AMPLIFIED);
/// Boltzmann constant in joules per kelvin (SI).
const BOLTZMANN: f64 = 1.380_649e-23;
/// Temperature of the room in kelvin.
const ROOM_K: f64 = 298.15;

/// Columns of one device.
#[derive(Clone, Debug)]
pub struct Columns {
    /// Gain of load and amplifier over those on which a light of one reads as one.
    gain: f64,
    /// Reading without light.
    reference: f64,
    settling: Option<Settling>,
}

/// Lag of the phototransistors: one time constant, up and down.
#[derive(Clone, Debug)]
struct Settling {
    /// Remainders of a difference: at the reading of a step, at its end, and after the pause.
    ///
    /// The pause is between two frames, with every LED off.
    read: f64,
    end: f64,
    pause: f64,
    /// Present level of each column.
    level: [f64; COLS],
}

impl Columns {
    /// Creates the columns of the scene's device, at rest in the light `dark` of a room.
    #[must_use]
    pub fn new(scene: &Scene, dark: [f64; COLS]) -> Self {
        let step = f64::from(scene.scan.step_us());
        let period = 1e6 / f64::from(scene.rate_hz());
        let left = |time: f64| (-time / scene.time_constant_us()).exp();
        let settling = scene.has(Effect::Settling).then(|| Settling {
            read: left(step - scene.sampling_us()),
            end: left(step),
            pause: left(period - 5.0 * step),
            level: dark,
        });
        Self { gain: gain(scene), reference: scene.electronics.reference_ratio, settling }
    }

    /// Begins a frame: the LEDs have been off since the last frame ended.
    pub fn pause(&mut self, dark: &[f64; COLS]) {
        if let Some(settling) = &mut self.settling {
            let left = settling.pause;
            settling.level.iter_mut().zip(dark).for_each(|(l, d)| *l = d + (*l - d) * left);
        }
    }

    /// Voltages at the converter, as fractions of its range, when a step with this `light` is read.
    ///
    /// The amplifiers reach both rails, and no further, into an input that draws no current.
    #[must_use]
    pub fn step(&mut self, light: [f64; COLS]) -> [f64; COLS] {
        let read = match &mut self.settling {
            None => light,
            Some(settling) => {
                let mut read = light;
                for ((read, level), light) in read.iter_mut().zip(&mut settling.level).zip(light) {
                    let behind = *level - light;
                    *read = light + behind * settling.read;
                    *level = light + behind * settling.end;
                }
                read
            }
        };
        read.map(|level| (self.reference + self.gain * level).clamp(0.0, 1.0))
    }
}

fn gain(scene: &Scene) -> f64 {
    scene.electronics.load_ohm / LOAD_OHM * scene.electronics.pga_gain.times() / AMPLIFIED
}

/// Noise of a column as a variance, in squares of the converter's range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightNoise {
    /// Shot noise of a reading of one; it grows with the light.
    pub shot: f64,
    /// Thermal noise of the load, light or dark.
    pub thermal: f64,
    /// Reading without light.
    pub dark: f64,
}

impl LightNoise {
    /// Noise within the bandwidth 1/4τ of the phototransistor on its load.
    ///
    /// The load adds 4kTR to the shot noise. The conversions of a reading average out the part that
    /// changes while they last.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let bandwidth = 1e6 / (4.0 * scene.time_constant_us());
        let left = averaged(scene.sampling_us() / scene.time_constant_us());
        let load = scene.electronics.load_ohm;
        let amplified = scene.electronics.pga_gain.times() / RANGE_V;
        // Light that makes a reading of one.
        let current = UNIT_A / gain(scene);
        let shot = shot_noise(current) * bandwidth;
        Self {
            shot: shot * (load * amplified).powi(2) * left,
            dark: scene.electronics.reference_ratio,
            thermal: 4.0 * BOLTZMANN * ROOM_K * load * bandwidth * amplified.powi(2) * left,
        }
    }

    /// Variance of a reading of `ratio`.
    #[must_use]
    pub fn of_reading(&self, ratio: f64) -> f64 {
        self.shot * (ratio - self.dark).max(0.0) + self.thermal
    }
}

/// Share of the variance that remains in a mean over `time`, for noise with the autocorrelation
/// e^−t.
///
/// Both times are in time constants of the noise.
fn averaged(time: f64) -> f64 {
    2.0 / time * (1.0 + (-time).exp_m1() / time)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(electronics: &str, step_us: u32) -> Scene {
        let text = format!(
            "effects = ['settling']\n[scan]\nrate_hz = 1000\nduration_s = 1\nstep_us = {step_us}\n\
             [device]\nbits = 12\n[electronics]\n{electronics}\n"
        );
        Scene::parse("test.toml", &text).unwrap()
    }

    /// Reading of a dark step as a remainder of the bright step before it.
    fn residue(electronics: &str, step_us: u32) -> f64 {
        let mut columns = Columns::new(&scene(electronics, step_us), [0.0; COLS]);
        for _ in 0..100 {
            let _ = columns.step([0.5; COLS]);
        }
        columns.step([0.0; COLS])[0] / 0.5
    }

    #[test]
    fn settling_to_12_bits_takes_26_5_us() {
        // Settling takes 26.75 µs, of which the conversion is the last 0.25 µs; steps are whole
        // microseconds.
        let (at_26, at_27) = (residue("", 26), residue("", 27));
        assert!(at_26 > 1.0 / 4096.0 && at_27 < 1.0 / 4096.0, "{at_26} {at_27}");
    }

    #[test]
    fn short_step_mixes_in_the_row_before() {
        let expected = (-(10.0 - 0.25) / (7.0 / 9f64.ln())).exp();
        assert!((residue("", 10) / expected - 1.0).abs() < 1e-12);
        assert!(residue("time_constant_us = 20", 30) > 0.2);
        assert!(residue("", 10) > 100.0 * residue("", 26));
    }

    #[test]
    fn quarter_load_settles_four_times_as_fast() {
        let quick = "load_ohm = 250\npga_gain = 64";
        let mut columns = Columns::new(&scene(quick, 30), [0.3; COLS]);
        assert!((columns.step([0.3; COLS])[0] - 0.3).abs() < 1e-12);
        let ratio = residue(quick, 10).ln() / residue("", 10).ln();
        assert!((ratio - 4.0).abs() < 1e-9, "{ratio}");
        // The cost is four times the bandwidth, so twice the shot noise of a single conversion.
        let of = |electronics: &str| LightNoise::of(&scene(electronics, 30)).shot;
        let tau = 7.0 / 9f64.ln();
        let averaged = averaged(4.0 * 0.25 / tau) / averaged(0.25 / tau);
        assert!((of(quick) / of("") / (4.0 * averaged) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn dark_column_reads_its_reference_without_shot_noise() {
        let scene = scene("reference_ratio = 0.125", 30);
        let mut columns = Columns::new(&scene, [0.0; COLS]);
        assert_eq!(columns.step([0.0; COLS]), [0.125; COLS]);
        let noise = LightNoise::of(&scene);
        assert_eq!(noise.of_reading(0.125), noise.thermal);
        assert!((noise.of_reading(0.625) - noise.thermal - 0.5 * noise.shot).abs() < 1e-18);
    }

    #[test]
    fn amplifier_clips_at_its_rail() {
        let mut columns = Columns::new(&scene("pga_gain = 64", 30), [0.0; COLS]);
        assert_eq!(columns.step([0.5; COLS]), [1.0; COLS]);
    }

    #[test]
    fn light_noise_matches_shot_and_thermal_noise() {
        // 206 µA on 1 kΩ: 2·1.602e-19·451·206e-6 A²/Hz over 78.5 kHz are 48.4 nA, 48.4 µV,
        // sixteenfold 774 µV of 3.3 V. 4kTR over the same band is 1.136 µV, sixteenfold 18.2 µV.
        // One conversion, a quarter of a microsecond in 3.2, averages 2.6 % of the variance out.
        let noise = LightNoise::of(&scene("", 30));
        let volts = |variance: f64| (variance / 0.9743).sqrt() * RANGE_V;
        assert!((volts(noise.shot) / 774e-6 - 1.0).abs() < 2e-3, "{}", volts(noise.shot));
        assert!((volts(noise.thermal) / 18.18e-6 - 1.0).abs() < 2e-3, "{}", volts(noise.thermal));
    }

    #[test]
    fn averaged_noise_matches_its_samples() {
        // Sums of e^−|i − j|dt over a thousand samples, over the square of their number.
        for time in [0.08, 1.0, 5.0] {
            let step = time / 1000.0;
            let sum: f64 =
                (1..1000).map(|lag| f64::from(1000 - lag) * (-f64::from(lag) * step).exp()).sum();
            let sampled = (1000.0 + 2.0 * sum) / 1e6;
            assert!((averaged(time) / sampled - 1.0).abs() < 1e-3, "{time}");
        }
    }

    #[test]
    fn unlisted_settling_keeps_rows_apart() {
        let text = "[scan]\nrate_hz = 1000\nduration_s = 1\nstep_us = 10\n";
        let scene = Scene::parse("test.toml", text).unwrap();
        let mut columns = Columns::new(&scene, [0.0; COLS]);
        let _ = columns.step([0.5; COLS]);
        assert_eq!(columns.step([0.1; COLS]), [0.1; COLS]);
    }
}

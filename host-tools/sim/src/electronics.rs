//! Photocurrents to voltages: four columns of phototransistors, each on one load, and their amplifiers.
//!
//! A column's light is in fractions of full scale on 1 kΩ without amplification, so that one is a
//! photocurrent of 3.3 mA. At rest a mean pair passes 1 mA, the current at which the data sheet of the
//! SFH 3010 states its 7 µs; what flowed in 002's sensor is not published.

use taxel::scan::COLS;

use crate::scene::{Effect, Scene};

/// Range of the converter in volts.
const RANGE_V: f64 = 3.3;
/// Photocurrent of a light of one.
const UNIT_A: f64 = RANGE_V / 1000.0;
/// In coulombs (SI).
const ELEMENTARY_CHARGE: f64 = 1.602_176_634e-19;
/// In joules per kelvin (SI).
const BOLTZMANN: f64 = 1.380_649e-23;
/// Of the room, in kelvin.
const ROOM_K: f64 = 298.15;
/// Collector over base current of the phototransistor. The SFH 3010's sheet gives at least 25 µA in
/// 0.5 mW/cm²; its 0.04 mm² of silicon make some 0.12 µA of that at 0.6 A/W, which is 200 and more.
const CURRENT_GAIN: f64 = 250.0;

/// The columns of one device.
#[derive(Clone, Debug)]
pub struct Columns {
    /// Load and amplifier against 1 kΩ and none.
    gain: f64,
    settling: Option<Settling>,
}

/// A phototransistor follows the light with one time constant, up and down.
#[derive(Clone, Debug)]
struct Settling {
    /// What is left of a difference when a step is read, when it ends, and after the pause between two
    /// frames, in which every LED is off.
    read: f64,
    end: f64,
    pause: f64,
    /// Where the columns are.
    level: [f64; COLS],
}

impl Columns {
    /// The columns of the scene's device, come to rest in the light `dark` of a room.
    #[must_use]
    pub fn new(scene: &Scene, dark: [f64; COLS]) -> Self {
        let step = f64::from(scene.scan.step_us);
        let period = 1e6 / f64::from(scene.rate_hz());
        let left = |time: f64| (-time / scene.time_constant_us()).exp();
        let settling = scene.has(Effect::Settling).then(|| Settling {
            read: left(step - scene.sampling_us()),
            end: left(step),
            pause: left(period - 5.0 * step),
            level: dark,
        });
        Self { gain: gain(scene), settling }
    }

    /// A frame begins: the LEDs have been off since its predecessor ended.
    pub fn pause(&mut self, dark: &[f64; COLS]) {
        if let Some(settling) = &mut self.settling {
            let left = settling.pause;
            settling.level.iter_mut().zip(dark).for_each(|(l, d)| *l = d + (*l - d) * left);
        }
    }

    /// Voltages at the converter, as fractions of its range, when a step with this `light` is read. The
    /// amplifiers reach both rails into an input that draws nothing, and no further.
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
        read.map(|level| (self.gain * level).clamp(0.0, 1.0))
    }
}

fn gain(scene: &Scene) -> f64 {
    scene.electronics.load_ohm / 1000.0 * scene.electronics.pga_gain.times()
}

/// Noise of a column, in squares of the converter's range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightNoise {
    /// For a reading of one; it grows with the light.
    pub shot: f64,
    /// Of the load, light or dark.
    pub thermal: f64,
}

impl LightNoise {
    /// Within the bandwidth 1/4τ of the phototransistor on its load. The base current's shot noise is
    /// amplified and the collector's own adds to it: 2q(1 + h)I; the load adds 4kTR.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        let bandwidth = 1e6 / (4.0 * scene.time_constant_us());
        let load = scene.electronics.load_ohm;
        let amplified = scene.electronics.pga_gain.times() / RANGE_V;
        // A reading of one comes from this light.
        let current = UNIT_A / gain(scene);
        let shot = 2.0 * ELEMENTARY_CHARGE * (1.0 + CURRENT_GAIN) * current * bandwidth;
        Self {
            shot: shot * (load * amplified).powi(2),
            thermal: 4.0 * BOLTZMANN * ROOM_K * load * bandwidth * amplified.powi(2),
        }
    }
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

    /// What a dark step holds of a bright one before it.
    fn residue(electronics: &str, step_us: u32) -> f64 {
        let mut columns = Columns::new(&scene(electronics, step_us), [0.0; COLS]);
        for _ in 0..100 {
            let _ = columns.step([0.5; COLS]);
        }
        columns.step([0.0; COLS])[0] / 0.5
    }

    #[test]
    fn seven_microseconds_of_rise_settle_to_twelve_bits_in_twenty_six_and_a_half() {
        // 26.75 µs of which the conversion takes the last 0.25 µs; steps are whole microseconds.
        let (at_26, at_27) = (residue("", 26), residue("", 27));
        assert!(at_26 > 1.0 / 4096.0 && at_27 < 1.0 / 4096.0, "{at_26} {at_27}");
    }

    #[test]
    fn a_short_step_carries_the_row_before_into_the_reading() {
        let expected = (-(10.0 - 0.25) / (7.0 / 9f64.ln())).exp();
        assert!((residue("", 10) / expected - 1.0).abs() < 1e-12);
        assert!(residue("time_constant_us = 20", 30) > 0.2);
        assert!(residue("", 10) > 100.0 * residue("", 26));
    }

    #[test]
    fn a_quarter_of_the_load_with_four_times_the_gain_reads_the_same_and_settles_four_times_as_fast()
     {
        let quick = "load_ohm = 250\npga_gain = 4";
        let mut columns = Columns::new(&scene(quick, 30), [0.3; COLS]);
        assert!((columns.step([0.3; COLS])[0] - 0.3).abs() < 1e-12);
        let ratio = residue(quick, 10).ln() / residue("", 10).ln();
        assert!((ratio - 4.0).abs() < 1e-9, "{ratio}");
        // What it costs: four times the bandwidth, so twice the shot noise.
        let (slow, quick) = (LightNoise::of(&scene("", 30)), LightNoise::of(&scene(quick, 30)));
        assert!((quick.shot / slow.shot - 4.0).abs() < 1e-9);
    }

    #[test]
    fn an_amplifier_ends_at_its_rail() {
        let mut columns = Columns::new(&scene("pga_gain = 16", 30), [0.0; COLS]);
        assert_eq!(columns.step([0.5; COLS]), [1.0; COLS]);
    }

    #[test]
    fn noise_of_light_follows_from_charge_and_temperature() {
        // 3.3 mA on 1 kΩ: 2·1.602e-19·251·3.3e-3 A²/Hz over 78.5 kHz are 144 nA, 144 µV of 3.3 V;
        // 4kTR over the same band is 1.14 µV.
        let noise = LightNoise::of(&scene("", 30));
        assert!(
            (noise.shot.sqrt() * RANGE_V / 144.3e-6 - 1.0).abs() < 2e-3,
            "{}",
            noise.shot.sqrt()
        );
        assert!((noise.thermal.sqrt() * RANGE_V / 1.136e-6 - 1.0).abs() < 2e-3);
    }

    #[test]
    fn where_settling_is_not_listed_a_reading_knows_nothing_of_the_one_before() {
        let text = "[scan]\nrate_hz = 1000\nduration_s = 1\nstep_us = 10\n";
        let scene = Scene::parse("test.toml", text).unwrap();
        let mut columns = Columns::new(&scene, [0.0; COLS]);
        let _ = columns.step([0.5; COLS]);
        assert_eq!(columns.step([0.1; COLS]), [0.1; COLS]);
    }
}

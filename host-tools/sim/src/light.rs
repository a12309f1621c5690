//! Light of the room that gets past the rubber, the same on every column.
//!
//! All values are fractions of the converter's full scale on a load of 1 kΩ amplified sixteenfold.

use rand_distr::{Distribution as _, Uniform};

use crate::scene::{Effect, Scene};
use crate::seeds::{Purpose, stream};

/// Lamps and sun of one run.
#[derive(Clone, Debug)]
pub struct Room {
    ambient: f64,
    flicker: Option<Flicker>,
    /// Light of the sun, and the time in µs of the scene from which it shines.
    sun: Option<(f64, f64)>,
}

#[derive(Clone, Copy, Debug)]
struct Flicker {
    amplitude: f64,
    /// Angular frequency in radians per microsecond.
    speed: f64,
    phase: f64,
}

impl Room {
    /// Creates the scene's room; the first phase of its lamps follows from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let light = &scene.light;
        let flicker = scene.has(Effect::Flicker).then(|| {
            let phase = Uniform::new(0.0, core::f64::consts::TAU)
                .map_or(0.0, |phase| phase.sample(&mut stream(seed, Purpose::Flicker)));
            Flicker {
                amplitude: light.flicker_ratio,
                speed: core::f64::consts::TAU * light.flicker_hz * 1e-6,
                phase,
            }
        });
        Self {
            ambient: if scene.has(Effect::Ambient) { light.ambient_ratio } else { 0.0 },
            flicker,
            sun: scene.has(Effect::Sun).then_some((light.sun_ratio, light.sun_at_s * 1e6)),
        }
    }

    /// Light at `device_us` of the device's clock, when the scene is at `scene_us`.
    ///
    /// Lamps continue where a scene begins again. They swing between no light and twice their mean,
    /// as the power of the mains does.
    #[must_use]
    pub fn at(&self, device_us: f64, scene_us: f64) -> f64 {
        let lamps = self.flicker.map_or(0.0, |flicker| {
            flicker.amplitude * (1.0 + (flicker.phase + flicker.speed * device_us).sin())
        });
        let sun = self.sun.map_or(0.0, |(sun, from)| if scene_us >= from { sun } else { 0.0 });
        self.ambient + lamps + sun
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room(effects: &str, light: &str) -> Room {
        let text = format!(
            "effects = [{effects}]\n[scan]\nrate_hz = 1000\nduration_s = 1\n[light]\n{light}\n"
        );
        Room::new(&Scene::parse("test.toml", &text).unwrap(), 1)
    }

    #[test]
    fn unlisted_light_is_off() {
        let dark = room("", "ambient_ratio = 0.3\nflicker_ratio = 0.1\nsun_ratio = 0.5");
        assert_eq!([0.0, 1.3e3, 5e5].map(|t| dark.at(t, t)), [0.0; 3]);
    }

    #[test]
    fn lamps_swing_from_dark_to_twice_their_mean() {
        for (hz, period) in [(100.0, 10_000.0), (120.0, 1e6 / 120.0)] {
            let room = room("'flicker'", &format!("flicker_hz = {hz}"));
            let at = |time| room.at(time, time);
            assert!((at(700.0) - at(700.0 + period)).abs() < 1e-12);
            assert!((at(700.0) + at(700.0 + period / 2.0) - 2.0 * 0.002).abs() < 1e-12);
            let all: Vec<f64> = (0..100).map(|i| at(f64::from(i) * period / 100.0)).collect();
            let most = all.iter().fold(0.0f64, |most, light| most.max(*light));
            let least = all.iter().fold(1.0f64, |least, light| least.min(*light));
            assert!((most - 0.004).abs() < 1e-5 && (0.0..1e-5).contains(&least), "{least} {most}");
        }
    }

    #[test]
    fn sun_comes_out_on_time_in_every_pass() {
        let room = room("'sun'", "sun_at_s = 0.25\nsun_ratio = 0.4");
        assert_eq!(room.at(249_999.0, 249_999.0), 0.0);
        assert_eq!(room.at(250_000.0, 250_000.0), 0.4);
        assert_eq!(room.at(1_100_000.0, 100_000.0), 0.0);
    }
}

//! Voltages to codes: noise, range and resolution of the converter.
//!
//! `bits = 12` is one conversion. `bits = 16` is the mean of sixteen, scaled to 65535: its steps are a
//! sixteenth of a 12-bit step and its converter noise is a quarter.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use taxel::units::{Code, FullScale};

use crate::scene::{Bits, Effect, Scene};
use crate::seeds::{Purpose, stream};

/// Noise of one conversion: 0.8 of a 12-bit step, converter and thermal together.
const CONVERSION: f64 = 0.8 / 4095.0;
/// Conversions behind a 16-bit value.
const OVERSAMPLING: f64 = 16.0;
/// Shot noise of a phototransistor at full scale: 35 µV of 3.3 V, falling with the root of the light.
const SHOT: f64 = 35e-6 / 3.3;

/// The converter of a run.
#[derive(Clone, Debug)]
pub struct Adc {
    full_scale: FullScale,
    noise: Option<Noise>,
}

#[derive(Clone, Debug)]
struct Noise {
    rng: ChaCha8Rng,
    /// Variance of a dark reading.
    floor: f64,
}

impl Adc {
    /// The scene's converter; its noise follows from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let (full_scale, averaged) = match scene.device.bits {
            Bits::Twelve => (FullScale::BITS_12, 1.0),
            Bits::Sixteen => (FullScale::BITS_16, OVERSAMPLING),
        };
        let noise = scene.has(Effect::Noise).then(|| Noise {
            rng: stream(seed, Purpose::Noise),
            floor: CONVERSION * CONVERSION / averaged,
        });
        Self { full_scale, noise }
    }

    /// What codes are fractions of.
    #[must_use]
    pub fn full_scale(&self) -> FullScale {
        self.full_scale
    }

    /// Reads a phototransistor's `ratio` of full scale; light is noisier than darkness.
    pub fn light(&mut self, ratio: f64) -> Code {
        self.convert(ratio, SHOT * SHOT * ratio.max(0.0))
    }

    /// Reads a voltage that has no noise of its own to speak of.
    pub fn voltage(&mut self, ratio: f64) -> Code {
        self.convert(ratio, 0.0)
    }

    fn convert(&mut self, ratio: f64, variance: f64) -> Code {
        let mut reading = ratio;
        if let Some(noise) = &mut self.noise {
            let unit: f64 = StandardNormal.sample(&mut noise.rng);
            reading += (noise.floor + variance).sqrt() * unit;
        }
        let top = f64::from(self.full_scale.top().0);
        // Clamped to the range, so the conversion to an integer is exact.
        Code((reading * top).round().clamp(0.0, top) as u16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adc(bits: u8, effects: &str) -> Adc {
        let text = format!(
            "effects = [{effects}]\n[device]\nbits = {bits}\n[scan]\nrate_hz = 1000\nduration_s = 1\n"
        );
        Adc::new(&Scene::parse("test.toml", &text).unwrap(), 7)
    }

    #[test]
    fn the_range_ends_at_zero_and_at_full_scale() {
        for (bits, top) in [(12, 4095), (16, 65535)] {
            let mut adc = adc(bits, "");
            assert_eq!(adc.light(-0.1), Code(0));
            assert_eq!(adc.light(1.7), Code(top));
            assert_eq!(adc.voltage(1.0), Code(top));
        }
    }

    #[test]
    fn without_noise_a_code_is_the_nearest_step() {
        assert_eq!(adc(12, "").voltage(0.5), Code(2048));
        assert_eq!(adc(16, "").voltage(0.25), Code(16384));
    }

    #[test]
    fn oversampling_makes_a_quarter_of_the_noise_and_light_adds_its_own() {
        let spread = |bits, ratio, light: bool| {
            let mut adc = adc(bits, "'noise'");
            let n = 20_000;
            let top = f64::from(adc.full_scale().top().0);
            let read: Vec<f64> = (0..n)
                .map(|_| if light { adc.light(ratio) } else { adc.voltage(ratio) })
                .map(|code| f64::from(code.0) / top)
                .collect();
            let mean = read.iter().sum::<f64>() / f64::from(n);
            (read.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / f64::from(n)).sqrt()
        };
        // One 12-bit step of quantisation adds its 1/√12.
        let quantised = |sigma: f64, step: f64| (sigma * sigma + step * step / 12.0).sqrt();
        let twelve = spread(12, 0.5, false) / quantised(CONVERSION, 1.0 / 4095.0);
        let sixteen = spread(16, 0.5, false) / (CONVERSION / 4.0);
        assert!((twelve - 1.0).abs() < 0.03 && (sixteen - 1.0).abs() < 0.03);
        assert!(spread(16, 0.9, true) > spread(16, 0.9, false));
    }
}

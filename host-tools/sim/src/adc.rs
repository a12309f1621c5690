//! Analogue-to-digital converter: noise, range and resolution from voltage to code.
//!
//! A reading is the mean of N conversions of 12 bits. Its steps are 1/N of theirs, or those of
//! 65535 where these are coarser. Usually N is 1 for `bits = 12` and 16 for `bits = 16`.
//!
//! The conversions are not drawn one by one. Their own noise is wider than half a step, so that
//! rounding adds its 1/12 of a squared step to each. The mean then has 1/N of both (tested against
//! drawing all conversions). Noise of the light is slower; [`LightNoise`] has the part that N
//! conversions average out.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use scan_plan::finger::REFERENCE;
use taxel::units::{Code, FullScale};

use crate::electronics::LightNoise;
use crate::scene::{Bits, Effect, Scene};
use crate::seeds::{Purpose, stream};

/// Noise of one conversion, one standard deviation.
const CONVERSION: f64 = REFERENCE.converter.noise_steps * STEP;
/// Step of one conversion.
const STEP: f64 = 1.0 / 4095.0;

/// Converter of one run.
#[derive(Clone, Debug)]
pub struct Adc {
    full_scale: FullScale,
    /// Number of steps in a reading's range, where they are coarser than its codes.
    steps: Option<f64>,
    noise: Option<Noise>,
    bent: Option<Bent>,
}

#[derive(Clone, Debug)]
struct Noise {
    rng: ChaCha8Rng,
    /// Variance that the converter adds to any reading.
    converter: f64,
    light: LightNoise,
}

impl Adc {
    /// Creates the scene's converter; its noise follows from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let conversions = f64::from(scene.oversampling());
        let full_scale = match scene.device.bits {
            Bits::Twelve => FullScale::BITS_12,
            Bits::Sixteen => FullScale::BITS_16,
        };
        // The reading is rounded to 1/N of a step below; that is the last Nth of all rounding.
        let rounding = STEP * STEP / 12.0 * (1.0 - 1.0 / conversions);
        let noise = scene.has(Effect::Noise).then(|| Noise {
            rng: stream(seed, Purpose::Noise),
            converter: (CONVERSION * CONVERSION + rounding) / conversions,
            light: LightNoise::of(scene),
        });
        // 65520 steps come close enough to 65535.
        let coarse = full_scale == FullScale::BITS_16 && conversions < 16.0;
        let steps = coarse.then_some(conversions / STEP);
        let bent = scene.has(Effect::Nonlinearity).then(|| Bent::new(scene.device.seed));
        Self { full_scale, steps, noise, bent }
    }

    /// Full scale of the codes.
    #[must_use]
    pub fn full_scale(&self) -> FullScale {
        self.full_scale
    }

    /// Reads a column of phototransistors; its noise grows with the light.
    pub fn light(&mut self, ratio: f64) -> Code {
        let noise = self.noise.as_ref().map_or(0.0, |n| n.light.of_reading(ratio));
        self.convert(ratio, noise)
    }

    /// Reads a voltage that has no noise of its own.
    pub fn voltage(&mut self, ratio: f64) -> Code {
        self.convert(ratio, 0.0)
    }

    /// Converts a voltage with noise of `variance`, both over the converter's range.
    fn convert(&mut self, ratio: f64, variance: f64) -> Code {
        let mut reading = ratio;
        if let Some(bent) = &self.bent {
            reading += bent.at(ratio);
        }
        if let Some(noise) = &mut self.noise {
            let unit: f64 = StandardNormal.sample(&mut noise.rng);
            reading += (noise.converter + variance).sqrt() * unit;
        }
        let top = f64::from(self.full_scale.top().0);
        if let Some(steps) = self.steps {
            reading = (reading * steps).round() / steps;
        }
        // Clamped to the range, so the conversion to an integer is exact.
        Code((reading * top).round().clamp(0.0, top) as u16)
    }
}

/// Integral non-linearity of a device's converter: slow waves of at most two 12-bit steps.
#[derive(Clone, Debug)]
struct Bent {
    nodes: Vec<f64>,
}

impl Bent {
    /// Largest deviation in 12-bit steps, the typical figure of the STM32G431's sheet.
    const MOST: f64 = 2.0;
    /// Waves over the range, with their shares of the deviation; an assumption.
    const WAVES: [(f64, f64); 3] = [(1.0, 0.5), (3.0, 0.3), (11.0, 0.2)];
    const NODES: usize = 257;

    fn new(device: u64) -> Self {
        let mut rng = stream(device, Purpose::Nonlinearity);
        let phases = Self::WAVES.map(|_| {
            let unit: f64 = StandardNormal.sample(&mut rng);
            7.0 * unit
        });
        let node = |i: usize| {
            let at = core::f64::consts::TAU * i as f64 / (Self::NODES - 1) as f64;
            let waves = Self::WAVES.iter().zip(phases);
            let sum: f64 =
                waves.map(|((wave, share), phase)| share * (wave * at + phase).sin()).sum();
            Self::MOST * STEP * sum
        };
        Self { nodes: (0..Self::NODES).map(node).collect() }
    }

    fn at(&self, ratio: f64) -> f64 {
        let node = ratio.clamp(0.0, 1.0) * (Self::NODES - 1) as f64;
        let low = (node.floor() as usize).min(Self::NODES - 2);
        match self.nodes.get(low..low + 2) {
            Some([first, second]) => first + (node - low as f64) * (second - first),
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adc(bits: u8, effects: &str) -> Adc {
        with(bits, effects, "")
    }

    fn with(bits: u8, effects: &str, electronics: &str) -> Adc {
        let text = format!(
            "effects = [{effects}]\n[device]\nbits = {bits}\n[scan]\nrate_hz = 1000\nstep_us = 100\n\
             duration_s = 1\n[electronics]\n{electronics}\n"
        );
        Adc::new(&Scene::parse("test.toml", &text).unwrap(), 7)
    }

    /// Mean and standard deviation, as fractions of full scale.
    fn moments(values: impl ExactSizeIterator<Item = f64> + Clone) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.clone().sum::<f64>() / n;
        (mean, (values.map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt())
    }

    fn readings(mut adc: Adc, ratio: f64, light: bool) -> Vec<f64> {
        let top = f64::from(adc.full_scale().top().0);
        let mut read = || if light { adc.light(ratio) } else { adc.voltage(ratio) };
        (0..20_000).map(|_| f64::from(read().0) / top).collect()
    }

    #[test]
    fn codes_clip_at_zero_and_full_scale() {
        for (bits, top) in [(12, 4095), (16, 65535)] {
            let mut adc = adc(bits, "");
            assert_eq!(adc.light(-0.1), Code(0));
            assert_eq!(adc.light(1.7), Code(top));
            assert_eq!(adc.voltage(1.0), Code(top));
        }
    }

    #[test]
    fn noiseless_code_is_the_nearest_step() {
        assert_eq!(adc(12, "").voltage(0.5), Code(2048));
        assert_eq!(adc(16, "").voltage(0.25), Code(16384));
    }

    #[test]
    fn nonlinearity_stays_within_two_steps() {
        let bent = |device| Bent::new(device);
        let curve = |device| (0..=1000).map(move |i| bent(device).at(f64::from(i) / 1000.0) / STEP);
        for device in 1..4 {
            let most = curve(device).fold(0.0, |most: f64, steps| most.max(steps.abs()));
            assert!((0.8..=2.0).contains(&most), "{most}");
        }
        // A property of the device.
        assert!(curve(1).eq(curve(1)) && curve(1).ne(curve(2)));
        let codes = |effects| adc(16, effects).voltage(0.4).0;
        assert!(codes("'nonlinearity'").abs_diff(codes("")) <= 33);
    }

    #[test]
    fn few_conversions_leave_coarse_steps() {
        let mut adc = with(16, "", "oversampling = 4");
        let codes: Vec<u16> = (0..4000).map(|i| adc.voltage(f64::from(i) * 1e-5).0).collect();
        let mut steps: Vec<u16> =
            codes.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0).collect();
        steps.sort_unstable();
        // A quarter of a 12-bit step is 4.0009 of 65535.
        assert!(steps[0] == 4 && steps[steps.len() - 1] <= 5, "{steps:?}");
    }

    #[test]
    fn reading_matches_averaged_conversions() {
        for conversions in [4u32, 16, 64] {
            let ratio = 0.3 + 0.37 * STEP;
            let short = readings(
                with(16, "'noise'", &format!("oversampling = {conversions}")),
                ratio,
                false,
            );
            let mut rng = stream(8, Purpose::Noise);
            let long: Vec<f64> = (0..20_000)
                .map(|_| {
                    let sum: f64 = (0..conversions)
                        .map(|_| {
                            let unit: f64 = StandardNormal.sample(&mut rng);
                            ((ratio + CONVERSION * unit) / STEP).round()
                        })
                        .sum();
                    sum / f64::from(conversions) * STEP
                })
                .collect();
            let (short, long) = (moments(short.iter().copied()), moments(long.iter().copied()));
            // With 20000 draws the mean is good to 1/141 of a spread and the spread to 1/200. The
            // bounds are four of each, and half a code for the scaling of the reading.
            let mean = 4.0 * long.1 / 100.0 + 0.5 / 65535.0;
            assert!((short.0 - long.0).abs() < mean, "{conversions}: {short:?} {long:?}");
            assert!((short.1 / long.1 - 1.0).abs() < 0.03, "{conversions}: {short:?} {long:?}");
        }
    }

    #[test]
    fn averaging_leaves_most_light_noise() {
        let spread =
            |ratio, light| moments(readings(adc(16, "'noise'"), ratio, light).iter().copied()).1;
        let own = |ratio: f64| (spread(ratio, true).powi(2) - spread(ratio, false).powi(2)).sqrt();
        // 774 µV of 3.3 V at full scale (see the electronics), times the root of the light below.
        // Sixteen conversions in 4 µs leave 0.685 of the variance.
        let expected = 774e-6 / 3.3 * (0.9f64 * 0.685).sqrt();
        assert!((own(0.9) / expected - 1.0).abs() < 0.03, "{} {expected}", own(0.9));
        assert!(own(0.9) > 1.5 * own(0.2));
        // docs/simulator.md quotes these for a pair at rest, in codes.
        let (pair, converter) = (65535.0 * own(0.29), 65535.0 * spread(0.29, false));
        assert!((pair - 7.0).abs() < 0.4 && (converter - 3.4).abs() < 0.1, "{pair} {converter}");
    }
}

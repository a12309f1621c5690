//! Conversion of codes to signals in one pass, in half the cycles of the separate steps.
//!
//! The signals are those of the separate steps, bit for bit.

use super::levels::{BridgeLevels, BridgeLimits, any_sign, lost, outputs};
use super::{Bias, Health, Levels, Signals, TaxelLevels, TemperatureCompensation, Warm};
use crate::scan::{COLS, Codes, SENSORS, TAXELS, TaxelCodes};
use crate::units::Code;

impl Bias {
    /// Converts one scan into `signals`, as [`Self::apply`] does with [`Levels::at_reference`], at
    /// the force sensors' calibrated sensitivity. `gain` is the factor of the light.
    #[inline(never)]
    pub fn direct(
        &self,
        codes: &Codes,
        healthy: Option<&TaxelLevels>,
        warm: Option<Warm<'_>>,
        gain: f32,
        signals: &mut Signals,
    ) {
        let (Some(taxels), Some(bias)) = (&codes.taxels, &self.taxels) else {
            return self.by_levels(codes, healthy, warm, gain, signals);
        };
        let step = codes.full_scale.step().0;
        let change = warm.map(|(warmth, level)| (warmth, warmth.change(level)));
        let brighter = change.map_or(gain, |(warmth, change)| warmth.brighter(change) * gain);
        let levels = [&bias.level, healthy.unwrap_or(&bias.level)];
        let c = signals.taxels.get_or_insert([0.0; TAXELS]);
        if !matrix(taxels, levels, c, [step, brighter], codes.full_scale.clipped()) {
            return self.by_levels(codes, healthy, warm, gain, signals);
        }
        let bridge_faults = self.bridges(codes, step, change, &mut signals.bridges);
        signals.health = Health { bridge_faults, ..Health::SOUND };
    }

    /// Writes the signals of the bridges; returns a bit for each faulty one.
    #[inline(never)]
    fn bridges(
        &self,
        codes: &Codes,
        step: f32,
        change: Option<(&TemperatureCompensation, f32)>,
        signals: &mut [Option<BridgeLevels>; SENSORS],
    ) -> u8 {
        let mut faults = 0;
        let limits = BridgeLimits::new(codes.full_scale);
        let gain = change.map_or(1.0, |(warmth, change)| warmth.gain_after(change));
        let channels = codes.bridges.iter().zip(&self.bridges);
        for (i, (signal, (midpoints, bias))) in signals.iter_mut().zip(channels).enumerate() {
            *signal = midpoints.as_ref().and_then(|midpoints| {
                if !limits.hold(midpoints) {
                    faults |= 1 << i;
                }
                let mut u = outputs(midpoints, step);
                if let Some((warmth, change)) = change
                    && let Some(offset) = warmth.offset.get(i)
                {
                    u.iter_mut().zip(offset).for_each(|(u, offset)| *u -= offset * change);
                }
                let bias = bias.as_ref()?;
                u.iter_mut().zip(bias.level).for_each(|(u, b)| *u = (*u - b) * gain);
                Some(u)
            });
        }
        faults
    }

    /// Converts by the separate steps: for a finger without a matrix or its bias, and for faults.
    #[cold]
    #[inline(never)]
    fn by_levels(
        &self,
        codes: &Codes,
        healthy: Option<&TaxelLevels>,
        warm: Option<Warm<'_>>,
        gain: f32,
        signals: &mut Signals,
    ) {
        *signals = self.apply(&Levels::at_reference(codes, warm, gain), healthy);
        if let Some((warmth, level)) = warm {
            warmth.scale(signals, level);
        }
    }
}

/// Writes the signals of the matrix. Returns `false` at once if a code may be clipped or a taxel
/// has lost its light. A separate function keeps a taxel's values in registers.
#[inline(never)]
fn matrix(
    codes: &TaxelCodes,
    [bias, unloaded]: [&TaxelLevels; 2],
    signals: &mut TaxelLevels,
    [step, brighter]: [f32; 2],
    limit: Code,
) -> bool {
    if codes.dark.iter().any(|dark| *dark >= limit) {
        return false;
    }
    let dark = codes.dark.map(|code| f32::from(code.0));
    let levels = bias.as_chunks::<COLS>().0.iter().zip(unloaded.as_chunks::<COLS>().0);
    let rows = signals.as_chunks_mut::<COLS>().0.iter_mut().zip(&codes.lit).zip(levels);
    for ((signals, lit), (bias, unloaded)) in rows {
        if lit.iter().any(|lit| *lit >= limit) {
            return false;
        }
        let mut signs = 0;
        let levels = bias.iter().zip(unloaded);
        let taxels = signals.iter_mut().zip(lit.iter().zip(dark)).zip(levels);
        for ((signal, (lit, dark)), (bias, unloaded)) in taxels {
            let level = (f32::from(lit.0) - dark) * step * brighter;
            signs |= lost(level, *unloaded);
            *signal = bias - level;
        }
        if any_sign(signs) {
            return false;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::{BridgeBias, PER_KELVIN, TaxelBias};
    use crate::scan::Midpoints;
    use crate::units::FullScale;
    use proptest::prelude::*;

    fn bits(signals: &Signals) -> impl PartialEq + core::fmt::Debug {
        let taxels = signals.taxels.map(|taxels| taxels.map(f32::to_bits));
        let bridges = signals.bridges.map(|bridge| bridge.map(|bridge| bridge.map(f32::to_bits)));
        (taxels, bridges, signals.health)
    }

    /// Codes mostly of a sound finger; some are clipped, some without light, some at a rail.
    fn code() -> impl Strategy<Value = Code> + Clone {
        prop_oneof![30 => 20_000..40_000u16, 1 => any::<u16>(), 1 => 65_000..=u16::MAX]
            .prop_map(Code)
    }

    fn codes() -> impl Strategy<Value = Codes> {
        let low = prop_oneof![30 => 800..1200u16, 1 => any::<u16>()].prop_map(Code);
        let matrix = ([(); 4].map(|()| [(); 4].map(|()| code())), [(); 4].map(|()| low.clone()));
        let matrix = matrix.prop_map(|(lit, dark)| TaxelCodes { lit, dark });
        let sensor = [(); 4].map(|()| code()).prop_map(|[a, b, c, d]| Midpoints { a, b, c, d });
        let bridges = [(); SENSORS].map(|()| prop::option::weighted(0.9, sensor.clone()));
        (prop::option::weighted(0.9, matrix), bridges).prop_map(|(taxels, bridges)| Codes {
            full_scale: FullScale::BITS_16,
            taxels,
            bridges,
            reference: None,
            temperature: None,
        })
    }

    fn bias() -> impl Strategy<Value = Bias> {
        let taxels = [(); TAXELS].map(|()| 0.2f32..0.8);
        let taxels = taxels.prop_map(|level| TaxelBias { level, noise: 1e-4 });
        let sensor = [(); 3].map(|()| -0.1f32..0.1);
        let sensor = sensor.prop_map(|level| BridgeBias { level, noise: 1e-4 });
        let bridges = [(); SENSORS].map(|()| prop::option::weighted(0.8, sensor.clone()));
        let taxels = prop::option::weighted(0.9, taxels);
        (taxels, bridges).prop_map(|(taxels, bridges)| Bias { taxels, bridges })
    }

    proptest! {
        #[test]
        fn direct_equals_separate_steps_bit_for_bit(
            scans in prop::collection::vec(codes(), 1..4),
            bias in bias(),
            healthy in prop::option::of([(); TAXELS].map(|()| 0.2f32..0.8)),
            kelvin in prop::option::of(-80.0f32..80.0),
            gain in prop_oneof![Just(1.0f32), 0.9f32..1.1],
        ) {
            let warmth = TemperatureCompensation {
                reference: 0.23,
                range: [0.22, 0.24],
                light: -6.6,
                sensitivity: -4.4,
                offset: [[0.3, -0.2, 0.5], [0.0; 3], [-1.0; 3], [0.1; 3]],
            };
            let warm = kelvin.map(|kelvin| (&warmth, warmth.reference + kelvin * PER_KELVIN));
            // The second scan must not depend on signals left by the first.
            let mut signals = Signals::default();
            for codes in scans {
                bias.direct(&codes, healthy.as_ref(), warm, gain, &mut signals);
                let levels = Levels::at_reference(&codes, warm, gain);
                let mut step_by_step = bias.apply(&levels, healthy.as_ref());
                if let Some((warmth, level)) = warm {
                    warmth.scale(&mut step_by_step, level);
                }
                prop_assert_eq!(bits(&signals), bits(&step_by_step));
            }
        }
    }
}

//! Codes become signals in one pass, without levels in between: to the bit what the steps say one after the
//! other, in half of their cycles.

use super::levels::{BridgeLimits, any_sign, clipped, light, lost, reaches, read_bridge};
use super::{Bias, Health, Levels, Signals, TaxelLevels, Warm};
use crate::scan::{COLS, Codes, TAXELS, TaxelCodes};
use crate::units::Code;

impl Bias {
    /// Of one scan what [`Self::apply`] says of [`Levels::at_reference`], into `signals`.
    #[inline(never)]
    pub fn direct(
        &self,
        codes: &Codes,
        healthy: Option<&TaxelLevels>,
        warm: Option<Warm<'_>>,
        signals: &mut Signals,
    ) {
        let (Some(taxels), Some(bias)) = (&codes.taxels, &self.taxels) else {
            return self.by_levels(codes, healthy, warm, signals);
        };
        signals.health = Health::default();
        let step = codes.full_scale.step().0;
        let change = warm.map(|(warmth, level)| (warmth, warmth.change(level)));
        let brighter = change.map_or(1.0, |(warmth, change)| warmth.brighter(change));
        let unloaded = healthy.unwrap_or(&bias.level);
        let c = signals.taxels.get_or_insert([0.0; TAXELS]);
        let limit = codes.full_scale.clipped();
        let levels = [&bias.level, unloaded];
        let [high, dark] = matrix(taxels, levels, [step, brighter], limit, c);
        if any_sign(high) {
            signals.health.saturated = clipped(taxels, codes.full_scale);
        }
        if any_sign(dark) {
            signals.health.dead = dead(codes, unloaded, warm);
        }
        let limits = BridgeLimits::new(codes.full_scale);
        for (i, ((signal, midpoints), bias)) in
            signals.bridges.iter_mut().zip(&codes.bridges).zip(&self.bridges).enumerate()
        {
            let Some(midpoints) = midpoints else {
                *signal = None;
                continue;
            };
            let (mut u, intact) = read_bridge(midpoints, &limits, step);
            signals.health.bridge_faults |= u8::from(!intact) << i;
            if let Some((offset, change)) =
                change.and_then(|(warmth, change)| Some((warmth.offset.get(i)?, change)))
            {
                u.iter_mut().zip(offset).for_each(|(u, offset)| *u -= offset * change);
            }
            *signal = bias.as_ref().map(|bias| {
                u.iter_mut().zip(bias.level).for_each(|(u, b)| *u -= b);
                u
            });
        }
    }

    /// The long way, for a finger without a matrix or without a bias of it.
    #[cold]
    #[inline(never)]
    fn by_levels(
        &self,
        codes: &Codes,
        healthy: Option<&TaxelLevels>,
        warm: Option<Warm<'_>>,
        signals: &mut Signals,
    ) {
        *signals = self.apply(&Levels::at_reference(codes, warm), healthy);
    }
}

/// Puts the signals of the matrix; signs where a code may be clipped, and where a taxel has lost its light.
/// Apart, so that what a taxel needs stays in registers.
#[inline(never)]
fn matrix(
    codes: &TaxelCodes,
    [bias, unloaded]: [&TaxelLevels; 2],
    [step, brighter]: [f32; 2],
    limit: Code,
    signals: &mut TaxelLevels,
) -> [u32; 2] {
    // Two passes, each of which needs few registers.
    let mut high = codes.dark.iter().fold(0, |signs, dark| signs | reaches(limit, *dark));
    let rows = signals.as_chunks_mut::<COLS>().0.iter_mut().zip(&codes.lit);
    for (levels, lit) in rows {
        for (level, (lit, dark)) in levels.iter_mut().zip(lit.iter().zip(&codes.dark)) {
            high |= reaches(limit, *lit);
            *level = light(*lit, *dark, step) * brighter;
        }
    }
    let mut dark = 0;
    for (level, (bias, unloaded)) in signals.iter_mut().zip(bias.iter().zip(unloaded)) {
        dark |= lost(*level, *unloaded);
        *level = bias - *level;
    }
    [high, dark]
}

/// Which they are.
#[cold]
#[inline(never)]
fn dead(codes: &Codes, unloaded: &TaxelLevels, warm: Option<Warm<'_>>) -> u16 {
    Levels::at_reference(codes, warm).dead(Some(unloaded))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::{BridgeBias, PER_KELVIN, TaxelBias, Warmth};
    use crate::scan::{Midpoints, SENSORS};
    use crate::units::FullScale;
    use proptest::prelude::*;

    fn bits(signals: &Signals) -> impl PartialEq + core::fmt::Debug {
        let taxels = signals.taxels.map(|taxels| taxels.map(f32::to_bits));
        let bridges = signals.bridges.map(|bridge| bridge.map(|bridge| bridge.map(f32::to_bits)));
        (taxels, bridges, signals.health)
    }

    /// Mostly those of a sound finger; some clipped, some without light, some at a rail.
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
        fn in_one_pass_as_step_by_step_to_the_bit(
            scans in prop::collection::vec(codes(), 1..4),
            bias in bias(),
            healthy in prop::option::of([(); TAXELS].map(|()| 0.2f32..0.8)),
            kelvin in prop::option::of(-80.0f32..80.0),
        ) {
            let warmth = Warmth {
                reference: 0.23,
                range: [0.22, 0.24],
                light: -6.6,
                sensitivity: -4.4,
                offset: [[0.3, -0.2, 0.5], [0.0; 3], [-1.0; 3], [0.1; 3]],
            };
            let warm = kelvin.map(|kelvin| (&warmth, warmth.reference + kelvin * PER_KELVIN));
            // What a scan leaves is nothing to the next.
            let mut signals = Signals::default();
            for codes in scans {
                bias.direct(&codes, healthy.as_ref(), warm, &mut signals);
                let step_by_step = bias.apply(&Levels::at_reference(&codes, warm), healthy.as_ref());
                prop_assert_eq!(bits(&signals), bits(&step_by_step));
            }
        }
    }
}

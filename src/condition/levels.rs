//! Absolute levels of one frame, before any bias.

use super::Health;
use crate::scan::{Codes, Midpoints, SENSORS, TAXELS, TaxelCodes};
use crate::units::FullScale;

/// Light of each taxel above dark, as fractions of full scale.
pub type TaxelLevels = [f32; TAXELS];

/// u_x, u_y, u_z of one sensor, as fractions of full scale.
pub type BridgeLevels = [f32; 3];

/// An intact bridge's amplified midpoint rests near half the supply and moves by some 10 % of full scale
/// per newton (8.5 mV/V/N times the gain, 003 §1.2). An open or shorted arm takes it to a rail.
const MIDPOINT_MARGIN: f32 = 0.1;

/// The four midpoints of an intact bridge average half its supply whatever the force, which moves two up
/// and two down: what is left is half a per cent of mismatch per resistor, amplified (one standard
/// deviation is 0.014 at a gain of 16). A supply that has dropped by a quarter, under a converter that does
/// not follow it, takes the mean to 0.375.
const COMMON_MARGIN: f32 = 0.1;

/// Without a bias to compare with, a taxel whose LED adds less than this is dead: the weakest
/// phototransistor of a working pair adds some ten times as much.
const DEAD_LEVEL: f32 = 1.0 / 128.0;

/// A taxel that has lost three quarters of its unloaded light is dead: a facet moving away under
/// shear takes a few per cent at most.
const DEAD_SHARE: f32 = 0.25;

/// What one frame's codes say, before any bias.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Levels {
    /// Lit minus dark.
    pub taxels: Option<TaxelLevels>,
    /// Bridge outputs.
    pub bridges: [Option<BridgeLevels>; SENSORS],
    /// Faults seen in the codes alone.
    pub health: Health,
}

impl Levels {
    /// Normalises one frame.
    #[must_use]
    pub fn read(codes: &Codes) -> Self {
        let mut levels = Self::default();
        if let Some(taxels) = &codes.taxels {
            levels.taxels = Some(read_taxels(taxels, codes.full_scale, &mut levels.health));
        }
        for (i, (level, midpoints)) in levels.bridges.iter_mut().zip(&codes.bridges).enumerate() {
            *level = midpoints.as_ref().map(|midpoints| {
                let (outputs, intact) = read_bridge(midpoints, codes.full_scale);
                levels.health.bridge_faults |= u8::from(!intact) << i;
                outputs
            });
        }
        levels
    }

    /// Marks taxels that have lost most of the light they have unloaded.
    pub(super) fn mark_dead(&mut self, unloaded: Option<&TaxelLevels>) {
        let Some(levels) = &self.taxels else { return };
        let mut dead = 0;
        for (k, level) in levels.iter().enumerate() {
            let least = unloaded
                .and_then(|unloaded| unloaded.get(k))
                .map_or(DEAD_LEVEL, |unloaded| (unloaded * DEAD_SHARE).max(DEAD_LEVEL));
            dead |= u16::from(*level < least) << k;
        }
        self.health.dead = dead;
    }
}

fn read_taxels(codes: &TaxelCodes, full_scale: FullScale, health: &mut Health) -> TaxelLevels {
    let mut levels = [0.0; TAXELS];
    let lit = codes.lit.iter().flat_map(|row| row.iter().zip(&codes.dark));
    for (k, (level, (lit, dark))) in levels.iter_mut().zip(lit).enumerate() {
        *level = full_scale.ratio(*lit).0 - full_scale.ratio(*dark).0;
        let clipped = full_scale.clips(*lit) || full_scale.clips(*dark);
        health.saturated |= u16::from(clipped) << k;
    }
    levels
}

/// 003 eqs (1.10)–(1.12) before the amplifiers: u_x = V_B − V_A, u_y = V_C − V_D,
/// u_z = (V_A + V_B) − (V_C + V_D). The amplifiers' gains are in S.
fn read_bridge(midpoints: &Midpoints, full_scale: FullScale) -> (BridgeLevels, bool) {
    let [a, b, c, d] =
        [midpoints.a, midpoints.b, midpoints.c, midpoints.d].map(|code| full_scale.ratio(code).0);
    let intact = [a, b, c, d].iter().all(|v| (MIDPOINT_MARGIN..=1.0 - MIDPOINT_MARGIN).contains(v));
    let common = 0.25 * ((a + b) + (c + d));
    let fed = (0.5 - COMMON_MARGIN..=0.5 + COMMON_MARGIN).contains(&common);
    ([b - a, c - d, (a + b) - (c + d)], intact && fed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Code;

    fn codes(taxels: TaxelCodes) -> Codes {
        Codes {
            full_scale: FullScale::BITS_12,
            taxels: Some(taxels),
            bridges: [None; SENSORS],
            reference: None,
            temperature: None,
        }
    }

    #[test]
    fn ambient_light_of_a_column_is_taken_off_every_taxel_of_it() {
        let mut taxels = TaxelCodes { lit: [[Code(1800); 4]; 4], dark: [Code(100); 4] };
        let before = Levels::read(&codes(taxels)).taxels;
        for row in &mut taxels.lit {
            row[2] = Code(1800 + 700);
        }
        taxels.dark[2] = Code(100 + 700);
        let after = Levels::read(&codes(taxels)).taxels;
        for (before, after) in before.unwrap().iter().zip(after.unwrap()) {
            assert!((before - after).abs() < 1e-6);
        }
    }

    #[test]
    fn a_clipped_dark_reading_marks_its_whole_column() {
        let mut taxels = TaxelCodes { lit: [[Code(1800); 4]; 4], dark: [Code(100); 4] };
        taxels.lit[1][0] = Code(4095);
        taxels.dark[3] = Code(4095);
        let health = Levels::read(&codes(taxels)).health;
        assert_eq!(health.saturated, 1 << 4 | 1 << 3 | 1 << 7 | 1 << 11 | 1 << 15);
    }

    #[test]
    fn a_taxel_that_lost_its_led_is_dead_with_or_without_a_bias() {
        let mut taxels = TaxelCodes { lit: [[Code(1800); 4]; 4], dark: [Code(100); 4] };
        let unloaded = Levels::read(&codes(taxels)).taxels.unwrap();
        taxels.lit[2][1] = Code(101);
        for bias in [None, Some(&unloaded)] {
            let mut levels = Levels::read(&codes(taxels));
            levels.mark_dead(bias);
            assert_eq!(levels.health.dead, 1 << 9);
        }
    }

    #[test]
    fn bridge_outputs_follow_the_thesis_and_an_open_arm_is_a_fault() {
        let midpoints = Midpoints { a: Code(1000), b: Code(1100), c: Code(1300), d: Code(1250) };
        let full_scale = FullScale::new(2000).unwrap();
        let ([x, y, z], intact) = read_bridge(&midpoints, full_scale);
        assert!(intact);
        assert!((x - 100.0 / 2000.0).abs() < 1e-6);
        assert!((y - 50.0 / 2000.0).abs() < 1e-6);
        assert!((z - (2100.0 - 2550.0) / 2000.0).abs() < 1e-6);
        let open = Midpoints { c: Code(1990), ..midpoints };
        assert!(!read_bridge(&open, full_scale).1);
        let starved = Midpoints { a: Code(780), b: Code(780), c: Code(790), d: Code(790) };
        assert!(!read_bridge(&starved, full_scale).1);
    }
}

//! Absolute levels of one scan, before any bias.

use core::slice;

use super::Health;
use super::warmth::Warm;
use crate::scan::{COLS, Codes, Midpoints, SENSORS, TAXELS, TaxelCodes};
use crate::units::{Code, FullScale};

/// Light of each taxel above dark, as fractions of full scale.
pub type TaxelLevels = [f32; TAXELS];

/// Outputs u_x, u_y, u_z of one sensor, as fractions of full scale.
pub type BridgeLevels = [f32; 3];

/// Margin of the midpoints from the rails: full scale divided by this.
///
/// An intact bridge's amplified midpoint rests near half the supply. A force moves the midpoint by
/// some 10 % of full scale per newton (8.5 mV/V/N times the gain, [Ospina2017] §1.2). An open or
/// shorted arm takes it to a rail.
pub const MIDPOINT_MARGIN: u32 = 10;

/// Margin of the midpoints' mean from half the supply: full scale divided by this.
///
/// A force moves two midpoints up and two down, so that their mean stays. A mismatch of half a per
/// cent per resistor, amplified, moves it with a standard deviation of 0.014 at a gain of 16. A
/// supply that has dropped by a quarter, under a converter that does not follow it, takes the mean
/// to 0.375.
const COMMON_MARGIN: u32 = 10;

/// Least light of a working taxel if no bias is known, as a fraction of full scale. The weakest
/// phototransistor of a working pair adds some ten times as much.
pub const DEAD_LEVEL: f32 = 1.0 / 128.0;

/// Least share of its unloaded light that a working taxel keeps. A facet that moves away under
/// shear takes a few per cent at most.
const DEAD_SHARE: f32 = 0.25;

/// Levels and faults of one scan, before any bias.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Levels {
    /// Lit minus dark of each taxel.
    pub taxels: Option<TaxelLevels>,
    /// Bridge outputs.
    pub bridges: [Option<BridgeLevels>; SENSORS],
    /// Faults detected in the codes alone.
    pub health: Health,
}

impl Levels {
    /// Normalises one scan. Integer codes are compared and subtracted; floats begin with the
    /// scaling.
    #[must_use]
    pub fn read(codes: &Codes) -> Self {
        let mut levels = Self::default();
        let step = codes.full_scale.step().0;
        if let Some(taxels) = &codes.taxels {
            levels.health.saturated = clipped(taxels, codes.full_scale);
            levels.taxels = Some(read_taxels(taxels, step));
        }
        let limits = BridgeLimits::new(codes.full_scale);
        for (i, (level, midpoints)) in levels.bridges.iter_mut().zip(&codes.bridges).enumerate() {
            if let Some(midpoints) = midpoints {
                levels.health.bridge_faults |= u8::from(!limits.hold(midpoints)) << i;
                *level = Some(outputs(midpoints, step));
            }
        }
        levels
    }

    /// Returns the levels of a scan, corrected to the temperature of the calibration, with the
    /// light multiplied by `gain`.
    #[must_use]
    #[inline(never)]
    pub fn at_reference(codes: &Codes, warm: Option<Warm<'_>>, gain: f32) -> Self {
        let mut levels = Self::read(codes);
        match warm {
            Some((warmth, level)) => warmth.correct(&mut levels, level, gain),
            None => levels.taxels.iter_mut().flatten().for_each(|level| *level *= gain),
        }
        levels
    }

    /// Returns the taxels that have lost most of their unloaded light, a bit each.
    pub(super) fn dead(&self, unloaded: Option<&TaxelLevels>) -> u16 {
        let Some(levels) = &self.taxels else { return 0 };
        let unloaded = unloaded.unwrap_or(&[0.0; TAXELS]);
        let pairs = levels.iter().zip(unloaded);
        if !any_sign(pairs.fold(0, |signs, (level, unloaded)| signs | lost(*level, *unloaded))) {
            return 0;
        }
        let pairs = levels.iter().zip(unloaded);
        marked(pairs.map(|(level, unloaded)| *level < unloaded * DEAD_SHARE || *level < DEAD_LEVEL))
    }
}

/// Returns whether any OR-ed difference was negative. Testing the common sign bit takes half the
/// time of single comparisons, and nearly always finds nothing.
pub(super) fn any_sign(signs: u32) -> bool {
    signs >> 31 != 0
}

/// Returns a word whose sign bit is set if a taxel has lost most of its light.
#[inline(always)]
pub(super) fn lost(level: f32, unloaded: f32) -> u32 {
    (level - unloaded * DEAD_SHARE).to_bits() | (level - DEAD_LEVEL).to_bits()
}

/// Returns a bit for each taxel that is true. The caller knows that there is at least one.
#[cold]
#[inline(never)]
fn marked(taxels: impl Iterator<Item = bool>) -> u16 {
    taxels.enumerate().fold(0, |marks, (k, holds)| marks | u16::from(holds) << k)
}

fn read_taxels(codes: &TaxelCodes, step: f32) -> TaxelLevels {
    let mut levels = [0.0; TAXELS];
    let rows = levels.as_chunks_mut::<COLS>().0;
    for (levels, lit) in rows.iter_mut().zip(&codes.lit) {
        for (level, (lit, dark)) in levels.iter_mut().zip(lit.iter().zip(&codes.dark)) {
            *level = (f32::from(lit.0) - f32::from(dark.0)) * step;
        }
    }
    levels
}

/// Bits of the taxels in the first column.
pub(super) const COLUMN: u16 = 0x1111;

/// Returns the taxels whose lit or dark code may be clipped. A clipped dark code spoils its column.
fn clipped(codes: &TaxelCodes, full_scale: FullScale) -> u16 {
    let limit = full_scale.clipped();
    let columns = high(slice::from_ref(&codes.dark), limit);
    high(&codes.lit, limit) | (columns * COLUMN)
}

/// Returns a bit for each code from `limit` on.
#[inline(never)]
fn high(rows: &[[Code; COLS]], limit: Code) -> u16 {
    let high = |code: &Code| *code >= limit;
    if rows.iter().any(|row| row.iter().any(high)) {
        marked(rows.as_flattened().iter().map(high))
    } else {
        0
    }
}

/// Limits of an intact bridge's midpoints.
pub(super) struct BridgeLimits {
    lowest: u32,
    highest: u32,
    /// Least sum of all four.
    least: u32,
    most: u32,
}

impl BridgeLimits {
    pub fn new(full_scale: FullScale) -> Self {
        let top = u32::from(full_scale.top().0);
        let (rail, common) = (top.div_ceil(MIDPOINT_MARGIN), 4 * top / COMMON_MARGIN);
        Self { lowest: rail, highest: top - rail, least: 2 * top - common, most: 2 * top + common }
    }

    /// Returns whether the bridge is intact.
    #[inline(always)]
    pub fn hold(&self, midpoints: &Midpoints) -> bool {
        let [a, b, c, d] = midpoints.codes().map(|code| u32::from(code.0));
        // One comparison each, because a value below the range wraps.
        let within = |v: u32, low: u32, high: u32| v.wrapping_sub(low) <= high.wrapping_sub(low);
        [a, b, c, d].into_iter().all(|v| within(v, self.lowest, self.highest))
            && within(a + b + c + d, self.least, self.most)
    }
}

/// Returns the bridge outputs before the amplifiers ([Ospina2017] eqs (1.10)–(1.12)).
///
/// u_x = V_B − V_A, u_y = V_C − V_D, u_z = (V_A + V_B) − (V_C + V_D).
///
/// The sensitivity matrix S contains the amplifiers' gains.
#[inline(always)]
pub(super) fn outputs(midpoints: &Midpoints, step: f32) -> BridgeLevels {
    let [a, b, c, d] = midpoints.codes().map(|code| i32::from(code.0));
    [b - a, c - d, (a + b) - (c + d)].map(|codes| codes as f32 * step)
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn dark_code_is_subtracted_from_its_column() {
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
    fn clipped_dark_code_marks_its_column() {
        let mut taxels = TaxelCodes { lit: [[Code(1800); 4]; 4], dark: [Code(100); 4] };
        taxels.lit[1][0] = Code(4095);
        taxels.dark[3] = Code(4095);
        let health = Levels::read(&codes(taxels)).health;
        assert_eq!(health.saturated, 1 << 4 | 1 << 3 | 1 << 7 | 1 << 11 | 1 << 15);
    }

    #[test]
    fn taxel_without_led_light_is_dead() {
        let mut taxels = TaxelCodes { lit: [[Code(1800); 4]; 4], dark: [Code(100); 4] };
        let unloaded = Levels::read(&codes(taxels)).taxels.unwrap();
        taxels.lit[2][1] = Code(101);
        for bias in [None, Some(&unloaded)] {
            let levels = Levels::read(&codes(taxels));
            assert_eq!(levels.dead(bias), 1 << 9);
        }
    }

    #[test]
    fn bridge_outputs_match_ospina_and_open_arm_faults() {
        let midpoints = Midpoints { a: Code(1000), b: Code(1100), c: Code(1300), d: Code(1250) };
        let full_scale = FullScale::new(2000).unwrap();
        let limits = BridgeLimits::new(full_scale);
        let [x, y, z] = outputs(&midpoints, full_scale.step().0);
        assert!(limits.hold(&midpoints));
        assert!((x - 100.0 / 2000.0).abs() < 1e-6);
        assert!((y - 50.0 / 2000.0).abs() < 1e-6);
        assert!((z - (2100.0 - 2550.0) / 2000.0).abs() < 1e-6);
        let open = Midpoints { c: Code(1990), ..midpoints };
        assert!(!limits.hold(&open));
        let starved = Midpoints { a: Code(780), b: Code(780), c: Code(790), d: Code(790) };
        assert!(!limits.hold(&starved));
    }
}

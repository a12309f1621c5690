//! tanh in integers, from a table of values and slopes.

/// tanh(1/64) and tanh(1/32).
const TANH_HALF_STEP: f64 = 0.015_623_728_558_408_737;
const TANH_STEP: f64 = 0.031_239_831_446_031_27;
const ENTRIES: usize = 512;
/// Distance from the middle of a step to either end.
///
/// The tangent misses t·g·d² there; half of it is subtracted everywhere.
const HALF_STEP: f64 = 1.0 / 64.0;

/// Value (upper half) and slope (lower half) of tanh at the middle of each step of 1/32.
///
/// Indices are bits of the argument's two's complement, so that negative arguments come last.
#[expect(clippy::indexing_slicing, reason = "evaluated at compile time")]
pub(crate) static TABLE: [u32; ENTRIES] = {
    let mut table = [0; ENTRIES];
    let mut t = TANH_HALF_STEP;
    let mut i = 0;
    while i < ENTRIES / 2 {
        let g = 1.0 - t * t;
        let bent = t - t * g * HALF_STEP * HALF_STEP / 2.0;
        // Rounded, plus half a unit, because the shift at the end rounds down.
        let slope = (g * 1024.0 + 0.5) as u32;
        let value = bent * 32_768.0;
        let up = if value < 32_767.0 { (value + 1.0) as i32 } else { 32_767 };
        let down = -(value as i32);
        table[i] = ((up as u32) << 16) | slope;
        table[ENTRIES - 1 - i] = ((down as u32) << 16) | slope;
        t = (t + TANH_STEP) / (1.0 + t * TANH_STEP);
        i += 1;
    }
    table
};

/// tanh by the tangent at the middle of a step, with an error below **1e-4**.
///
/// The argument has 18 fraction bits, the result 15. The test below checks the error for every
/// argument.
#[cfg(not(dsp))]
#[inline(always)]
pub(crate) fn whole_tanh(x: i32) -> i16 {
    // Arguments beyond ±8 are clipped.
    let x = x.clamp(-(1 << 21), (1 << 21) - 1);
    let entry = TABLE.get((x as u32 >> 13) as usize % ENTRIES).copied().unwrap_or_default();
    // A step is 2¹³ in the argument, and 2¹⁶ here.
    let from_middle = ((x << 3) ^ 0x8000) as i16;
    let slope = i32::from(entry as i16);
    ((entry as i32).wrapping_add(slope * i32::from(from_middle)) >> 16) as i16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_tanh_error_is_below_1e_4_everywhere() {
        let mut worst = (0.0f64, 0);
        for x in -2_200_000..2_200_000 {
            let exact = (f64::from(x) / 262_144.0).tanh();
            let error = (f64::from(whole_tanh(x)) / 32_768.0 - exact).abs();
            if error > worst.0 {
                worst = (error, x);
            }
        }
        assert!(worst.0 < 1e-4, "{worst:?}");
        assert_eq!([whole_tanh(i32::MIN), whole_tanh(i32::MAX)], [-32_767, 32_767]);
    }
}

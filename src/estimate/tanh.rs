//! tanh without a division: a table and a third-order Taylor step.
//!
//! The table has the step 1/16; the Taylor step starts from its nearest entry.
//!
//! With t = tanh(x₀) and g = 1 − t² the derivatives of tanh are g, −2tg and g(4 − 6g), so that
//! tanh(x₀ + d) ≈ t + g·d·(1 − d·t + d²(⅔ − g)), |d| ≤ 1/32. With f32 rounding the error stays
//! below **2.8e-7** (asserted below).

/// tanh(1/16).
const TANH_STEP: f64 = 0.062_418_746_747_512_514;
const STEPS_PER_UNIT: f32 = 16.0;
/// Index of the middle and half the size of the table. The table's 2⁸ entries let one instruction
/// keep an index inside. Odd, see [`MIDDLE`].
const LAST: usize = 127;
const END: i32 = 2 * LAST as i32 + 1;

/// Values of tanh(i/16) for i from −LAST, built by the addition theorem in f64.
///
/// Both signs are included, because removing and restoring the sign would cost a sixth of the
/// whole. The ends also serve all arguments beyond them. The ends are ±1, which equals tanh(7.94)
/// to 2.6e-7.
#[expect(clippy::indexing_slicing, reason = "evaluated at compile time")]
static TABLE: [f32; 2 * LAST + 2] = {
    let mut table = [1.0; 2 * LAST + 2];
    let mut t = 0.0f64;
    let mut i = 0;
    while i < LAST {
        table[LAST + i] = t as f32;
        table[LAST - i] = -table[LAST + i];
        t = (t + TANH_STEP) / (1.0 + t * TANH_STEP);
        i += 1;
    }
    table[0] = -1.0;
    table
};

const TWO_THIRDS: f32 = 2.0 / 3.0;
/// Offset that rounds a sum to whole steps. From 2¹⁹ to 2²⁰ an f32 is a whole number of steps, and
/// its lowest bits are their number: one addition rounds and converts.
const WHOLE: f32 = 8_388_608.0 / STEPS_PER_UNIT;
/// Position of the table's middle in that range. Odd, so that ties are rounded symmetrically.
const MIDDLE: f32 = WHOLE + LAST as f32 / STEPS_PER_UNIT;

/// Returns tanh(x), within 2.8e-7 for every x, exactly odd.
///
/// A NaN gives ±1, so that no later value becomes NaN.
#[must_use]
#[inline]
pub fn tanh(x: f32) -> f32 {
    if x.is_finite() {
        let [t] = tanh_of_finite([x]);
        t
    } else {
        1.0f32.copysign(x)
    }
}

/// Returns tanh of several finite numbers, without the branch for infinite ones. Each step is done
/// for all numbers, because waiting for the result of the last instruction costs a cycle.
#[inline(always)]
pub(super) fn tanh_of_finite<const N: usize>(x: [f32; N]) -> [f32; N] {
    let sum = x.map(|x| x + MIDDLE);
    let t = sum.map(|sum| {
        let place = (sum.to_bits() as i32).saturating_sub(WHOLE.to_bits() as i32).clamp(0, END);
        TABLE.get(place as usize).copied().unwrap_or(1.0)
    });
    let nearest = sum.map(|sum| sum - MIDDLE);
    let d = zip(x, nearest, |x, nearest| x - nearest);
    let dt = zip(d, t, |d, t| d * t);
    let dtt = zip(dt, t, |dt, t| dt * t);
    let dg = zip(d, dtt, |d, dtt| d - dtt);
    let cubic = zip(d, dg, |d, dg| TWO_THIRDS * d - dg);
    let cubic = zip(cubic, d, |cubic, d| cubic * d);
    let rest = zip(cubic, dt, |cubic, dt| cubic - dt);
    let rest = rest.map(|rest| 1.0 + rest);
    let step = zip(dg, rest, |dg, rest| dg * rest);
    zip(t, step, |t, step| t + step)
}

#[inline(always)]
fn zip<const N: usize>(a: [f32; N], b: [f32; N], f: impl Fn(f32, f32) -> f32) -> [f32; N] {
    let mut b = b.into_iter();
    a.map(|a| f(a, b.next().unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_stays_within_the_stated_bound_everywhere() {
        let mut worst = (0.0f64, 0.0f32);
        for i in -4_000_000..=4_000_000i32 {
            let x = i as f32 * 3e-6;
            let error = (f64::from(tanh(x)) - f64::from(x).tanh()).abs();
            if error > worst.0 {
                worst = (error, x);
            }
        }
        assert!(worst.0 < 2.8e-7, "{worst:?}");
    }

    #[test]
    fn tanh_is_odd_bounded_and_never_nan() {
        for x in [0.0, 1e-30, 0.031_25, 0.5, 9.0, 9.04, 50.0, f32::MAX, f32::INFINITY, f32::NAN] {
            let y = tanh(x);
            assert!(y.abs() <= 1.0, "{x}: {y}");
            assert_eq!(tanh(-x), -y, "{x}");
        }
    }
}

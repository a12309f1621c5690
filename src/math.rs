//! Square roots, powers, tangent and arc tangent with the same bits on host and chip.
//!
//! The functions use only additions, multiplications, divisions and square roots, which IEEE 754
//! rounds alike everywhere. The tests assert every error bound.
#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "a NaN must take the branch of too small values"
)]

/// Returns `x`, at least `low`; `low` for a NaN.
///
/// `f32::max` and `f32::min` are calls where the processor has no instructions for them.
#[must_use]
#[inline(always)]
pub fn at_least(x: f32, low: f32) -> f32 {
    if x > low { x } else { low }
}

/// Returns `x`, at most `high`; `high` for a NaN.
#[must_use]
#[inline(always)]
pub fn at_most(x: f32, high: f32) -> f32 {
    if x < high { x } else { high }
}

/// Returns the nearest positive normal number; the smallest for a negative NaN, the greatest for a
/// positive one.
#[inline]
fn normal(x: f32) -> f32 {
    // As integers, positive numbers have the same order, and a comparison takes half the time.
    const LEAST: i32 = f32::MIN_POSITIVE.to_bits() as i32;
    const MOST: i32 = f32::MAX.to_bits() as i32;
    f32::from_bits((x.to_bits() as i32).clamp(LEAST, MOST) as u32)
}

/// Returns 1/√x for a positive normal x, relative error below 5e-7, without a division.
///
/// The result is always finite: other arguments give the value for the nearest such number, a NaN
/// that of the smallest or the greatest. Root and division take 28 cycles of a Cortex-M4F, this
/// takes 20.
#[must_use]
#[inline]
pub fn inverse_sqrt(x: f32) -> f32 {
    let x = normal(x);
    let half = 0.5 * x;
    // Halving the exponent's bits is the classic start, 3.5 % off; each Newton step squares the
    // error.
    let mut root = f32::from_bits(0x5f37_59df - (x.to_bits() >> 1));
    for _ in 0..3 {
        root *= 1.5 - half * root * root;
    }
    root
}

/// Returns √x, rounded exactly; 0 for zero, negative and NaN arguments.
///
/// Infinity gives the root of the greatest number.
#[must_use]
#[inline]
pub fn sqrt(x: f32) -> f32 {
    const MOST: u32 = f32::MAX.to_bits();
    if x > 0.0 { taxel_dsp::sqrt(f32::from_bits(x.to_bits().min(MOST))) } else { 0.0 }
}

/// Returns ∛x, relative error below 1e-6; 0 for zero, negative and NaN arguments.
#[must_use]
#[inline(never)]
pub fn cube_root(x: f32) -> f32 {
    if !(x >= f32::MIN_POSITIVE) {
        return 0.0;
    }
    let x = normal(x);
    // A third of the exponent's bits is 5 % off at most; Newton steps on r³ = x follow.
    let mut root = f32::from_bits(x.to_bits() / 3 + 0x2a51_1cd0);
    for _ in 0..3 {
        root = (2.0 * root + x / (root * root)) * (1.0 / 3.0);
    }
    root
}

/// Returns x^p as 2^(p·log₂ x); 0 for zero, negative and NaN x.
///
/// The relative error is below 2e-5 for results between 1e-6 and 1e6. The result for a positive x
/// lies in [2⁻¹²⁶, 2¹²⁶].
#[must_use]
#[inline(never)]
pub fn power(x: f32, p: f32) -> f32 {
    if x > 0.0 { exp2(p * log2(x)) } else { 0.0 }
}

/// Returns log₂ of a positive number: its exponent plus atanh's series on the mantissa in [√½, √2).
fn log2(x: f32) -> f32 {
    let x = normal(x);
    let bits = x.to_bits();
    let shifted = bits.wrapping_sub(0x3f35_04f3);
    let exponent = (shifted as i32 >> 23) as f32;
    let mantissa = f32::from_bits((shifted & 0x007f_ffff) + 0x3f35_04f3);
    let t = (mantissa - 1.0) / (mantissa + 1.0);
    let t2 = t * t;
    // 2/ln 2 · (t + t³/3 + t⁵/5 + t⁷/7)
    exponent
        + (2.0 * core::f32::consts::LOG2_E)
            * t
            * (1.0 + t2 * (1.0 / 3.0 + t2 * (0.2 + t2 * (1.0 / 7.0))))
}

/// Returns 2^x, x clamped to [−126, 126], by Taylor's series of 2^f around the nearest integer, |f|
/// ≤ ½.
fn exp2(x: f32) -> f32 {
    let x = at_most(at_least(x, -126.0), 126.0);
    let whole = (x + if x < 0.0 { -0.5 } else { 0.5 }) as i32;
    let f = (x - whole as f32) * core::f32::consts::LN_2;
    let series = 1.0
        + f * (1.0
            + f * (0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0 + f * (1.0 / 120.0 + f / 720.0)))));
    // |whole| ≤ 126 keeps the exponent's field between 1 and 253.
    series * f32::from_bits(((whole + 127) as u32) << 23)
}

/// Returns tan x for 0 ≤ x ≤ ¼π, relative error below 3e-6, by four terms of its continued
/// fraction.
#[must_use]
#[inline]
pub fn tan(x: f32) -> f32 {
    let x2 = x * x;
    x / (1.0 - x2 / (3.0 - x2 / (5.0 - x2 / 7.0)))
}

/// Returns the angle of (x, y) from the x axis in radians, −π to π.
///
/// The absolute error is below 3e-6. The angle is 0 if either is NaN, if both are zero, and if both
/// are infinite.
///
/// Own code because `micromath`'s is off by up to 0.002 to 0.003 rad, more than the 0.1° allowed
/// for an inclination.
#[must_use]
pub fn atan2(y: f32, x: f32) -> f32 {
    use core::f32::consts::{FRAC_PI_2, PI};
    let (rise, run) = (y.abs(), x.abs());
    let steep = rise > run;
    let ratio = if steep { run / rise } else { rise / run };
    // NaN, and inputs without a direction.
    if !(0.0..=1.0).contains(&ratio) {
        return 0.0;
    }
    let (t, from) = if steep { (-ratio, FRAC_PI_2) } else { (ratio, 0.0) };
    // One half-angle step, atan t = 2 atan(t/(1 + √(1 + t²))), leaves |t| ≤ 0.4143 for the series.
    let t = t / (1.0 + sqrt(1.0 + t * t));
    let t2 = t * t;
    let series = t
        * (1.0
            - t2 * (1.0 / 3.0
                - t2 * (0.2 - t2 * (1.0 / 7.0 - t2 * (1.0 / 9.0 - t2 * (1.0 / 11.0))))));
    let angle = from + 2.0 * series;
    (if x.is_sign_negative() { PI - angle } else { angle }).copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positive numbers over the whole range of exponents, mantissas included.
    fn numbers() -> impl Iterator<Item = f32> {
        (0x0080_0000..0x7f00_0000u32).step_by(9973).map(f32::from_bits)
    }

    #[test]
    fn roots_are_exact_to_a_millionth() {
        for x in numbers() {
            let exact = f64::from(x);
            assert!((f64::from(inverse_sqrt(x)) * exact.sqrt() - 1.0).abs() < 5e-7, "{x:e}");
            assert_eq!(sqrt(x), x.sqrt(), "{x:e}");
            assert!((f64::from(cube_root(x)) / exact.cbrt() - 1.0).abs() < 1e-6, "{x:e}");
        }
    }

    #[test]
    fn powers_are_exact_to_2e_5() {
        for p in [-1.0f32, 0.2, 1.0 / 3.0, 0.5, 2.0] {
            for x in numbers().filter(|x| (1e-3..1e3).contains(x)) {
                let exact = f64::from(x).powf(f64::from(p));
                assert!((f64::from(power(x, p)) / exact - 1.0).abs() < 2e-5, "{x}^{p}");
            }
        }
    }

    #[test]
    fn arc_tangent_is_exact_to_3e_6() {
        let right = |y: f32, x: f32| {
            let exact = f64::from(y).atan2(f64::from(x));
            assert!((f64::from(atan2(y, x)) - exact).abs() < 3e-6, "{y:e} {x:e}");
        };
        for i in -400_000..=400_000i32 {
            let slope = i as f32 * 1e-4;
            right(slope, 1.0);
            right(slope, -1.0);
        }
        for i in 0..100_000 {
            let (y, x) = (i as f32 * 6.283_185e-5).sin_cos();
            for size in [1e-30, 1e-3, 1.0, 1e30] {
                right(size * y, size * x);
            }
        }
        for far in [1.0, 1e-20, f32::MIN_POSITIVE, f32::MAX, f32::INFINITY] {
            for near in [0.0, -0.0, 1e-38, 1.0] {
                for (y, x) in [(far, near), (-far, near), (near, far), (near, -far)] {
                    right(y, x);
                }
            }
        }
    }

    #[test]
    fn tangent_is_exact_to_3e_6_up_to_45_degrees() {
        for i in 1..=100_000 {
            let x = i as f32 * 1e-5 * core::f32::consts::FRAC_PI_4;
            let exact = f64::from(x).tan();
            assert!((f64::from(tan(x)) / exact - 1.0).abs() < 3e-6, "{x}");
        }
        assert_eq!(tan(0.0), 0.0);
    }

    /// Checks the figures of `docs/decisions/0013-micromath.md`; `--nocapture` prints them.
    #[test]
    fn micromath_is_exact_in_floor_and_trunc_only() {
        use micromath::F32Ext;
        for x in numbers().filter(|x| *x < 2e9).flat_map(|x| [x, -x]) {
            assert_eq!(F32Ext::floor(x), x.floor(), "{x:e}");
            assert_eq!(F32Ext::trunc(x), x.trunc(), "{x:e}");
            assert_eq!(F32Ext::copysign(1.5, x), 1.5f32.copysign(x), "{x:e}");
        }
        assert_ne!(
            F32Ext::round(0.5 - f32::EPSILON / 4.0),
            0.0,
            "it adds a half, which is rounded"
        );
        assert_ne!(F32Ext::round(8_388_609.0), 8_388_609.0, "and again where no fraction is left");
        let worst = |name: &str, least: f64, errors: &mut dyn Iterator<Item = f64>| {
            let worst = errors.fold(0.0, |worst: f64, error| worst.max(error.abs()));
            std::println!("{name:8} {worst:.2e}");
            assert!(worst > least, "{name} is good enough by now: {worst:e}");
        };
        let span =
            |from: f32, to: f32| (1..100_000).map(move |i| from + (to - from) * (i as f32 * 1e-5));
        let relative = |found: f32, exact: f64| f64::from(found) / exact - 1.0;
        let roots = || numbers().filter(|x| (1e-6..1e6).contains(x));
        worst("sqrt", 6e-7, &mut roots().map(|x| relative(F32Ext::sqrt(x), f64::from(x).sqrt())));
        worst(
            "invsqrt",
            5e-7,
            &mut roots().map(|x| relative(F32Ext::invsqrt(x), f64::from(x).sqrt().recip())),
        );
        worst(
            "powf",
            2e-5,
            &mut roots()
                .map(|x| relative(F32Ext::powf(x, 0.3), f64::from(x).powf(f64::from(0.3f32)))),
        );
        worst(
            "tan",
            3e-6,
            &mut span(0.0, core::f32::consts::FRAC_PI_4)
                .map(|x| relative(F32Ext::tan(x), f64::from(x).tan())),
        );
        worst(
            "exp",
            1e-6,
            &mut span(-8.0, 8.0).map(|x| relative(F32Ext::exp(x), f64::from(x).exp())),
        );
        worst(
            "atan2",
            3e-6,
            &mut span(-3.2, 3.2).map(|turn| {
                let (y, x) = turn.sin_cos();
                f64::from(F32Ext::atan2(y, x)) - f64::from(y).atan2(f64::from(x))
            }),
        );
    }

    #[test]
    fn angle_is_0_without_direction() {
        for (y, x) in [(0.0, 0.0), (f32::NAN, 1.0), (1.0, f32::NAN), (f32::INFINITY, f32::INFINITY)]
        {
            assert_eq!(atan2(y, x), 0.0, "{y} {x}");
        }
    }

    #[test]
    fn results_are_finite_for_any_argument() {
        let odd = [0.0, -1.0, 1e-45, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        for x in odd {
            for y in [inverse_sqrt(x), sqrt(x), cube_root(x)] {
                assert!(y.is_finite(), "{x}: {y}");
            }
            for p in odd {
                assert!(power(x, p).is_finite(), "{x}^{p}");
                assert!(atan2(x, p).is_finite(), "{x} over {p}");
            }
        }
    }
}

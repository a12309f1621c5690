//! Steps of the net, and the square root, on any processor.
//!
//! Within a record's bounds nothing overflows. Beyond them nothing panics, and both forms wrap
//! alike.

use crate::tanh::whole_tanh;
use crate::{Group, Input, Lanes, OUTPUTS, Rows, word};

/// Activations h = tanh(W·x + a) of four hidden units.
#[must_use]
pub fn activations(group: &Group, input: &Input) -> [u32; 2] {
    let sums = sums(&group.weights, &input.x, group.bias);
    let [a, b, c, d] = sums.map(|sum| whole_tanh(sum >> input.shift.min(31)));
    [word([a, b]), word([c, d])]
}

/// Output sums plus V·h, or plus L·x.
#[must_use]
pub fn sums_of_outputs(rows: &Rows<OUTPUTS>, h: &Lanes, sums: [i32; OUTPUTS]) -> [i32; OUTPUTS] {
    self::sums(rows, h, sums)
}

fn sums<const N: usize>(Rows(weights): &Rows<N>, x: &Lanes, mut sums: [i32; N]) -> [i32; N] {
    for (weights, x) in weights.iter().zip(x) {
        for (sum, weights) in sums.iter_mut().zip(weights) {
            for (w, x) in weights.iter().zip(x) {
                let low = i32::from(*w as i16) * i32::from(*x as i16);
                let high = (*w as i32 >> 16) * (*x as i32 >> 16);
                *sum = sum.wrapping_add(low).wrapping_add(high);
            }
        }
    }
    sums
}

/// Scales eight signals, rounds towards zero and clips to 16 bits; a NaN becomes 0.
#[must_use]
pub fn narrowed(c: &[f32; 8], scale: f32) -> [[u32; 2]; 2] {
    let clipped = |x: i32| x.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16;
    let [a, b, c, d, e, f, g, h] = c.map(|c| clipped((c * scale) as i32));
    [[word([a, b]), word([c, d])], [word([e, f]), word([g, h])]]
}

/// Square root of a positive finite number, rounded to nearest.
#[must_use]
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "core has no square root")]
pub fn sqrt(x: f32) -> f32 {
    use core::arch::x86_64::{_mm_cvtss_f32, _mm_set_ss, _mm_sqrt_ss};
    // SAFETY: these are instructions of SSE, which every x86-64 has.
    unsafe { _mm_cvtss_f32(_mm_sqrt_ss(_mm_set_ss(x))) }
}

#[cfg(not(target_arch = "x86_64"))]
pub use self::sqrt_of_integers as sqrt;

/// Square root from that of an integer, on any processor.
#[must_use]
#[cfg(any(test, not(target_arch = "x86_64")))]
pub fn sqrt_of_integers(x: f32) -> f32 {
    const MANTISSA: u32 = (1 << 23) - 1;
    let (fraction, exponent) = (x.to_bits() & MANTISSA, (x.to_bits() >> 23) as i32);
    // x = m·2^e with 24 bits of m.
    let (m, e) = if exponent == 0 {
        let up = fraction.leading_zeros().saturating_sub(8).min(23);
        (fraction << up, -149 - up as i32)
    } else {
        (fraction | (MANTISSA + 1), exponent - 150)
    };
    // The radicand has 49 bits and an odd exponent, or 50 and an even one, so that its root has 25:
    // one more than the result. A root of 25 bits whose last is set is never exact, so that this
    // bit alone decides the rounding.
    let shift = 26 - (e & 1);
    let root = (u64::from(m) << shift).isqrt();
    let scale = ((e - shift) / 2 + 1 + 127).clamp(1, 254);
    root.div_ceil(2) as f32 * f32::from_bits((scale as u32) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn square_root_is_rounded_exactly() {
        for bits in (1..f32::INFINITY.to_bits()).step_by(1009).chain(1..10_000) {
            let x = f32::from_bits(bits);
            for root in [sqrt(x), sqrt_of_integers(x)] {
                assert_eq!(root.to_bits(), x.sqrt().to_bits(), "{x:e}");
            }
        }
    }
}

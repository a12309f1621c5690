//! Random numbers of the tests.

/// Noise with a standard deviation of one: twelve numbers of a multiplicative generator.
pub fn noise(state: &mut u32) -> f32 {
    let mut uniform = || {
        *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (*state >> 8) as f32 / (1 << 24) as f32
    };
    (0..12).map(|_| uniform()).sum::<f32>() - 6.0
}

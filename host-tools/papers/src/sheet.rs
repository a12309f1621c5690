//! Sheet of 10×12 conical [feelers](crate::feeler) ([Ohka2005] section 4).

/// Feelers along x and along y.
pub const SIZE: [usize; 2] = [10, 12];
/// Number of feelers.
pub const FEELERS: usize = SIZE[0] * SIZE[1];
/// Distance of the feelers in mm.
pub const PITCH_MM: f64 = 0.6;

/// Computes the position of a feeler's tip in mm; feelers are numbered row by row from −y.
#[must_use]
pub fn centre(feeler: usize) -> [f64; 2] {
    let along = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * PITCH_MM;
    [along(feeler % SIZE[0], SIZE[0]), along(feeler / SIZE[0] % SIZE[1], SIZE[1])]
}

//! Contact point of a single contact by the methods of [DeMaria2011].
//!
//! The paper's section is "Calibration of the 4 × 4 taxel sensor prototype".

use serde::{Deserialize, Serialize};

use super::ContactPoint;
use crate::measured::{Measured, NoValue};
use crate::scan::{CENTRES, COLS, TAXEL_CENTRES, TAXELS};
use crate::units::Millimetres;

/// Method of computing the contact point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PointMethod {
    /// 0: centroid of the taxels that came nearer ([DeMaria2011] eqs (8)–(9)).
    #[cfg_attr(not(feature = "model"), default)]
    Centroid,
    /// 1: centre of the taxel that came nearest ([DeMaria2011] eq. (7)).
    ArgMin,
    /// 2: skin model of the record (see [`super::inverse`]); the centroid if it has none. The model
    /// then gives the force, too. With the other methods the net gives the force if the record has
    /// one.
    #[cfg_attr(feature = "model", default)]
    Model,
}

impl PointMethod {
    /// Returns whether this build contains the method.
    #[must_use]
    pub const fn is_built(self) -> bool {
        !matches!(self, Self::Model) || cfg!(feature = "model")
    }
}

/// Returns the centre of the taxel with the most negative c_k ([DeMaria2011] eq. (7)).
///
/// Only taxels whose bit in `skip` is clear count. The result is discrete: its error is up to half
/// a pitch in x and in y.
///
/// # Errors
/// [`NoValue::IllConditioned`] if no taxel came nearer.
pub fn arg_min(c: &[f32; TAXELS], skip: u16) -> Measured<ContactPoint> {
    let mut nearest: Option<(f32, usize)> = None;
    for (k, c) in c.iter().enumerate() {
        if skip >> k & 1 == 0 && *c < nearest.map_or(0.0, |(least, _)| least) {
            nearest = Some((*c, k));
        }
    }
    nearest
        .and_then(|(_, k)| TAXEL_CENTRES.get(k))
        .map(|[x, y]| ContactPoint { x: *x, y: *y })
        .ok_or(NoValue::IllConditioned)
}

/// Returns the centroid Σ x_k c_k / Σ c_k of the taxels with c_k < 0.
///
/// The equations are [DeMaria2011] eqs (8)–(9). Only taxels whose bit in `skip` is clear count.
/// Near the edge of the pad, which cuts off the contact's field, the method draws the centroid
/// towards the middle.
///
/// # Errors
/// [`NoValue::IllConditioned`] if the weights sum to less than `least`: the quotient would be
/// noise.
#[inline(always)]
pub fn centroid(c: &[f32; TAXELS], skip: u16, least: f32) -> Measured<ContactPoint> {
    let sound;
    let c = if skip == 0 {
        c
    } else {
        sound = without(c, skip);
        &sound
    };
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (row, row_y) in c.as_chunks::<COLS>().0.iter().zip(&CENTRES) {
        for (c, column_x) in row.iter().zip(&CENTRES) {
            // The sign bit masks the value: a taxel that is not nearer counts as zero, without a
            // branch.
            let nearer = f32::from_bits(c.to_bits() & (c.to_bits() as i32 >> 31) as u32);
            sum -= nearer;
            x -= nearer * column_x.0;
            y -= nearer * row_y.0;
        }
    }
    if sum > least && sum > f32::MIN_POSITIVE {
        Ok(ContactPoint { x: Millimetres(x / sum), y: Millimetres(y / sum) })
    } else {
        Err(NoValue::IllConditioned)
    }
}

/// Returns the signals with zeros where the bit in `skip` is set.
#[cold]
#[inline(never)]
fn without(c: &[f32; TAXELS], skip: u16) -> [f32; TAXELS] {
    let mut c = *c;
    for (k, c) in c.iter_mut().enumerate() {
        if skip >> k & 1 == 1 {
            *c = 0.0;
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centroid_lies_between_two_equally_pressed_taxels() {
        let mut c = [0.0; TAXELS];
        c[5] = -0.1;
        c[6] = -0.1;
        assert_eq!(
            centroid(&c, 0, 1e-3),
            Ok(ContactPoint { x: Millimetres(0.0), y: Millimetres(-1.25) })
        );
    }

    #[test]
    fn rising_taxels_do_not_pull_the_centroid() {
        let mut c = [0.05; TAXELS];
        c[0] = -0.1;
        assert_eq!(centroid(&c, 0, 1e-3), arg_min(&c, 0));
        assert_eq!(
            arg_min(&c, 0),
            Ok(ContactPoint { x: Millimetres(-3.75), y: Millimetres(-3.75) })
        );
    }

    #[test]
    fn skipped_taxel_is_not_the_contact() {
        let mut c = [0.0; TAXELS];
        c[3] = -0.9;
        c[12] = -0.1;
        let corner = ContactPoint { x: Millimetres(-3.75), y: Millimetres(3.75) };
        assert_eq!(arg_min(&c, 1 << 3), Ok(corner));
        assert_eq!(centroid(&c, 1 << 3, 1e-3), Ok(corner));
    }

    #[test]
    fn no_nearer_taxel_gives_a_reason() {
        assert_eq!(arg_min(&[0.0; TAXELS], 0), Err(NoValue::IllConditioned));
        assert_eq!(centroid(&[0.1; TAXELS], 0, 1e-3), Err(NoValue::IllConditioned));
    }
}

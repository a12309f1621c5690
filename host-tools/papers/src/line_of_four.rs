//! Four taxels in a row, without force sensors ([DeMaria2011], figs 5 and 8).
//!
//! Odd polynomials of four displacements give the contact position along the row and the angle of
//! the force.
//!
//! The paper prints no dimensions. It states the contacts (0.2 N, p from −3 to 3 mm, angles from
//! 30° to 150°) and a correlation of −0.68 between s and t, eqs (3) and (4). A pitch of 7.5 mm
//! under 4 mm of silicone with facets of 4 mm gives −0.69. It leaves walls between LEDs in cans of
//! 5.5 mm. The finger's own pitch of 2.5 mm gives +0.95, at which s and t hardly distinguish p from
//! the angle.

use taxel::scan::COLS;

/// Distance of the taxels in mm.
pub const PITCH_MM: f64 = 7.5;

/// Centres of the facets in mm, from left to right.
pub const CENTRES: [[f64; 2]; COLS] =
    [[-1.5 * PITCH_MM, 0.0], [-0.5 * PITCH_MM, 0.0], [0.5 * PITCH_MM, 0.0], [1.5 * PITCH_MM, 0.0]];

/// Coefficients a_1 … a_8 and b_1 … b_8 of [DeMaria2011] eqs (5), (6).
///
/// They belong to s, t, st², s²t, s³, t³, s⁵, t⁵.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePolynomials {
    /// a: the contact point p in mm.
    pub point: [f32; 8],
    /// b: the angle θ − 90° in degrees.
    pub angle: [f32; 8],
}

impl LinePolynomials {
    /// Computes p in mm from the middle of the row and θ in degrees from the skin.
    ///
    /// θ is 90 for a normal force. `u` are the displacements of the four facets.
    #[must_use]
    pub fn contact(&self, u: [f32; 4]) -> (f32, f32) {
        let terms = terms(u);
        let sum =
            |weights: &[f32; 8]| weights.iter().zip(&terms).fold(0.0, |sum, (w, t)| sum + w * t);
        (sum(&self.point), 90.0 + sum(&self.angle))
    }
}

/// Computes s (3), t (4) and their odd products, in the order of eqs (5), (6).
///
/// s = −1.5u_1 − 0.5u_2 + 0.5u_3 + 1.5u_4 and t = u_1u_3 − u_2u_4.
#[must_use]
pub fn terms([u1, u2, u3, u4]: [f32; 4]) -> [f32; 8] {
    let s = -1.5 * u1 - 0.5 * u2 + 0.5 * u3 + 1.5 * u4;
    let t = u1 * u3 - u2 * u4;
    let (s2, t2) = (s * s, t * t);
    [s, t, s * t2, s2 * t, s * s2, t * t2, s * s2 * s2, t * t2 * t2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Weights as large as a record may hold, displacements as large as a difference of levels.
        #[test]
        fn contact_is_finite_for_any_input(
            point in proptest::array::uniform8(prop_oneof![-1e30..1e30f32, Just(1e30f32)]),
            angle in proptest::array::uniform8(prop_oneof![-1e30..1e30f32, Just(-1e30f32)]),
            u in proptest::array::uniform4(prop_oneof![-2.0..2.0f32, Just(-2.0f32), Just(2.0f32)]),
        ) {
            let (p, theta) = LinePolynomials { point, angle }.contact(u);
            prop_assert!(p.is_finite() && theta.is_finite(), "{p} {theta}");
        }
    }

    #[test]
    fn mirrored_contact_mirrors_the_result() {
        let row = LinePolynomials {
            point: [2.0, -30.0, 500.0, 70.0, -8.0, 900.0, 11.0, -5e4],
            angle: [50.0, 400.0, -900.0, 30.0, -90.0, 7.0, 40.0, 1e4],
        };
        let u = [0.05, 0.12, 0.2, 0.08];
        let (p, theta) = row.contact(u);
        // From the other end, s and t only change their signs.
        let (q, phi) = row.contact([u[3], u[2], u[1], u[0]]);
        assert!((p + q).abs() < 1e-5 && (theta - 90.0 + phi - 90.0).abs() < 1e-4);
        assert_eq!(row.contact([0.0; 4]), (0.0, 90.0));
    }

    #[test]
    fn terms_match_the_paper() {
        let [s, t, st2, s2t, s3, t3, s5, t5] = terms([1.0, 0.5, 0.25, 2.0]);
        assert_eq!((s, t), (-1.5 - 0.25 + 0.125 + 3.0, 0.25 - 1.0));
        assert_eq!((st2, s2t, s3, t3), (s * t * t, s * s * t, s * s * s, t * t * t));
        assert_eq!((s5, t5), (s * s * s * s * s, t * t * t * t * t));
    }
}

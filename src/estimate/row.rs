//! The 4×1 prototype of 002: contact point along the row and angle of the force out of four displacements,
//! by odd polynomials.

/// a_1 … a_8 and b_1 … b_8 of 002 eqs (5), (6): coefficients of s, t, st², s²t, s³, t³, s⁵, t⁵.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPolynomials {
    /// a: the contact point p in mm.
    pub point: [f32; 8],
    /// b: the angle θ − 90° in degrees.
    pub angle: [f32; 8],
}

impl RowPolynomials {
    /// p in mm from the middle of the row and θ in degrees from the skin, 90 for a normal force, for the
    /// four displacements of the facets.
    #[must_use]
    pub fn contact(&self, u: [f32; 4]) -> (f32, f32) {
        let terms = terms(u);
        let sum =
            |weights: &[f32; 8]| weights.iter().zip(&terms).fold(0.0, |sum, (w, t)| sum + w * t);
        (sum(&self.point), 90.0 + sum(&self.angle))
    }
}

/// s = −1.5u_1 − 0.5u_2 + 0.5u_3 + 1.5u_4 (3), t = u_1u_3 − u_2u_4 (4) and their odd products, in the order
/// of (5), (6).
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
        /// Weights as large as any that a record may hold, displacements as large as any difference of levels.
        #[test]
        fn no_displacements_and_no_weights_give_nan_or_infinity(
            point in proptest::array::uniform8(prop_oneof![-1e30..1e30f32, Just(1e30f32)]),
            angle in proptest::array::uniform8(prop_oneof![-1e30..1e30f32, Just(-1e30f32)]),
            u in proptest::array::uniform4(prop_oneof![-2.0..2.0f32, Just(-2.0f32), Just(2.0f32)]),
        ) {
            let (p, theta) = RowPolynomials { point, angle }.contact(u);
            prop_assert!(p.is_finite() && theta.is_finite(), "{p} {theta}");
        }
    }

    #[test]
    fn a_mirrored_touch_is_a_mirrored_answer() {
        let row = RowPolynomials {
            point: [2.0, -30.0, 500.0, 70.0, -8.0, 900.0, 11.0, -5e4],
            angle: [50.0, 400.0, -900.0, 30.0, -90.0, 7.0, 40.0, 1e4],
        };
        let u = [0.05, 0.12, 0.2, 0.08];
        let (p, theta) = row.contact(u);
        // Read from the other end: s and t change their signs only.
        let (q, phi) = row.contact([u[3], u[2], u[1], u[0]]);
        assert!((p + q).abs() < 1e-5 && (theta - 90.0 + phi - 90.0).abs() < 1e-4);
        assert_eq!(row.contact([0.0; 4]), (0.0, 90.0));
    }

    #[test]
    fn terms_are_the_papers() {
        let [s, t, st2, s2t, s3, t3, s5, t5] = terms([1.0, 0.5, 0.25, 2.0]);
        assert_eq!((s, t), (-1.5 - 0.25 + 0.125 + 3.0, 0.25 - 1.0));
        assert_eq!((st2, s2t, s3, t3), (s * t * t, s * s * t, s * s * s, t * t * t));
        assert_eq!((s5, t5), (s * s * s * s * s, t * t * t * t * t));
    }
}

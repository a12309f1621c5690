//! Displacement of each facet by one contact: the forward model of the skin.
//!
//! The model follows [TactileEnc] and Johnson, *Contact Mechanics*, §3.2, §3.6. Calibration fits
//! its coefficients.
//!
//! A contact of force (f_x, f_y, f_z) at p moves the facet at p + d by
//!
//! u = f_z·N(d²) + (f_x d_x + f_y d_y)·T(d²).
//!
//! On a half-space with ν = ½ a point load has N ∝ 1/ρ + z²/ρ³ and T ∝ z/ρ³, ρ² = d² + z². Finite
//! sizes of contact and facet smear that, and a layer on a rigid floor cuts it off. A depth that
//! grows with the contact's area and a few higher multipoles account for both:
//!
//! N = 1/ρ·P(w), T = 1/ρ³·P′(w), w = D/ρ², ρ² = d² + D, D = D₀ + D₁s², s = f_z^⅓.
//!
//! P and P′ are cubic in w with coefficients quadratic in s², because by Hertz the contact's area
//! grows like s². Under shear the contact slips in a ring from its rim inwards (Cattaneo, Mindlin;
//! Johnson §7.2), which narrows the traction. T therefore uses the area s²·(1 + e·b), where b is
//! the friction utilisation.

use serde::{Deserialize, Serialize};

use crate::math::inverse_sqrt;
use crate::scan::TAXELS;

/// Number of powers of w.
pub(crate) const TERMS: usize = 4;
/// Least D in mm²: a contact is at least half a millimetre away from a facet.
const LEAST_DEPTH: f32 = 0.3;

/// Function of the distance from the contact, for any size of the contact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Radial {
    /// D₀ in mm², and D₁ in mm² per unit of s².
    pub depth: [f32; 2],
    /// Coefficients of 1, s², s⁴ for each power of w.
    pub terms: [[f32; 3]; TERMS],
}

/// Displacement field of one finger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Field {
    /// Function N. With ρ in mm and forces in newtons, u is in the calibration's own length.
    pub normal: Radial,
    /// Function T.
    pub shear: Radial,
    /// Coefficient e: relative change of the sheared area at full slip.
    pub slip: f32,
}

/// A contact in the unknowns of the field.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Shear force f_x, f_y in newtons.
    pub shear: [f32; 2],
    /// Contact size s, the cube root of f_z in newtons.
    pub size: f32,
    /// Contact position p in mm.
    pub point: [f32; 2],
    /// Friction utilisation b.
    pub used: f32,
}

impl Load {
    /// Returns the normal force f_z = s³ in newtons.
    #[must_use]
    pub fn normal(&self) -> f32 {
        self.size * self.size * self.size
    }
}

/// A radial function at one contact size.
#[derive(Clone, Copy)]
struct AtSize {
    depth: f32,
    depth_slope: f32,
    terms: [f32; TERMS],
    /// Derivatives of `terms` by s².
    slopes: [f32; TERMS],
}

/// A value and its derivatives by d² and by s².
#[derive(Clone, Copy, Default)]
struct Local {
    value: f32,
    by_distance: f32,
    by_size: f32,
}

impl Radial {
    fn at(&self, size2: f32) -> AtSize {
        let [deep, grows] = self.depth;
        let depth = deep + grows * size2;
        let deep_enough = depth > LEAST_DEPTH;
        AtSize {
            depth: if deep_enough { depth } else { LEAST_DEPTH },
            depth_slope: if deep_enough { grows } else { 0.0 },
            terms: self.terms.map(|[a, b, c]| a + size2 * (b + size2 * c)),
            slopes: self.terms.map(|[_, b, c]| b + 2.0 * size2 * c),
        }
    }
}

impl AtSize {
    /// Returns ρ⁻², w and ρ^(−2·`half`).
    #[inline(always)]
    fn powers(&self, distance2: f32, half: f32) -> (f32, f32, f32) {
        let inverse = inverse_sqrt(distance2 + self.depth);
        let inverse2 = inverse * inverse;
        let lead = if half > 1.0 { inverse * inverse2 } else { inverse };
        (inverse2, self.depth * inverse2, lead)
    }

    /// Returns the value of [`Self::local`] alone.
    #[inline(always)]
    fn value(&self, distance2: f32, half: f32) -> f32 {
        let (_, w, lead) = self.powers(distance2, half);
        let [a, b, c, d] = self.terms;
        lead * (a + w * (b + w * (c + w * d)))
    }

    /// Returns P(w)/ρ^(2·`half`), where `half` is ½ for N and 3/2 for T.
    fn local(&self, distance2: f32, half: f32) -> Local {
        let (inverse2, w, lead) = self.powers(distance2, half);
        let [a, b, c, d] = self.terms;
        let p = a + w * (b + w * (c + w * d));
        let slope = b + w * (2.0 * c + w * (3.0 * d));
        let [a, b, c, d] = self.slopes;
        let grows = a + w * (b + w * (c + w * d));
        let lead2 = lead * inverse2;
        Local {
            value: lead * p,
            by_distance: -lead2 * (half * p + w * slope),
            by_size: lead2 * ((1.0 - w) * slope - half * p) * self.depth_slope + lead * grows,
        }
    }
}

/// Field of one contact: values and derivatives at any facet.
pub struct Around<'l> {
    load: &'l Load,
    normal: AtSize,
    shear: AtSize,
    /// Derivatives of s²(1 + e b), by s² and by b.
    area: [f32; 2],
}

impl Field {
    /// Returns the field of the contact `load`.
    #[must_use]
    pub fn around<'l>(&self, load: &'l Load) -> Around<'l> {
        let size2 = load.size * load.size;
        let narrowed = (1.0 + self.slip * load.used).max(0.0);
        Around {
            load,
            normal: self.normal.at(size2),
            shear: self.shear.at(size2 * narrowed),
            area: [narrowed, size2 * self.slip],
        }
    }
}

impl Around<'_> {
    /// Subtracts this contact from the displacements `left` of the `facets` (mm), with its shear or
    /// without.
    #[inline(never)]
    pub fn subtract(&self, left: &mut [f32; TAXELS], facets: &[[f32; 2]; TAXELS], sheared: bool) {
        let ([px, py], [fx, fy]) = (self.load.point, self.load.shear);
        let fz = self.load.normal();
        for (left, [x, y]) in left.iter_mut().zip(facets) {
            let [dx, dy] = [x - px, y - py];
            let distance2 = dx * dx + dy * dy;
            let mut u = fz * self.normal.value(distance2, 0.5);
            if sheared {
                u += (fx * dx + fy * dy) * self.shear.value(distance2, 1.5);
            }
            *left -= u;
        }
    }

    /// Returns u of the facet at `facet` (mm) and its derivatives by s, x, y, without shear.
    #[must_use]
    #[inline(never)]
    pub fn pressed(&self, facet: [f32; 2]) -> (f32, [f32; 3]) {
        let load = self.load;
        let [dx, dy] = [facet[0] - load.point[0], facet[1] - load.point[1]];
        let fz = load.normal();
        let n = self.normal.local(dx * dx + dy * dy, 0.5);
        let falls = -2.0 * fz * n.by_distance;
        let by_size = load.size * (3.0 * load.size * n.value + 2.0 * fz * n.by_size);
        (fz * n.value, [by_size, falls * dx, falls * dy])
    }

    /// Returns u of the facet at `facet` (mm) and its derivatives by f_x, f_y, s, x, y, b.
    #[must_use]
    pub fn sheared(&self, facet: [f32; 2]) -> (f32, [f32; 6]) {
        let load = self.load;
        let ([dx, dy], [fx, fy]) =
            ([facet[0] - load.point[0], facet[1] - load.point[1]], load.shear);
        let distance2 = dx * dx + dy * dy;
        let (u, [by_size, by_x, by_y]) = self.pressed(facet);
        let t = self.shear.local(distance2, 1.5);
        let along = fx * dx + fy * dy;
        let falls = 2.0 * along * t.by_distance;
        let [narrowed, by_used] = self.area;
        (
            u + along * t.value,
            [
                dx * t.value,
                dy * t.value,
                by_size + 2.0 * load.size * along * t.by_size * narrowed,
                by_x - fx * t.value - falls * dx,
                by_y - fy * t.value - falls * dy,
                along * t.by_size * by_used,
            ],
        )
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Field of a point load on a half-space of ν = ½, 2.5 mm deep, blunter with more force.
    pub(crate) const HALF_SPACE: Field = Field {
        normal: Radial {
            depth: [6.25, 2.0],
            terms: [[1.0, 0.0, 0.0], [1.0, -0.1, 0.02], [0.0, 0.05, 0.0], [0.0; 3]],
        },
        shear: Radial {
            depth: [6.25, 3.0],
            terms: [[2.5, 0.1, 0.0], [0.0, 0.3, 0.0], [0.0; 3], [0.0; 3]],
        },
        slip: -0.4,
    };

    #[test]
    fn point_load_on_half_space_matches_johnson() {
        let field = Field {
            normal: Radial {
                depth: [6.25, 0.0],
                terms: [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]],
            },
            shear: Radial {
                depth: [6.25, 0.0],
                terms: [[2.5, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0; 3]],
            },
            slip: 0.0,
        };
        let load = Load { shear: [0.3, -0.2], size: 1.1, point: [0.4, 0.1], used: 0.0 };
        for facet in [[0.0, 0.0], [3.75, -1.25], [-3.75, 3.75]] {
            let (dx, dy, z) = (facet[0] - 0.4, facet[1] - 0.1, 2.5f32);
            let rho = (dx * dx + dy * dy + z * z).sqrt();
            let fz = load.normal();
            let exact =
                fz * (z * z / rho.powi(3) + 1.0 / rho) + (0.3 * dx - 0.2 * dy) * z / rho.powi(3);
            let (u, _) = field.around(&load).sheared(facet);
            assert!((u - exact).abs() < 1e-5, "{u} {exact}");
        }
    }

    proptest! {
        #[test]
        fn derivatives_match_finite_differences(
            fx in -1.0..1.0f32, fy in -1.0..1.0f32, size in 0.4..1.3f32,
            x in -4.0..4.0f32, y in -4.0..4.0f32, used in 0.0..1.0f32,
            at in prop_oneof![Just([-3.75f32, 1.25]), Just([1.25, 3.75])],
        ) {
            let load = Load { shear: [fx, fy], size, point: [x, y], used };
            let u = |change: [f32; 6]| {
                let [fx, fy, s, x, y, b] = change;
                let load = Load {
                    shear: [load.shear[0] + fx, load.shear[1] + fy],
                    size: load.size + s,
                    point: [load.point[0] + x, load.point[1] + y],
                    used: load.used + b,
                };
                f64::from(HALF_SPACE.around(&load).sheared(at).0)
            };
            let (_, row) = HALF_SPACE.around(&load).sheared(at);
            for (i, found) in row.iter().enumerate() {
                let step = |h: f32| { let mut change = [0.0; 6]; change[i] = h; u(change) };
                let slope = (step(0.01) - step(-0.01)) / 0.02;
                prop_assert!((f64::from(*found) - slope).abs() < 2e-3, "{i}: {found} {slope}");
            }
            let still = Load { shear: [0.0; 2], ..load };
            let (pressed, _) = HALF_SPACE.around(&still).pressed(at);
            prop_assert!((pressed - HALF_SPACE.around(&still).sheared(at).0).abs() < 1e-6);
        }
    }
}

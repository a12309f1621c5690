//! Long indenters in plane strain, in closed form: line, flat block and cylinder of [TactileEnc].
//!
//! With w = z + ix and F(w) = ∫ p(s) ds/(w − is), a normal traction p makes (the line load
//! superposed; Johnson §2.3)
//!
//! σ_zz = −(Re F − z Re F′)/π, σ_xx = −(Re F + z Re F′)/π,
//!
//! and F is P/w for the line, P/√(w² + a²) for the block, (2P/a²)(√(w² + a²) − w) for the cylinder.
//! In the polar terms of [TactileEnc], √(w² + a²) is r₁₂ e^{iθ₁₂}.
//!
//! Where [TactileEnc] prints something else, the tests below show which is right:
//! - its ε_zz of line and block leaves σ_yy out, which is Hooke's law of plane stress, although
//!   both are named plane strain; under the line that is a third too much;
//! - its σ_zz of the cylinder gives half the pressure at the surface and *tension* deep below it.

use core::f64::consts::PI;

use super::HalfSpace;

/// Traction across a strip that runs along y and is centred at x = 0; forces in N/mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Strip {
    /// A line load: normal, and tangential along x.
    Line {
        /// Normal force P.
        normal: f64,
        /// Tangential force Q.
        tangential: f64,
    },
    /// A rigid flat block without friction.
    Block {
        /// Normal force P.
        normal: f64,
        /// Half the block's width in mm.
        half_width: f64,
    },
    /// A rigid cylinder without friction; [`HalfSpace::contact_half_width`].
    Cylinder {
        /// Normal force P.
        normal: f64,
        /// Half the width of contact in mm.
        half_width: f64,
    },
}

impl Strip {
    /// σ_zz in MPa at x, z (mm).
    #[must_use]
    pub fn stress(&self, x: f64, z: f64) -> f64 {
        self.stresses(x, z).0
    }

    /// ε_zz at x, z (mm) in plane strain: (1 + ν)((1 − ν) σ_zz − ν σ_xx)/E.
    #[must_use]
    pub fn strain(&self, skin: &HalfSpace, x: f64, z: f64) -> f64 {
        let (along_z, along_x) = self.stresses(x, z);
        skin.strain_of(along_z, (1.0 + skin.poisson()) * (along_z + along_x))
    }

    /// σ_zz and σ_xx in MPa.
    fn stresses(&self, x: f64, z: f64) -> (f64, f64) {
        let w = Complex(z, x);
        let (f, slope) = match *self {
            Self::Line { normal, tangential } => {
                // The field is all radial: −2(Pz + Qx)/πr² ([TactileEnc]; Johnson §2.3).
                let square = w.square().modulus();
                let radial = -2.0 * (normal * z + tangential * x) / (PI * square);
                return (radial * z * z / square, radial * x * x / square);
            }
            Self::Block { normal, half_width } => {
                let root = w.root_with(half_width);
                let inverse = root.inverse();
                (inverse.0 * normal, -(w * inverse * inverse * inverse).0 * normal)
            }
            Self::Cylinder { normal, half_width } => {
                let root = w.root_with(half_width);
                let scale = 2.0 * normal / (half_width * half_width);
                (scale * (root.0 - z), scale * ((w * root.inverse()).0 - 1.0))
            }
        };
        (-(f - z * slope) / PI, -(f + z * slope) / PI)
    }
}

/// Complex number: real and imaginary part.
#[derive(Clone, Copy)]
struct Complex(f64, f64);

impl core::ops::Mul for Complex {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }
}

impl Complex {
    fn square(self) -> Self {
        self * self
    }

    fn modulus(self) -> f64 {
        self.0.hypot(self.1)
    }

    fn inverse(self) -> Self {
        let square = self.0 * self.0 + self.1 * self.1;
        Self(self.0 / square, -self.1 / square)
    }

    /// √(w² + a²) on the branch that behaves like w at infinity, for Re w ≥ 0.
    fn root_with(self, a: f64) -> Self {
        let Self(re, im) = self.square();
        let (re, im) = (re + a * a, im);
        let modulus = re.hypot(im);
        let root = ((modulus + re) / 2.0).max(0.0).sqrt();
        Self(root, ((modulus - re) / 2.0).max(0.0).sqrt().copysign(self.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SKIN: (f64, f64) = (0.236, 0.5);
    const A: f64 = 1.3;
    /// On axis, under the rim, outside, shallow and deep.
    const PLACES: [[f64; 2]; 6] =
        [[0.0, 0.4], [0.0, 2.5], [1.3, 0.6], [-0.8, 1.1], [3.0, 1.0], [2.0, 9.0]];

    #[test]
    fn deep_plane_carries_the_whole_force() {
        for strip in [
            Strip::Line { normal: 1.0, tangential: 0.0 },
            Strip::Block { normal: 1.0, half_width: A },
            Strip::Cylinder { normal: 1.0, half_width: A },
        ] {
            let (z, n) = (8.0, 200);
            let carried: f64 = (0..n)
                .map(|i| (f64::from(i) + 0.5) * PI / f64::from(n) - PI / 2.0)
                .map(|t| -strip.stress(z * t.tan(), z) * z / t.cos().powi(2) * PI / f64::from(n))
                .sum();
            assert!((carried - 1.0).abs() < 1e-6, "{strip:?}: {carried}");
        }
    }

    #[test]
    fn polar_form_of_the_block_matches_print() {
        for [x, z] in PLACES {
            let (r, theta) = (x.hypot(z), x.atan2(z));
            let (r1, r2) = ((x - A).hypot(z), (x + A).hypot(z));
            let r12 = (r1 * r2).sqrt();
            let theta12 = 0.5 * ((x - A).atan2(z) + (x + A).atan2(z));
            let turned = r * r / (r12 * r12) * theta.cos() * (theta - 3.0 * theta12).cos();
            let printed = -(theta12.cos() + turned) / (PI * r12);
            let block = Strip::Block { normal: 1.0, half_width: A };
            assert!((block.stress(x, z) - printed).abs() < 1e-12);
        }
    }

    #[test]
    fn printed_strains_are_plane_stress() {
        let skin = HalfSpace::new(SKIN.0, SKIN.1);
        let z = 2.0;
        // On the axis of the line, [TactileEnc] prints −2P/πEz.
        let right = Strip::Line { normal: 1.0, tangential: 0.0 }.strain(&skin, 0.0, z);
        let printed = -2.0 / (PI * skin.young() * z);
        assert!((printed / right - 4.0 / 3.0).abs() < 1e-12);
        // On the axis of the cylinder it prints −P/πa²·(r₁₂ + 2z²/r₁₂ − 3z).
        let printed = |z: f64| {
            let root = z.hypot(A);
            -(root + 2.0 * z * z / root - 3.0 * z) / (PI * A * A)
        };
        let strip = Strip::Cylinder { normal: 1.0, half_width: A };
        assert!((printed(0.0) / strip.stress(0.0, 0.0) - 0.5).abs() < 1e-12);
        assert!(printed(8.0) > 0.0 && strip.stress(0.0, 8.0) < 0.0);
    }
}

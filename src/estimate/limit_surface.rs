//! Limit surface of a soft contact: combined shear and torsion at which it slides.
//!
//! The model is that of [Ospina2017], chapter 3.
//!
//! The contact is a disc of radius a = c·N^γ with the power-law pressure p(r) ∝ (1 − (r/a)^k)^(1/k)
//! and Coulomb friction. Rotation about any centre in its plane gives a force and a torsion. All
//! centres together give a curve from (μN, 0) to (0, τ_max) with τ_max = κ·μ·N·a. The ellipse
//! through the same ends is its cheap form.
//!
//! The host computes the curve (`taxel_calibrate::limit_surface`) and stores the ratio of its
//! radius to the ellipse's at a few angles. [`Sweep`] computes the curve itself at a dozen times
//! the cost. `host-tools/calibrate/data/limit-surface.csv` compares cost and accuracy of the three.

mod sweep;

use serde::{Deserialize, Serialize};

use crate::math::{at_least, power, sqrt};
pub use sweep::Sweep;

/// Intervals of the stored curve.
pub const INTERVALS: usize = 8;

/// Limit surface of one kind of contact, normalised by the friction coefficient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LimitSurface {
    /// Coefficients c in mm/N^γ and γ of a = c·N^γ. By Hertz γ = ⅓.
    pub radius: [f32; 2],
    /// Coefficient κ: the greatest torsion over μ·N·a.
    pub torque: f32,
    /// Ratio of the curve's radius to the ellipse's at nine angles. At these the force's share of
    /// the ellipse's squared radius is 0, 1/8 … 1. All ones give the ellipse.
    pub curve: [f32; INTERVALS + 1],
}

impl LimitSurface {
    /// Makes the surface of a sphere on an incompressible skin by Hertz's theory.
    ///
    /// The sphere has the radius `radius_mm`, the skin Young's modulus `young` MPa.
    ///
    /// Hertz's pressure has k = 2 and κ = 3π/16, and a³ = 9PR/16E ([TactileEnc]).
    #[must_use]
    pub fn hertz(radius_mm: f32, young: f32) -> Self {
        Self {
            radius: [crate::math::cube_root(9.0 * radius_mm / (16.0 * young)), 1.0 / 3.0],
            torque: 3.0 * core::f32::consts::PI / 16.0,
            curve: [1.0; INTERVALS + 1],
        }
    }

    /// Returns the torsion in N·mm that a contact holds without shear. The contact is loaded by
    /// `normal` newtons and has the friction coefficient `mu`.
    #[must_use]
    pub fn most_torsion(&self, normal: f32, mu: f32) -> f32 {
        let [c, gamma] = self.radius;
        self.torque * mu * normal * c * power(normal, gamma)
    }

    /// Returns the contact's own share of a torsion also held at an `arm`, in mm.
    ///
    /// The arm is that of two separate contacts. The parts held at the arm and by the contact
    /// itself grow with μ·N.
    #[must_use]
    pub fn own_share(&self, normal: f32, arm: f32) -> f32 {
        if !(f32::MIN_POSITIVE..f32::MAX).contains(&arm) {
            return 1.0;
        }
        let own = self.most_torsion(normal, 1.0 / at_least(normal, f32::MIN_POSITIVE));
        let share = own / (own + arm);
        if (0.0..1.0).contains(&share) { share } else { 1.0 }
    }

    /// Returns the load relative to the limit: 0 unloaded, 1 on the limit, more beyond it.
    ///
    /// Shear is in newtons, torsion in N·mm. A contact without normal force or friction holds
    /// nothing: any load is 1 for it.
    #[must_use]
    pub fn load(&self, shear: [f32; 2], torsion: f32, normal: f32, mu: f32) -> f32 {
        let [force2, turning2] = match self.squares(shear, torsion, normal, mu) {
            Ok(squares) => squares,
            Err(load) => return load,
        };
        let sum = force2 + turning2;
        bounded(sqrt(sum) / self.bulge(force2 / sum))
    }

    /// Returns the load by the ellipse, ignoring the curve: the cheap form.
    #[must_use]
    pub fn load_by_ellipse(&self, shear: [f32; 2], torsion: f32, normal: f32, mu: f32) -> f32 {
        match self.squares(shear, torsion, normal, mu) {
            Ok([force2, turning2]) => bounded(sqrt(force2 + turning2)),
            Err(load) => load,
        }
    }

    /// Returns the squares of shear and torsion relative to their limits. If the limits or both
    /// loads are zero, `Err` has the load.
    #[inline(always)]
    fn squares(
        &self,
        [fx, fy]: [f32; 2],
        torsion: f32,
        normal: f32,
        mu: f32,
    ) -> Result<[f32; 2], f32> {
        let shares = |load2: f32, most: f32| {
            if (1e-9..1e9).contains(&most) { Ok(load2 * square(1.0 / most)) } else { Err(1.0) }
        };
        let force2 = shares(fx * fx + fy * fy, mu * normal)?;
        // Most contacts are not turned, and a power costs as much as all the rest.
        let turning2 = if torsion == 0.0 {
            0.0
        } else {
            shares(torsion * torsion, self.most_torsion(normal, mu))?
        };
        let sum = force2 + turning2;
        if sum.is_nan() || sum <= f32::MIN_POSITIVE {
            return Err(0.0);
        }
        Ok([force2, turning2])
    }

    /// Returns the ratio of the curve's radius to the ellipse's at this share of force.
    fn bulge(&self, share: f32) -> f32 {
        let at = share.clamp(0.0, 1.0) * INTERVALS as f32;
        let from = (at as usize).min(INTERVALS - 1);
        let (Some(a), Some(b)) = (self.curve.get(from), self.curve.get(from + 1)) else {
            return 1.0;
        };
        at_least(a + (b - a) * (at - from as f32), 0.1)
    }
}

fn square(x: f32) -> f32 {
    x * x
}

/// Limits a load to 1e9, so that an overflow is far beyond the limit.
fn bounded(load: f32) -> f32 {
    if load < 1e9 { load } else { 1e9 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn surface_ends_at_coulomb_friction_and_most_torsion() {
        let surface = LimitSurface::hertz(6.0, 0.236);
        let (normal, mu) = (1.2, 0.7);
        assert!((surface.load([mu * normal, 0.0], 0.0, normal, mu) - 1.0).abs() < 1e-5);
        let a = f32::cbrt(9.0 * normal * 6.0 / (16.0 * 0.236));
        let most = 3.0 * core::f32::consts::PI / 16.0 * mu * normal * a;
        assert!((surface.most_torsion(normal, mu) / most - 1.0).abs() < 1e-4);
        assert!((surface.load([0.0, 0.0], most, normal, mu) - 1.0).abs() < 1e-4);
        let half = 0.5f32.sqrt();
        let both = surface.load([half * mu * normal, 0.0], half * most, normal, mu);
        assert!((both - 1.0).abs() < 1e-4, "on the ellipse: {both}");
    }

    #[test]
    fn load_follows_the_curve_not_the_ellipse() {
        let ellipse = LimitSurface::hertz(6.0, 0.236);
        let mut surface = ellipse;
        surface.curve[INTERVALS / 2] = 1.25;
        let load = |surface: &LimitSurface, force: f32, turning: f32| {
            let most = surface.most_torsion(1.2, 0.7);
            surface.load([force.sqrt() * 0.84, 0.0], turning.sqrt() * most, 1.2, 0.7)
        };
        assert!((load(&ellipse, 0.5, 0.5) - 1.0).abs() < 1e-4);
        assert!((load(&surface, 0.5, 0.5) - 0.8).abs() < 1e-4, "{}", load(&surface, 0.5, 0.5));
        assert!((load(&surface, 1.0, 0.0) - 1.0).abs() < 1e-4, "the ends stay");
    }

    #[test]
    fn load_is_one_without_normal_force() {
        assert_eq!(LimitSurface::hertz(6.0, 0.236).load([0.1, 0.0], 0.0, 0.0, 0.8), 1.0);
    }

    proptest! {
        #[test]
        fn load_is_finite(
            shear in any::<[f32; 2]>(), torsion in any::<f32>(), normal in any::<f32>(),
            mu in any::<f32>(), c in any::<f32>(), gamma in any::<f32>(), bulge in any::<f32>(),
        ) {
            let surface = LimitSurface {
                radius: [c, gamma], torque: 0.6, curve: [bulge; INTERVALS + 1],
            };
            prop_assert!(surface.load(shear, torsion, normal, mu).is_finite());
            prop_assert!(surface.load_by_ellipse(shear, torsion, normal, mu).is_finite());
        }
    }
}

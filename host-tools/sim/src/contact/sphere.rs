//! Rigid sphere on the skin: Hertz's contact in closed form.

use core::f64::consts::PI;

use super::HalfSpace;

/// Hertz's pressure distribution (3P/2πa²)√(1 − r²/a²) without friction ([TactileEnc] eq. (3);
/// Johnson §4.2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hertz {
    /// Radius a of the contact in mm; [`HalfSpace::contact_radius`].
    pub radius: f64,
    /// Normal force P in newtons.
    pub normal: f64,
}

impl Hertz {
    /// σ_zz in MPa at r from the axis and depth z (mm, z > 0).
    ///
    /// The stress is −p₀ (z/√u)³ a²u/(u² + a²z²), with u the larger root of u² − (r² + z² − a²)u −
    /// a²z² = 0 (Huber 1904).
    #[must_use]
    pub fn stress(&self, r: f64, z: f64) -> f64 {
        let a2 = self.radius * self.radius;
        let u = self.u(r, z);
        -self.peak() * (z / u.sqrt()).powi(3) * a2 * u / (u * u + a2 * z * z)
    }

    /// ε_zz at r from the axis and depth z (mm, z > 0).
    ///
    /// Hooke's law on σ_zz and on the trace of the stress, −2(1 + ν)p₀ z/√u·(1 − √u/a·atan a/√u).
    #[must_use]
    pub fn strain(&self, skin: &HalfSpace, r: f64, z: f64) -> f64 {
        let trace = -(1.0 + skin.poisson()) / PI * self.attraction(r, z);
        skin.strain_of(self.stress(r, z), trace)
    }

    /// u_z in mm: (z ∫p z/ρ³ dA + 2(1 − ν) ∫p/ρ dA)/4πG, the two integrals in closed form.
    #[must_use]
    pub fn displacement(&self, skin: &HalfSpace, r: f64, z: f64) -> f64 {
        let integrals =
            z * self.attraction(r, z) + 2.0 * (1.0 - skin.poisson()) * self.potential(r, z);
        integrals / (4.0 * PI * skin.shear_modulus())
    }

    /// Peak pressure p₀ = 3P/2πa² in MPa.
    fn peak(&self) -> f64 {
        1.5 * self.normal / (PI * self.radius * self.radius)
    }

    fn u(&self, r: f64, z: f64) -> f64 {
        let a2 = self.radius * self.radius;
        let half = 0.5 * (r * r + z * z - a2);
        let product = self.radius * z;
        let root = half.hypot(product);
        // The product of the two roots is −a²z²; the root without cancellation gives the other.
        if half >= 0.0 { half + root } else { product * product / (root - half) }
    }

    /// Attraction integral ∫ p z/ρ³ dA.
    fn attraction(&self, r: f64, z: f64) -> f64 {
        let root = self.u(r, z).sqrt();
        let angle = (self.radius / root).atan();
        2.0 * PI * self.peak() * z / root * (1.0 - root / self.radius * angle)
    }

    /// Potential integral ∫ p/ρ dA: Newton's potential of a disc that is denser in the middle.
    ///
    /// The integral is ½πp₀a² ∫_u^∞ (1 − r²/(a² + s) − z²/s) ds/((a² + s)√s).
    fn potential(&self, r: f64, z: f64) -> f64 {
        let (a, u) = (self.radius, self.u(r, z));
        let (a2, root) = (a * a, u.sqrt());
        let angle = (a / root).atan() / a;
        let along = (angle - root / (a2 + u)) / a2;
        let down = 2.0 * (1.0 / root - angle) / a2;
        0.5 * PI * self.peak() * a2 * (2.0 * angle - r * r * along - z * z * down)
    }

    /// Tangential integral ∫ p x/ρ³ dA at x = r on the x axis, −∂/∂x of the potential.
    ///
    /// Multiplied by z/4πG, it is u_z of the same traction pulling along x on an incompressible
    /// skin.
    #[cfg(test)]
    fn pull(&self, r: f64, z: f64) -> f64 {
        let (a, u) = (self.radius, self.u(r, z));
        let (a2, root) = (a * a, u.sqrt());
        PI * self.peak() * r * ((a / root).atan() / a - root / (a2 + u))
    }
}

#[cfg(test)]
mod tests {
    use super::super::traction::{Patch, Round, Rule};
    use super::*;

    const A: f64 = 1.6;
    /// On axis and off, under the rim, outside; shallow and deep.
    const PLACES: [[f64; 2]; 6] =
        [[0.0, 0.5], [0.0, 2.5], [1.6, 0.8], [0.9, 0.7], [3.5, 1.5], [2.0, 8.0]];

    fn pressed() -> (Hertz, Patch) {
        (Hertz { radius: A, normal: 0.8 }, Patch::disc([0.0; 2], A, [0.0, 0.0, 0.8]))
    }

    #[test]
    fn closed_forms_agree_with_superposition() {
        let rule = Rule::round(Round::Hertz, 24, 96);
        let (hertz, patch) = pressed();
        for poisson in [0.5, 0.3] {
            let skin = HalfSpace::new(0.236, poisson);
            for [r, z] in PLACES {
                let at = [r * 0.6, r * 0.8, z];
                let pairs = [
                    (hertz.stress(r, z), patch.superpose(&rule, at, |f, d| skin.stress(f, d))),
                    (
                        hertz.strain(&skin, r, z),
                        patch.superpose(&rule, at, |f, d| skin.strain(f, d)),
                    ),
                    (
                        hertz.displacement(&skin, r, z),
                        patch.superpose(&rule, at, |f, d| skin.displacement(f, d)),
                    ),
                ];
                for (closed, sum) in pairs {
                    assert!((sum / closed - 1.0).abs() < 1e-5, "{r} {z}: {sum} for {closed}");
                }
            }
        }
    }

    #[test]
    fn superposition_converges_above_eighth_order() {
        // Twice the points of a ring and twice the rings: above the facets the error falls by more
        // than 2⁸, down to round-off.
        let (hertz, patch) = pressed();
        let skin = HalfSpace::new(0.236, 0.5);
        let error = |n: usize| {
            let rule = Rule::round(Round::Hertz, n, 8 * n);
            let sum = patch.superpose(&rule, [1.0, 0.4, 1.5], |f, d| skin.displacement(f, d));
            (sum / hertz.displacement(&skin, f64::hypot(1.0, 0.4), 1.5) - 1.0).abs()
        };
        let errors = [2, 4, 8].map(error);
        for pair in errors.windows(2) {
            assert!(pair[1] < pair[0] / 256.0 || pair[1] < 1e-12, "{errors:?}");
        }
    }

    #[test]
    fn sphere_sinks_by_a_squared_over_r() {
        // Hertz's approach (Johnson eq. (4.23)) must follow from the traction, the contact radius
        // and the influence function together.
        for poisson in [0.5, 0.25] {
            let skin = HalfSpace::new(0.236, poisson);
            let radius = skin.contact_radius(6.0, 0.8);
            let displacement = Hertz { radius, normal: 0.8 }.displacement(&skin, 0.0, 1e-12);
            assert!((displacement / (radius * radius / 6.0) - 1.0).abs() < 1e-9, "{displacement}");
        }
    }

    #[test]
    fn dragging_agrees_with_its_closed_form() {
        let rule = Rule::round(Round::Hertz, 24, 96);
        let (hertz, _) = pressed();
        let skin = HalfSpace::new(0.236, 0.5);
        let patch = Patch::disc([0.0; 2], A, [0.8, 0.0, 0.0]);
        for [r, z] in PLACES {
            let sum = patch.superpose(&rule, [r, 0.0, z], |f, d| skin.displacement(f, d));
            let closed = z * hertz.pull(r, z) / (4.0 * PI * skin.shear_modulus());
            assert!((sum - closed).abs() <= 1e-5 * closed.abs() + 1e-12, "{r} {z}");
        }
    }
}

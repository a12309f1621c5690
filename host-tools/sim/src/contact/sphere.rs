//! A rigid sphere on the skin: Hertz in closed form, and its shear by Cattaneo and Mindlin.

use core::f64::consts::PI;

use super::{HalfSpace, Patch};

/// The tractions of a sphere of `radius` mm pressed on `skin` at `centre` with `force` (N): one or two
/// discs of Hertz's traction.
///
/// Friction holds μP at most, at each point as on the whole. A shear below that, applied after the
/// normal force and growing, slips in a ring c < r < a and sticks inside (Cattaneo, Mindlin; Johnson
/// §7.2): the traction is that of sliding on the disc a, less a similar one on the disc
/// c = a(1 − Q/μP)^⅓ that takes back μP − Q. What was before, and shear that turns or falls, is not
/// remembered.
#[must_use]
pub fn tractions(
    skin: &HalfSpace,
    radius: f64,
    centre: [f64; 2],
    force: [f64; 3],
    mu: f64,
) -> [Option<Patch>; 2] {
    let [qx, qy, normal] = force;
    let a = skin.contact_radius(radius, normal);
    let (shear, held) = (qx.hypot(qy), mu * normal);
    if shear <= 0.0 || shear >= held {
        return [Some(Patch::disc(centre, a, force)), None];
    }
    let spare = held - shear;
    let [x, y] = [qx / shear, qy / shear];
    let c = a * (spare / held).cbrt();
    [
        Some(Patch::disc(centre, a, [x * held, y * held, normal])),
        Some(Patch::disc(centre, c, [-x * spare, -y * spare, 0.0])),
    ]
}

/// Hertz's pressure (3P/2πa²)√(1 − r²/a²) (004 eq. (3); Johnson §4.2) without friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hertz {
    /// Radius a of the contact in mm; [`HalfSpace::contact_radius`].
    pub radius: f64,
    /// Normal force P in newtons.
    pub normal: f64,
}

impl Hertz {
    /// σ_zz in MPa, r from the axis and z deep (mm, z > 0): −p₀ (z/√u)³ a²u/(u² + a²z²), with u the
    /// larger root of u² − (r² + z² − a²)u − a²z² = 0 (Huber 1904).
    #[must_use]
    pub fn stress(&self, r: f64, z: f64) -> f64 {
        let a2 = self.radius * self.radius;
        let u = self.u(r, z);
        -self.peak() * (z / u.sqrt()).powi(3) * a2 * u / (u * u + a2 * z * z)
    }

    /// ε_zz: Hooke's law on σ_zz and on the trace of the stress, −2(1 + ν)p₀ z/√u·(1 − √u/a·atan a/√u).
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

    /// p₀ = 3P/2πa².
    fn peak(&self) -> f64 {
        1.5 * self.normal / (PI * self.radius * self.radius)
    }

    fn u(&self, r: f64, z: f64) -> f64 {
        let a2 = self.radius * self.radius;
        let half = 0.5 * (r * r + z * z - a2);
        let product = self.radius * z;
        let root = half.hypot(product);
        // The two roots' product is −a²z²; the one without cancellation gives the other.
        if half >= 0.0 { half + root } else { product * product / (root - half) }
    }

    /// ∫ p z/ρ³ dA.
    fn attraction(&self, r: f64, z: f64) -> f64 {
        let root = self.u(r, z).sqrt();
        let angle = (self.radius / root).atan();
        2.0 * PI * self.peak() * z / root * (1.0 - root / self.radius * angle)
    }

    /// ∫ p/ρ dA, Newton's potential of a disc that is denser in the middle: ½πp₀a² ∫_u^∞
    /// (1 − r²/(a² + s) − z²/s) ds/((a² + s)√s).
    fn potential(&self, r: f64, z: f64) -> f64 {
        let (a, u) = (self.radius, self.u(r, z));
        let (a2, root) = (a * a, u.sqrt());
        let angle = (a / root).atan() / a;
        let along = (angle - root / (a2 + u)) / a2;
        let down = 2.0 * (1.0 / root - angle) / a2;
        0.5 * PI * self.peak() * a2 * (2.0 * angle - r * r * along - z * z * down)
    }

    /// ∫ p x/ρ³ dA at x = r on the x axis, −∂/∂x of the potential: z/4πG times it is u_z of the same
    /// traction pulling along x on an incompressible skin.
    #[cfg(test)]
    fn pull(&self, r: f64, z: f64) -> f64 {
        let (a, u) = (self.radius, self.u(r, z));
        let (a2, root) = (a * a, u.sqrt());
        PI * self.peak() * r * ((a / root).atan() / a - root / (a2 + u))
    }
}

#[cfg(test)]
mod tests {
    use super::super::traction::{Round, Rule};
    use super::*;
    use proptest::prelude::*;

    const A: f64 = 1.6;
    /// On axis and off, under the rim, outside; shallow and deep.
    const PLACES: [[f64; 2]; 6] =
        [[0.0, 0.5], [0.0, 2.5], [1.6, 0.8], [0.9, 0.7], [3.5, 1.5], [2.0, 8.0]];

    fn pressed() -> (Hertz, Patch) {
        (Hertz { radius: A, normal: 0.8 }, Patch::disc([0.0; 2], A, [0.0, 0.0, 0.8]))
    }

    #[test]
    fn the_closed_forms_agree_with_superposed_point_loads() {
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
    fn superposition_converges_faster_than_the_eighth_power() {
        // Twice the points a ring and twice the rings: above the facets the error falls by more than
        // 2⁸, down to round-off.
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
    fn the_surface_under_the_sphere_sinks_by_a_squared_over_r() {
        // Hertz's approach (Johnson eq. (4.23)) must follow from the traction, the contact radius and
        // the influence function together.
        for poisson in [0.5, 0.25] {
            let skin = HalfSpace::new(0.236, poisson);
            let radius = skin.contact_radius(6.0, 0.8);
            let sunk = Hertz { radius, normal: 0.8 }.displacement(&skin, 0.0, 1e-12);
            assert!((sunk / (radius * radius / 6.0) - 1.0).abs() < 1e-9, "{sunk}");
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

    /// Shear traction along x at a distance r from the centre, over μ times the pressure there.
    fn use_of_friction(patches: &[Option<Patch>; 2], mu: f64, r: f64) -> f64 {
        let density = |patch: &Patch, axis: usize| {
            let s = r / patch.along[0];
            let disc = 1.5 / (PI * patch.along[0].powi(2));
            disc * patch.force[axis] * (1.0 - s * s).max(0.0).sqrt()
        };
        let sum = |axis| patches.iter().flatten().map(|p| density(p, axis)).sum::<f64>();
        sum(0) / (mu * sum(2))
    }

    #[test]
    fn shear_sticks_inside_and_slips_in_a_ring() {
        let skin = HalfSpace::new(0.236, 0.5);
        let (mu, normal) = (0.8, 1.0);
        let shear = 0.5 * mu * normal;
        let patches = tractions(&skin, 6.0, [0.0; 2], [shear, 0.0, normal], mu);
        let [a, c] = patches.map(|patch| patch.unwrap().along[0]);
        assert!((c / a - 0.5f64.cbrt()).abs() < 1e-12);
        for i in 1..100 {
            let r = a * f64::from(i) / 100.0;
            let used = use_of_friction(&patches, mu, r);
            if r < c { assert!(used < 1.0) } else { assert!((used - 1.0).abs() < 1e-12) }
        }
        // What sticks has moved as one: u_x under such a disc is
        // πq₀/32Gr·[4(2 − ν)r² − (4 − 3ν)x² − (4 − ν)y²] (Johnson §7.1).
        let moved = |x: f64, y: f64| -> f64 {
            let discs = patches.iter().flatten().map(|p| (p.along[0], p.force[0]));
            discs
                .map(|(r, q)| {
                    let falls = 2.5 * x * x + 3.5 * y * y;
                    1.5 * q / (32.0 * skin.shear_modulus() * r.powi(3)) * (6.0 * r * r - falls)
                })
                .sum()
        };
        for [x, y] in [[0.9 * c, 0.0], [0.0, 0.9 * c], [-0.3 * c, 0.5 * c]] {
            assert!((moved(x, y) / moved(0.0, 0.0) - 1.0).abs() < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn tractions_carry_the_force_and_nowhere_more_than_friction_holds(
            qx in -1.0..1.0f64, qy in -1.0..1.0f64, normal in 0.01..3.0f64, mu in 0.0..1.5f64,
        ) {
            let held = mu * normal;
            let scale = (held / qx.hypot(qy)).min(1.0);
            let force = [qx * scale, qy * scale, normal];
            let skin = HalfSpace::new(0.236, 0.5);
            let patches = tractions(&skin, 6.0, [1.0, 2.0], force, mu);
            for (axis, force) in force.iter().enumerate() {
                let sum: f64 = patches.iter().flatten().map(|p| p.force[axis]).sum();
                prop_assert!((sum - force).abs() < 1e-9);
            }
            let turned = tractions(&skin, 6.0, [0.0; 2], [scale * qx.hypot(qy), 0.0, normal], mu);
            if mu > 0.01 {
                for i in 0..50 {
                    let r = turned[0].unwrap().along[0] * f64::from(i) / 50.0;
                    prop_assert!(use_of_friction(&turned, mu, r) < 1.0 + 1e-9);
                }
            }
        }
    }
}

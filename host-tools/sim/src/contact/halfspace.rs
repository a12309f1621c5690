//! The elastic half-space and the point load on it.

use core::f64::consts::PI;

/// Young's modulus of the silicone of [DeMaria2011] at small strain in MPa.
///
/// The value is 6 (α1 + α2) of the paper's Mooney–Rivlin law, eq. (1).
pub const SILICONE_YOUNG_MPA: f64 = scan_plan::finger::REFERENCE.skin.young_mpa;

/// Elastic half-space. Forces in newtons and lengths in millimetres make its moduli MPa.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    young: f64,
    poisson: f64,
}

impl HalfSpace {
    /// Creates a half-space with Young's modulus `young_mpa` and Poisson's ratio `poisson`.
    #[must_use]
    pub fn new(young_mpa: f64, poisson: f64) -> Self {
        Self { young: young_mpa, poisson }
    }

    /// Young's modulus in MPa.
    #[must_use]
    pub fn young(&self) -> f64 {
        self.young
    }

    /// Poisson's ratio.
    #[must_use]
    pub fn poisson(&self) -> f64 {
        self.poisson
    }

    /// Shear modulus in MPa, G = E / 2(1 + ν).
    #[must_use]
    pub fn shear_modulus(&self) -> f64 {
        self.young / (2.0 * (1.0 + self.poisson))
    }

    /// Contact modulus against a rigid body in MPa, E* = E / (1 − ν²).
    #[must_use]
    pub fn contact_modulus(&self) -> f64 {
        self.young / (1.0 - self.poisson * self.poisson)
    }

    /// Contact radius in mm of a rigid sphere of `radius` mm under `normal` newtons.
    ///
    /// Hertz: a³ = 3PR/4E* (Johnson §4.2); for ν = ½ it is a = (9PR/16E)^⅓ of [TactileEnc].
    #[must_use]
    pub fn contact_radius(&self, radius: f64, normal: f64) -> f64 {
        (3.0 * normal.max(0.0) * radius / (4.0 * self.contact_modulus())).cbrt()
    }

    /// Half the contact width in mm of a long rigid cylinder of `radius` mm under `normal` N/mm.
    ///
    /// a² = 4PR/πE* (Johnson §4.2); for ν = ½ it is a = √(3RP/πE) of [TactileEnc].
    #[must_use]
    pub fn contact_half_width(&self, radius: f64, normal: f64) -> f64 {
        (4.0 * normal.max(0.0) * radius / (PI * self.contact_modulus())).sqrt()
    }

    /// Half the contact width in mm of a blunt rigid edge under `normal` N/mm.
    ///
    /// Its two faces rise from the skin with `slope` (tangent): P = aE*·slope (Johnson §5.2).
    #[must_use]
    pub fn edge_half_width(&self, slope: f64, normal: f64) -> f64 {
        normal.max(0.0) / (self.contact_modulus() * slope)
    }

    /// Contact radius in mm of a blunt rigid corner under `normal` newtons.
    ///
    /// The corner is a cone whose side rises from the skin with `slope` (tangent): P = ½πa²E*·slope
    /// (Johnson §5.2).
    #[must_use]
    pub fn corner_radius(&self, slope: f64, normal: f64) -> f64 {
        (2.0 * normal.max(0.0) / (PI * self.contact_modulus() * slope)).sqrt()
    }

    /// σ_zz in MPa at `at` (mm from the load) under a point load `force`, [TactileEnc] eq. (1):
    /// −3z²(Pz + Q·x)/2πρ⁵.
    #[must_use]
    pub fn stress(&self, force: [f64; 3], at: [f64; 3]) -> f64 {
        let z = at[2];
        let along = force[0] * at[0] + force[1] * at[1] + force[2] * z;
        let square = at.iter().map(|c| c * c).sum::<f64>();
        -3.0 * z * z * along / (2.0 * PI * square * square * square.sqrt())
    }

    /// ε_zz at `at` (mm from the load) under a point load `force`, for any Poisson's ratio.
    ///
    /// Hooke's law on σ_zz and on the trace of the stress, −(1 + ν)(P z + Q·x)/πρ³ (Johnson §3.2,
    /// §3.6). For ν = ½ it is [TactileEnc] eq. (2).
    #[must_use]
    pub fn strain(&self, force: [f64; 3], at: [f64; 3]) -> f64 {
        let along: f64 = force.iter().zip(at).map(|(f, c)| f * c).sum();
        let square = at.iter().map(|c| c * c).sum::<f64>();
        let trace = -(1.0 + self.poisson) * along / (PI * square * square.sqrt());
        self.strain_of(self.stress(force, at), trace)
    }

    /// Strain from Hooke's law: ε_zz = ((1 + ν) σ_zz − ν (σ_xx + σ_yy + σ_zz)) / E.
    pub(super) fn strain_of(&self, stress: f64, trace: f64) -> f64 {
        ((1.0 + self.poisson) * stress - self.poisson * trace) / self.young
    }

    /// u_z in mm at `at` (mm from the load) under a point load `force`.
    ///
    /// With ρ the distance (Johnson §3.2 and §3.6): P/4πG·\[z²/ρ³ + 2(1 − ν)/ρ\] and Q/4πG·\[xz/ρ³
    /// + (1 − 2ν)x/ρ(ρ + z)\].
    #[must_use]
    pub fn displacement(&self, force: [f64; 3], at: [f64; 3]) -> f64 {
        let [x, y, z] = at;
        let rho = (x * x + y * y + z * z).sqrt();
        let [qx, qy, p] = force;
        let normal = z * z / rho.powi(3) + 2.0 * (1.0 - self.poisson) / rho;
        let tangential = z / rho.powi(3) + (1.0 - 2.0 * self.poisson) / (rho * (rho + z));
        (p * normal + (qx * x + qy * y) * tangential) / (4.0 * PI * self.shear_modulus())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn incompressible_strain_matches_tactile_enc() {
        // [TactileEnc] eq. (2), as printed.
        let skin = HalfSpace::new(0.3, 0.5);
        let (force, at) = ([0.3, -0.2, 1.1], [0.7, 1.2, 1.9]);
        let [x, y, z] = at;
        let r = f64::sqrt(x * x + y * y + z * z);
        let along = force[2] * z + force[0] * x + force[1] * y;
        let printed = -3.0 * along / (2.0 * PI * 0.3 * r.powi(5)) * (z * z - (x * x + y * y) / 2.0);
        assert!((skin.strain(force, at) / printed - 1.0).abs() < 1e-12);
    }

    #[test]
    fn contact_sizes_match_tactile_enc() {
        // [TactileEnc]: a = (9PR/16E)^⅓ for the sphere and √(3RP/πE) for the cylinder, ν = ½.
        let skin = HalfSpace::new(0.3, 0.5);
        let sphere = f64::cbrt(9.0 * 1.2 * 5.0 / (16.0 * 0.3));
        assert!((skin.contact_radius(5.0, 1.2) - sphere).abs() < 1e-12);
        let cylinder = f64::sqrt(3.0 * 5.0 * 1.2 / (PI * 0.3));
        assert!((skin.contact_half_width(5.0, 1.2) - cylinder).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn strain_is_the_slope_of_displacement(
            x in -2.0..2.0f64, y in -2.0..2.0f64, z in 0.5..3.0f64, poisson in 0.0..0.5f64,
            fx in -1.0..1.0f64, fy in -1.0..1.0f64, fz in -1.0..1.0f64,
        ) {
            let skin = HalfSpace::new(0.236, poisson);
            let u = |dz: f64| skin.displacement([fx, fy, fz], [x, y, z + dz]);
            let slope = (u(1e-4) - u(-1e-4)) / 2e-4;
            let most = skin.strain([0.0, 0.0, 2.0], [0.0, 0.0, z]).abs();
            prop_assert!((skin.strain([fx, fy, fz], [x, y, z]) - slope).abs() < 1e-6 * most);
        }
    }
}

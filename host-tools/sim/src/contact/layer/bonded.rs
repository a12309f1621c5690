//! Layer bonded all over to a rigid floor: shows how far the half-space can be trusted.

use core::f64::consts::PI;

use super::super::HalfSpace;
use super::super::gauss::legendre;
use super::spectrum::{Wave, bessel};

/// Layer whose lower face cannot move.
#[derive(Clone, Copy, Debug)]
pub struct Bonded {
    skin: HalfSpace,
    thickness: f64,
}

impl Bonded {
    /// Creates a layer of `thickness_mm` of the material of `skin`.
    #[must_use]
    pub fn new(skin: HalfSpace, thickness_mm: f64) -> Self {
        Self { skin, thickness: thickness_mm }
    }

    /// u_z in mm at `at` (mm from the load, z within the layer) under a point load `force`.
    ///
    /// The result is the half-space's displacement, and the change by the bond as a Hankel
    /// transform: ∫ ΔW(k, z) J₀(kr) k dk/2π for the normal force and −x/r ∫ ΔW(k, z) J₁(kr) k dk/2π
    /// for the tangential one. ΔW falls like e^{−k(2h − z)}, so that the integral is smooth.
    #[must_use]
    pub fn displacement(&self, force: [f64; 3], at: [f64; 3]) -> f64 {
        let [x, y, z] = at;
        let r = x.hypot(y);
        let along = if r > 0.0 { (force[0] * x + force[1] * y) / r } else { 0.0 };
        let (h, nu) = (self.thickness, self.skin.poisson());
        let reach = 2.0 * h - z;
        let top = 36.0 / reach;
        let nodes = 48 + (top * r / PI) as usize;
        let mut change = 0.0;
        for (c, weight) in legendre(nodes) {
            let k = 0.5 * top * (c + 1.0);
            let share = 0.5 * top * weight * k / (2.0 * PI);
            let [pushed, dragged] = [[0.0, -1.0], [1.0, 0.0]]
                .map(|upper| Wave::new(k, h, nu, upper, [0.0; 2]).displacement(z)[1]);
            let decay = (-k * z).exp();
            let half_pushed = (k * z + 2.0 * (1.0 - nu)) * decay / (2.0 * k);
            let half_dragged = -(k * z + 1.0 - 2.0 * nu) * decay / (2.0 * k);
            change += share * force[2] * (pushed - half_pushed) * bessel(0, k * r);
            change -= share * along * (dragged - half_dragged) * bessel(1, k * r);
        }
        self.skin.displacement(force, at) + change / self.skin.shear_modulus()
    }

    /// Pressure in MPa on the floor at `r` mm from the axis of a point load.
    ///
    /// The load is `normal` newtons: ∫ p(k) J₀(kr) k dk/2π.
    #[must_use]
    pub fn pressure(&self, normal: f64, r: f64) -> f64 {
        let (h, nu) = (self.thickness, self.skin.poisson());
        let top = 36.0 / h;
        legendre(48 + (top * r.abs() / PI) as usize)
            .into_iter()
            .map(|(c, weight)| (0.5 * top * (c + 1.0), 0.5 * top * weight))
            .map(|(k, weight)| {
                let stress = Wave::new(k, h, nu, [0.0, -1.0], [0.0; 2]).traction(h)[1];
                -normal * stress * bessel(0, k * r) * weight * k / (2.0 * PI)
            })
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skin() -> HalfSpace {
        HalfSpace::new(0.236, 0.5)
    }

    #[test]
    fn bonded_face_is_fixed() {
        let force = [0.3, 0.0, 1.0];
        for poisson in [0.5, 0.3] {
            let skin = HalfSpace::new(0.236, poisson);
            for [x, y] in [[0.0, 0.0], [1.0, 0.5], [-3.0, 1.0]] {
                let most = skin.displacement(force, [0.0, 0.0, 2.5]);
                let stuck = Bonded::new(skin, 2.5).displacement(force, [x, y, 2.5]);
                assert!(stuck.abs() < 1e-6 * most, "{stuck}");
                let at = [x, y, 2.5];
                let thick = Bonded::new(skin, 2500.0).displacement(force, at);
                assert!((thick - skin.displacement(force, at)).abs() < 2e-3 * most);
            }
        }
    }

    #[test]
    fn floor_carries_the_load() {
        let (layer, far) = (Bonded::new(skin(), 2.5), 20.0);
        let carried: f64 = legendre(60)
            .into_iter()
            .map(|(c, weight)| (0.5 * far * (c + 1.0), 0.5 * far * weight))
            .map(|(r, weight)| layer.pressure(0.8, r) * 2.0 * PI * r * weight)
            .sum();
        assert!((carried / 0.8 - 1.0).abs() < 5e-3, "{carried}");
    }

    /// Largest difference between bonded layer and half-space `depth` below a unit force.
    ///
    /// The difference is relative to the largest displacement there.
    fn miss(thickness: f64, force: [f64; 3]) -> f64 {
        let (skin, depth) = (skin(), 2.5);
        let layer = Bonded::new(skin, thickness);
        let places = (0..40).map(|i| [f64::from(i) * 0.2, 0.0, depth]);
        let (mut most, mut worst) = (0.0f64, 0.0f64);
        for at in places {
            let half = skin.displacement(force, at);
            most = most.max(half.abs());
            worst = worst.max((half - layer.displacement(force, at)).abs());
        }
        worst / most
    }

    #[test]
    fn half_space_needs_a_distant_floor() {
        // docs/simulator.md quotes these. The effect of the floor falls as one over its distance
        // under a normal force, and as one over its square under shear.
        for (ratio, pressed, sheared) in
            [(2.0, 0.521, 0.493), (10.0, 0.0931, 0.0461), (100.0, 0.0089, 0.000_447)]
        {
            let found = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]].map(|force| miss(2.5 * ratio, force));
            for (found, quoted) in found.iter().zip([pressed, sheared]) {
                assert!((found / quoted - 1.0).abs() < 0.01, "{ratio}: {found}");
            }
        }
    }
}

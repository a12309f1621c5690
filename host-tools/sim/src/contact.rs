//! Contact of a sphere with the skin, and how far it pushes each reflective facet down.
//!
//! The skin is taken as a half-space: z down from its surface, facets at the depth of the layer. The
//! traction over the contact disc is Hertz's, normal and tangential alike, and a facet's displacement is
//! the superposition of point loads over the disc, averaged over the facet.
//!
//! Where that is an approximation:
//! - The tangential traction is that of full sliding. Stuck, shear gathers at the rim (Cattaneo, Mindlin;
//!   Johnson §7.2), which changes the shear part of a facet's displacement: on a 6 mm sphere, 2.5 mm
//!   down, by 9 % of its largest at 0.3 N and by 21 % at 2 N, at half of what friction holds.
//! - The real layer ends at the facets and hangs on the walls between them.
//! - Hertz wants a ≪ R; at 2 N on a 6 mm sphere a/R is one half.

use taxel::scan::{TAXEL_CENTRES, TAXELS};

/// Young's modulus of the silicone of 002 at small strain in MPa: 6 (α1 + α2) of its Mooney–Rivlin law,
/// eq. (1).
pub const SILICONE_YOUNG_MPA: f64 = 0.236;

/// An elastic half-space. Forces in newtons and lengths in millimetres make its moduli MPa.
#[derive(Clone, Copy, Debug)]
pub struct HalfSpace {
    young: f64,
    poisson: f64,
}

impl HalfSpace {
    /// Of Young's modulus `young_mpa` and Poisson's ratio `poisson`.
    #[must_use]
    pub fn new(young_mpa: f64, poisson: f64) -> Self {
        Self { young: young_mpa, poisson }
    }

    /// Shear modulus in MPa, G = E / 2(1 + ν).
    #[must_use]
    pub fn shear_modulus(&self) -> f64 {
        self.young / (2.0 * (1.0 + self.poisson))
    }

    /// Radius in mm of the disc in which a rigid sphere of `radius` mm touches under `normal` newtons
    /// (Hertz: a³ = 3PR/4E*, E* = E/(1 − ν²); Johnson §4.2).
    #[must_use]
    pub fn contact_radius(&self, radius: f64, normal: f64) -> f64 {
        let reduced = self.young / (1.0 - self.poisson * self.poisson);
        (3.0 * normal.max(0.0) * radius / (4.0 * reduced)).cbrt()
    }
}

/// A load on the skin: a disc of Hertz traction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Centre in mm.
    pub centre: [f64; 2],
    /// Radius in mm.
    pub radius: f64,
    /// Total force in newtons, z into the skin.
    pub force: [f64; 3],
}

/// Facets a layer below the surface, one under each taxel centre.
#[derive(Clone, Debug)]
pub struct Layer {
    skin: HalfSpace,
    depth: f64,
    /// Facet k is sampled at nodes 4k … 4k + 3, in mm: apart in x and y for the sake of SIMD.
    x: [f64; NODES],
    y: [f64; NODES],
}

/// Each facet is averaged by the 2 × 2 Gauss rule (exact to third degree in x and in y).
const PER_FACET: usize = 4;
const NODES: usize = TAXELS * PER_FACET;

/// Radius and weight of the two rings that replace the disc: Gauss–Jacobi points of the Hertz weight
/// √(1 − t) in t = r². With eight points a ring the rule is exact to seventh degree; the second ring is
/// turned by half a step.
const RINGS: [(f64, f64); 2] = [
    (0.422_892_523_952_102_03, 0.583_666_002_653_407_4),
    (0.842_645_122_263_405_6, 0.416_333_997_346_592_6),
];
const PER_RING: usize = 8;

impl Layer {
    /// Square facets of side `facet_mm` at `depth_mm` below the surface of `skin`.
    #[must_use]
    pub fn new(skin: HalfSpace, depth_mm: f64, facet_mm: f64) -> Self {
        let gauss = facet_mm / 2.0 / f64::sqrt(3.0);
        let [mut x, mut y] = [[0.0; NODES]; 2];
        let corners = [[-gauss, -gauss], [gauss, -gauss], [-gauss, gauss], [gauss, gauss]];
        let places = TAXEL_CENTRES.iter().flat_map(|centre| {
            corners.map(|[dx, dy]| [f64::from(centre[0].0) + dx, f64::from(centre[1].0) + dy])
        });
        for ((x, y), place) in x.iter_mut().zip(&mut y).zip(places) {
            [*x, *y] = place;
        }
        Self { skin, depth: depth_mm, x, y }
    }

    /// The contact disc of a sphere of `radius` mm pressed on this skin at `centre` with `force`.
    #[must_use]
    pub fn sphere(&self, radius: f64, centre: [f64; 2], force: [f64; 3]) -> Disc {
        Disc { centre, radius: self.skin.contact_radius(radius, force[2]), force }
    }

    /// Mean displacement of each facet in mm, positive down (nearer to its LED); the quadrature is good to
    /// two thousandths of the largest one (tested).
    ///
    /// Per point load, with G the shear modulus and ρ the distance (Johnson §3.2 and §3.6):
    /// P/(4πG)·\[z²/ρ³ + 2(1 − ν)/ρ\] and Q/(4πG)·\[xz/ρ³ + (1 − 2ν)x/(ρ(ρ + z))\].
    #[must_use]
    pub fn displacement(&self, disc: &Disc) -> [f64; TAXELS] {
        let mut nodes = [0.0; NODES];
        for (ring, (radius, weight)) in RINGS.iter().enumerate() {
            for point in 0..PER_RING {
                let turn = point as f64 + 0.5 * ring as f64;
                let (sin, cos) = (turn * core::f64::consts::TAU / PER_RING as f64).sin_cos();
                let at = [
                    disc.centre[0] + disc.radius * radius * cos,
                    disc.centre[1] + disc.radius * radius * sin,
                ];
                let share = weight / PER_RING as f64;
                self.add_point_load(&mut nodes, at, disc.force.map(|f| f * share));
            }
        }
        let mut facets = [0.0; TAXELS];
        for (facet, nodes) in facets.iter_mut().zip(nodes.chunks_exact(PER_FACET)) {
            *facet = nodes.iter().sum::<f64>() / PER_FACET as f64;
        }
        facets
    }

    fn add_point_load(&self, nodes: &mut [f64; NODES], at: [f64; 2], force: [f64; 3]) {
        let z = self.depth;
        let compliance = 1.0 / (4.0 * core::f64::consts::PI * self.skin.shear_modulus());
        let [qx, qy, p] = force.map(|f| f * compliance);
        let around = 2.0 * (1.0 - self.skin.poisson);
        let compressible = 1.0 - 2.0 * self.skin.poisson;
        for ((u, x), y) in nodes.iter_mut().zip(&self.x).zip(&self.y) {
            let (x, y) = (x - at[0], y - at[1]);
            let inverse = 1.0 / (x * x + y * y + z * z).sqrt();
            let square = inverse * inverse;
            let normal = inverse * (z * z * square + around);
            let tangential = square * (z * inverse + compressible / (1.0 + z * inverse));
            *u += p * normal + (qx * x + qy * y) * tangential;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DEPTH: f64 = 2.5;
    const FACET: f64 = 1.9;

    fn layer(poisson: f64) -> Layer {
        Layer::new(HalfSpace::new(SILICONE_YOUNG_MPA, poisson), DEPTH, FACET)
    }

    /// Displacement at one place by brute force: the formulas as the books print them, integrated over
    /// the Hertz traction on a fine polar grid.
    fn integrated(skin: &HalfSpace, disc: &Disc, at: [f64; 3]) -> f64 {
        const R: usize = 60;
        const T: usize = 72;
        let [px, py, z] = at;
        let nu = skin.poisson;
        let a = disc.radius;
        let scale = 1.0 / (4.0 * std::f64::consts::PI * skin.shear_modulus());
        let mut sum = 0.0;
        for i in 0..R {
            // r = a sin(s) takes the infinite slope of the traction at the rim away.
            let s = (i as f64 + 0.5) / R as f64 * std::f64::consts::FRAC_PI_2;
            let r = a * s.sin();
            let area = r
                * a
                * s.cos()
                * (std::f64::consts::FRAC_PI_2 / R as f64)
                * (std::f64::consts::TAU / T as f64);
            let traction = 3.0 / (2.0 * std::f64::consts::PI * a * a) * s.cos();
            for j in 0..T {
                let t = (j as f64 + 0.5) / T as f64 * std::f64::consts::TAU;
                let x = px - disc.centre[0] - r * t.cos();
                let y = py - disc.centre[1] - r * t.sin();
                let rho = (x * x + y * y + z * z).sqrt();
                let [qx, qy, p] = disc.force.map(|f| f * traction * area);
                sum += p * (z * z / rho.powi(3) + 2.0 * (1.0 - nu) / rho);
                sum += (qx * x + qy * y) * (z / rho.powi(3) + (1.0 - 2.0 * nu) / (rho * (rho + z)));
            }
        }
        sum * scale
    }

    fn facet_integrated(skin: &HalfSpace, disc: &Disc, k: usize) -> f64 {
        const N: usize = 8;
        let mut sum = 0.0;
        for i in 0..N * N {
            let offset = |i: usize| ((i as f64 + 0.5) / N as f64 - 0.5) * FACET;
            let x = f64::from(TAXEL_CENTRES[k][0].0) + offset(i % N);
            let y = f64::from(TAXEL_CENTRES[k][1].0) + offset(i / N);
            sum += integrated(skin, disc, [x, y, DEPTH]);
        }
        sum / (N * N) as f64
    }

    #[test]
    fn facets_agree_with_brute_force_integration() {
        for poisson in [0.5, 0.3] {
            let layer = layer(poisson);
            for (centre, force) in [
                ([0.4, -0.9], [0.0, 0.0, 0.3]),
                ([-3.0, 2.2], [0.0, 0.0, 2.0]),
                ([1.1, 1.3], [0.7, -0.5, 1.5]),
            ] {
                let disc = layer.sphere(6.0, centre, force);
                let facets = layer.displacement(&disc);
                let mut worst = 0.0f64;
                let most = facets.iter().fold(0.0f64, |m, u| m.max(u.abs()));
                for (k, u) in facets.iter().enumerate() {
                    let exact = facet_integrated(&layer.skin, &disc, k);
                    worst = worst.max((u - exact).abs() / most);
                }
                assert!(worst < 2e-3, "ν = {poisson}, {force:?}: {worst}");
            }
        }
    }

    #[test]
    fn the_surface_under_the_sphere_sinks_by_a_squared_over_r() {
        // Hertz's approach (Johnson eq. 4.23) is a closed form that the traction, the contact radius
        // and the influence function must reproduce together.
        for poisson in [0.5, 0.25] {
            let skin = HalfSpace::new(SILICONE_YOUNG_MPA, poisson);
            let radius = skin.contact_radius(6.0, 0.8);
            let disc = Disc { centre: [0.0; 2], radius, force: [0.0, 0.0, 0.8] };
            let sunk = integrated(&skin, &disc, [0.0; 3]);
            assert!((sunk / (radius * radius / 6.0) - 1.0).abs() < 2e-3, "{sunk}");
        }
    }

    #[test]
    fn contact_radius_of_an_incompressible_skin_is_the_one_of_the_encyclopedia() {
        // 004: a = (9PR/16E)^⅓ for ν = ½.
        let skin = HalfSpace::new(0.3, 0.5);
        let expected = f64::cbrt(9.0 * 1.2 * 5.0 / (16.0 * 0.3));
        assert!((skin.contact_radius(5.0, 1.2) - expected).abs() < 1e-12);
    }

    #[test]
    fn the_rings_carry_the_whole_force_with_its_second_and_third_moment_of_area() {
        // ∫ r² p dA / P = 2a²/5 and ∫ r⁴ p dA / P = 8a⁴/35 for Hertz's p; also the sixth, 16a⁶/105.
        for (power, moment) in [(0, 1.0), (2, 2.0 / 5.0), (4, 8.0 / 35.0), (6, 16.0 / 105.0)] {
            let sum: f64 = RINGS.iter().map(|(r, w)| w * r.powi(power)).sum();
            assert!((sum - moment).abs() < 1e-12, "{power}: {sum}");
        }
    }

    #[test]
    fn pure_shear_sinks_the_skin_ahead_and_raises_it_behind() {
        let disc = Disc { centre: [0.0; 2], radius: 1.5, force: [0.5, 0.0, 0.0] };
        let u = layer(0.5).displacement(&disc);
        for row in 0..4 {
            assert!(u[4 * row + 3] > 0.0 && u[4 * row] < 0.0);
            assert!((u[4 * row + 3] + u[4 * row]).abs() < 1e-12, "odd in x");
            assert!((u[4 * row + 2] + u[4 * row + 1]).abs() < 1e-12, "odd in x");
        }
    }

    #[test]
    fn far_away_only_force_over_distance_is_left() {
        // 2(1 − ν)P/(4πGρ): the extent of contact and depth no longer matter.
        let layer = layer(0.5);
        let disc = Disc { centre: [400.0, 0.0], radius: 2.0, force: [0.0, 0.0, 1.0] };
        let expected = 1.0 / (4.0 * std::f64::consts::PI * layer.skin.shear_modulus() * 400.0);
        assert!(layer.displacement(&disc).iter().all(|u| (u / expected - 1.0).abs() < 0.02));
    }

    proptest! {
        #[test]
        fn displacement_is_linear_in_force_for_a_fixed_disc(
            x in -4.0..4.0f64, y in -4.0..4.0f64, scale in 0.1..5.0f64,
            fx in -1.0..1.0f64, fy in -1.0..1.0f64, fz in 0.0..2.0f64,
        ) {
            let layer = layer(0.4);
            let disc = |force| Disc { centre: [x, y], radius: 2.0, force };
            let once = layer.displacement(&disc([fx, fy, fz]));
            let scaled = layer.displacement(&disc([fx, fy, fz].map(|f| f * scale)));
            let parts = [[fx, 0.0, 0.0], [0.0, fy, 0.0], [0.0, 0.0, fz]]
                .map(|force| layer.displacement(&disc(force)));
            for k in 0..TAXELS {
                prop_assert!((scaled[k] - once[k] * scale).abs() < 1e-12);
                prop_assert!((parts[0][k] + parts[1][k] + parts[2][k] - once[k]).abs() < 1e-12);
            }
        }

        #[test]
        fn lengths_and_moduli_scale_as_dimensions_say(
            force in 0.05..2.0f64, young in 0.05..3.0f64, factor in 0.5..4.0f64,
        ) {
            // a depends on P R / E only, and u at fixed a on P / E only.
            let soft = HalfSpace::new(young, 0.5);
            let stiff = HalfSpace::new(young * factor, 0.5);
            let a = soft.contact_radius(6.0, force);
            prop_assert!((stiff.contact_radius(6.0, force * factor) - a).abs() < 1e-9);
            prop_assert!((soft.contact_radius(6.0 * factor, force / factor) - a).abs() < 1e-9);
            prop_assert!((soft.contact_radius(6.0, force * 8.0) - 2.0 * a).abs() < 1e-9);
            let [soft, stiff] = [soft, stiff].map(|skin| Layer::new(skin, DEPTH, FACET));
            let one = soft.displacement(&soft.sphere(6.0, [0.5, 0.1], [0.0, 0.0, force]));
            let same =
                stiff.displacement(&stiff.sphere(6.0, [0.5, 0.1], [0.0, 0.0, force * factor]));
            for (one, same) in one.iter().zip(same) {
                prop_assert!((one - same).abs() < 1e-9);
            }
        }

        #[test]
        fn the_finger_is_the_same_turned_by_a_quarter(
            x in -4.0..4.0f64, y in -4.0..4.0f64,
            fx in -1.0..1.0f64, fy in -1.0..1.0f64, fz in 0.0..2.0f64,
        ) {
            let layer = layer(0.5);
            let u = layer.displacement(
                &Disc { centre: [x, y], radius: 1.5, force: [fx, fy, fz] });
            let turned = layer.displacement(
                &Disc { centre: [-y, x], radius: 1.5, force: [-fy, fx, fz] });
            for row in 0..4 {
                for column in 0..4 {
                    // (column, row) goes to (3 − row, column).
                    let there = turned[4 * column + 3 - row];
                    prop_assert!((u[4 * row + column] - there).abs() < 1e-12);
                }
            }
        }
    }
}

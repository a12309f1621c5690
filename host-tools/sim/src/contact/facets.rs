//! Mean displacement of each reflective facet under a contact, as the optical taxels measure it.

use taxel::scan::{TAXEL_CENTRES, TAXELS};

use super::gauss::legendre;
use super::{HalfSpace, Patch, Rule};

/// Facets below the surface of a half-space, one under each taxel centre.
#[derive(Clone, Debug)]
pub struct Facets {
    skin: HalfSpace,
    depth: f64,
    nodes: Nodes,
}

/// Sampling points of the facets in mm; facet k has `per_facet` of them from k × `per_facet` on.
/// Separate arrays for x and y let the compiler use SIMD.
#[derive(Clone, Debug)]
struct Nodes {
    x: Vec<f64>,
    y: Vec<f64>,
    /// Weight of each point in the mean over its facet.
    share: Vec<f64>,
    per_facet: usize,
}

/// Largest number of nodes along the side of a facet.
const MOST_ALONG: usize = 16;
/// Number of nodes whose sums are kept at a time.
const BLOCK: usize = MOST_ALONG * MOST_ALONG;

impl Facets {
    /// Creates the square facets of the 4×4 finger.
    ///
    /// The facets have the side `facet_mm` and lie `depth_mm` below the surface of `skin`. Each is
    /// averaged by a Gauss rule of `along` × `along` points (1 to 16).
    #[must_use]
    pub fn new(skin: HalfSpace, depth_mm: f64, facet_mm: f64, along: usize) -> Self {
        let centres = TAXEL_CENTRES.map(|centre| centre.map(|mm| f64::from(mm.0)));
        Self::below(skin, depth_mm, facet_mm, along, &centres)
    }

    /// Creates facets below `centres` (mm, up to sixteen); see [`Self::new`].
    #[must_use]
    pub fn below(
        skin: HalfSpace,
        depth_mm: f64,
        facet_mm: f64,
        along: usize,
        centres: &[[f64; 2]],
    ) -> Self {
        let rule = legendre(along.clamp(1, MOST_ALONG));
        let mut nodes = Nodes { x: vec![], y: vec![], share: vec![], per_facet: rule.len().pow(2) };
        for [x, y] in centres.iter().take(TAXELS) {
            for (v, weight_v) in &rule {
                for (u, weight_u) in &rule {
                    nodes.x.push(x + 0.5 * facet_mm * u);
                    nodes.y.push(y + 0.5 * facet_mm * v);
                    nodes.share.push(0.25 * weight_u * weight_v);
                }
            }
        }
        Self { skin, depth: depth_mm, nodes }
    }

    /// Number of points along a facet's side for a relative quadrature error of about `error`.
    ///
    /// The error of Gauss's rule is ρ^−2n for a field whose nearest pole is as far from the facet
    /// as a load above it. Here ρ = t + √(1 + t²) at t = 2·depth/side, from Bernstein's ellipse
    /// through the pole.
    #[must_use]
    pub fn points_along(depth_mm: f64, facet_mm: f64, error: f64) -> usize {
        let t = 2.0 * depth_mm / facet_mm;
        let points = -0.5 * error.ln() / (t + (1.0 + t * t).sqrt()).ln();
        (points.ceil() as usize).clamp(1, MOST_ALONG)
    }

    /// Number of field evaluations (point loads × nodes) of [`Self::displacement`] for one patch.
    #[must_use]
    pub fn evaluations(&self, rule: &Rule) -> u64 {
        (rule.points().len() * self.nodes.x.len()) as u64
    }

    /// Mean displacement of each facet in mm under all patches, positive down (nearer to its LED).
    ///
    /// `rule` spreads each patch into point loads; each load adds [`HalfSpace::displacement`].
    #[must_use]
    pub fn displacement<'a>(
        &self,
        rule: &Rule,
        patches: impl IntoIterator<Item = &'a Patch, IntoIter: Clone>,
    ) -> [f64; TAXELS] {
        let Nodes { x, y, share, per_facet } = &self.nodes;
        let at_once = BLOCK / per_facet;
        let block = at_once * per_facet;
        let places = x.chunks(block).zip(y.chunks(block)).zip(share.chunks(block));
        let patches = patches.into_iter();
        let mut facets = [0.0; TAXELS];
        for (((x, y), share), facets) in places.zip(facets.chunks_mut(at_once)) {
            let mut sums = [0.0; BLOCK];
            for patch in patches.clone() {
                for (at, force) in patch.loads(rule) {
                    self.add_point_load(&mut sums, [x, y], at, force);
                }
            }
            let facets = facets.iter_mut().zip(sums.chunks(*per_facet));
            for ((facet, sums), shares) in facets.zip(share.chunks_exact(*per_facet)) {
                *facet = sums.iter().zip(shares).map(|(sum, share)| sum * share).sum();
            }
        }
        facets
    }

    /// Adds the displacement under one point load to `sums`.
    ///
    /// Terms that are zero are skipped: no shear, no normal force, or an incompressible skin.
    fn add_point_load(
        &self,
        sums: &mut [f64; BLOCK],
        [x, y]: [&[f64]; 2],
        at: [f64; 2],
        force: [f64; 3],
    ) {
        let z = self.depth;
        let compliance = 1.0 / (4.0 * core::f64::consts::PI * self.skin.shear_modulus());
        let [qx, qy, p] = force.map(|f| f * compliance);
        let around = 2.0 * (1.0 - self.skin.poisson());
        let compressible = 1.0 - 2.0 * self.skin.poisson();
        let places = x.iter().zip(y).map(|(x, y)| (x - at[0], y - at[1]));
        let inverse = |x: f64, y: f64| 1.0 / (x * x + y * y + z * z).sqrt();
        if qx == 0.0 && qy == 0.0 {
            for (sum, (x, y)) in sums.iter_mut().zip(places) {
                let inverse = inverse(x, y);
                *sum += p * inverse * (z * z * inverse * inverse + around);
            }
        } else if compressible == 0.0 {
            // With ν = ½ the displacement is (Pz + Q·x) z/ρ³ + P/ρ.
            for (sum, (x, y)) in sums.iter_mut().zip(places) {
                let inverse = inverse(x, y);
                let along = (p * z + qx * x + qy * y) * z;
                *sum += inverse * (along * inverse * inverse + p);
            }
        } else {
            for (sum, (x, y)) in sums.iter_mut().zip(places) {
                let inverse = inverse(x, y);
                let square = inverse * inverse;
                let normal = inverse * (z * z * square + around);
                let tangential = square * (z * inverse + compressible / (1.0 + z * inverse));
                *sum += p * normal + (qx * x + qy * y) * tangential;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::traction::Round;
    use super::super::{Indenter, SILICONE_YOUNG_MPA};
    use super::*;
    use proptest::prelude::*;

    const SPHERE: Indenter = Indenter::Sphere { radius: 6.0 };
    const DEPTH: f64 = 2.5;
    const FACET: f64 = 1.9;

    fn facets(poisson: f64) -> Facets {
        Facets::new(HalfSpace::new(SILICONE_YOUNG_MPA, poisson), DEPTH, FACET, 2)
    }

    fn few() -> Rule {
        Rule::round(Round::Hertz, 2, 8)
    }

    fn disc(centre: [f64; 2], radius: f64, force: [f64; 3]) -> [Patch; 1] {
        [Patch::disc(centre, radius, force)]
    }

    /// Mean over facet k by brute force: printed formulas, midpoint rule over facet and discs.
    fn brute_force(skin: &HalfSpace, patches: &[Option<Patch>], k: usize) -> f64 {
        const N: usize = 8;
        let rule = Rule::round(Round::Hertz, 20, 40);
        let offset = |i: usize| ((i as f64 + 0.5) / N as f64 - 0.5) * FACET;
        let mut sum = 0.0;
        for i in 0..N * N {
            let x = f64::from(TAXEL_CENTRES[k][0].0) + offset(i % N);
            let y = f64::from(TAXEL_CENTRES[k][1].0) + offset(i / N);
            for patch in patches.iter().flatten() {
                let field = |f, at| skin.displacement(f, at);
                sum += patch.superpose(&rule, [x, y, DEPTH], field);
            }
        }
        sum / (N * N) as f64
    }

    #[test]
    fn facets_agree_with_brute_force() {
        for poisson in [0.5, 0.3] {
            let facets = facets(poisson);
            for (centre, force) in [
                ([0.4, -0.9], [0.0, 0.0, 0.3]),
                ([-3.0, 2.2], [0.0, 0.0, 2.0]),
                ([1.1, 1.3], [0.7, -0.5, 1.5]),
                ([0.3, 1.8], [0.2, 0.1, 1.0]),
            ] {
                let patches = SPHERE.tractions(&facets.skin, centre, force, 0.0, 0.8);
                let means = facets.displacement(&few(), patches.iter().flatten());
                let most = means.iter().fold(0.0f64, |m, u| m.max(u.abs()));
                for (k, u) in means.iter().enumerate() {
                    let exact = brute_force(&facets.skin, &patches, k);
                    let error = (u - exact).abs() / most;
                    assert!(error < 2.5e-3, "ν = {poisson}, {force:?}: {error}");
                }
            }
        }
    }

    #[test]
    fn stick_changes_shear_part_up_to_a_quarter() {
        // Error over the largest displacement by shear, worst case over positions and shares of
        // friction.
        let facets = facets(0.5);
        let under = |centre, force, mu| {
            let patches = SPHERE.tractions(&facets.skin, centre, force, 0.0, mu);
            facets.displacement(&few(), patches.iter().flatten())
        };
        let change = |normal: f64| {
            let mut worst = 0.0f64;
            for x in [0.0, 0.5, 1.0, 1.25] {
                for used in [0.1, 0.3, 0.5, 0.7, 0.9] {
                    let shear = used * 0.8 * normal;
                    let pressed = under([x, 0.0], [0.0, 0.0, normal], 0.8);
                    let stuck = under([x, 0.0], [shear, 0.0, normal], 0.8);
                    let slid = under([x, 0.0], [shear, 0.0, normal], used * 0.8);
                    let most = |u: [f64; TAXELS], rest: [f64; TAXELS]| {
                        u.iter().zip(rest).fold(0.0f64, |m, (u, rest)| m.max((u - rest).abs()))
                    };
                    worst = worst.max(most(stuck, slid) / most(slid, pressed));
                }
            }
            worst
        };
        let [light, firm] = [0.3, 2.0].map(change);
        assert!((0.09..0.11).contains(&light), "{light}");
        assert!((0.22..0.26).contains(&firm), "{firm}");
    }

    #[test]
    fn two_contacts_add_up() {
        let facets = facets(0.5);
        let [one] = disc([-2.0, 1.0], 1.2, [0.1, 0.0, 0.5]);
        let [other] = disc([2.5, -1.5], 1.6, [0.0, -0.2, 1.1]);
        let [both, first, second] = [vec![one, other], vec![one], vec![other]]
            .map(|patches| facets.displacement(&few(), &patches));
        for k in 0..TAXELS {
            assert!((both[k] - first[k] - second[k]).abs() < 1e-12);
        }
    }

    #[test]
    fn shear_lowers_skin_ahead_raises_it_behind() {
        let u = facets(0.5).displacement(&few(), &disc([0.0; 2], 1.5, [0.5, 0.0, 0.0]));
        for row in 0..4 {
            assert!(u[4 * row + 3] > 0.0 && u[4 * row] < 0.0);
            assert!((u[4 * row + 3] + u[4 * row]).abs() < 1e-12, "odd in x");
            assert!((u[4 * row + 2] + u[4 * row + 1]).abs() < 1e-12, "odd in x");
        }
    }

    #[test]
    fn far_displacement_is_force_over_distance() {
        // Far away, u = 2(1 − ν)P/(4πGρ): size of contact and depth no longer matter.
        let facets = facets(0.5);
        let far = disc([400.0, 0.0], 2.0, [0.0, 0.0, 1.0]);
        let expected = 1.0 / (4.0 * std::f64::consts::PI * facets.skin.shear_modulus() * 400.0);
        assert!(
            facets.displacement(&few(), &far).iter().all(|u| (u / expected - 1.0).abs() < 0.02)
        );
    }

    proptest! {
        #[test]
        fn displacement_is_linear_in_force(
            x in -4.0..4.0f64, y in -4.0..4.0f64, scale in 0.1..5.0f64,
            fx in -1.0..1.0f64, fy in -1.0..1.0f64, fz in 0.0..2.0f64,
        ) {
            let facets = facets(0.4);
            let under = |force| facets.displacement(&few(), &disc([x, y], 2.0, force));
            let once = under([fx, fy, fz]);
            let scaled = under([fx, fy, fz].map(|f| f * scale));
            let parts = [[fx, 0.0, 0.0], [0.0, fy, 0.0], [0.0, 0.0, fz]].map(under);
            for k in 0..TAXELS {
                prop_assert!((scaled[k] - once[k] * scale).abs() < 1e-12);
                prop_assert!((parts[0][k] + parts[1][k] + parts[2][k] - once[k]).abs() < 1e-12);
            }
        }

        #[test]
        fn lengths_and_moduli_scale_by_dimension(
            force in 0.05..2.0f64, young in 0.05..3.0f64, factor in 0.5..4.0f64,
        ) {
            // a depends on P R / E only, and u at fixed a on P / E only.
            let soft = HalfSpace::new(young, 0.5);
            let stiff = HalfSpace::new(young * factor, 0.5);
            let a = soft.contact_radius(6.0, force);
            prop_assert!((stiff.contact_radius(6.0, force * factor) - a).abs() < 1e-9);
            prop_assert!((soft.contact_radius(6.0 * factor, force / factor) - a).abs() < 1e-9);
            prop_assert!((soft.contact_radius(6.0, force * 8.0) - 2.0 * a).abs() < 1e-9);
            let [one, same] = [(soft, force), (stiff, force * factor)].map(|(skin, force)| {
                let patches = SPHERE.tractions(&skin, [0.5, 0.1], [0.0, 0.0, force], 0.0, 0.8);
                Facets::new(skin, DEPTH, FACET, 2).displacement(&few(), patches.iter().flatten())
            });
            for (one, same) in one.iter().zip(same) {
                prop_assert!((one - same).abs() < 1e-9);
            }
        }

        #[test]
        fn quarter_turn_permutes_the_facets(
            x in -4.0..4.0f64, y in -4.0..4.0f64,
            fx in -1.0..1.0f64, fy in -1.0..1.0f64, fz in 0.0..2.0f64,
        ) {
            let facets = facets(0.5);
            let u = facets.displacement(&few(), &disc([x, y], 1.5, [fx, fy, fz]));
            let turned = facets.displacement(&few(), &disc([-y, x], 1.5, [-fy, fx, fz]));
            for row in 0..4 {
                for column in 0..4 {
                    // A quarter turn takes (column, row) to (3 − row, column).
                    let there = turned[4 * column + 3 - row];
                    prop_assert!((u[4 * row + column] - there).abs() < 1e-12);
                }
            }
        }
    }
}

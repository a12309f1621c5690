//! Tractions as point loads: a [`Rule`] spreads them over a unit shape, a [`Patch`] puts it on the
//! skin.
//!
//! Every rule is of Gauss's kind. A change of variable or the weight removes the singularities of
//! its traction, so that it converges faster than any power of the number of points. Its shares sum
//! to one, so that a patch carries its force exactly with any number of points.

use core::f64::consts::{PI, TAU};

use super::gauss::{arcosh, legendre};

/// Distribution of a traction over the unit disc, with r the distance from its centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Round {
    /// √(1 − r²): Hertz's sphere, normal and sliding (Johnson §4.2, §7.1). Stretched to an ellipse
    /// it is for crossed cylinders ([TactileEnc] eq. (4)).
    Hertz,
    /// 1/√(1 − r²): the flat circular punch (Johnson §3.8).
    ///
    /// The shear of a contact that sticks all over has the same form, Q/(2πa)·(a² − r²)^−½.
    /// [TactileEnc] eq. (3) prints three times that, which would carry 3Q.
    Punch,
    /// arcosh(1/r): a blunt corner, taken as a cone (Johnson §5.2).
    Corner,
}

/// Distribution of a traction across a strip |v| ≤ 1; along the strip it is uniform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Across {
    /// The whole force at v = 0.
    Line,
    /// 1/√(1 − v²): the flat block ([TactileEnc]).
    Block,
    /// √(1 − v²): the cylinder ([TactileEnc]).
    Cylinder,
    /// arcosh(1/|v|): a blunt edge, two faces of one slope (Johnson §5.2).
    Edge,
}

/// Points of a unit shape and the share of the force that acts at each.
#[derive(Clone, Debug)]
pub struct Rule {
    points: Vec<([f64; 2], f64)>,
    /// Mean squares of u and of v; the mean of uv is zero.
    second: [f64; 2],
}

impl Rule {
    /// Rule over the unit disc: `rings` of points, every other ring turned by half a step.
    ///
    /// A ring as long as the rim would have `spokes` points. A shorter one has proportionally
    /// fewer, but always a multiple of four, because the rule must have the symmetry of the taxel
    /// matrix.
    #[must_use]
    pub fn round(traction: Round, rings: usize, spokes: usize) -> Self {
        let rings: Vec<(f64, f64)> = match traction {
            // In c = √(1 − r²), dA Hertz is 3c² dc and r² = 1 − c²: an even polynomial. The odd
            // rule's point at c = 0 has no weight.
            Round::Hertz => upper_half(2 * rings + 1)
                .map(|(c, weight)| ((1.0 - c * c).sqrt(), 3.0 * c * c * weight))
                .collect(),
            Round::Punch => {
                upper_half(2 * rings).map(|(c, weight)| ((1.0 - c * c).sqrt(), weight)).collect()
            }
            Round::Corner => arcosh(rings, 1.0),
        };
        let total: f64 = rings.iter().map(|(_, share)| share).sum();
        let points = rings.iter().enumerate().flat_map(|(ring, (r, share))| {
            let spokes = 4 * (spokes as f64 * r / 4.0).ceil().max(1.0) as usize;
            (0..spokes).map(move |spoke| {
                let turn = (spoke as f64 + 0.5 * (ring % 2) as f64) * TAU / spokes as f64;
                let (sin, cos) = turn.sin_cos();
                ([r * cos, r * sin], share / total / spokes as f64)
            })
        });
        Self::of(points.collect())
    }

    /// Rule over the strip |u| ≤ 1, |v| ≤ 1, with `along` points in u and `across` in v (one for a
    /// line).
    #[must_use]
    pub fn strip(traction: Across, along: usize, across: usize) -> Self {
        let n = across as f64;
        let across: Vec<(f64, f64)> = match traction {
            Across::Line => vec![(0.0, 1.0)],
            // Gauss–Chebyshev of the first and of the second kind.
            Across::Block => {
                (0..across).map(|i| (((i as f64 + 0.5) * PI / n).cos(), 1.0)).collect()
            }
            Across::Cylinder => (1..=across)
                .map(|i| (i as f64 * PI / (n + 1.0)).sin_cos())
                .map(|(sin, cos)| (cos, sin * sin))
                .collect(),
            Across::Edge => {
                let half = arcosh(across.div_ceil(2), 0.0).into_iter();
                half.flat_map(|(v, share)| [(-v, share), (v, share)]).collect()
            }
        };
        let total: f64 = across.iter().map(|(_, share)| share).sum();
        let points = legendre(along).into_iter().flat_map(|(u, weight)| {
            across.iter().map(move |(v, share)| ([u, *v], 0.5 * weight * share / total))
        });
        Self::of(points.collect())
    }

    /// Rule of one point: the whole force at the centre.
    #[must_use]
    pub fn point() -> Self {
        Self::of(vec![([0.0; 2], 1.0)])
    }

    fn of(points: Vec<([f64; 2], f64)>) -> Self {
        let second = points.iter().fold([0.0; 2], |[along, across], ([u, v], share)| {
            [along + share * u * u, across + share * v * v]
        });
        Self { points, second }
    }

    /// Points of the unit shape and their shares of the force.
    #[must_use]
    pub fn points(&self) -> &[([f64; 2], f64)] {
        &self.points
    }
}

/// Unit shape laid on the skin, and the force that it carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Centre in mm.
    pub centre: [f64; 2],
    /// Vector in mm from the centre to the unit shape's u = 1.
    pub along: [f64; 2],
    /// Vector in mm from the centre to the unit shape's v = 1.
    pub across: [f64; 2],
    /// Force in newtons, z into the skin.
    pub force: [f64; 3],
    /// Moment about the normal in N mm, from x to y.
    ///
    /// Its traction grows with the distance from the centre.
    pub torsion: f64,
}

impl Patch {
    /// A disc of `radius` mm.
    #[must_use]
    pub fn disc(centre: [f64; 2], radius: f64, force: [f64; 3]) -> Self {
        Self { centre, along: [radius, 0.0], across: [0.0, radius], force, torsion: 0.0 }
    }

    /// Points of `rule` on this patch: offset from the centre in mm, and share of the force.
    pub fn places<'a>(&self, rule: &'a Rule) -> impl Iterator<Item = ([f64; 2], f64)> + 'a {
        let ([ux, uy], [vx, vy]) = (self.along, self.across);
        rule.points.iter().map(move |([u, v], share)| ([u * ux + v * vx, u * uy + v * vy], *share))
    }

    /// Force across the offset from the centre, in newtons a mm, that carries the torsion.
    #[must_use]
    pub fn spin(&self, rule: &Rule) -> f64 {
        let ([ux, uy], [vx, vy], [along, across]) = (self.along, self.across, rule.second);
        let second = along * (ux * ux + uy * uy) + across * (vx * vx + vy * vy);
        // A torsion without a lever arm makes no traction.
        if second > 0.0 { self.torsion / second } else { 0.0 }
    }

    /// Point loads of `rule` on this patch: position in mm and force in newtons.
    pub fn loads<'a>(&'a self, rule: &'a Rule) -> impl Iterator<Item = ([f64; 2], [f64; 3])> + 'a {
        let ([cx, cy], [qx, qy, p], spin) = (self.centre, self.force, self.spin(rule));
        self.places(rule).map(move |([x, y], share)| {
            let force = [qx - spin * y, qy + spin * x, p].map(|f| f * share);
            ([cx + x, cy + y], force)
        })
    }

    /// Superposed field at `at` (mm) of all point loads.
    ///
    /// The result is the sum of `field(force, from the load to at)` over the loads; an example of a
    /// field is [`HalfSpace::stress`](super::HalfSpace::stress).
    #[must_use]
    pub fn superpose(
        &self,
        rule: &Rule,
        at: [f64; 3],
        field: impl Fn([f64; 3], [f64; 3]) -> f64,
    ) -> f64 {
        let [x, y, z] = at;
        self.loads(rule).map(|([lx, ly], force)| field(force, [x - lx, y - ly, z])).sum()
    }
}

/// Positive half of a Gauss–Legendre rule.
fn upper_half(n: usize) -> impl Iterator<Item = (f64, f64)> {
    legendre(n).into_iter().filter(|(c, _)| *c > 1e-12)
}

#[cfg(test)]
mod tests {
    use super::super::{HalfSpace, plane::Strip};
    use super::*;
    use core::f64::consts::FRAC_PI_2;

    const SKIN: (f64, f64) = (0.236, 0.5);

    fn skin() -> HalfSpace {
        HalfSpace::new(SKIN.0, SKIN.1)
    }

    fn rules() -> Vec<Rule> {
        let round = [Round::Hertz, Round::Punch, Round::Corner].map(|t| Rule::round(t, 5, 8));
        let strips = [Across::Line, Across::Block, Across::Cylinder, Across::Edge]
            .map(|t| Rule::strip(t, 4, 6));
        round.into_iter().chain(strips).chain([Rule::point()]).collect()
    }

    #[test]
    fn every_traction_carries_its_force() {
        // The sphere's shear in particular must sum to Q, and not to the 3Q of [TactileEnc] eq.
        // (3).
        let patch = Patch::disc([0.3, -0.2], 1.4, [0.4, -0.1, 1.2]);
        for rule in rules() {
            let sum = patch
                .loads(&rule)
                .fold([0.0; 3], |s, (_, f)| [s[0] + f[0], s[1] + f[1], s[2] + f[2]]);
            for (sum, force) in sum.iter().zip(patch.force) {
                assert!((sum - force).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn printed_shear_traction_carries_three_q() {
        // [TactileEnc] eq. (3): 3Q(a² − r²)^−½/2πa, by the midpoint rule in r = a sin t.
        let (a, q, n) = (1.7, 0.8, 1000);
        let printed = |r: f64| 3.0 * q / (2.0 * PI * a) / (a * a - r * r).sqrt();
        let step = FRAC_PI_2 / f64::from(n);
        let carried: f64 = (0..n)
            .map(|i| (f64::from(i) + 0.5) * step)
            .map(|t| printed(a * t.sin()) * TAU * a * t.sin() * a * t.cos() * step)
            .sum();
        assert!((carried / q - 3.0).abs() < 1e-5);
    }

    #[test]
    fn rings_have_the_moments_of_their_tractions() {
        // ∫ r^2k dA over Hertz: 1, 2/5, 8/35, 16/105; over the punch: 1, 2/3, 8/15, 16/35; over the
        // cone B(k + 1, ½)/2(k + 1), by parts.
        let moment = |traction, power| -> f64 {
            let rule = Rule::round(traction, 4, 3);
            rule.points().iter().map(|([x, y], share)| share * x.hypot(*y).powi(power)).sum()
        };
        for (power, hertz, punch, cone) in [
            (0, 1.0, 1.0, 1.0),
            (2, 2.0 / 5.0, 2.0 / 3.0, 1.0 / 3.0),
            (4, 8.0 / 35.0, 8.0 / 15.0, 8.0 / 45.0),
            (6, 16.0 / 105.0, 16.0 / 35.0, 4.0 / 35.0),
        ] {
            assert!((moment(Round::Hertz, power) - hertz).abs() < 1e-12);
            assert!((moment(Round::Punch, power) - punch).abs() < 1e-12);
            assert!((moment(Round::Corner, power) - cone).abs() < 1e-12);
        }
        // Across the edge B(k + ½, ½)/π(2k + 1).
        let rule = Rule::strip(Across::Edge, 1, 4);
        for (power, edge) in [(2, 1.0 / 6.0), (4, 3.0 / 40.0), (6, 5.0 / 112.0)] {
            let sum: f64 = rule.points().iter().map(|([_, v], share)| share * v.powi(power)).sum();
            assert!((sum - edge).abs() < 1e-12, "{power}: {sum}");
        }
    }

    #[test]
    fn flat_punch_matches_closed_form_on_axis() {
        // Johnson §3.8; the displacement goes to P/2aE* at the surface.
        let (a, p) = (1.2, 0.9);
        let skin = HalfSpace::new(0.236, 0.4);
        let rule = Rule::round(Round::Punch, 24, 1);
        let patch = Patch::disc([0.0; 2], a, [0.0, 0.0, p]);
        for z in [0.3, 1.0, 4.0] {
            let at = [0.0, 0.0, z];
            let s = z * z / (a * a);
            let stress = -p / (2.0 * PI * a * a) * (1.0 + 3.0 * s) / (1.0 + s).powi(2);
            let sum = patch.superpose(&rule, at, |f, at| skin.stress(f, at));
            assert!((sum / stress - 1.0).abs() < 1e-6, "{z}");
            let disc = z / (a * a + z * z) + 2.0 * 0.6 * (a / z).atan() / a;
            let displacement = p * disc / (4.0 * PI * skin.shear_modulus());
            let sum = patch.superpose(&rule, at, |f, at| skin.displacement(f, at));
            assert!((sum / displacement - 1.0).abs() < 1e-6, "{z}");
        }
    }

    #[test]
    fn long_strips_agree_with_plane_strain() {
        // A strip a hundred times as long as it is deep, at its middle; the missing ends are (z/l)²
        // of it.
        const LONG: f64 = 100.0;
        let skin = skin();
        let a = 0.8;
        for (across, strip) in [
            (Across::Line, Strip::Line { normal: 1.0, tangential: 0.0 }),
            (Across::Block, Strip::Block { normal: 1.0, half_width: a }),
            (Across::Cylinder, Strip::Cylinder { normal: 1.0, half_width: a }),
        ] {
            let rule = Rule::strip(across, 800, 24);
            let patch = Patch {
                centre: [0.0; 2],
                along: [0.0, LONG],
                across: [a, 0.0],
                force: [0.0, 0.0, 2.0 * LONG],
                torsion: 0.0,
            };
            for [x, z] in [[0.0, 1.5], [0.8, 1.0], [2.5, 1.5]] {
                let sum = patch.superpose(&rule, [x, 0.0, z], |f, at| skin.stress(f, at));
                assert!((sum / strip.stress(x, z) - 1.0).abs() < 1e-3, "{across:?} {x} {z}");
                let sum = patch.superpose(&rule, [x, 0.0, z], |f, at| skin.strain(f, at));
                let scale = strip.strain(&skin, 0.0, z).abs();
                assert!((sum - strip.strain(&skin, x, z)).abs() < 1e-3 * scale, "{across:?}");
            }
        }
    }

    #[test]
    fn cone_is_a_sum_of_punches() {
        // arcosh(a/r) = ∫ dt/√(t² − r²) from r to a: a punch of radius t carries 2t dt/a² of the
        // force.
        let skin = skin();
        let (slope, normal) = (0.3, 0.7);
        let a = skin.corner_radius(slope, normal);
        let displacement = |z: f64| -> f64 {
            let punches = legendre(100).into_iter().map(|(x, weight)| {
                let t = 0.5 * (x + 1.0) * a;
                let disc = z / (t * t + z * z) + (t / z).atan() / t;
                weight * t / a * disc
            });
            normal * punches.sum::<f64>() / (4.0 * PI * skin.shear_modulus())
        };
        // The tip of a rigid cone is ½πa·slope deep (Johnson §5.2).
        assert!((displacement(1e-9) / (FRAC_PI_2 * a * slope) - 1.0).abs() < 1e-6);
        let patch = Patch::disc([0.0; 2], a, [0.0, 0.0, normal]);
        for (rings, within) in [(2, 4e-2), (8, 2e-6), (16, 1e-9)] {
            let rule = Rule::round(Round::Corner, rings, 1);
            for z in [1.0, 2.5, 4.0] {
                let sum = patch.superpose(&rule, [0.0, 0.0, z], |f, at| skin.displacement(f, at));
                let error = (sum / displacement(z) - 1.0).abs();
                assert!(error < within, "{rings} rings, {z} mm: {error}");
            }
        }
    }

    #[test]
    fn crossed_cylinders_have_ellipse_moments() {
        // [TactileEnc] eq. (4): ⟨x²⟩ = a²/5 and ⟨y²⟩ = b²/5 over a Hertz ellipse.
        let (a, b) = (2.0, 0.7);
        let patch = Patch {
            along: [a, 0.0],
            across: [0.0, b],
            ..Patch::disc([0.0; 2], 1.0, [0.0, 0.0, 1.0])
        };
        let rule = Rule::round(Round::Hertz, 2, 4);
        let mean = |axis: usize| -> f64 {
            patch.loads(&rule).map(|(at, force)| at[axis] * at[axis] * force[2]).sum()
        };
        assert!((mean(0) - a * a / 5.0).abs() < 1e-12);
        assert!((mean(1) - b * b / 5.0).abs() < 1e-12);
    }

    #[test]
    fn deep_plane_carries_every_traction() {
        // ∫ σ_zz dA = −P, whatever the shear, by Gauss in the mapped polar angle.
        let skin = skin();
        let patch = Patch::disc([0.2, 0.1], 1.5, [0.3, 0.2, 1.0]);
        let (z, n, spokes) = (8.0, 24, 16);
        for rule in rules() {
            let mut carried = 0.0;
            for (t, weight) in legendre(n) {
                let angle = (t + 1.0) * PI / 4.0;
                let r = z * angle.tan();
                let ring = weight * PI / 4.0 * z / angle.cos().powi(2) * r * TAU / spokes as f64;
                for spoke in 0..spokes {
                    let (sin, cos) = (spoke as f64 * TAU / spokes as f64).sin_cos();
                    let at = [r * cos, r * sin, z];
                    carried -= ring * patch.superpose(&rule, at, |f, at| skin.stress(f, at));
                }
            }
            assert!((carried - 1.0).abs() < 5e-3, "{carried}");
        }
    }
}

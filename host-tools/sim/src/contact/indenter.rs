//! Rigid indenters: the size of their contact and the tractions they make.
//!
//! Friction carries at most μp at each point. A shear that grows on a contact already pressed slips
//! where more is needed and sticks elsewhere. On an incompressible skin the traction is then μ
//! times the pressure under P, less μ times the pressure under P − Q/μ. That holds for every
//! profile, round or long (Jäger 1998, Ciavarella 1998). On a sphere it is the solution of Cattaneo
//! and Mindlin (Johnson §7.2). A flat face keeps its size, so that it sticks all over until it
//! slides. The load history is not modelled: neither earlier loads nor shear that turns or falls.

use core::f64::consts::{FRAC_PI_2, PI};

use super::traction::{Across, Round};
use super::{HalfSpace, Patch, Rule};

/// Rigid indenter; lengths in mm, slopes as tangents, turns in radians from the x axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Indenter {
    /// A tip of zero size.
    Point,
    /// A sphere.
    Sphere {
        /// Radius of the sphere.
        radius: f64,
    },
    /// A round flat punch.
    Punch {
        /// Radius of its face.
        radius: f64,
    },
    /// A blunt corner, taken as a cone.
    Corner {
        /// Slope of its side from the skin.
        slope: f64,
    },
    /// A cylinder on its side; the pressure is even along it.
    Cylinder {
        /// Radius of the cylinder.
        radius: f64,
        /// Axis of the cylinder.
        axis: Axis,
    },
    /// A flat block.
    Block {
        /// Width of the block.
        width: f64,
        /// Axis of the block.
        axis: Axis,
    },
    /// A blunt edge, two faces of one slope.
    Edge {
        /// Slope of its faces from the skin.
        slope: f64,
        /// Axis of the edge.
        axis: Axis,
    },
}

/// Axis of a long indenter, in the plane of the skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Length along the axis.
    pub length: f64,
    /// Direction of the axis.
    pub turn: f64,
}

impl Indenter {
    /// Half the extent of the contact along and across, in mm, under `normal` newtons.
    #[must_use]
    pub fn half_extents(&self, skin: &HalfSpace, normal: f64) -> [f64; 2] {
        let round = |radius| [radius; 2];
        match *self {
            Self::Point => round(0.0),
            Self::Sphere { radius } => round(skin.contact_radius(radius, normal)),
            Self::Punch { radius } => round(radius),
            Self::Corner { slope } => round(skin.corner_radius(slope, normal)),
            Self::Cylinder { radius, axis: Axis { length, .. } } => {
                [0.5 * length, skin.contact_half_width(radius, normal / length)]
            }
            Self::Block { width, axis: Axis { length, .. } } => [0.5 * length, 0.5 * width],
            Self::Edge { slope, axis: Axis { length, .. } } => {
                [0.5 * length, skin.edge_half_width(slope, normal / length)]
            }
        }
    }

    /// Radius in mm of the circle around the contact under `normal` newtons.
    #[must_use]
    pub fn reach(&self, skin: &HalfSpace, normal: f64) -> f64 {
        let [along, across] = self.half_extents(skin, normal);
        match self {
            Self::Cylinder { .. } | Self::Block { .. } | Self::Edge { .. } => along.hypot(across),
            _ => along,
        }
    }

    /// Extent of the contact from its middle along x and along y, in mm, under `normal` newtons.
    #[must_use]
    pub fn sides(&self, skin: &HalfSpace, normal: f64) -> [f64; 2] {
        let [along, across] = self.half_extents(skin, normal);
        if matches!(self, Self::Cylinder { .. } | Self::Block { .. } | Self::Edge { .. }) {
            let [cos, sin] = [self.turn().cos().abs(), self.turn().sin().abs()];
            [along * cos + across * sin, along * sin + across * cos]
        } else {
            [along; 2]
        }
    }

    /// Radius of curvature of the face in mm; `None` unless sphere or cylinder.
    #[must_use]
    pub fn radius(&self) -> Option<f64> {
        match *self {
            Self::Sphere { radius } | Self::Cylinder { radius, .. } => Some(radius),
            _ => None,
        }
    }

    /// Depth in mm that the indenter sinks into the surface under `normal` newtons; `None` for a
    /// tip, which has no size.
    ///
    /// Johnson §3.8, §4.2, §5.2. For a long indenter the result is the depth at the middle, as the
    /// sum of lines of its length.
    #[must_use]
    pub fn indentation(&self, skin: &HalfSpace, normal: f64) -> Option<f64> {
        let modulus = skin.contact_modulus();
        let [along, across] = self.half_extents(skin, normal);
        match *self {
            Self::Point => None,
            _ if normal <= 0.0 => Some(0.0),
            Self::Sphere { radius } => Some(along * along / radius),
            Self::Punch { radius } => Some(normal / (2.0 * radius * modulus)),
            Self::Corner { slope } => Some(FRAC_PI_2 * along * slope),
            Self::Cylinder { .. } | Self::Block { .. } | Self::Edge { .. } => {
                // An even number of lines puts none in the middle, where the depth would be
                // infinite.
                let lines = self.rule(64, 1);
                let line = |([_, v], share): &([f64; 2], f64)| {
                    share * (along / (across * v)).abs().asinh()
                };
                Some(normal / (PI * modulus * along) * lines.points().iter().map(line).sum::<f64>())
            }
        }
    }

    /// Tractions under `force` (N, z into the skin) and `torsion` (N mm) about the normal at
    /// `centre` (mm).
    ///
    /// One or two patches, for the rules of this indenter. The traction of the torsion is spread as
    /// p·r; under a flat punch that is sticking all over (Johnson §3.9). Below a round contact on a
    /// half-space it displaces nothing vertically, however it is spread.
    #[must_use]
    pub fn tractions(
        &self,
        skin: &HalfSpace,
        centre: [f64; 2],
        force: [f64; 3],
        torsion: f64,
        mu: f64,
    ) -> [Option<Patch>; 2] {
        let [qx, qy, normal] = force;
        let patch = |normal: f64, force: [f64; 3], torsion: f64| {
            let [along, across] = self.half_extents(skin, normal);
            let (sin, cos) = self.turn().sin_cos();
            Patch {
                centre,
                along: [along * cos, along * sin],
                across: [-across * sin, across * cos],
                force,
                torsion,
            }
        };
        let (shear, held) = (qx.hypot(qy), mu * normal);
        if shear <= 0.0 || shear >= held || self.is_flat() {
            return [Some(patch(normal, force, torsion)), None];
        }
        let spare = held - shear;
        let [x, y] = [qx / shear, qy / shear];
        [
            Some(patch(normal, [x * held, y * held, normal], torsion)),
            Some(patch(normal * (spare / held), [-x * spare, -y * spare, 0.0], 0.0)),
        ]
    }

    /// Largest torsion in N mm that friction carries under `normal` newtons: μ∫p r dA.
    #[must_use]
    pub fn torsion_held(&self, skin: &HalfSpace, normal: f64, mu: f64) -> f64 {
        let [patch, _] = self.tractions(skin, [0.0; 2], [0.0, 0.0, normal], 0.0, mu);
        let rule = self.rule(3, 16);
        let lever = |patch: Patch| -> f64 {
            patch.loads(&rule).map(|([x, y], [.., p])| p * x.hypot(y)).sum()
        };
        mu * patch.map_or(0.0, lever)
    }

    /// Quadrature rule for this indenter's traction.
    ///
    /// Over a disc it has `rings` and `spokes`; over a strip, `rings` points across and `spokes`
    /// along.
    #[must_use]
    pub fn rule(&self, rings: usize, spokes: usize) -> Rule {
        match self {
            Self::Point => Rule::point(),
            Self::Sphere { .. } => Rule::round(Round::Hertz, rings, spokes),
            Self::Punch { .. } => Rule::round(Round::Punch, rings, spokes),
            Self::Corner { .. } => Rule::round(Round::Corner, rings, spokes),
            Self::Cylinder { .. } => Rule::strip(Across::Cylinder, spokes, rings),
            Self::Block { .. } => Rule::strip(Across::Block, spokes, rings),
            Self::Edge { .. } => Rule::strip(Across::Edge, spokes, rings),
        }
    }

    /// Whether the contact has the same size under any force.
    fn is_flat(&self) -> bool {
        matches!(self, Self::Point | Self::Punch { .. } | Self::Block { .. })
    }

    fn turn(&self) -> f64 {
        match self {
            Self::Cylinder { axis, .. } | Self::Block { axis, .. } | Self::Edge { axis, .. } => {
                axis.turn
            }
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Facets;
    use super::*;
    use proptest::prelude::*;

    const SPHERE: Indenter = Indenter::Sphere { radius: 6.0 };

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
    fn shear_sticks_inside_and_slips_in_annulus() {
        let skin = HalfSpace::new(0.236, 0.5);
        let (mu, normal) = (0.8, 1.0);
        let shear = 0.5 * mu * normal;
        let patches = SPHERE.tractions(&skin, [0.0; 2], [shear, 0.0, normal], 0.0, mu);
        let [a, c] = patches.map(|patch| patch.unwrap().along[0]);
        assert!((c / a - 0.5f64.cbrt()).abs() < 1e-12);
        for i in 1..100 {
            let r = a * f64::from(i) / 100.0;
            let used = use_of_friction(&patches, mu, r);
            if r < c { assert!(used < 1.0) } else { assert!((used - 1.0).abs() < 1e-12) }
        }
        // The part that sticks has moved as one: u_x under such a disc is πq₀/32Gr·[4(2 − ν)r² − (4
        // − 3ν)x² − (4 − ν)y²] (Johnson §7.1).
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

    const AXIS: Axis = Axis { length: 8.0, turn: 0.4 };
    const ALL: [Indenter; 7] = [
        Indenter::Point,
        SPHERE,
        Indenter::Punch { radius: 1.5 },
        Indenter::Corner { slope: 0.5 },
        Indenter::Cylinder { radius: 6.0, axis: AXIS },
        Indenter::Block { width: 2.0, axis: AXIS },
        Indenter::Edge { slope: 0.5, axis: AXIS },
    ];

    #[test]
    fn every_indenter_carries_force_and_torsion() {
        let (skin, centre) = (HalfSpace::new(0.236, 0.5), [1.0, 2.0]);
        let force = [0.3, -0.2, 1.1];
        for indenter in ALL {
            let torsion = if indenter == Indenter::Point { 0.0 } else { 0.7 };
            let patches = indenter.tractions(&skin, centre, force, torsion, 0.6);
            let rule = indenter.rule(3, 8);
            let (mut sum, mut moment) = ([0.0; 3], 0.0);
            for (at, f) in patches.iter().flatten().flat_map(|patch| patch.loads(&rule)) {
                sum = [sum[0] + f[0], sum[1] + f[1], sum[2] + f[2]];
                moment += (at[0] - centre[0]) * f[1] - (at[1] - centre[1]) * f[0];
            }
            let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{indenter:?}: {a} {b}");
            sum.iter().zip(force).for_each(|(sum, force)| near(*sum, force));
            near(moment, torsion);
        }
    }

    #[test]
    fn long_indenters_stick_within_jaeger_zone() {
        // Cylinder: c = a√(1 − Q/μP) (Johnson §7.2); edge: c = a(1 − Q/μP).
        let skin = HalfSpace::new(0.236, 0.5);
        let across = |patch: Patch| patch.across[0].hypot(patch.across[1]);
        for (indenter, share) in [
            (Indenter::Cylinder { radius: 6.0, axis: AXIS }, 0.5f64.sqrt()),
            (Indenter::Edge { slope: 0.5, axis: AXIS }, 0.5),
        ] {
            let patches = indenter.tractions(&skin, [0.0; 2], [0.0, 0.4, 1.0], 0.0, 0.8);
            let [a, c] = patches.map(|patch| across(patch.unwrap()));
            assert!((c / a - share).abs() < 1e-12, "{indenter:?}: {}", c / a);
        }
    }

    #[test]
    fn indentation_matches_surface_displacement() {
        // Just below the indenter, so that no point load falls on the place.
        let (skin, depth) = (HalfSpace::new(0.236, 0.5), 0.05);
        for indenter in ALL {
            let found = indenter.indentation(&skin, 1.1);
            assert_eq!(found.is_none(), indenter == Indenter::Point);
            let Some(found) = found else { continue };
            let [patch, _] = indenter.tractions(&skin, [0.0; 2], [0.0, 0.0, 1.1], 0.0, 0.8);
            let below = |f: [f64; 3], at: [f64; 3]| skin.displacement(f, at);
            let rule = indenter.rule(40, 240);
            let surface = patch.unwrap().superpose(&rule, [0.0, 0.0, depth], below);
            assert!(
                (found / surface - 1.0).abs() < 0.05,
                "{indenter:?}: {found} mm for {surface} mm"
            );
            assert_eq!(indenter.indentation(&skin, 0.0), Some(0.0));
        }
    }

    #[test]
    fn torsion_displaces_only_below_long_contacts() {
        let skin = HalfSpace::new(0.236, 0.5);
        let facets = Facets::new(skin, 2.5, 1.9, 4);
        let most = |indenter: Indenter| {
            let [patch, _] = indenter.tractions(&skin, [0.4, -0.3], [0.0, 0.0, 1.0], 1.0, 0.8);
            let twisted = patch.map(|patch| Patch { force: [0.0; 3], ..patch });
            let displacement = facets.displacement(&indenter.rule(16, 48), &twisted);
            displacement.iter().fold(0.0f64, |m, u| m.max(u.abs()))
        };
        // The rest under a round indenter is the error of the rule, which has a finite number of
        // spokes.
        for indenter in [SPHERE, ALL[2], ALL[3]] {
            assert!(most(indenter) < 1e-7, "{indenter:?}: {}", most(indenter));
        }
        for indenter in [ALL[4], ALL[5], ALL[6]] {
            assert!(most(indenter) > 1e-3, "{indenter:?}: {}", most(indenter));
        }
    }

    proptest! {
        #[test]
        fn tractions_stay_within_friction(
            qx in -1.0..1.0f64, qy in -1.0..1.0f64, normal in 0.01..3.0f64, mu in 0.0..1.5f64,
        ) {
            let held = mu * normal;
            let scale = (held / qx.hypot(qy)).min(1.0);
            let force = [qx * scale, qy * scale, normal];
            let skin = HalfSpace::new(0.236, 0.5);
            let patches = SPHERE.tractions(&skin, [1.0, 2.0], force, 0.0, mu);
            for (axis, force) in force.iter().enumerate() {
                let sum: f64 = patches.iter().flatten().map(|p| p.force[axis]).sum();
                prop_assert!((sum - force).abs() < 1e-9);
            }
            let turned = SPHERE.tractions(&skin, [0.0; 2], [scale * qx.hypot(qy), 0.0, normal], 0.0, mu);
            if mu > 0.01 {
                for i in 0..50 {
                    let r = turned[0].unwrap().along[0] * f64::from(i) / 50.0;
                    prop_assert!(use_of_friction(&turned, mu, r) < 1.0 + 1e-9);
                }
            }
        }
    }
}

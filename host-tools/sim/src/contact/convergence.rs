//! Convergence of superposed point loads to the closed forms of [TactileEnc].
//!
//! A strip is integrated along its whole line, so that plane strain is a result and no assumption.

use core::f64::consts::{FRAC_PI_2, TAU};

use super::gauss::legendre;
use super::plane::Strip;
use super::sphere::Hertz;
use super::traction::{Across, Round};
use super::{HalfSpace, Patch, Rule};

/// Contact with a closed form in [TactileEnc], of the size and force of a usual touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Case {
    /// A line load, normal and tangential.
    Line,
    /// A flat block.
    Block,
    /// A cylinder.
    Cylinder,
    /// A sphere.
    Sphere,
}

/// Points under the contact: x from the axis and depth z, in mm.
pub const ON_AXIS: [[f64; 2]; 2] = [[0.0, 0.8], [0.0, 2.5]];
/// Points under the rim and outside the contact: x from the axis and depth z, in mm.
pub const OFF_AXIS: [[f64; 2]; 3] = [[1.3, 0.8], [0.9, 2.5], [3.0, 1.5]];

/// Half the width of the contacts in mm.
const A: f64 = 1.3;
/// Normal load: N/mm for a strip, N for the sphere.
const NORMAL: f64 = 1.0;
const TANGENTIAL: f64 = 0.6;

impl Case {
    /// All four contacts.
    pub const ALL: [Self; 4] = [Self::Line, Self::Block, Self::Cylinder, Self::Sphere];

    /// Relative error of superposition at x, z with `n` points in each direction.
    ///
    /// The larger of the errors of σ_zz and ε_zz counts.
    #[must_use]
    pub fn error(self, skin: &HalfSpace, [x, z]: [f64; 2], n: usize) -> f64 {
        let (stress, strain) = self.closed(skin, x, z);
        let loads = self.loads(x.hypot(z), n);
        let sum = |field: &dyn Fn([f64; 3], [f64; 3]) -> f64| -> f64 {
            loads.iter().map(|([lx, ly], force)| field(*force, [x - lx, -ly, z])).sum()
        };
        let stressed = sum(&|force, at| skin.stress(force, at));
        let strained = sum(&|force, at| skin.strain(force, at));
        (stressed / stress - 1.0).abs().max((strained / strain - 1.0).abs())
    }

    fn closed(self, skin: &HalfSpace, x: f64, z: f64) -> (f64, f64) {
        let strip = match self {
            Self::Line => Strip::Line { normal: NORMAL, tangential: TANGENTIAL },
            Self::Block => Strip::Block { normal: NORMAL, half_width: A },
            Self::Cylinder => Strip::Cylinder { normal: NORMAL, half_width: A },
            Self::Sphere => {
                let hertz = Hertz { radius: A, normal: NORMAL };
                return (hertz.stress(x, z), hertz.strain(skin, x, z));
            }
        };
        (strip.stress(x, z), strip.strain(skin, x, z))
    }

    /// Point loads that replace the contact, for a field point `reach` mm from its axis.
    fn loads(self, reach: f64, n: usize) -> Vec<([f64; 2], [f64; 3])> {
        let across = match self {
            Self::Line => Across::Line,
            Self::Block => Across::Block,
            Self::Cylinder => Across::Cylinder,
            Self::Sphere => {
                let patch = Patch::disc([0.0; 2], A, [0.0, 0.0, NORMAL]);
                return patch.loads(&Rule::round(Round::Hertz, n, 4 * n)).collect();
            }
        };
        let tangential = if self == Self::Line { TANGENTIAL } else { 0.0 };
        let rule = Rule::strip(across, 1, n);
        let points = rule.points().iter().map(|([_, v], share)| (A * v, share));
        points
            .flat_map(|(x, share)| {
                whole_line(reach, n).map(move |(y, length)| {
                    ([x, y], [tangential, 0.0, NORMAL].map(|f| f * share * length))
                })
            })
            .collect()
    }
}

/// Nodes on an infinite line and the length that each represents: Gauss's rule in the angle.
fn whole_line(reach: f64, n: usize) -> impl Iterator<Item = (f64, f64)> {
    legendre(n).into_iter().map(move |(t, weight)| {
        let (tan, cos) = ((t * FRAC_PI_2).tan(), (t * FRAC_PI_2).cos());
        (reach * tan, weight * TAU / 4.0 * reach / (cos * cos))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places() -> impl Iterator<Item = [f64; 2]> {
        ON_AXIS.into_iter().chain(OFF_AXIS)
    }

    fn skins() -> [HalfSpace; 2] {
        [0.5, 0.3].map(|poisson| HalfSpace::new(0.236, poisson))
    }

    #[test]
    fn superposition_converges_to_closed_forms() {
        for skin in skins() {
            for case in Case::ALL {
                for place in places() {
                    let [rough, fine] = [20, 64].map(|n| case.error(&skin, place, n));
                    assert!(rough < 1e-3, "{case:?} {place:?}: {rough}");
                    assert!(fine < 1e-9, "{case:?} {place:?}: {fine}");
                }
            }
        }
    }

    #[test]
    fn doubling_points_divides_error_by_128() {
        const ROUND_OFF: f64 = 1e-12;
        for case in Case::ALL {
            for place in places() {
                let errors = [8, 16, 32].map(|n| case.error(&skins()[0], place, n));
                for pair in errors.windows(2) {
                    let order = (pair[0] / pair[1]).log2();
                    assert!(order > 7.0 || pair[1] < ROUND_OFF, "{case:?} {place:?}: {errors:?}");
                }
            }
        }
    }
}

//! Limit surface by the method of [Ospina2017], computed for each load.
//!
//! The contact turns about a centre, and every element of its area resists its motion with μp. The
//! centre is moved until force and torsion have the required ratio.
//!
//! The true motion maximises the dissipated work, so that a small error of the centre has only a
//! second-order effect on the load. A few steps suffice.

use core::f32::consts::FRAC_1_SQRT_2;

use crate::math::{inverse_sqrt, power, sqrt};

/// Radii r/a and weights r dr of Gauss's rule for r = sin t, t from 0 to ½π. The substitution
/// resolves the steep rim.
const RADII: [[f32; 2]; 5] = [
    [0.073_620, 0.008_698],
    [0.354_599, 0.079_346],
    [FRAC_1_SQRT_2, 0.142_222],
    [0.935_018, 0.079_346],
    [0.997_286, 0.008_698],
];
/// Cosines and sines of the centres of six parts of half a turn; the other half is its mirror
/// image.
const TURNS: [[f32; 2]; 6] = [
    [0.965_926, 0.258_819],
    [FRAC_1_SQRT_2, FRAC_1_SQRT_2],
    [0.258_819, 0.965_926],
    [-0.258_819, 0.965_926],
    [-FRAC_1_SQRT_2, FRAC_1_SQRT_2],
    [-0.965_926, 0.258_819],
];
/// Steps of the search for the centre.
const STEPS: usize = 3;

/// Limit surface of one kind of contact, as a pressure to integrate, normalised by the friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    /// Coefficients c in mm/N^γ and γ of a = c·N^γ.
    radius: [f32; 2],
    /// Share of the normal force at each point of its ring.
    shares: [f32; RADII.len()],
    /// Coefficient κ: the greatest torsion over μ·N·a.
    torque: f32,
}

impl Sweep {
    /// Makes the surface of a power-law pressure.
    ///
    /// p(r) ∝ (1 − (r/a)^k)^(1/k), a = c·N^γ mm; k is clamped to ½ … 100.
    #[must_use]
    pub fn power_law(k: f32, radius: [f32; 2]) -> Self {
        let k = if k.is_nan() { 2.0 } else { k.clamp(0.5, 100.0) };
        let mut shares = RADII.map(|[r, weight]| weight * power(1.0 - power(r, k), 1.0 / k));
        let whole = TURNS.len() as f32 * shares.iter().sum::<f32>();
        shares.iter_mut().for_each(|share| *share /= whole);
        let mut sweep = Self { radius, shares, torque: 1.0 };
        [_, sweep.torque] = sweep.held([0.0, 1.0]);
        sweep
    }

    /// Returns the load relative to the limit, as [`super::LimitSurface::load`] does.
    #[must_use]
    pub fn load(&self, [fx, fy]: [f32; 2], torsion: f32, normal: f32, mu: f32) -> f32 {
        let [c, gamma] = self.radius;
        let holds = mu * normal;
        let turns = self.torque * holds * c * power(normal, gamma);
        if ![holds, turns].iter().all(|most| (1e-9..1e9).contains(most)) {
            return 1.0;
        }
        let asked = [sqrt(fx * fx + fy * fy) / holds, torsion.abs() / turns];
        let Some((way, length)) = unit(asked) else { return 0.0 };
        if length > 1e9 {
            return 1e9;
        }
        // On a circle the contact would move in the direction of the load.
        let (mut moves, mut work) = (way, 1.0);
        for _ in 0..STEPS {
            let [force, torsion] = self.held([moves[0], moves[1] / self.torque]);
            let held = [force, torsion / self.torque];
            work = dot(way, moves) / dot(held, moves).max(0.1);
            let Some((holding, _)) = unit(held) else { break };
            let moved = [moves[0] + way[0] - holding[0], moves[1] + way[1] - holding[1]];
            let Some((next, _)) = unit(moved.map(|part| part.max(0.0))) else { break };
            moves = next;
        }
        length * work.max(0.0)
    }

    /// Returns force over μN and torsion over μNa of a disc of radius 1. The disc moves at `along`
    /// and turns at `turning`.
    fn held(&self, [along, turning]: [f32; 2]) -> [f32; 2] {
        let (mut force, mut torsion) = (0.0, 0.0);
        for ([radius, _], share) in RADII.iter().zip(&self.shares) {
            for [cosine, sine] in &TURNS {
                let (x, y) = (radius * cosine, radius * sine);
                let (u, v) = (along + turning * x, turning * y);
                let weight = share * inverse_sqrt(u * u + v * v);
                force += weight * u;
                torsion += weight * (x * u + y * v);
            }
        }
        [force, torsion]
    }
}

fn dot([a, b]: [f32; 2], [c, d]: [f32; 2]) -> f32 {
    a * c + b * d
}

/// Returns direction and length; `None` for a vector without a direction.
fn unit(v: [f32; 2]) -> Option<([f32; 2], f32)> {
    let square = dot(v, v);
    (square > f32::MIN_POSITIVE).then(|| {
        let inverse = inverse_sqrt(square);
        (v.map(|part| part * inverse), square * inverse)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f32::consts::PI;
    use proptest::prelude::*;

    #[test]
    fn sweep_ends_at_coulomb_friction_and_first_moment() {
        let (sweep, normal, mu) = (Sweep::power_law(2.0, [1.5, 1.0 / 3.0]), 1.2, 0.7);
        let most = 3.0 * PI / 16.0 * mu * normal * 1.5 * f32::cbrt(normal);
        assert!((sweep.load([0.0, mu * normal], 0.0, normal, mu) - 1.0).abs() < 1e-3);
        assert!((sweep.load([0.0; 2], -most, normal, mu) - 1.0).abs() < 1e-3);
        assert_eq!(sweep.load([0.0; 2], 0.0, normal, mu), 0.0);
        assert_eq!(sweep.load([0.1, 0.0], 0.0, 0.0, mu), 1.0, "nothing holds without normal force");
    }

    proptest! {
        #[test]
        fn load_is_proportional_to_traction(
            shear in 0.01..1.0f32, torsion in 0.01..1.0f32, turn in -3.0..3.0f32, k in 1.0..9.0f32,
        ) {
            let sweep = Sweep::power_law(k, [1.5, 0.3]);
            let once = sweep.load([shear, 0.0], torsion, 1.0, 0.6);
            let twice = [2.0 * shear * turn.cos(), 2.0 * shear * turn.sin()];
            let twice = sweep.load(twice, -2.0 * torsion, 1.0, 0.6);
            prop_assert!((twice / once - 2.0).abs() < 1e-3, "{once} {twice}");
        }

        #[test]
        fn load_is_finite(
            shear in any::<[f32; 2]>(), torsion in any::<f32>(), normal in any::<f32>(),
            mu in any::<f32>(), k in any::<f32>(), radius in any::<[f32; 2]>(),
        ) {
            let load = Sweep::power_law(k, radius).load(shear, torsion, normal, mu);
            prop_assert!(load.is_finite(), "{load}");
        }
    }
}

//! Limit surface of a power-law pressure, by quadrature ([Ospina2017], chapter 3).

use std::f64::consts::{PI, TAU};

use taxel::estimate::limit_surface::{INTERVALS, LimitSurface};

/// Number of quadrature points along the radius and around it.
const RADII: usize = 64;
const TURNS: usize = 128;
/// Number of centres of rotation, from the middle of the contact to far away.
const CENTRES: usize = 400;

/// Limit surface of a contact of radius a = c·N^γ mm with pressure p(r) ∝ (1 − (r/a)^k)^(1/k).
#[must_use]
pub fn power_law(k: f64, c: f64, gamma: f64) -> LimitSurface {
    let curve = sweep(k);
    let torque = curve.first().map_or(1.0, |(_, torsion)| *torsion);
    // Ratio of the curve's radius to the ellipse's, over the force's share of the squared radius.
    let bulges: Vec<(f64, f64)> = curve
        .iter()
        .map(|(force, torsion)| {
            let (f2, t2) = (force * force, (torsion / torque).powi(2));
            (f2 / (f2 + t2), (f2 + t2).sqrt())
        })
        .collect();
    let at = |share: f64| {
        let next = bulges.partition_point(|(s, _)| *s < share).clamp(1, bulges.len() - 1);
        let ((s0, b0), (s1, b1)) = (bulges[next - 1], bulges[next]);
        if s1 > s0 { b0 + (b1 - b0) * (share - s0) / (s1 - s0) } else { b0 }
    };
    LimitSurface {
        radius: [c as f32, gamma as f32],
        torque: torque as f32,
        curve: std::array::from_fn(|i| at(i as f64 / INTERVALS as f64) as f32),
    }
}

/// Force over μN and torsion over μNa for centres of rotation ever farther from the middle.
///
/// The curve goes from (0, κ) to (1, 0).
#[must_use]
pub fn sweep(k: f64) -> Vec<(f64, f64)> {
    let cells = cells(k);
    let at = |i: usize| {
        // tan spreads the centres from the middle to infinity.
        let away = (0.5 * PI * i as f64 / CENTRES as f64).tan();
        let (mut force, mut torsion) = (0.0, 0.0);
        for (x, y, share) in &cells {
            let (arm, speed) = (x - away, (x - away).hypot(*y));
            if speed > 0.0 {
                force -= share * arm / speed;
                torsion += share * (x * arm + y * y) / speed;
            }
        }
        (force, torsion)
    };
    (0..CENTRES).map(at).chain([(1.0, 0.0)]).collect()
}

/// Positions on the unit disc and their shares of the normal force.
fn cells(k: f64) -> Vec<(f64, f64, f64)> {
    let mut cells = Vec::with_capacity(RADII * TURNS);
    for i in 0..RADII {
        // r = sin t resolves the steep rim of the pressure.
        let t = (i as f64 + 0.5) / RADII as f64 * 0.5 * PI;
        let (r, dr) = (t.sin(), t.cos());
        let share = (1.0 - r.powf(k)).powf(1.0 / k) * r * dr;
        for j in 0..TURNS {
            let turn = (j as f64 + 0.5) * TAU / TURNS as f64;
            cells.push((r * turn.cos(), r * turn.sin(), share));
        }
    }
    let total: f64 = cells.iter().map(|(_, _, share)| share).sum();
    cells.iter_mut().for_each(|(_, _, share)| *share /= total);
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn largest_torsion_equals_first_moment_of_pressure() {
        // ∫p r dA/(N a): ⅔ for an even pressure (k → ∞), 3π/16 for Hertz's (k = 2).
        assert!((sweep(2.0)[0].1 - 3.0 * PI / 16.0).abs() < 1e-4);
        assert!((sweep(200.0)[0].1 - 2.0 / 3.0).abs() < 2e-3);
    }

    #[test]
    fn sweep_falls_from_pure_torsion_to_pure_shear() {
        for k in [1.8, 2.0, 3.0, 8.0] {
            let curve = sweep(k);
            assert!(curve.windows(2).all(|p| p[1].0 > p[0].0 - 1e-9 && p[1].1 < p[0].1 + 1e-9));
            assert!(curve[0].0.abs() < 1e-9);
        }
    }
}

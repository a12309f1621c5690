//! Displacement of a layer at one spatial frequency, through its thickness.
//!
//! A layer of thickness h is displaced by u_x = iU(z)e^{ikx}, u_z = W(z)e^{ikx}. Navier's equation
//! leaves four constants (κ = 3 − 4ν, s = kz, t = k(z − h); Johnson's half-space solution and its
//! mirror image):
//!
//! W = (A + Bs)e^{−s} + (C + Dt)e^{t}, U = (−A − B(s − κ))e^{−s} + (C + D(t + κ))e^{t},
//!
//! with tractions σ_zz = N e^{ikx} and τ_xz = iT e^{ikx}. Nothing is singular at ν = ½. Across the
//! wave, the layer is in pure shear: u_y ∝ cosh kz above a free surface.

/// Wave of one frequency in a layer; tractions are over the shear modulus.
#[derive(Clone, Copy, Debug)]
pub struct Wave {
    k: f64,
    thickness: f64,
    poisson: f64,
    /// The constants A, B, C, D.
    constants: [f64; 4],
}

impl Wave {
    /// Creates a wave of wave number `k` per mm from its boundary values.
    ///
    /// The values are T and N at the upper face, and U and W at the lower one.
    pub fn new(k: f64, thickness: f64, poisson: f64, upper: [f64; 2], lower: [f64; 2]) -> Self {
        let wave = Self { k, thickness, poisson, constants: [0.0; 4] };
        let ([t, n], [u, w]) = (wave.tractions_at(0.0), wave.displacements_at(thickness));
        let rows = [(t, upper[0]), (n, upper[1]), (u, lower[0]), (w, lower[1])];
        Self { constants: solve(rows.map(|(row, _)| row), rows.map(|(_, value)| value)), ..wave }
    }

    /// U and W at depth `z` mm.
    pub fn displacement(&self, z: f64) -> [f64; 2] {
        self.displacements_at(z).map(|row| dot(&row, &self.constants))
    }

    /// T and N at depth `z` mm.
    pub fn traction(&self, z: f64) -> [f64; 2] {
        self.tractions_at(z).map(|row| dot(&row, &self.constants))
    }

    fn displacements_at(&self, z: f64) -> [[f64; 4]; 2] {
        let (s, t, kappa) = (self.k * z, self.k * (z - self.thickness), 3.0 - 4.0 * self.poisson);
        let (down, up) = ((-s).exp(), t.exp());
        [[-down, -(s - kappa) * down, up, (t + kappa) * up], [down, s * down, up, t * up]]
    }

    fn tractions_at(&self, z: f64) -> [[f64; 4]; 2] {
        let (s, t, k) = (self.k * z, self.k * (z - self.thickness), 2.0 * self.k);
        let (down, up) = (k * (-s).exp(), k * t.exp());
        let (normal, shear) = (1.0 - 2.0 * self.poisson, 2.0 - 2.0 * self.poisson);
        [
            [down, (s - shear) * down, up, (t + shear) * up],
            [-down, (normal - s) * down, up, (normal + t) * up],
        ]
    }
}

fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Solves four linear equations by Gauss elimination with row pivots.
fn solve(mut rows: [[f64; 4]; 4], mut values: [f64; 4]) -> [f64; 4] {
    for column in 0..4 {
        let size = |row: usize| rows[row][column].abs();
        let pivot = (column..4).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(column);
        rows.swap(column, pivot);
        values.swap(column, pivot);
        for row in column + 1..4 {
            let factor = rows[row][column] / rows[column][column];
            let lead = rows[column];
            rows[row].iter_mut().zip(lead).for_each(|(v, p)| *v -= factor * p);
            values[row] -= factor * values[column];
        }
    }
    let mut x = [0.0; 4];
    for row in (0..4).rev() {
        let known: f64 = (row + 1..4).map(|i| rows[row][i] * x[i]).sum();
        x[row] = (values[row] - known) / rows[row][row];
    }
    x
}

/// Bessel function J_n(x): Bessel's integral by the trapezoidal rule.
///
/// The rule is exact to round-off once it has a few more points than x + n.
pub fn bessel(n: usize, x: f64) -> f64 {
    let points = 2 * ((x.abs() as usize + n) / 2 + 16);
    let sum: f64 = (0..points)
        .map(|i| (i as f64 + 0.5) * core::f64::consts::PI / points as f64)
        .map(|t| (n as f64 * t - x * t.sin()).cos())
        .sum();
    sum / points as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wave_meets_its_boundary_values() {
        for (k, poisson) in [(0.05, 0.5), (0.8, 0.5), (0.8, 0.2), (30.0, 0.5)] {
            let wave = Wave::new(k, 2.5, poisson, [0.3, -0.7], [0.2, 0.9]);
            let (upper, lower) = (wave.traction(0.0), wave.displacement(2.5));
            for (found, asked) in upper.iter().chain(&lower).zip([0.3, -0.7, 0.2, 0.9]) {
                assert!((found - asked).abs() < 1e-9, "{k}: {upper:?} {lower:?}");
            }
        }
    }

    #[test]
    fn forces_balance_inside_the_layer() {
        // ∂σ_zz/∂z + ∂τ_xz/∂x = 0: N′ = kT.
        let wave = Wave::new(0.9, 2.5, 0.4, [0.3, -0.7], [0.2, 0.9]);
        for z in [0.4, 1.2, 2.2] {
            let slope = (wave.traction(z + 1e-5)[1] - wave.traction(z - 1e-5)[1]) / 2e-5;
            assert!((slope - 0.9 * wave.traction(z)[0]).abs() < 1e-7);
        }
    }

    #[test]
    fn thick_layer_surface_equals_half_space() {
        // W(0) = (1 − ν)p/Gk (Johnson §13.1 for a wavy pressure).
        let wave = Wave::new(1.3, 40.0, 0.3, [0.0, -1.0], [0.0, 0.0]);
        assert!((wave.displacement(0.0)[1] - 0.7 / 1.3).abs() < 1e-12);
    }

    #[test]
    fn bessel_matches_recurrence_and_known_values() {
        assert!((bessel(0, 1.0) - 0.765_197_686_557_966_6).abs() < 1e-14);
        assert!((bessel(1, 10.0) - 0.043_472_746_168_861_44).abs() < 1e-14);
        for x in [0.3, 4.0, 77.0] {
            let sum = bessel(2, x) + bessel(4, x);
            assert!((sum - 6.0 / x * bessel(3, x)).abs() < 1e-13);
        }
    }
}

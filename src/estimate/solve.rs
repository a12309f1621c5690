//! Solver of small symmetric positive definite systems in a fixed number of steps.
#![expect(
    clippy::indexing_slicing,
    clippy::needless_range_loop,
    reason = "matrix algebra: every index runs over 0..n of arrays of at least n"
)]

use crate::math::inverse_sqrt;

/// Normal equations A·x = b of a least-squares problem in `N` unknowns. A is the sum of the outer
/// products of the rows.
#[derive(Clone, Copy, Debug)]
pub struct Normal<const N: usize> {
    /// Matrix A; only its lower triangle is used.
    pub matrix: [[f32; N]; N],
    /// Right-hand side b.
    pub right: [f32; N],
}

impl<const N: usize> Normal<N> {
    /// Equations without any row.
    pub const EMPTY: Self = Self { matrix: [[0.0; N]; N], right: [0.0; N] };

    /// Adds a row of the Jacobian and its residual.
    #[inline]
    pub fn add(&mut self, row: &[f32; N], residual: f32) {
        for i in 0..N {
            // A constant bound lets the compiler unroll the loop: half the cycles of `0..=i`.
            for j in 0..N {
                if j <= i {
                    self.matrix[i][j] += row[i] * row[j];
                }
            }
            self.right[i] += row[i] * residual;
        }
    }

    /// Adds `weight` to the diagonal, like an observation of each unknown at its present value.
    pub fn damp(&mut self, weight: &[f32; N]) {
        for i in 0..N {
            self.matrix[i][i] += weight[i];
        }
    }

    /// Returns x and the diagonal of A⁻¹ (the variances, up to the noise's). Returns `None` if A is
    /// not positive definite to the accuracy of f32.
    #[must_use]
    pub fn solve(mut self) -> Option<([f32; N], [f32; N])> {
        let (mut x, mut diagonal) = (self.right, [0.0; N]);
        solve(&mut self.matrix, &mut x, &mut diagonal).then_some((x, diagonal))
    }
}

/// Solves in place: x in `right`, the diagonal of A⁻¹ in `diagonal`.
#[inline(never)]
fn solve<const N: usize>(
    matrix: &mut [[f32; N]; N],
    right: &mut [f32; N],
    diagonal: &mut [f32; N],
) -> bool {
    // A = L·Lᵀ; L replaces A, with 1/L_ii in place of L_ii.
    let l = matrix;
    for i in 0..N {
        for j in 0..i {
            let mut sum = l[i][j];
            for k in 0..j {
                sum -= l[i][k] * l[j][k];
            }
            l[i][j] = sum * l[j][j];
        }
        let mut sum = l[i][i];
        for k in 0..i {
            sum -= l[i][k] * l[i][k];
        }
        let positive = sum > f32::EPSILON * l[i][i] && sum > f32::MIN_POSITIVE;
        if !positive {
            return false;
        }
        l[i][i] = inverse_sqrt(sum);
    }
    for i in 0..N {
        for k in 0..i {
            right[i] -= l[i][k] * right[k];
        }
        right[i] *= l[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            right[i] -= l[k][i] * right[k];
        }
        right[i] *= l[i][i];
    }
    // A⁻¹ = L⁻ᵀ·L⁻¹: the squared norms of the columns of L⁻¹.
    for j in 0..N {
        let mut column = [0.0; N];
        column[j] = l[j][j];
        diagonal[j] = column[j] * column[j];
        for i in j + 1..N {
            let mut sum = 0.0;
            for k in j..i {
                sum -= l[i][k] * column[k];
            }
            column[i] = sum * l[i][i];
            diagonal[j] += column[i] * column[i];
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solution_and_inverse_diagonal_are_exact(
            rows in proptest::array::uniform8(proptest::array::uniform4(-1.0..1.0f32)),
            right in proptest::array::uniform8(-1.0..1.0f32),
        ) {
            let mut normal = Normal::<4>::EMPTY;
            rows.iter().zip(right).for_each(|(row, b)| normal.add(row, b));
            normal.damp(&[0.1; 4]);
            let (x, diagonal) = normal.solve().unwrap();
            let entry = |i: usize, j: usize| normal.matrix[i.max(j)][i.min(j)];
            for i in 0..4 {
                let sum: f32 = (0..4).map(|j| entry(i, j) * x[j]).sum();
                prop_assert!((sum - normal.right[i]).abs() < 1e-4);
                let mut unit = Normal::<4> { right: [0.0; 4], ..normal };
                unit.right[i] = 1.0;
                let (column, _) = unit.solve().unwrap();
                prop_assert!((column[i] - diagonal[i]).abs() < 1e-3 * diagonal[i]);
            }
        }
    }

    #[test]
    fn singular_system_is_refused() {
        let mut normal = Normal::<3>::EMPTY;
        normal.add(&[1.0, 2.0, 0.5], 1.0);
        assert_eq!(normal.solve(), None);
        normal.matrix[0][0] = f32::NAN;
        assert_eq!(normal.solve(), None);
    }
}

//! Least squares about a kept linearisation.
//!
//! Slopes of the displacements by six unknowns, and the inverse of their normal matrix, stay the
//! same while the contact stays within the reach that their user allows. A step with them needs
//! nothing but the present residuals, which are exact. The remaining error of such a step is the
//! slopes' error times the step, and the next scan's residuals show it again.

use core::ops::Range;

use crate::scan::TAXELS;

/// Unknowns of a sheared contact, and of two contacts without shear.
pub const UNKNOWNS: usize = 6;
/// Values of the unknowns, or of something that belongs to each.
pub type Six = [f32; UNKNOWNS];

/// Slopes of all displacements at one contact, and the inverse of their normal matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Linearised {
    /// Derivatives of each displacement.
    pub slopes: [Six; TAXELS],
    /// Weights of the prior: squared ratios of the residual's standard deviation to the prior's.
    pub weights: Six,
    /// (JᵀJ + weights)⁻¹.
    inverse: [Six; UNKNOWNS],
}

impl Linearised {
    /// Calculates the inverse from `slopes` and `weights`. Only the unknowns `sought` have slopes;
    /// the others stay as they are. Returns false if the matrix is not positive definite to the
    /// accuracy of f32.
    #[must_use]
    #[inline(never)]
    pub fn renew(&mut self, sought: Range<usize>) -> bool {
        let mut matrix = [[0.0; UNKNOWNS]; UNKNOWNS];
        // One row of sums at a time fits into the registers; both triangles cost less than a
        // condition.
        for (i, (sums, weight)) in matrix.iter_mut().zip(&self.weights).enumerate() {
            let mut row = [0.0; UNKNOWNS];
            if sought.contains(&i) {
                for slopes in &self.slopes {
                    let own = slopes.get(i).copied().unwrap_or(0.0);
                    for (sum, slope) in row.iter_mut().zip(slopes) {
                        *sum += own * slope;
                    }
                }
            }
            if let Some(own) = row.get_mut(i) {
                *own += weight;
            }
            *sums = row;
        }
        self.inverse = matrix;
        invert(&mut self.inverse, sought)
    }

    /// Returns the step that explains the residuals `left` best. `pull` is the gradient of the
    /// prior, [`Self::weights`] times the way to its mean.
    ///
    /// The second value is what the step takes from the sum of the squared residuals where `pull`
    /// is zero, and about that where the displacements tell more than the prior.
    #[must_use]
    #[inline(never)]
    pub fn step(&self, left: &[f32; TAXELS], pull: &Six) -> (Six, f32) {
        let mut gradient = [0.0; UNKNOWNS];
        for (row, left) in self.slopes.iter().zip(left) {
            for (sum, slope) in gradient.iter_mut().zip(row) {
                *sum += slope * left;
            }
        }
        let mut drawn = gradient;
        for (sum, pull) in drawn.iter_mut().zip(pull) {
            *sum += pull;
        }
        let step = self.inverse.map(|row| dot(&row, &drawn));
        (step, dot(&step, &gradient))
    }

    /// Returns the variances of the unknowns in units of the residual's variance.
    #[must_use]
    pub fn variances(&self) -> Six {
        diagonal(&self.inverse)
    }

    /// Returns by how much two more observations change the last unknown of `step`, and its
    /// variance then.
    ///
    /// The observations are of the first and the second unknown, each plus `lean` times the third.
    /// They miss the present values by `missed`, and their weight is `weight`. (A + RᵀR)⁻¹ follows
    /// from A⁻¹ by Woodbury's identity with a matrix of 2 × 2.
    #[must_use]
    pub fn refine(&self, step: &Six, lean: [f32; 2], missed: [f32; 2], weight: f32) -> (f32, f32) {
        let [r0, r1, r2, .., last] = &self.inverse;
        let [c00, c01, c02, ..] = *r0;
        let [_, c11, c12, ..] = *r1;
        let [_, _, c22, ..] = *r2;
        let [l0, l1, l2, .., own] = *last;
        let ([a, b], [d0, d1, d2, ..]) = (lean, *step);
        let noise = 1.0 / weight;
        let m00 = noise + c00 + a * (2.0 * c02 + a * c22);
        let m01 = c01 + b * c02 + a * (c12 + b * c22);
        let m11 = noise + c11 + b * (2.0 * c12 + b * c22);
        let [k0, k1] = [l0 + a * l2, l1 + b * l2];
        let [e0, e1] = [missed[0] - d0 - a * d2, missed[1] - d1 - b * d2];
        let whole = m00 * m11 - m01 * m01;
        // Observations that rounding has made the same one say nothing new.
        if !(whole > f32::EPSILON * m00 * m11 && whole < f32::MAX) {
            return (0.0, own);
        }
        let whole = 1.0 / whole;
        let [g0, g1] = [(m11 * k0 - m01 * k1) * whole, (m00 * k1 - m01 * k0) * whole];
        (g0 * e0 + g1 * e1, own - g0 * k0 - g1 * k1)
    }
}

fn diagonal(matrix: &[Six; UNKNOWNS]) -> Six {
    let mut rows = matrix.iter().enumerate();
    [0.0; UNKNOWNS].map(|_| rows.next().and_then(|(i, row)| row.get(i)).copied().unwrap_or(0.0))
}

fn dot(a: &Six, b: &Six) -> f32 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b)
}

/// Inverts a symmetric positive definite matrix in place by Gauss–Jordan elimination, which needs
/// no exchange of rows then. Rows but those `sought` stay. Returns false if a pivot is lost in
/// rounding.
fn invert(matrix: &mut [Six; UNKNOWNS], sought: Range<usize>) -> bool {
    let before = diagonal(matrix);
    for (k, before) in before.iter().enumerate() {
        if !sought.contains(&k) {
            continue;
        }
        let Some(row) = matrix.get_mut(k) else { return false };
        let Some(own) = row.get_mut(k) else { return false };
        let pivot = core::mem::replace(own, 1.0);
        if !(pivot > f32::EPSILON * before && pivot < f32::MAX) {
            return false;
        }
        let scale = 1.0 / pivot;
        let scaled = row.map(|value| value * scale);
        *row = scaled;
        for (i, other) in matrix.iter_mut().enumerate() {
            if i == k || !sought.contains(&i) {
                continue;
            }
            let Some(below) = other.get_mut(k) else { return false };
            let factor = core::mem::take(below);
            for (value, scaled) in other.iter_mut().zip(&scaled) {
                *value -= factor * scaled;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn six() -> impl Strategy<Value = Six> {
        proptest::array::uniform6(-1.0..1.0f32)
    }

    fn linearised(slopes: [Six; TAXELS]) -> Linearised {
        let mut kept = Linearised { slopes, weights: [0.1; UNKNOWNS], ..Linearised::default() };
        assert!(kept.renew(0..UNKNOWNS));
        kept
    }

    fn normal(kept: &Linearised, i: usize, j: usize) -> f32 {
        let own = if i == j { kept.weights[i] } else { 0.0 };
        kept.slopes.iter().fold(own, |sum, row| sum + row[i] * row[j])
    }

    proptest! {
        #[test]
        fn step_solves_normal_equations(
            slopes in proptest::array::uniform16(six()),
            left in proptest::array::uniform16(-1.0..1.0f32),
            pull in six(),
        ) {
            let kept = linearised(slopes);
            let (step, explained) = kept.step(&left, &pull);
            let mut by_hand = 0.0;
            for i in 0..UNKNOWNS {
                let gradient: f32 = slopes.iter().zip(&left).map(|(row, left)| row[i] * left).sum();
                let sum: f32 = (0..UNKNOWNS).map(|j| normal(&kept, i, j) * step[j]).sum();
                prop_assert!((sum - gradient - pull[i]).abs() < 1e-3, "{sum} {gradient}");
                by_hand += step[i] * gradient;
            }
            prop_assert!((explained - by_hand).abs() < 1e-3);
        }

        #[test]
        fn refined_unknown_is_that_of_all_observations(
            slopes in proptest::array::uniform16(six()),
            left in proptest::array::uniform16(-1.0..1.0f32),
            lean in proptest::array::uniform2(-1.0..1.0f32),
            missed in proptest::array::uniform2(-1.0..1.0f32),
            weight in 0.01..10.0f32,
        ) {
            let kept = linearised(slopes);
            let (step, _) = kept.step(&left, &[0.0; UNKNOWNS]);
            let (more, variance) = kept.refine(&step, lean, missed, weight);
            // The two observations as rows in place of two that are left out of the sixteen.
            let rows = [
                [1.0, 0.0, lean[0], 0.0, 0.0, 0.0].map(|slope: f32| slope * weight.sqrt()),
                [0.0, 1.0, lean[1], 0.0, 0.0, 0.0].map(|slope: f32| slope * weight.sqrt()),
            ];
            let mut all = kept;
            (0..UNKNOWNS).for_each(|i| (0..UNKNOWNS).for_each(|j| {
                all.inverse[i][j] = normal(&kept, i, j) + rows.iter().map(|r| r[i] * r[j]).sum::<f32>();
            }));
            prop_assert!(invert(&mut all.inverse, 0..UNKNOWNS));
            let pull: Six = core::array::from_fn(|i| {
                rows.iter().zip(missed).map(|(r, missed)| r[i] * missed * weight.sqrt()).sum()
            });
            let (known, _) = all.step(&left, &pull);
            prop_assert!((step[5] + more - known[5]).abs() < 2e-3, "{} {}", step[5] + more, known[5]);
            prop_assert!((variance - all.variances()[5]).abs() < 2e-3 * all.variances()[5].max(1.0));
        }
    }

    #[test]
    fn singular_system_is_refused() {
        let mut kept = Linearised::default();
        kept.slopes[0] = [1.0, 2.0, 0.5, 0.0, 0.0, 0.0];
        assert!(!kept.renew(0..UNKNOWNS));
        // Numbers that are no exact binaries leave a pivot of rounding.
        kept.slopes = [[0.1, 0.3, 0.7, 1.1, 1.3, 1.7]; TAXELS];
        assert!(!kept.renew(0..UNKNOWNS));
        kept.slopes[0][0] = f32::NAN;
        assert!(!kept.renew(0..UNKNOWNS));
    }
}

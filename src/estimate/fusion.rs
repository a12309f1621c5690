//! Fusion of two estimates of one quantity, weighted by their inverse variances.

/// A value with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian {
    /// The value.
    pub value: f32,
    /// Standard deviation, positive.
    pub sigma: f32,
}

/// Largest distance of two estimates that agree, in standard deviations of their difference.
const AGREEMENT: f32 = 6.0;

/// Returns the mean of `a` and `b` weighted by their inverse variances, and whether they agree. If
/// they contradict each other, the result is the more certain one alone.
#[must_use]
#[inline]
pub fn fuse(a: Gaussian, b: Gaussian) -> (Gaussian, bool) {
    /// Keeps the sum of the variances from zero: a µN or nm, squared.
    const LEAST: f32 = 1e-12;
    let [va, vb] = [a, b].map(|of| of.sigma * of.sigma + LEAST);
    let apart = a.value - b.value;
    let both = va + vb;
    // A sum or a distance that overflows is a contradiction too.
    if !(apart * apart <= AGREEMENT * AGREEMENT * both && both < f32::MAX) {
        return (if va <= vb { a } else { b }, false);
    }
    // b + (a − b)·v_b/(v_a + v_b): the weight lies between 0 and 1 for all variances.
    let share = vb / both;
    let sigma = crate::math::sqrt(va * share);
    (Gaussian { value: b.value + apart * share, sigma }, true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const fn of(value: f32, sigma: f32) -> Gaussian {
        Gaussian { value, sigma }
    }

    #[test]
    fn fusion_weighs_by_inverse_variance() {
        let (fused, agree) = fuse(of(1.0, 0.01), of(1.02, 0.02));
        assert!(agree);
        assert!((fused.value - 1.004).abs() < 1e-6 && fused.sigma < 0.01, "{fused:?}");
    }

    #[test]
    fn contradicting_estimates_are_not_averaged() {
        let (surer, other) = (of(1.0, 0.01), of(0.5, 0.03));
        assert_eq!(fuse(other, surer), (surer, false));
    }

    proptest! {
        #[test]
        fn finite_estimates_stay_finite(a in -1e30..1e30f32, b in -1e30..1e30f32, sa in any::<f32>(), sb in any::<f32>()) {
            prop_assume!(sa.is_finite() && sb.is_finite());
            let (fused, _) = fuse(of(a, sa), of(b, sb));
            prop_assert!(fused.value.is_finite() && fused.sigma.is_finite());
        }
    }
}

//! Gauss quadrature rules: highest polynomial degree for a number of points.

use core::f64::consts::PI;

/// Points and weights of the Gauss–Legendre rule on \[−1, 1\]: roots of P_n by Newton's method from
/// Tricomi's estimate.
pub fn legendre(n: usize) -> Vec<(f64, f64)> {
    let polynomial = |x: f64| {
        let (mut before, mut now) = (0.0, 1.0);
        for k in 1..=n {
            let k = k as f64;
            (before, now) = (now, ((2.0 * k - 1.0) * x * now - (k - 1.0) * before) / k);
        }
        (now, n as f64 * (x * now - before) / (x * x - 1.0))
    };
    (0..n)
        .map(|i| {
            let mut x = -(PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
            for _ in 0..8 {
                let (value, slope) = polynomial(x);
                x -= value / slope;
            }
            let (_, slope) = polynomial(x);
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// Gauss rule with `n` points for the weight arcosh(1/v)·v^power on (0, 1).
///
/// The rule is exact for 1, v² … v^(4n − 2). The recurrence of the orthogonal polynomials in s = v²
/// comes from Stieltjes's procedure. The weight is sampled by the double exponential rule, because
/// its logarithm and its root do not disturb that rule.
pub fn arcosh(n: usize, power: f64) -> Vec<(f64, f64)> {
    let step = 1.0 / (4 * n + 32) as f64;
    let reach = (4.0 / step) as i32;
    let samples = (-reach..=reach).map(|i| {
        let t = f64::from(i) * step;
        let e = (PI * t.sinh()).exp();
        let (s, rest) = (e / (1.0 + e), 1.0 / (1.0 + e));
        let bent = (1.0 + rest.sqrt()).ln() - 0.5 * s.ln();
        (s, bent * s.powf(0.5 * (power - 1.0)) * s * rest * t.cosh())
    });
    // Each sample: position, weight, and the previous and current polynomial.
    let mut samples: Vec<_> = samples.map(|(s, weight)| (s, weight, 0.0, 1.0)).collect();
    let mut recurrence: Vec<[f64; 3]> = vec![];
    for _ in 0..n {
        let (norm, first) =
            samples.iter().fold((0.0, 0.0), |(norm, first), (s, weight, _, now)| {
                (norm + weight * now * now, first + weight * s * now * now)
            });
        let mean = first / norm;
        let fall = recurrence.last().map_or(0.0, |[.., before]| norm / before);
        for (s, _, before, now) in &mut samples {
            (*before, *now) = (*now, (*s - mean) * *now - fall * *before);
        }
        recurrence.push([mean, fall, norm]);
    }
    // The polynomial of degree k at s, and the sum of the squares of the lower ones over their
    // norms.
    let polynomial = |k: usize, s: f64| {
        let lower = recurrence.iter().take(k);
        let start = (0.0, 1.0, 0.0);
        let (_, value, squares) =
            lower.fold(start, |(before, now, squares), [mean, fall, norm]| {
                (now, (s - mean) * now - fall * before, squares + now * now / norm)
            });
        (value, squares)
    };
    // The roots of each polynomial lie between those of the previous one.
    let mut roots: Vec<f64> = vec![];
    for k in 1..=n {
        let ends: Vec<f64> = [0.0].into_iter().chain(roots).chain([1.0]).collect();
        let between = ends.iter().zip(ends.iter().skip(1)).map(|(low, high)| {
            let (mut low, mut high) = (*low, *high);
            let below = polynomial(k, low).0.signum();
            for _ in 0..54 {
                let middle = 0.5 * (low + high);
                let side =
                    if polynomial(k, middle).0.signum() == below { &mut low } else { &mut high };
                *side = middle;
            }
            0.5 * (low + high)
        });
        roots = between.collect();
    }
    roots.into_iter().map(|s| (s.sqrt(), 1.0 / polynomial(n, s).1)).collect()
}

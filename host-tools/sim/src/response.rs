//! Dynamic response of a force sensor, or of rubber like its coating ([Ospina2017] §1.3.3, §1.4.3).
//!
//! The published transfer functions are sampled exactly. The only approximation is a first-order
//! hold: between two frames the force is a straight line. The two states then move by the
//! exponential of their matrix.

use serde::Deserialize;

/// Coating of the force sensors; `coating` of `[device]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum Coating {
    /// The bare sensor, T1 = T2 = 1.99 ms.
    ///
    /// 53.9 Hz are damped by 3.26 dB, as in the Bode diagram of D12 ([Ospina2017] fig. 1.17).
    #[default]
    #[serde(rename = "bare")]
    Bare,
    /// Polyurethane, Shore 40: T1 = T2 = 2.18 ms (fig. 1.23).
    #[serde(rename = "rA")]
    A,
    /// Polyurethane, Shore 40: T1 = T2 = 1.98 ms (fig. 1.23).
    #[serde(rename = "rB")]
    B,
    /// Polyurethane, Shore 80, which relaxes.
    #[serde(rename = "rC")]
    C,
    /// Polyurethane, Shore 80, which relaxes.
    #[serde(rename = "rD")]
    D,
    /// The whole assembly, which relaxes.
    #[serde(rename = "F02")]
    F02,
}

impl Coating {
    /// Share of a force along x, y and z that the membrane takes.
    ///
    /// The coating carries the rest past the membrane.
    ///
    /// The thesis states that coated sensors bear 10 N (§1.5). Bare ones bear 1 N along the skin
    /// and 15 bar, which are 4.7 N on the membrane. The shares are the ratios of these limits.
    /// Coatings with a wide base, rC and F02, are less sensitive along the skin (§1.6); half is an
    /// assumption.
    #[must_use]
    pub fn takes(self) -> [f64; 3] {
        let [narrow, wide, normal] = [0.1, 0.05, 0.47];
        match self {
            Self::Bare => [1.0; 3],
            Self::A | Self::B | Self::D => [narrow, narrow, normal],
            Self::C | Self::F02 => [wide, wide, normal],
        }
    }

    /// Coefficients a₁ … a₄ of (a₁s + a₂)/(s² + a₃s + a₄).
    ///
    /// The values are from [Ospina2017] eq. (1.26), fig. 1.23, and eq. (1.25) in the same form.
    #[must_use]
    pub fn coefficients(self) -> [f64; 4] {
        let critical = |t: f64| [0.0, 1.0 / (t * t), 2.0 / t, 1.0 / (t * t)];
        match self {
            Self::Bare => critical(1.99e-3),
            Self::A => critical(2.18e-3),
            Self::B => critical(1.98e-3),
            Self::C => [242.4, 192.4, 243.7, 192.5],
            Self::D => [233.3, 368.5, 237.0, 368.7],
            Self::F02 => [202.4, 337.8, 214.8, 340.2],
        }
    }
}

/// Response of `N` independent channels.
#[derive(Clone, Debug)]
pub struct Response<const N: usize> {
    /// Matrix from the states, the force and its change to the next states.
    step: [[f64; 4]; 2],
    /// Weights of the states in the output force.
    output: [f64; 2],
    coefficients: [f64; 4],
    channels: [Channel; N],
}

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    states: [f64; 2],
    acted: f64,
}

impl<const N: usize> Response<N> {
    /// Creates a response at rest, with `period` seconds between frames.
    #[must_use]
    pub fn new(coating: Coating, period: f64) -> Self {
        let coefficients = coating.coefficients();
        let mut response = Self {
            step: [[0.0; 4]; 2],
            output: [0.0; 2],
            coefficients,
            channels: [Channel::default(); N],
        };
        response.set_period(period);
        response
    }

    /// Sets the time between frames to `period` seconds.
    pub fn set_period(&mut self, period: f64) {
        let [a1, a2, a3, a4] = self.coefficients;
        // x₁′ = x₂, x₂′ = u − a₄x₁ − a₃x₂, out = a₂x₁ + a₁x₂; u′ = v/period with v the change of u.
        let slopes =
            [[0.0, 1.0, 0.0, 0.0], [-a4, -a3, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0 / period], [0.0; 4]];
        let [first, second, ..] = exponential(slopes.map(|row| row.map(|v| v * period)));
        (self.step, self.output) = ([first, second], [a2, a1]);
    }

    /// Output one frame later, from the applied forces.
    pub fn follow(&mut self, acts: [f64; N]) -> [f64; N] {
        let (step, output) = (self.step, self.output);
        let mut sensed = [0.0; N];
        for ((channel, acts), sensed) in self.channels.iter_mut().zip(acts).zip(&mut sensed) {
            let [x1, x2] = channel.states;
            let from = [x1, x2, channel.acted, acts - channel.acted];
            channel.states = step.map(|row| row.iter().zip(from).map(|(m, v)| m * v).sum());
            channel.acted = acts;
            *sensed = channel.states.iter().zip(output).map(|(x, c)| x * c).sum();
        }
        sensed
    }
}

/// Matrix exponential e^M: Taylor's series of M/2ⁿ, squared n times.
fn exponential(matrix: [[f64; 4]; 4]) -> [[f64; 4]; 4] {
    let most = matrix.as_flattened().iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let halvings = (8.0 * most.max(1.0)).log2().ceil() as i32;
    let small = matrix.map(|row| row.map(|v| v * 0.5f64.powi(halvings)));
    let mut term = IDENTITY;
    let mut sum = IDENTITY;
    for n in 1..=16 {
        term = product(&term, &small).map(|row| row.map(|v| v / f64::from(n)));
        sum.as_flattened_mut().iter_mut().zip(term.as_flattened()).for_each(|(s, t)| *s += t);
    }
    (0..halvings).fold(sum, |power, _| product(&power, &power))
}

const IDENTITY: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn product(a: &[[f64; 4]; 4], b: &[[f64; 4]; 4]) -> [[f64; 4]; 4] {
    a.map(|row| {
        core::array::from_fn(|column| {
            row.iter().zip(b).map(|(v, of)| v * of.get(column).copied().unwrap_or(0.0)).sum()
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const RELAXING: [Coating; 3] = [Coating::C, Coating::D, Coating::F02];

    /// Gain in dB of a sine of `hertz`, from its sine and cosine parts over whole periods.
    fn damping(coating: Coating, hertz: f64) -> f64 {
        const RATE: f64 = 20_000.0;
        let mut response = Response::new(coating, 1.0 / RATE);
        let settled = (5.0 * RATE) as usize;
        let frames = (40.0 / hertz * RATE).round() as usize;
        let (mut sine, mut cosine) = (0.0, 0.0);
        for i in 0..settled + frames {
            let angle = TAU * hertz * i as f64 / RATE;
            let sensed = response.follow([0.0, 0.0, angle.sin()])[2];
            if i >= settled {
                sine += sensed * angle.sin();
                cosine += sensed * angle.cos();
            }
        }
        20.0 * f64::log10(2.0 * f64::hypot(sine, cosine) / frames as f64)
    }

    #[test]
    fn response_meets_published_bode_points() {
        // [Ospina2017] fig. 1.17 and 1.24: D12, rB and F02.
        for (coating, hertz, published) in
            [(Coating::Bare, 53.9, -3.26), (Coating::B, 54.3, -3.27), (Coating::F02, 29.6, -2.92)]
        {
            let found = damping(coating, hertz);
            assert!((found - published).abs() < 0.03, "{coating:?}: {found} dB");
        }
    }

    fn step(coating: Coating, seconds: f64) -> Vec<f64> {
        let mut response = Response::new(coating, 1e-3);
        (0..(seconds * 1000.0) as usize).map(|_| response.follow([0.5, 0.0, 1.0])[2]).collect()
    }

    #[test]
    fn soft_coatings_settle_in_ten_milliseconds() {
        // The settling times of its figures use a band of ± 5 % (fig. 1.16).
        const RATE: f64 = 100_000.0;
        let settled = |coating: Coating, band: f64| {
            let mut response = Response::new(coating, 1.0 / RATE);
            let sensed: Vec<f64> = (0..3000).map(|_| response.follow([1.0])[0]).collect();
            assert!(sensed.windows(2).all(|pair| pair[1] >= pair[0]), "{coating:?} overshoots");
            sensed.iter().filter(|f| **f < 1.0 - band).count() as f64 / RATE * 1e3
        };
        // The rest of a step is (1 + t/T)e^−t/T: 5 % of it after 4.744 T, 2 % after 5.834 T.
        let left = |x: f64| (1.0 + x) * (-x).exp();
        let times = [(0.05, 4.744), (0.02, 5.834)];
        assert!(times.iter().all(|(band, x)| (left(*x) / band - 1.0).abs() < 1e-3));
        for (coating, t) in [(Coating::Bare, 1.99), (Coating::A, 2.18), (Coating::B, 1.98)] {
            for (band, x) in times {
                let found = settled(coating, band);
                assert!((found - x * t).abs() < 0.02, "{coating:?}: {found} ms to {band}");
            }
            let found = settled(coating, 0.05);
            assert!((found / 10.0 - 1.0).abs() < 0.07, "{coating:?}: {found} ms");
        }
    }

    #[test]
    fn relaxing_coatings_settle_in_given_times() {
        // Settling into ± 5 % of the final value of each (fig. 1.23 and 1.25, which print no
        // times), and around the force, of which F02 keeps 0.7 % less.
        const RATE: f64 = 100_000.0;
        for (coating, of_final, of_force) in
            [(Coating::C, 12.5, 12.5), (Coating::D, 13.5, 13.5), (Coating::F02, 22.9, 31.5)]
        {
            let [_, a2, _, a4] = coating.coefficients();
            let mut response = Response::new(coating, 1.0 / RATE);
            let sensed: Vec<f64> = (0..10_000).map(|_| response.follow([1.0])[0]).collect();
            for (end, published) in [(a2 / a4, of_final), (1.0, of_force)] {
                let outside = sensed.iter().rposition(|f| (f / end - 1.0).abs() > 0.05).unwrap();
                let found = outside as f64 / RATE * 1e3;
                assert!((found - published).abs() < 0.1, "{coating:?}: {found} ms");
            }
        }
    }

    #[test]
    fn relaxing_coatings_creep_to_final_value() {
        for coating in RELAXING {
            let [_, a2, _, a4] = coating.coefficients();
            let sensed = step(coating, 20.0);
            assert!((sensed[19_999] - a2 / a4).abs() < 1e-6, "{coating:?}");
            assert!((sensed[100] - sensed[19_999]).abs() > 1e-3, "{coating:?} creeps");
        }
    }

    #[test]
    fn sampling_is_exact_for_a_ramp_at_any_rate() {
        // The hold is exact for a ramp: slow and fast frames agree at common times.
        for coating in [Coating::A, Coating::F02] {
            let at = |rate: usize| {
                let mut response = Response::new(coating, 1.0 / rate as f64);
                (0..rate / 2)
                    .fold(0.0, |_, i| response.follow([0.0, 0.0, (i + 1) as f64 / rate as f64])[2])
            };
            assert!((at(10) - at(10_000)).abs() < 1e-9, "{coating:?}");
        }
    }
}

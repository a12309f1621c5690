//! Matrix of OHKA-MICRO above one [feeler](taxel_papers::feeler) ([Ohka2005]).
//!
//! The 4×4 matrix replaces the paper's camera. It looks through the paper's window of 460 µm and
//! out of focus, so that each phototransistor weighs light by a hat function two pitches wide. Hats
//! add up to one everywhere between the outer centres, and their centroid is that of the light. The
//! sum over the matrix is therefore G, and the centroid is u times 2.5 mm/[`PITCH_MM`], exactly,
//! for any spot. In a lit step the edge light is on and one row is read; in a dark step the light
//! is off.

use rand_distr::{Distribution as _, StandardNormal};
use taxel::scan::{COLS, ROWS, TAXELS};
use taxel_papers::feeler::{shift, threshold};

use crate::contact::Rule;
use crate::contact::traction::Round;
use crate::scene::{Effect, Scene};
use crate::seeds::{Purpose, stream};

/// Young's modulus of the sheet in MPa.
const YOUNG_MPA: f64 = 0.476;
/// Poisson's ratio of the sheet.
const POISSON: f64 = 0.499;
/// Slope of the cone: 100 µm high over 150 µm.
const SLOPE: f64 = 100.0 / 150.0;

/// Distance on the board in mm between the places that neighbouring phototransistors look at.
///
/// The spot stays between the outer ones, 240 µm from the middle, as it stays in the paper's
/// window.
pub const PITCH_MM: f64 = 0.16;
/// Light per normal force, G over F_z or 1/C, in full scales per newton.
///
/// 12 mN half-way between two phototransistors give each three quarters of the range.
pub const LIGHT_PER_NEWTON: f64 = 125.0;
/// Light that the board itself scatters while the edge is lit, in full scales.
pub const BACKGROUND: f64 = 0.03;
/// Relative spread of gain between phototransistors of one die, one standard deviation.
const GAIN_SPREAD: f64 = 0.01;
/// Offset of the matrix's middle from the feeler's tip, one standard deviation in mm.
const MISALIGNMENT_MM: f64 = 0.005;

/// The bright spot under one feeler.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spot {
    /// Integrated light G, in full scales.
    pub light: f64,
    /// Shift of its centroid in mm.
    pub shift: [f64; 2],
    /// Radius of contact in mm.
    pub radius: f64,
}

impl Spot {
    /// Spot under a feeler that carries `force` in newtons, z towards the board.
    ///
    /// Shear without a normal force leaves no spot.
    #[must_use]
    pub fn under([fx, fy, fz]: [f64; 3]) -> Self {
        if fz <= 0.0 {
            return Self::default();
        }
        let holds = threshold(fz);
        Self {
            light: LIGHT_PER_NEWTON * fz,
            shift: [shift(fx, holds), shift(fy, holds)],
            radius: contact_radius(fz),
        }
    }
}

/// Contact radius in mm of a cone pressed on a plane (Sneddon 1965): P = (π/2)·E*·a²·slope.
fn contact_radius(normal: f64) -> f64 {
    let reduced = YOUNG_MPA / (1.0 - POISSON * POISSON);
    (2.0 * normal / (std::f64::consts::PI * reduced * SLOPE)).sqrt()
}

/// The matrix of a device, looking at one feeler.
#[derive(Clone, Debug)]
pub struct Feeler {
    gains: [f64; TAXELS],
    /// Offset of the spot at rest, in mm.
    offset: [f64; 2],
    /// Distribution of a spot's light: the cone's pressure over its contact.
    spot: Rule,
}

impl Feeler {
    /// Creates the matrix of the scene's device.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let mut feeler =
            Self { gains: [1.0; TAXELS], offset: [0.0; 2], spot: Rule::round(Round::Corner, 2, 8) };
        if scene.has(Effect::GainSpread) {
            let mut rng = stream(scene.device.seed, Purpose::GainSpread);
            let mut draw = |sigma: f64| -> f64 {
                let unit: f64 = StandardNormal.sample(&mut rng);
                sigma * unit.clamp(-3.0, 3.0)
            };
            feeler.gains.iter_mut().for_each(|gain| *gain += draw(GAIN_SPREAD));
            feeler.offset = [draw(MISALIGNMENT_MM), draw(MISALIGNMENT_MM)];
        }
        feeler
    }

    /// Light on each phototransistor above the dark, in full scales, with `spot` on the board.
    #[must_use]
    pub fn light(&self, spot: &Spot) -> [f64; TAXELS] {
        let mut light = self.gains.map(|gain| gain * BACKGROUND);
        if spot.light <= 0.0 {
            return light;
        }
        let [ux, uy] = [spot.shift[0] + self.offset[0], spot.shift[1] + self.offset[1]];
        for (at, share) in self.spot.points() {
            let [x, y] = [ux + spot.radius * at[0], uy + spot.radius * at[1]];
            let [along, across] = [x, y].map(|x| hats(x / PITCH_MM));
            let seen = across.iter().flat_map(|v| along.iter().map(move |u| u * v));
            for ((light, gain), seen) in light.iter_mut().zip(&self.gains).zip(seen) {
                *light += gain * spot.light * share * seen;
            }
        }
        light
    }
}

/// Weights with which the four phototransistors of a row see a point `x` pitches from the middle.
fn hats(x: f64) -> [f64; COLS] {
    const { assert!(ROWS == COLS) };
    [-1.5, -0.5, 0.5, 1.5].map(|centre: f64| (1.0 - (x - centre).abs()).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use taxel_papers::feeler::{ALPHA, GAMMA_N, LINEAR_N, SLIDING, STICKING};

    fn feeler() -> Feeler {
        let text = "[scan]\nrate_hz = 1000\nduration_s = 1\n";
        Feeler::new(&Scene::parse("test.toml", text).unwrap())
    }

    /// Integral G and the centroid in mm, from the sixteen readings.
    fn read(feeler: &Feeler, spot: &Spot) -> (f64, [f64; 2]) {
        let rest = feeler.light(&Spot::default());
        let light = feeler.light(spot);
        let gained: Vec<f64> = light.iter().zip(rest).map(|(now, rest)| now - rest).collect();
        let sum: f64 = gained.iter().sum();
        let at = |place: &dyn Fn(usize) -> usize| -> f64 {
            let moment = |(k, g): (usize, &f64)| (place(k) as f64 - 1.5) * PITCH_MM * g;
            gained.iter().enumerate().map(moment).sum::<f64>() / sum
        };
        (sum, [at(&|k| k % COLS), at(&|k| k / COLS)])
    }

    #[test]
    fn bilinear_law_matches_corrected_paper() {
        let fz = 6.5e-3;
        let holds = ALPHA * fz + GAMMA_N;
        for fx in [0.2e-3, 1.9e-3, 2.5e-3, 10e-3] {
            let u = Spot::under([fx, 0.0, fz]).shift[0];
            let sticks = STICKING * u;
            let slips = SLIDING * u + (1.0 - SLIDING / STICKING) * holds;
            let found = if fx < holds { sticks } else { slips };
            assert!((found - fx).abs() < 1e-15, "{fx}");
            // αF_x + γ in the bracket, as printed, gives another force.
            let printed = SLIDING * u + (1.0 - SLIDING / STICKING) * (ALPHA * fx + GAMMA_N);
            assert!(fx < holds || (printed - fx).abs() > 0.05 * fx);
        }
    }

    #[test]
    fn paper_window_contains_every_spot() {
        // Contact radius by Sneddon's cone; F_z as in fig. 12, F_x up to 10 mN; the window is 460
        // µm.
        for fz in [2.2e-3, 4.4e-3, 6.5e-3, 8.7e-3, 10.9e-3] {
            let spot = Spot::under([10e-3, 0.0, fz]);
            assert!(spot.shift[0] + spot.radius <= 0.2305, "{spot:?}");
        }
    }

    proptest! {
        #[test]
        fn matrix_reads_integral_and_centroid(
            fx in -10e-3..10e-3f64, fy in -10e-3..10e-3f64, fz in 1e-4..LINEAR_N,
        ) {
            let spot = Spot::under([fx, fy, fz]);
            prop_assume!(spot.shift.iter().all(|u| u.abs() + spot.radius <= 1.5 * PITCH_MM));
            let (light, shift) = read(&feeler(), &spot);
            prop_assert!((light / spot.light - 1.0).abs() < 1e-9);
            for (read, asked) in shift.iter().zip(spot.shift) {
                prop_assert!((read - asked).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn brightness_does_not_depend_on_shear() {
        // Brightness does not depend on shear (fig. 14).
        let at = |fx| Spot::under([fx, 0.0, 6.5e-3]).light;
        assert_eq!(at(0.0), at(10e-3));
    }
}

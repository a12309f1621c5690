//! Gap to light: sixteen LED–phototransistor pairs looking at their facets.
//!
//! A pair of wide-angle devices a distance s apart, looking at a white facet at gap g, is taken as a
//! Lambertian source whose mirror image lies 2g away: the light is cos²θ/r² = 4g²/(4g² + s²)², which
//! rises, peaks at g = s/2 and falls. 002 measures this curve, because at these distances no closed form
//! is exact (its eq. (2)); the shape is right, and each pair's own gap, gain and leakage come from the
//! device's seed. The finger works on the far side of the peak: nearer is brighter.
//!
//! Everything is a fraction of the converter's full scale.

use rand_distr::{Distribution as _, Uniform};
use taxel::scan::{COLS, ROWS, TAXELS};

use crate::scene::{Effect, Scene};
use crate::seeds::{Purpose, stream};

/// Distance of LED and phototransistor in mm: the light peaks at a gap of half of it, 0.7 mm.
const SEPARATION_MM: f64 = 1.4;
/// What the mean pair reads at the peak of its curve; the rest is room for bright pairs and lamps.
const PEAK: f64 = 0.75;
/// Leakage of a column of four phototransistors, read in the dark too.
const LEAKAGE: f64 = 0.01;

/// Spread of a device, one standard deviation: gain, gap in mm, leakage.
const GAIN_SPREAD: f64 = 0.08;
const GAP_SPREAD_MM: f64 = 0.06;
const LEAKAGE_SPREAD: f64 = 0.15;
/// Most light that spills between neighbours. Those in a row are lit together and pick up each other's
/// facets; those in a column share a load, so that a dark one adds what it sees of its lit neighbour's
/// light.
const STRAY: f64 = 0.03;

/// The optics of one device in one room.
#[derive(Clone, Debug)]
pub struct Optics {
    pairs: [Pair; TAXELS],
    leakage: [f64; COLS],
    stray: Option<Box<Stray>>,
    ambient: f64,
    flicker: Option<Flicker>,
}

#[derive(Clone, Copy, Debug)]
struct Pair {
    gain: f64,
    gap: f64,
}

/// What taxel k gets of its neighbours: left, right, below, above.
type Stray = [[f64; 4]; TAXELS];

#[derive(Clone, Copy, Debug)]
struct Flicker {
    amplitude: f64,
    /// Radians per microsecond.
    speed: f64,
    phase: f64,
}

impl Optics {
    /// The optics of the scene's device; lamps begin at a phase that follows from `seed`.
    #[must_use]
    pub fn new(scene: &Scene, seed: u64) -> Self {
        let mut pairs = [Pair { gain: PEAK, gap: scene.layer.gap_mm }; TAXELS];
        let mut leakage = [LEAKAGE; COLS];
        let device = scene.device.seed;
        if scene.has(Effect::GainSpread) {
            let mut rng = stream(device, Purpose::GainSpread);
            let mut draw = |sigma: f64| -> f64 {
                // Beyond three sigma a pair is rejected at assembly.
                let unit: f64 = rand_distr::StandardNormal.sample(&mut rng);
                sigma * unit.clamp(-3.0, 3.0)
            };
            for pair in &mut pairs {
                pair.gain *= 1.0 + draw(GAIN_SPREAD);
                pair.gap += draw(GAP_SPREAD_MM);
            }
            leakage.iter_mut().for_each(|leakage| *leakage *= 1.0 + draw(LEAKAGE_SPREAD));
        }
        let stray = scene.has(Effect::OpticalCrosstalk).then(|| Box::new(draw_stray(device)));
        let flicker = scene.has(Effect::Flicker).then(|| {
            let phase = uniform(0.0, core::f64::consts::TAU)
                .map_or(0.0, |phase| phase.sample(&mut stream(seed, Purpose::Flicker)));
            Flicker {
                amplitude: scene.light.flicker_ratio,
                speed: core::f64::consts::TAU * scene.light.flicker_hz * 1e-6,
                phase,
            }
        });
        let ambient = if scene.has(Effect::Ambient) { scene.light.ambient_ratio } else { 0.0 };
        Self { pairs, leakage, stray, ambient, flicker }
    }

    /// What each taxel's own LED adds to its column while its row is lit, with its facet sunk by
    /// `sunk` mm.
    #[must_use]
    pub fn reflected(&self, sunk: &[f64; TAXELS]) -> [f64; TAXELS] {
        let mut light = [0.0; TAXELS];
        for ((light, pair), sunk) in light.iter_mut().zip(&self.pairs).zip(sunk) {
            *light = pair.gain * response(pair.gap - sunk);
        }
        self.stray.as_ref().map_or(light, |stray| spill(&light, stray))
    }

    /// What a column reads with every LED off, at `time_us`.
    #[must_use]
    pub fn dark(&self, time_us: f64) -> [f64; COLS] {
        let lamps = self.flicker.map_or(0.0, |flicker| {
            flicker.amplitude * (flicker.phase + flicker.speed * time_us).sin()
        });
        self.leakage.map(|leakage| leakage + self.ambient + lamps)
    }
}

/// Light of a pair at `gap` mm as a fraction of its peak, 4qs²/(q + s²)² with q = 4g². A facet that
/// touches its pair (gap ≤ 0) shuts the light out.
#[must_use]
pub fn response(gap: f64) -> f64 {
    const S2: f64 = SEPARATION_MM * SEPARATION_MM;
    let gap = gap.max(0.0);
    let q = 4.0 * gap * gap;
    4.0 * q * S2 / ((q + S2) * (q + S2))
}

fn uniform(low: f64, high: f64) -> Option<Uniform<f64>> {
    Uniform::new(low, high).ok()
}

fn draw_stray(device: u64) -> Stray {
    let mut rng = stream(device, Purpose::OpticalCrosstalk);
    let mut stray = [[0.0; 4]; TAXELS];
    if let Some(share) = uniform(0.0, STRAY) {
        stray.as_flattened_mut().iter_mut().for_each(|s| *s = share.sample(&mut rng));
    }
    stray
}

fn spill(light: &[f64; TAXELS], stray: &Stray) -> [f64; TAXELS] {
    let at = |row: usize, column: usize| {
        if row < ROWS && column < COLS { light.get(row * COLS + column).copied() } else { None }
            .unwrap_or(0.0)
    };
    let mut mixed = *light;
    for (k, (mixed, [left, right, below, above])) in mixed.iter_mut().zip(stray).enumerate() {
        let (row, column) = (k / COLS, k % COLS);
        // Off the matrix there is nothing to pick up; wrapping makes an index that is off it.
        *mixed += left * at(row, column.wrapping_sub(1))
            + right * at(row, column + 1)
            + below * at(row.wrapping_sub(1), column)
            + above * at(row + 1, column);
    }
    mixed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn optics(effects: &str) -> Optics {
        let text = format!("effects = [{effects}]\n[scan]\nrate_hz = 1000\nduration_s = 1\n");
        Optics::new(&Scene::parse("test.toml", &text).unwrap(), 1)
    }

    #[test]
    fn the_curve_rises_to_its_peak_at_half_the_separation_and_then_falls() {
        assert_eq!(response(0.0), 0.0);
        assert!((response(SEPARATION_MM / 2.0) - 1.0).abs() < 1e-12);
        let curve: Vec<f64> = (0..300).map(|i| response(f64::from(i) * 0.01)).collect();
        let peak = (SEPARATION_MM / 2.0 / 0.01) as usize;
        assert!(curve[..peak].is_sorted() && curve[peak + 1..].is_sorted_by(|a, b| a > b));
    }

    #[test]
    fn a_nearer_facet_is_brighter_and_the_others_stay_as_they_were() {
        let optics = optics("'gain-spread'");
        let before = optics.reflected(&[0.0; TAXELS]);
        let mut sunk = [0.0; TAXELS];
        sunk[6] = 0.4;
        let after = optics.reflected(&sunk);
        for k in 0..TAXELS {
            assert!(if k == 6 { after[k] > 1.1 * before[k] } else { after[k] == before[k] });
        }
    }

    #[test]
    fn light_spills_to_the_four_neighbours_and_no_further() {
        let optics = optics("'optical-crosstalk'");
        let before = optics.reflected(&[0.0; TAXELS]);
        let mut sunk = [0.0; TAXELS];
        sunk[4] = 0.5;
        let after = optics.reflected(&sunk);
        let changed: Vec<usize> = (0..TAXELS).filter(|k| after[*k] != before[*k]).collect();
        assert_eq!(changed, [0, 4, 5, 8]);
        assert!(after[5] - before[5] < STRAY * PEAK);
    }

    #[test]
    fn an_effect_that_is_not_listed_changes_nothing() {
        let plain = optics("");
        assert!(plain.reflected(&[0.0; TAXELS]).windows(2).all(|pair| pair[0] == pair[1]));
        assert_eq!(plain.dark(0.0), plain.dark(2500.0));
        assert_eq!(plain.dark(0.0), [LEAKAGE; COLS]);
    }

    #[test]
    fn lamps_at_a_hundred_hertz_return_after_ten_milliseconds() {
        let optics = optics("'ambient', 'flicker'");
        let at = |time| optics.dark(time)[0];
        assert!((at(0.0) - at(10_000.0)).abs() < 1e-12);
        let mean = 0.5 * (at(1000.0) + at(6000.0));
        assert!(mean > LEAKAGE + 0.001, "the lamps' mean is the ambient light");
        let swing = (0..100).map(|i| at(f64::from(i) * 100.0)).fold(0.0f64, |m, v| m.max(v));
        assert!(swing > mean);
    }
}

//! Optical pairs: from the gaps of sixteen LED–phototransistor pairs to light.
//!
//! A pair of wide-angle devices a distance s apart, looking at a white facet at gap g, is taken as
//! a Lambertian source whose mirror image is 2g away. The light is cos²θ/r² = 4g²/(4g² + s²)²,
//! which rises, peaks at g = s/2 and falls. [DeMaria2011] measures this curve, because at these
//! distances no closed form is exact (its eq. (2)). The shape is right; each pair's own gap, gain
//! and leakage come from the device's seed. The finger works on the far side of the peak: nearer is
//! brighter. A pair on the wrong side, nearer to its facet than the peak, darkens under a press.
//!
//! Neighbours couple in two ways ([DeMaria2011]: misaligned axes couple adjacent taxels):
//!
//! - Pairs in a row are lit together, and a phototransistor sees part of the facets next to its
//!   own.
//! - Pairs in a column share a load, and only one of them is lit. Its LED shines on the facets of
//!   the two next to it, whose phototransistors leak onto the load.
//!
//! Unlit phototransistors also leak without any LED; this dark current is in the dark step too.
//!
//! All values are fractions of the converter's full scale on a load of 1 kΩ amplified sixteenfold.

use rand_distr::{Distribution as _, Uniform};
use scan_plan::finger::REFERENCE;
use taxel::scan::{COLS, ROWS, TAXELS};

use crate::electronics::UNIT_A;
use crate::scene::{Effect, Layer, Scene};
use crate::seeds::{Purpose, stream};

/// Distance between LED and phototransistor in mm.
const SEPARATION_MM: f64 = REFERENCE.pair.separation_mm;
/// Gap in mm at which the light peaks.
const PEAK_MM: f64 = SEPARATION_MM / 2.0;
/// Reading of the mean pair at the peak of its curve.
///
/// The rest of the range is room for bright pairs and lamps.
const PEAK: f64 = REFERENCE.pair.peak_a / UNIT_A;
/// Reading of a column's amplifier without input; an assumption: two millivolts of offset.
const OFFSET: f64 = 0.01;
/// Dark current of a phototransistor at the reference temperature (SFH 3010, typical), in amperes.
const DARK_A: f64 = 1e-9;
/// Temperature rise in kelvin that doubles the dark current of silicon; an assumption.
const DOUBLES_K: f64 = 10.0;

/// Spread of a device, one standard deviation, all assumptions: gain, gap in mm, offset.
const GAIN_SPREAD: f64 = 0.08;
const GAP_SPREAD_MM: f64 = 0.06;
const OFFSET_SPREAD: f64 = 0.15;
/// Largest share of a facet's light that a neighbour gets; an assumption, because [DeMaria2011]
/// gives no number.
const STRAY: f64 = 0.03;

/// Dead LEDs and blind phototransistors, one bit per taxel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Missing {
    /// LEDs that give no light.
    pub leds: u16,
    /// Phototransistors that see no light.
    pub phototransistors: u16,
}

/// Optics of one device in one room.
#[derive(Clone, Debug)]
pub struct Optics {
    pairs: [Pair; TAXELS],
    offsets: [f64; COLS],
    stray: Option<Box<Stray>>,
    diffuse: Option<Box<Diffuse>>,
}

#[derive(Clone, Copy, Debug)]
struct Pair {
    gain: f64,
    gap: f64,
}

/// Share that taxel k gets of its neighbours' facets: left, right, below, above.
type Stray = [[f64; 4]; TAXELS];

impl Optics {
    /// Creates the optics of the scene's device.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let mut pairs = [Pair { gain: PEAK, gap: scene.layer.gap_mm }; TAXELS];
        let mut offsets = [OFFSET; COLS];
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
            offsets.iter_mut().for_each(|offset| *offset *= 1.0 + draw(OFFSET_SPREAD));
        }
        for taxel in &scene.device.wrong_side {
            if let Some(pair) = pairs.get_mut(taxel.index()) {
                // The pair stays as bright at rest, because the curve is the same in g and
                // (s/2)²/g.
                pair.gap = PEAK_MM * PEAK_MM / pair.gap;
            }
        }
        let stray = scene.has(Effect::OpticalCrosstalk).then(|| Box::new(draw_stray(device)));
        let diffuse = scene.has(Effect::DiffuseFacet);
        let diffuse = diffuse.then(|| Box::new(Diffuse::new(&scene.layer)));
        Self { pairs, offsets, stray, diffuse }
    }

    /// Whether a facet at `gap` mm is nearer than the peak of its pair's curve.
    ///
    /// Nearer than the peak, the light falls with the gap.
    #[must_use]
    pub fn wrong_side(gap: f64) -> bool {
        gap < PEAK_MM
    }

    /// Gap between facet and pair in mm, with the facets displaced by `displacement` mm.
    #[must_use]
    pub fn gaps(&self, displacement: &[f64; TAXELS]) -> [f64; TAXELS] {
        let mut gaps = *displacement;
        gaps.iter_mut().zip(&self.pairs).for_each(|(gap, pair)| *gap = pair.gap - *gap);
        gaps
    }

    /// Light added to each taxel's column while its row is lit.
    ///
    /// The facets are displaced by `displacement` mm.
    #[must_use]
    pub fn reflected(&self, displacement: &[f64; TAXELS], missing: Missing) -> [f64; TAXELS] {
        let mut light = [0.0; TAXELS];
        for ((light, pair), displacement) in light.iter_mut().zip(&self.pairs).zip(displacement) {
            let gap = pair.gap - displacement;
            *light = pair.gain * self.diffuse.as_ref().map_or_else(|| response(gap), |d| d.at(gap));
        }
        match &self.stray {
            Some(stray) => spill(&light, stray, missing),
            None => without(&light, missing.leds | missing.phototransistors),
        }
    }

    /// Readings of the columns' amplifiers without input.
    #[must_use]
    pub fn offsets(&self) -> [f64; COLS] {
        self.offsets
    }
}

/// Warming of the LEDs by their own current in kelvin, `seconds` after the start.
///
/// All sixteen take 20 mW with their resistors, next to a controller with 90 mW. Both together are
/// assumed to warm them by 2 K, most of it within the first minute.
#[must_use]
pub fn own_heat(seconds: f64) -> f64 {
    const OWN_K: f64 = 2.0;
    const WARMS_S: f64 = 60.0;
    -OWN_K * (-seconds / WARMS_S).exp_m1()
}

/// Dark current of a column's four phototransistors, `warmer_k` above the reference.
#[must_use]
pub fn dark_current(warmer_k: f64) -> f64 {
    ROWS as f64 * DARK_A / UNIT_A * (warmer_k / DOUBLES_K).exp2()
}

/// Light of an LED `warmer_k` above the reference, relative to the reference.
///
/// −0.5 %/K is assumed, as usual for such LEDs. The phototransistor's own change is a curve without
/// a number in its sheet and is not modelled.
#[must_use]
pub fn warm_led(warmer_k: f64) -> f64 {
    1.0 - 0.005 * warmer_k
}

/// Light of a pair at `gap` mm as a fraction of its peak, 4qs²/(q + s²)² with q = 4g².
///
/// A facet that touches its pair (gap ≤ 0) blocks the light.
#[must_use]
pub fn response(gap: f64) -> f64 {
    const S2: f64 = SEPARATION_MM * SEPARATION_MM;
    let gap = gap.max(0.0);
    let q = 4.0 * gap * gap;
    4.0 * q * S2 / ((q + S2) * (q + S2))
}

/// Light curve of a diffuse facet, which spreads what it gets by Lambert's law.
///
/// A point of the facet at distances r₁ from the LED and r₂ from the phototransistor hands on
/// g⁴/(r₁r₂)⁴; the curve is the mean over the facet. It is as bright as the mirror's at the usual
/// gap, where a photocurrent is given.
#[derive(Clone, Debug)]
struct Diffuse {
    nodes: Vec<f64>,
}

impl Diffuse {
    /// Distance of two nodes in mm; linear interpolation is then good to 10⁻⁵ of the peak.
    const STEP_MM: f64 = 0.004;
    const NODES: usize = 1001;

    fn new(layer: &Layer) -> Self {
        let (facet, usual) = (layer.facet_mm, layer.gap_mm);
        let scale = response(usual) / Self::mean(usual, facet);
        let nodes = 0..Self::NODES;
        let node = |i| scale * Self::mean(i as f64 * Self::STEP_MM, facet);
        Self { nodes: nodes.map(node).collect() }
    }

    fn mean(gap: f64, facet: f64) -> f64 {
        const POINTS: usize = 32;
        let at = |i: usize| ((i as f64 + 0.5) / POINTS as f64 - 0.5) * facet;
        let square = |x: f64, y: f64| x * x + y * y + gap * gap;
        let sum: f64 = (0..POINTS * POINTS)
            .map(|i| {
                let (x, y) = (at(i % POINTS), at(i / POINTS));
                let beside = SEPARATION_MM / 2.0;
                (gap * gap / (square(x + beside, y) * square(x - beside, y))).powi(2)
            })
            .sum();
        sum / (POINTS * POINTS) as f64
    }

    fn at(&self, gap: f64) -> f64 {
        let node = (gap / Self::STEP_MM).clamp(0.0, (Self::NODES - 2) as f64);
        let (low, rest) = (node.floor() as usize, node.fract());
        match self.nodes.get(low..low + 2) {
            Some([low, high]) => low + rest * (high - low),
            _ => 0.0,
        }
    }
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

/// Sets the light of every taxel whose bit is set in `missing` to zero.
#[must_use]
pub fn without(light: &[f64; TAXELS], missing: u16) -> [f64; TAXELS] {
    let mut light = *light;
    if missing != 0 {
        let taxels = light.iter_mut().enumerate();
        taxels.filter(|(k, _)| missing >> k & 1 == 1).for_each(|(_, light)| *light = 0.0);
    }
    light
}

fn spill(light: &[f64; TAXELS], stray: &Stray, missing: Missing) -> [f64; TAXELS] {
    // In a row every facet has its own LED, and one phototransistor sees them. In a column one LED
    // shines, and every facet has its own phototransistor.
    let (lit, seen) = (without(light, missing.leds), without(light, missing.phototransistors));
    // Outside the matrix there is no light; wrapping arithmetic makes any outside index invalid.
    let at = |light: &[f64; TAXELS], row: usize, column: usize| {
        if row < ROWS && column < COLS { light.get(row * COLS + column).copied() } else { None }
            .unwrap_or(0.0)
    };
    let mut mixed = [0.0; TAXELS];
    for (k, (mixed, [left, right, below, above])) in mixed.iter_mut().zip(stray).enumerate() {
        let (row, column) = (k / COLS, k % COLS);
        if missing.phototransistors >> k & 1 == 0 {
            *mixed += at(&lit, row, column)
                + left * at(&lit, row, column.wrapping_sub(1))
                + right * at(&lit, row, column + 1);
        }
        if missing.leds >> k & 1 == 0 {
            *mixed +=
                below * at(&seen, row.wrapping_sub(1), column) + above * at(&seen, row + 1, column);
        }
    }
    mixed
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: Missing = Missing { leds: 0, phototransistors: 0 };

    fn optics(effects: &str) -> Optics {
        let text = format!("effects = [{effects}]\n[scan]\nrate_hz = 1000\nduration_s = 1\n");
        Optics::new(&Scene::parse("test.toml", &text).unwrap())
    }

    #[test]
    fn light_peaks_at_half_the_separation() {
        assert_eq!(response(0.0), 0.0);
        assert!((response(SEPARATION_MM / 2.0) - 1.0).abs() < 1e-12);
        let curve: Vec<f64> = (0..300).map(|i| response(f64::from(i) * 0.01)).collect();
        let peak = (SEPARATION_MM / 2.0 / 0.01) as usize;
        assert!(curve[..peak].is_sorted() && curve[peak + 1..].is_sorted_by(|a, b| a > b));
    }

    #[test]
    fn diffuse_facet_is_as_bright_at_rest_and_steeper() {
        let (mirror, diffuse) = (optics(""), optics("'diffuse-facet'"));
        let light = |optics: &Optics, u: f64| optics.reflected(&[u; TAXELS], NONE)[0];
        assert!((light(&diffuse, 0.0) / light(&mirror, 0.0) - 1.0).abs() < 1e-4);
        let gains = [&mirror, &diffuse].map(|optics| light(optics, 0.3) / light(optics, 0.0));
        // A mirror of twice the distance against a second source: some −2/g against −3/g.
        assert!(gains[0] < 1.28 && gains[1] > 1.45, "{gains:?}");
        // Half way between two nodes.
        let curve = Diffuse::new(&Layer::default());
        let exact = Diffuse::mean(1.002, 1.9) / Diffuse::mean(2.0, 1.9) * response(2.0);
        assert!((curve.at(1.002) / exact - 1.0).abs() < 1e-5);
    }

    #[test]
    fn leds_warm_by_themselves_within_minutes() {
        assert_eq!(own_heat(0.0), 0.0);
        assert!((own_heat(60.0) - 2.0 * 0.632).abs() < 1e-3 && (own_heat(1e4) - 2.0).abs() < 1e-9);
    }

    #[test]
    fn nearer_facet_alone_gets_brighter() {
        let optics = optics("'gain-spread'");
        let before = optics.reflected(&[0.0; TAXELS], NONE);
        let mut displacement = [0.0; TAXELS];
        displacement[6] = 0.4;
        let after = optics.reflected(&displacement, NONE);
        for k in 0..TAXELS {
            assert!(if k == 6 { after[k] > 1.1 * before[k] } else { after[k] == before[k] });
        }
    }

    #[test]
    fn stray_light_reaches_four_neighbours_only() {
        let optics = optics("'optical-crosstalk'");
        let before = optics.reflected(&[0.0; TAXELS], NONE);
        let mut displacement = [0.0; TAXELS];
        displacement[4] = 0.5;
        let after = optics.reflected(&displacement, NONE);
        let changed: Vec<usize> = (0..TAXELS).filter(|k| after[*k] != before[*k]).collect();
        assert_eq!(changed, [0, 4, 5, 8]);
        assert!(after[5] - before[5] < STRAY * PEAK);
    }

    #[test]
    fn pairs_are_equal_without_effects() {
        let plain = optics("");
        assert!(plain.reflected(&[0.0; TAXELS], NONE).windows(2).all(|pair| pair[0] == pair[1]));
        assert_eq!(plain.offsets(), [OFFSET; COLS]);
    }

    #[test]
    fn wrong_side_pair_darkens_under_a_press() {
        let text = "effects = ['gain-spread']\n[scan]\nrate_hz = 1000\nduration_s = 1\n";
        let optics = |device: &str| {
            Optics::new(&Scene::parse("test.toml", &format!("{text}{device}")).unwrap())
        };
        let right = optics("");
        let wrong = optics("[device]\nwrong_side = ['r1c2', 'r3c0']\n");
        let rest = [0.0; TAXELS];
        let flagged = |optics: &Optics, displacement: f64| -> Vec<usize> {
            let gaps = optics.gaps(&[displacement; TAXELS]);
            (0..TAXELS).filter(|k| Optics::wrong_side(gaps[*k])).collect()
        };
        assert_eq!(flagged(&right, 0.2), []);
        assert_eq!(flagged(&wrong, 0.0), [6, 12]);
        let (before, after) = (wrong.reflected(&rest, NONE), wrong.reflected(&[0.1; TAXELS], NONE));
        for (k, usual) in right.reflected(&rest, NONE).into_iter().enumerate() {
            assert!((before[k] - usual).abs() < 1e-12);
            assert_eq!(after[k] < before[k], k == 6 || k == 12, "taxel {k}");
        }
        // At this depth every facet is past the peak.
        assert_eq!(flagged(&right, 1.6).len(), TAXELS);
    }

    #[test]
    fn dead_led_affects_its_taxel_and_row() {
        let optics = optics("'optical-crosstalk'");
        let of = |missing| optics.reflected(&[0.0; TAXELS], missing);
        let (all, dead) = (of(NONE), of(Missing { leds: 1 << 5, phototransistors: 0 }));
        assert!(dead[5] > 0.0 && dead[5] < 0.15 * all[5], "what is left is its neighbours'");
        let changed: Vec<usize> = (0..TAXELS).filter(|k| dead[*k] != all[*k]).collect();
        assert_eq!(changed, [4, 5, 6]);
    }

    #[test]
    fn blind_phototransistor_leaks_nothing() {
        let optics = optics("'optical-crosstalk'");
        let of = |missing| optics.reflected(&[0.0; TAXELS], missing);
        let (all, blind) = (of(NONE), of(Missing { leds: 0, phototransistors: 1 << 5 }));
        assert!(blind[5] > 0.0 && blind[5] < 0.15 * all[5], "the column's others see its LED");
        let changed: Vec<usize> = (0..TAXELS).filter(|k| blind[*k] != all[*k]).collect();
        assert_eq!(changed, [1, 5, 9]);
        // Without LED and phototransistor of one taxel, the others still have their neighbours.
        let gone = of(Missing { leds: 1 << 5, phototransistors: 1 << 5 });
        assert_eq!(gone[5], 0.0);
    }

    #[test]
    fn dark_current_doubles_every_ten_kelvin() {
        assert!((dark_current(0.0) * UNIT_A - 4e-9).abs() < 1e-15, "four of a nanoampere");
        assert!((dark_current(60.0) / dark_current(0.0) - 64.0).abs() < 1e-6);
    }
}

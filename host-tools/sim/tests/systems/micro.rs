//! OHKA-MICRO (000): the feeler's bi-linear curve out of its own trace, and force out of codes.

use taxel::estimate::bright_spot::{BrightSpot, Shear, Spot};
use taxel_formats::trace::Sample;

use crate::{contacts, fit, force, line, meets, run, signals};

/// What the matrix sees is 160 µm a phototransistor on the board.
const PIXEL_UM: f32 = 160.0;

/// G and the centroid in µm of each frame.
fn spots(samples: &[Sample]) -> Vec<(Spot, &Sample)> {
    let grey = |c: [f32; 16]| c.map(|c| -c);
    let spot = |c| Spot::measure(&grey(c), 4, PIXEL_UM);
    signals(samples).into_iter().map(|(signals, s)| (spot(signals.taxels.unwrap()), s)).collect()
}

/// F_x and F_z of the reference in mN.
fn reference(sample: &Sample) -> (f64, f64) {
    let [x, _, z] = force(sample);
    (1e3 * x, 1e3 * z)
}

/// β, K and F_x1 of the two straight pieces u(F), by least squares for every place of the kink.
fn two_segments(points: &[(f64, f64)]) -> [f64; 3] {
    let pieces = |kink: f64| {
        let rows = points.iter().map(|(u, f)| ([f.min(kink), (f - kink).max(0.0), 1.0], *u));
        let weights: [f64; 3] = fit(rows.clone());
        let error = |(terms, u): ([f64; 3], f64)| {
            (terms.iter().zip(weights).map(|(t, w)| t * w).sum::<f64>() - u).powi(2)
        };
        (rows.map(error).sum::<f64>(), weights)
    };
    let best = |from: f64, step: f64, steps: u32| {
        let kinks = (1..steps).map(|i| from + step * f64::from(i));
        kinks.min_by(|a, b| pieces(*a).0.total_cmp(&pieces(*b).0)).unwrap()
    };
    let coarse = best(0.0, 0.1, 99);
    let kink = best(coarse - 0.1, 0.002, 100);
    let [stuck, sliding, _] = pieces(kink).1;
    [1.0 / stuck, 1.0 / sliding, kink]
}

/// C of eq. (3) from normal presses up to 12 mN.
fn fit_normal(samples: &[Sample]) -> f64 {
    let rows = spots(samples);
    let rows = rows.iter().map(|(spot, s)| ([f64::from(spot.integral)], reference(s).1));
    let [c] = fit(rows);
    c
}

/// β, K, α, γ, and the centroid of the unsheared feeler, from shear at constant normal forces.
fn fit_shear(samples: &[Sample]) -> (Shear, f32) {
    let rows = spots(samples);
    let presses = contacts(&rows, |(_, s)| s.truth.contact == Some(true));
    assert_eq!(presses.len(), 5);
    let mut unsheared = vec![];
    let mut curves = vec![];
    for press in presses {
        let most = press.iter().map(|(_, s)| reference(s).1).fold(0.0, f64::max);
        let held = press.iter().filter(|(_, s)| reference(s).1 > 0.999 * most);
        let points: Vec<(f64, f64)> =
            held.map(|(spot, s)| (f64::from(spot.centroid[0]), reference(s).0)).collect();
        let at_rest = points.iter().filter(|(_, f)| *f < 0.02).map(|(u, _)| u);
        unsheared.push(at_rest.clone().sum::<f64>() / at_rest.count() as f64);
        curves.push((most, two_segments(&points)));
    }
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / 5.0;
    let [alpha, gamma] = line(curves.iter().map(|(normal, [_, _, kink])| (*normal, *kink)));
    let shear = Shear {
        stuck: mean(&mut curves.iter().map(|(_, [stuck, ..])| *stuck)) as f32,
        sheet: mean(&mut curves.iter().map(|(_, [_, sheet, _])| *sheet)) as f32,
        friction: alpha as f32,
        adhesion: gamma as f32,
    };
    (shear, mean(&mut unsheared.into_iter()) as f32)
}

#[test]
fn the_bi_linear_curve_gives_the_papers_four_constants_back() {
    let (shear, _) = fit_shear(&run("micro-shear", 1));
    meets("beta", shear.stuck.into(), 1.7, 5.0);
    meets("K", shear.sheet.into(), 0.067, 5.0);
    meets("alpha", shear.friction.into(), 0.25, 5.0);
    meets("gamma", shear.adhesion.into(), 0.56, 5.0);
}

#[test]
fn brightness_is_proportional_to_the_normal_force_up_to_twelve_millinewtons_sheared_or_not() {
    let c = fit_normal(&run("micro-press", 1));
    for scene in ["micro-press", "micro-shear"] {
        let samples = run(scene, 2);
        let worst = spots(&samples)
            .iter()
            .map(|(spot, s)| (c * f64::from(spot.integral) - reference(s).1).abs())
            .fold(0.0, f64::max);
        assert!(worst < 0.12, "{scene}: {worst} mN");
    }
}

/// The paper goes up in steps; here 50 ms are one.
#[test]
fn force_out_of_codes_meets_the_load_cell_of_the_paper() {
    let normal = fit_normal(&run("micro-press", 1)) as f32;
    let (x, unsheared) = fit_shear(&run("micro-shear", 1));
    let sensor = BrightSpot { normal, x, y: x };
    let samples = run("micro-shear", 2);
    let rows = spots(&samples);
    let (mut worst, mut squares, mut n) = (0.0f64, 0.0, 0.0);
    let held = |normal: f64| [2.2, 4.4, 6.5, 8.7, 10.9].iter().any(|n| (n - normal).abs() < 1e-3);
    let presses = contacts(&rows, |(_, s)| held(reference(s).1));
    for step in presses.iter().flat_map(|press| press.chunks_exact(25)) {
        let mean = |value: &dyn Fn(&(Spot, &Sample)) -> f64| {
            step.iter().map(value).sum::<f64>() / step.len() as f64
        };
        let integral = mean(&|(spot, _)| spot.integral.into()) as f32;
        let shift = mean(&|(spot, _)| spot.centroid[0].into()) as f32 - unsheared;
        let [fx, ..] = sensor.force(integral, [shift, 0.0]);
        let error = f64::from(fx) - mean(&|(_, s)| reference(s).0);
        worst = worst.max(error.abs());
        squares += error * error;
        n += 1.0;
    }
    let rms = f64::sqrt(squares / n);
    // The paper's load cells resolve 0.1 mN.
    assert!(n > 500.0 && rms < 0.05 && worst < 0.25, "{rms} mN RMS, {worst} mN at worst");
}

#[test]
fn the_feeler_slips_in_the_truth_exactly_beyond_the_papers_threshold() {
    let samples = run("micro-shear", 1);
    let slips = |s: &&Sample| s.truth.slip == Some(true);
    for sample in &samples {
        let (fx, fz) = reference(sample);
        assert_eq!(slips(&sample), fz > 0.0 && fx > 0.25 * fz + 0.56, "{fx} {fz}");
    }
    assert!(samples.iter().filter(slips).count() > samples.len() / 2);
    assert!(run("micro-press", 1).iter().all(|s| !slips(&s)));
}

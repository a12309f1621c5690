//! Scenes of the finger, each against the physical law behind it.

use std::f64::consts::{PI, TAU};

use taxel::scan::{TAXEL_CENTRES, TAXELS};
use taxel_files::trace::Sample;
use taxel_sim::contact::SILICONE_YOUNG_MPA;
use taxel_sim::plate::PLACES;
use taxel_sim::scene::{self, Effect};
use taxel_sim::{Scene, Simulator};

use crate::{contacts, force, line, run};

/// Sample with the displacement of its facets in mm.
type Frame = (Sample, [f64; TAXELS]);

fn frames(scene: &Scene) -> Vec<Frame> {
    let mut run = Simulator::new(scene, 1);
    std::iter::from_fn(|| run.next().map(|sample| (sample, *run.displacement().unwrap()))).collect()
}

fn built_in(name: &str) -> Scene {
    Scene::load(name).unwrap()
}

fn time(sample: &Sample) -> f64 {
    sample.scan.time.0 as f64 * 1e-6
}

fn touched((sample, _): &Frame) -> bool {
    sample.truth.contact == Some(true)
}

fn most(displacement: &[f64; TAXELS]) -> f64 {
    displacement.iter().fold(0.0, |m, u| m.max(*u))
}

fn centre(k: usize) -> [f64; 2] {
    TAXEL_CENTRES[k].map(|mm| f64::from(mm.0))
}

fn point(sample: &Sample) -> [f64; 2] {
    sample.truth.point.map(Option::unwrap)
}

fn dark(sample: &Sample, column: usize) -> f64 {
    f64::from(sample.scan.codes.taxels.unwrap().dark[column].0)
}

fn light(sample: &Sample, k: usize) -> f64 {
    f64::from(sample.scan.codes.taxels.unwrap().lit[k / 4][k % 4].0) - dark(sample, k % 4)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), value| (sum + value, n + 1.0));
    sum / n
}

/// Contact radius in mm of a 6 mm sphere on the silicone of [DeMaria2011] ([TactileEnc]: a =
/// (9PR/16E)^⅓).
fn contact_radius(normal: f64) -> f64 {
    (9.0 * normal * 6.0 / (16.0 * SILICONE_YOUNG_MPA)).cbrt()
}

#[test]
fn warming_grasp_stiffens_rubber_dims_leds() {
    let scene = built_in("grasp");
    let rows = frames(&scene);
    let held: Vec<&Frame> = rows.iter().filter(|(s, _)| (1.5..59.5).contains(&time(s))).collect();
    assert_eq!(held.len(), 58 * 250);
    assert!(held.iter().all(|(s, _)| (force(s)[2] - 1.2).abs() < 1e-12));
    // Shear rises and falls in a third of the hold each.
    let sheared = held.iter().filter(|(s, _)| (21.0..40.0).contains(&time(s)));
    assert!(sheared.clone().all(|(s, _)| (force(s)[0] - 0.4).abs() < 1e-12));
    // The displacement falls with absolute temperature, here by 6 K, because the rubber gets
    // stiffer.
    let ((first, cold), (last, warm)) = (held[0], held[held.len() - 1]);
    let kelvin = |sample: &Sample| scene.temperature().unwrap().at(time(sample)) + 273.15;
    let (found, expected) = (most(warm) / most(cold), kelvin(first) / kelvin(last));
    assert!((0.980..0.981).contains(&expected), "{expected}");
    assert!((found - expected).abs() < 0.002, "{found} for {expected}");
    // After release the facets are back, and the light has fallen by 0.5 %/K.
    let (before, after) = (&rows[..200], &rows[rows.len() - 200..]);
    assert!(after.iter().all(|(s, u)| force(s) == [0.0; 3] && *u == [0.0; TAXELS]));
    for k in 0..TAXELS {
        let [before, after] =
            [before, after].map(|rows| mean(rows.iter().map(|(s, _)| light(s, k))));
        assert!((after / before - 0.97).abs() < 1e-3, "taxel {k}: {}", after / before);
    }
}

#[test]
fn tap_force_is_half_a_sine() {
    let scene = built_in("tap");
    let period = 1.0 / f64::from(scene.rate_hz());
    let rows = frames(&scene);
    let taps = contacts(&rows, touched);
    let asked = [(1.0, 0.02), (0.1, 0.05), (2.0, 0.01), (0.5, 0.1), (1.5, 0.03), (0.8, 0.04)];
    assert_eq!(taps.len(), asked.len());
    for (tap, (peak, width)) in taps.into_iter().zip(asked) {
        let lasts = tap.len() as f64 * period;
        assert!((lasts - width).abs() < 1.5 * period, "{lasts} s for {width} s");
        let impulse: f64 = tap.iter().map(|(s, _)| force(s)[2] * period).sum();
        let half_sine = 2.0 / PI * peak * width;
        assert!((impulse / half_sine - 1.0).abs() < 5e-3, "{impulse} N s for {half_sine} N s");
        // Elastic: the facet below sinks most when the force is largest.
        let deepest = (0..tap.len()).max_by(|a, b| most(&tap[*a].1).total_cmp(&most(&tap[*b].1)));
        assert!(deepest.unwrap().abs_diff(tap.len() / 2) <= 1);
    }
}

#[test]
fn roll_moves_pressure_centre_evenly() {
    let rows = frames(&built_in("roll"));
    let rolls: Vec<&[Frame]> = contacts(&rows, touched);
    for (roll, from, to, normal) in
        [(rolls[0], [-3.5, -1.0], [3.5, 1.0], 1.0), (rolls[1], [1.0, 3.5], [-1.0, -3.5], 0.6)]
    {
        let began = time(&roll[0].0) - 0.001;
        let mut brightest = vec![];
        for (sample, displacement) in roll {
            let [fx, fy, fz] = force(sample);
            assert_eq!((fx, fy, sample.truth.slip), (0.0, 0.0, Some(false)));
            // Touch-down in 0.2 s, then the path in 1.4 s.
            let way = ((time(sample) - began - 0.2) / 1.4).clamp(0.0, 1.0);
            let there: [f64; 2] =
                std::array::from_fn(|axis| from[axis] + way * (to[axis] - from[axis]));
            let pressure: [f64; 2] = std::array::from_fn(|axis| {
                let moment = |(sensor, place): (&[Option<f64>; 3], [f64; 2])| {
                    sensor[2].unwrap() * place[axis]
                };
                sample.truth.sensors.iter().zip(PLACES).map(moment).sum::<f64>() / fz
            });
            for axis in 0..2 {
                assert!((point(sample)[axis] - there[axis]).abs() < 1e-9);
                assert!((pressure[axis] - there[axis]).abs() < 1e-9);
            }
            if way > 0.0 && way < 1.0 {
                assert!((fz - normal).abs() < 1e-12);
                let deepest =
                    (0..TAXELS).max_by(|a, b| displacement[*a].total_cmp(&displacement[*b]));
                let [x, y] = centre(deepest.unwrap());
                assert!((x - there[0]).abs() < 1.4 && (y - there[1]).abs() < 1.4);
                brightest.push(deepest.unwrap());
            }
        }
        brightest.dedup();
        assert!(brightest.len() >= 4, "from facet to facet: {brightest:?}");
    }
}

#[test]
fn twist_slips_at_its_limit_and_stays() {
    let rows = frames(&built_in("torsion"));
    let twists: Vec<&[Frame]> = contacts(&rows, touched);
    for (twist, normal, way) in [(twists[0], 1.0, 1.0), (twists[1], 1.6, -1.0)] {
        // Friction limit ∫μp r dA of a sphere (Johnson §4.2): 3π/16·μPa.
        let limit = 3.0 * PI / 16.0 * 0.8 * normal * contact_radius(normal);
        let torsion = |(sample, _): &Frame| way * sample.truth.torsion.unwrap();
        let slips = |(sample, _): &Frame| sample.truth.slip == Some(true);
        let first = twist.iter().position(slips).unwrap();
        let last = twist.iter().rposition(slips).unwrap();
        assert!((torsion(&twist[first - 1]) / limit - 1.0).abs() < 0.01, "it sticks until there");
        assert!(
            twist[first..=last].iter().all(|f| slips(f) && (torsion(f) / limit - 1.0).abs() < 0.01)
        );
        assert!(twist.iter().all(|frame| torsion(frame) <= 1.01 * limit));
        // The moment of the sensors' shear about the contact is the same.
        for (sample, _) in twist.iter().step_by(50) {
            let [x, y] = point(sample);
            let turning = sample.truth.sensors.iter().zip(PLACES).map(|(sensor, place)| {
                let [fx, fy, _] = sensor.map(Option::unwrap);
                (place[0] - x) * fy - (place[1] - y) * fx
            });
            assert!((turning.sum::<f64>() - sample.truth.torsion.unwrap()).abs() < 1e-9);
        }
    }
}

/// Frame of the hold of the press on the corner, without shear.
fn on_the_corner(scene: &Scene) -> Frame {
    let held = |(sample, _): &Frame| (2.1..2.11).contains(&time(sample));
    frames(scene).into_iter().find(held).unwrap()
}

#[test]
fn corner_press_falls_as_one_over_distance() {
    let (sample, displacement) = on_the_corner(&built_in("edge"));
    assert_eq!((point(&sample), force(&sample)), ([-4.9, -4.9], [0.0, 0.0, 1.0]));
    let away = |k: usize| (centre(k)[0] + 4.9).hypot(centre(k)[1] + 4.9);
    let mut order: Vec<usize> = (0..TAXELS).collect();
    order.sort_by(|a, b| away(*a).total_cmp(&away(*b)));
    assert!(order.windows(2).all(|k| displacement[k[0]] >= displacement[k[1]] - 1e-12));
    // Far from a contact only its force matters (Johnson §3.2, ν = ½): P/4πG·(1/ρ + z²/ρ³).
    let shear_modulus = SILICONE_YOUNG_MPA / 3.0;
    for k in order.into_iter().filter(|k| away(*k) > 8.0) {
        let rho = away(k).hypot(2.5);
        let point_load = (1.0 + 2.5 * 2.5 / (rho * rho)) / (4.0 * PI * shear_modulus * rho);
        let found = displacement[k] / point_load;
        assert!((found - 1.0).abs() < 0.015, "taxel {k}: {found}");
    }
}

#[test]
fn framed_corner_press_moves_corner_facets_only() {
    let (_, displacement) = on_the_corner(&built_in("edge").with_effect(Effect::Walls));
    let share = |k: usize| displacement[k].abs() / most(&displacement);
    assert_eq!(share(0), 1.0);
    for k in 1..TAXELS {
        let most = if k == 1 || k == 4 || k == 5 { 0.15 } else { 0.01 };
        assert!(share(k) < most, "taxel {k}: {}", share(k));
    }
}

/// Amplitude of the line at `hertz` in values sampled at `rate`, over whole periods.
fn amplitude(values: &[f64], rate: f64, hertz: f64) -> f64 {
    let level = mean(values.iter().copied());
    let (sine, cosine) =
        values.iter().enumerate().fold((0.0, 0.0), |(sine, cosine), (i, value)| {
            let (sin, cos) = (TAU * hertz * i as f64 / rate).sin_cos();
            (sine + (value - level) * sin, cosine + (value - level) * cos)
        });
    2.0 * f64::hypot(sine, cosine) / values.len() as f64
}

#[test]
fn dark_step_cancels_lamps_but_for_delay() {
    let (_, text) = scene::built_in().find(|(name, _)| *name == "flicker").unwrap();
    for hertz in [100.0, 120.0] {
        let keyed = text.replace("[light]\n", &format!("[light]\nflicker_hz = {hertz}\n"));
        let scene = Scene::parse("flicker.toml", &keyed).unwrap();
        // Unloaded part: 0.4 s, 40 or 48 periods.
        let samples: Vec<Sample> = Simulator::new(&scene, 1).take(1600).collect();
        let lamps = 0.05 * 65_535.0;
        let line = |values: &[f64], hertz| amplitude(values, 4000.0, hertz);
        let room: Vec<f64> = samples.iter().map(|s| dark(s, 1)).collect();
        let found = line(&room, hertz);
        assert!((found / lamps - 1.0).abs() < 0.01, "{found} of {lamps}");
        for other in [50.0, 75.0, 2.0 * hertz, 3.0 * hertz] {
            assert!(line(&room, other) < 1e-3 * lamps, "{other} Hz");
        }
        for row in 0..4 {
            let lit: Vec<f64> = samples.iter().map(|s| light(s, 4 * row + 1)).collect();
            // Row r is read 30 µs·(r + 1) after the dark step: 2 sin(πf·delay) of the swing
            // remains.
            let delay = 30e-6 * (row + 1) as f64;
            let left = 2.0 * (PI * hertz * delay).sin();
            let found = line(&lit, hertz) / lamps;
            assert!((found / left - 1.0).abs() < 0.1, "row {row}: {found} for {left}");
        }
    }
}

/// Midpoints of all sensors as shares of the converter's range.
fn midpoints(sample: &Sample) -> [f64; 16] {
    let all = sample
        .scan
        .codes
        .bridges
        .map(|m| m.map_or([0.0; 4], |m| [m.a, m.b, m.c, m.d].map(|c| f64::from(c.0))));
    std::array::from_fn(|i| all[i / 4][i % 4] / 65_535.0)
}

#[test]
fn temperature_effects_match_constants() {
    let scene = built_in("temperature");
    let celsius = |sample: &Sample| scene.temperature().unwrap().at(time(sample));
    let samples = run("temperature", 1);
    let rest: Vec<&Sample> = samples.iter().filter(|s| force(s) == [0.0; 3]).collect();
    for k in 0..TAXELS {
        let [slope, height] = line(rest.iter().map(|s| (celsius(s) - 25.0, light(s, k))));
        assert!((slope / height + 0.005).abs() < 5e-5, "taxel {k}: {} /K", slope / height);
    }
    // A midpoint is R/(R + R′) of the supply. It drifts by ¼ of the difference of the two,
    // √2·2·10⁻⁵/K (one σ), amplified sixteenfold. Sixteen midpoints give σ within a fifth.
    let drift = |i: usize| line(rest.iter().map(|s| (celsius(s) - 25.0, midpoints(s)[i])))[0];
    let rms = (mean((0..16).map(|i| drift(i).powi(2)))).sqrt();
    let sigma = 16.0 * 0.25 * f64::sqrt(2.0) * 2e-5;
    assert!((rms / sigma - 1.0).abs() < 0.2, "{rms} for {sigma}");
    // Presses are equal at the beginning and at the end.
    let u_z = |from: f64| {
        let held = |s: &&Sample| (from + 0.75..from + 0.85).contains(&time(s));
        let before = |s: &&Sample| (from - 0.3..from).contains(&time(s));
        let of = |samples: &mut dyn Iterator<Item = &Sample>| {
            mean(samples.map(|s| midpoints(s).chunks(4).map(|m| m[0] + m[1] - m[2] - m[3]).sum()))
        };
        of(&mut samples.iter().filter(held)) - of(&mut samples.iter().filter(before))
    };
    let (cold, warm) = (u_z(0.5), u_z(27.5));
    assert!((warm / cold - 293.15 / 318.15).abs() < 0.005, "{}", warm / cold);
}

//! Every built-in scene exists, runs, repeats bit for bit and has a consistent truth.

use taxel::condition::Levels;
use taxel::units::Code;
use taxel_files::trace::Sample;
use taxel_sim::scene::{Kind, built_in};
use taxel_sim::{Scene, Simulator};

use crate::UNLOADED;

/// Names of scenes that must exist.
const ASKED_FOR: [&str; 19] = [
    "press",
    "press-grid",
    "shear-ramp",
    "column-shear",
    "column-incline",
    "column-step",
    "stick-slip",
    "roll",
    "torsion",
    "tap",
    "grasp",
    "two-contacts",
    "edge",
    "flicker",
    "temperature",
    "ripple",
    "fault",
    "sheet-press",
    "sheet-shear",
];

#[test]
fn required_scenes_are_built_in() {
    for name in ASKED_FOR {
        assert!(built_in().any(|(built_in, _)| built_in == name), "{name}");
    }
    for (name, _) in built_in() {
        assert!(Scene::load(name).unwrap().description.len() > 10, "{name}");
    }
    let grasp = Scene::load("grasp").unwrap();
    let held = run_to_end(&grasp, "grasp").held_s;
    assert!(held >= 58.0, "{held} s");
}

/// Facts collected on the way through a scene.
#[derive(Default)]
struct Seen {
    held_s: f64,
    slips: bool,
}

/// Checks range of codes, rising time and a consistent truth, frame by frame.
fn run_to_end(scene: &Scene, name: &str) -> Seen {
    let mut seen = Seen::default();
    let mut last = None;
    let mut frames = 0;
    for (sample, again) in Simulator::new(scene, 1).zip(Simulator::new(scene, 1)) {
        assert_eq!(sample, again, "{name}");
        assert!(last < Some(sample.scan.time), "{name}: time runs");
        last = Some(sample.scan.time);
        frames += 1;
        if scene.faults().next().is_none() {
            codes_are_within_range(scene, name, &sample);
        }
        let truth = &sample.truth;
        let (contact, slip) = (truth.contact.unwrap(), truth.slip.unwrap());
        let [_, _, fz] = truth.force.map(Option::unwrap);
        assert!(contact || !slip, "{name}: nothing slips that does not touch");
        // The load cell of a bench may have an error.
        let exact = scene.bench.as_ref().is_none_or(|bench| bench.reference_n == 0.0);
        assert!(!exact || contact == (fz > 0.0), "{name}: what touches pushes");
        seen.slips |= slip;
        if contact {
            seen.held_s += 1.0 / f64::from(scene.rate_hz());
        }
    }
    assert_eq!(frames, scene.frames(), "{name}");
    seen
}

fn codes_are_within_range(scene: &Scene, name: &str, sample: &Sample) {
    let codes = sample.scan.codes;
    let lit = codes.taxels.map_or([[Code(5000); 4]; 4], |taxels| taxels.lit);
    let lit = &lit.as_flattened()[..scene.device.rows() * 4];
    let dimmest = if scene.device.kind == Kind::Taxel4x4 { 3000 } else { 1500 };
    let good = |code: &Code| code.0 > dimmest && !codes.full_scale.clips(*code);
    assert!(lit.iter().all(good), "{name}");
    for m in codes.bridges.iter().flatten() {
        let intact = |code: Code| (0.25..0.75).contains(&codes.full_scale.ratio(code).0);
        assert!([m.a, m.b, m.c, m.d].into_iter().all(intact), "{name}");
    }
}

#[test]
fn every_built_in_scene_runs_repeatably() {
    let slipping = [
        "shear-ramp",
        "stick-slip",
        "torsion",
        "tour",
        "array",
        "micro-shear",
        "sheet-press",
        "sheet-shear",
        "column-step",
    ];
    for (name, _) in built_in() {
        let scene = Scene::load(name).unwrap();
        let slips = run_to_end(&scene, name).slips;
        assert_eq!(slips, slipping.contains(&name), "{name}");
    }
}

#[test]
fn every_built_in_scene_is_in_the_manual() {
    let page = include_str!("../../../../docs/simulator.md");
    let (_, table) = page.split_once("Built-in scenes (").unwrap();
    let (table, _) = table.split_once("\n## ").unwrap();
    let names: Vec<&str> = table.split('`').skip(3).step_by(2).collect();
    for (name, _) in built_in() {
        let there = names.iter().any(|written| match written.strip_suffix('*') {
            Some(begin) => name.starts_with(begin),
            None => *written == name,
        });
        assert!(there, "{name} {names:?}");
    }
    let known = |written: &str| {
        let begin = written.trim_end_matches('*');
        built_in().any(|(name, _)| name.starts_with(begin))
    };
    assert!(names.iter().all(|written| known(written)), "{names:?}");
}

#[test]
fn other_seed_changes_the_run_not_the_device() {
    for (name, _) in built_in() {
        let scene = Scene::load(name).unwrap();
        let first =
            |seed| Simulator::new(&scene, seed).take(UNLOADED.into()).collect::<Vec<Sample>>();
        let (one, other) = (first(1), first(2));
        assert_ne!(one, other, "{name}");
        let (one, other) = (mean(&one), mean(&other));
        let near = one.iter().zip(&other).all(|(a, b)| (a - b).abs() < 0.01);
        assert!(near, "{name}: {one:?} {other:?}");
    }
}

/// Mean level of each channel.
fn mean(samples: &[Sample]) -> Vec<f32> {
    let levels = samples.iter().map(|sample| Levels::read(&sample.scan.codes));
    let channels = levels.map(|levels| {
        let bridges = levels.bridges.into_iter().flatten().flatten();
        levels.taxels.into_iter().flatten().chain(bridges).collect::<Vec<f32>>()
    });
    let sum = |sum: Vec<f32>, row: Vec<f32>| sum.iter().zip(row).map(|(s, c)| s + c).collect();
    let sums: Vec<f32> = channels.reduce(sum).unwrap();
    sums.into_iter().map(|sum| sum / samples.len() as f32).collect()
}

use super::*;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use crate::path::Path;
use crate::seeds::{Purpose, stream};

mod random;

const SCAN: &str = "[scan]\nrate_hz = 1000\nduration_s = 2\n";
const PRESS: &str = "[[press]]\nat_s = 0.2\nx_mm = 0.6\ny_mm = -0.4\nfz_n = 1.2\nfx_n = 0.3\n\
                     rise_s = 0.2\nhold_s = 0.7\nfall_s = 0.2\n";

fn scene(head: &str) -> Scene {
    Scene::parse("my.toml", &format!("{head}\n{SCAN}{PRESS}")).unwrap()
}

fn rung(head: &str) -> Rung {
    Ladder::new(&scene(head), 1).report().rung
}

#[test]
fn scene_can_name_its_rung() {
    assert_eq!(rung("fidelity = 'point'"), Rung::Point);
    assert_eq!(rung("fidelity = 'hertz'"), Rung::Hertz);
    assert_eq!(rung("fidelity = 'converged'"), Rung::Converged);
    assert_eq!(rung("fidelity = 'layer'"), Rung::Layer);
    let named = Ladder::new(&scene("fidelity = 'point'"), 1);
    assert_eq!(named.report().error, None, "nothing is measured that nobody asked for");
}

#[test]
fn tolerance_of_the_scene_selects_the_rung() {
    let loose = Ladder::new(&scene("tolerance = 0.5"), 1);
    let usual = Ladder::new(&scene(""), 1);
    let strict = Ladder::new(&scene("tolerance = 0.0001"), 1);
    assert_eq!(loose.report().rung, Rung::Point);
    assert_eq!(usual.report().rung, Rung::Hertz);
    assert_eq!(strict.report().rung, Rung::Converged);
    assert!(usual.report().error.unwrap() < 0.005);
    let text = usual.report().to_string();
    assert!(text.starts_with("fidelity hertz, 0.") && text.contains("of 1 % allowed"), "{text}");
    assert!(text.ends_with(", computed with 32 times less work than converged"), "{text}");
    assert!(!strict.report().to_string().contains("work"), "{}", strict.report());
}

#[test]
fn walls_make_the_layer_the_top_rung() {
    let framed = Ladder::new(&scene("effects = ['walls']"), 1);
    assert_eq!((framed.report().top, framed.report().rung), (Rung::Layer, Rung::Converged));
    let text = framed.report().to_string();
    assert!(text.contains("off layer of 1 % allowed, itself within 1 %, computed with"), "{text}");
    let free = Ladder::new(&scene(""), 1);
    let load =
        Contacts::from(Load { point: [0.6, -0.4], force: [0.0, 0.0, 1.2], ..Load::default() });
    let most = |ladder: &Ladder| ladder.displacement(&load).into_iter().fold(0.0f64, f64::max);
    assert!(most(&free) > 3.0 * most(&framed));
}

#[test]
fn scene_without_contact_takes_cheapest_rung() {
    let press = PRESS.replace("fz_n = 1.2\nfx_n = 0.3", "fz_n = 0");
    for acts in [String::new(), press] {
        let scene = Scene::parse("my.toml", &format!("{SCAN}{acts}")).unwrap();
        let report = *Ladder::new(&scene, 1).report();
        assert_eq!((report.rung, report.error), (Rung::Point, None));
        assert!(!report.to_string().contains('%'), "{report}");
    }
}

/// Worst error against the top rung, at `times`, of the rung that `auto` takes.
fn worst(ladder: &Ladder, scene: &Scene, seed: u64, times: impl IntoIterator<Item = f64>) -> f64 {
    let mut path = Path::new(scene, seed);
    let mut worst = 0.0f64;
    for time in times {
        let softness = scene.temperature().map_or(1.0, |t| crate::scene::softness(t.at(time)));
        let at = path.at(time).scaled(softness);
        let best = ladder.on_rung(ladder.report().top, &at);
        worst = worst.max(error(&ladder.displacement(&at), &best));
    }
    worst
}

/// A contact that lasts a moment of a long run counts like any other.
#[test]
fn short_contact_in_a_long_run_is_probed() {
    let light = "[[press]]\nat_s = 0.5\nx_mm = 0\ny_mm = 0\nfz_n = 0.01\nrise_s = 0.5\n\
                 hold_s = 60\nfall_s = 0.5\n";
    let tap = |at: f64, force: f64, width: f64| {
        format!(
            "[[tap]]\nat_s = {at}\nx_mm = 0.3\ny_mm = -0.2\nfz_n = {force}\nwidth_s = {width}\n"
        )
    };
    // Pad that carries ten newtons.
    let firm = "[material]\nyoung_mpa = 1\n";
    for (head, duration, acts, from, until) in [
        ("", 60, tap(31.2345, 2.0, 0.015), 31.2345, 31.2495),
        ("", 3000, PRESS.replace("at_s = 0.2", "at_s = 0.4"), 0.4, 1.5),
        (firm, 62, format!("{light}{}", tap(61.6, 10.0, 0.012)), 61.6, 61.612),
    ] {
        let text = format!("{head}[scan]\nrate_hz = 1000\nduration_s = {duration}\n{acts}");
        let scene = Scene::parse("my.toml", &text).unwrap();
        let ladder = Ladder::new(&scene, 1);
        let found = worst(
            &ladder,
            &scene,
            1,
            (1..500).map(|i| from + (until - from) * f64::from(i) / 500.0),
        );
        let report = ladder.report();
        assert!(found <= report.tolerance, "{duration} s: {found}, {report}");
        assert!(report.rung > Rung::Point && report.error.is_some(), "{report}");
    }
}

/// In a row too long for a comparison at every press, the hardest press decides.
#[test]
fn hardest_press_of_a_long_row_is_found() {
    let text = "tolerance = 0.06\n[scan]\nrate_hz = 100\nduration_s = 36000\n[[random]]\nat_s = 0\n\
                presses = 36000\neach_s = 1\nx_mm = [-3, 3]\ny_mm = [-3, 3]\nfz_n = [0.02, 1.5]\n\
                shear_of_limit = [0, 1]\n";
    let scene = Scene::parse("my.toml", text).unwrap();
    let ladder = Ladder::new(&scene, 1);
    let found =
        worst(&ladder, &scene, 1, (0..36_000).step_by(7).map(|press| f64::from(press) + 0.5));
    assert!(found <= ladder.report().tolerance, "{found}, {}", ladder.report());
}

/// Wide facets need more points, on the cheap rungs too: those must still save time.
#[test]
fn auto_saves_on_wide_and_narrow_facets() {
    for (device, layer) in [
        ("kind = 'taxel-4x4'", "depth_mm = 2.5\nfacet_mm = 4"),
        ("kind = 'taxel-4x1'", "depth_mm = 4\nfacet_mm = 4"),
        ("kind = 'taxel-4x1'", "depth_mm = 2\nfacet_mm = 4"),
    ] {
        let ladder = Ladder::new(&scene(&format!("[device]\n{device}\n[layer]\n{layer}")), 1);
        let report = ladder.report();
        assert_eq!(report.rung, Rung::Hertz, "{layer}");
        assert!(report.top_evaluations > 20 * report.evaluations, "{report}");
    }
}

/// Error of `converged`, the top rung of the half-space.
///
/// The reference has three times the rings and spokes, and twelve points along a facet.
#[test]
fn top_rung_is_converged() {
    for kind in ["sphere", "punch", "corner", "cylinder", "block", "edge"] {
        let scene = scene(&format!("[indenter]\nkind = '{kind}'"));
        let ladder = Ladder::new(&scene, 1);
        let skin = HalfSpace::new(scene.material.young_mpa, scene.material.poisson);
        let finer = Facets::new(skin, 2.5, 1.9, 12);
        let rule = scene.indenter().rule(24, 48);
        let mut worst = 0.0f64;
        for (point, force) in [
            ([0.6, -0.4], [0.0, 0.0, 1.5]),
            ([1.25, 1.25], [0.5, 0.3, 1.5]),
            ([3.7, -2.5], [-0.3, 0.9, 1.2]),
            ([0.0, 0.0], [0.0, 0.02, 0.05]),
        ] {
            let load = Load { point, force, ..Load::default() };
            let patches = scene.indenter().tractions(&skin, point, force, 0.0, scene.friction.mu);
            let best = finer.displacement(&rule, patches.iter().flatten());
            worst = worst.max(error(&ladder.on_rung(Rung::Converged, &load.into()), &best));
        }
        assert!(worst < 3e-6, "{kind}: {worst}");
    }
}

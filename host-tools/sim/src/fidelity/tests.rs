use super::*;
use crate::cost::timed;
use rand::RngExt as _;
use std::time::Duration;

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
fn a_scene_may_name_its_rung() {
    assert_eq!(rung("fidelity = 'point'"), Rung::Point);
    assert_eq!(rung("fidelity = 'hertz'"), Rung::Hertz);
    assert_eq!(rung("fidelity = 'converged'"), Rung::Converged);
    assert_eq!(rung("fidelity = 'layer'"), Rung::Layer);
    let named = Ladder::new(&scene("fidelity = 'point'"), 1);
    assert_eq!(named.report().error, None, "nothing is measured that nobody asked for");
}

#[test]
fn what_the_scene_tolerates_decides() {
    let loose = Ladder::new(&scene("tolerance = 0.5"), 1);
    let usual = Ladder::new(&scene(""), 1);
    let strict = Ladder::new(&scene("tolerance = 0.0001"), 1);
    assert_eq!(loose.report().rung, Rung::Point);
    assert_eq!(usual.report().rung, Rung::Hertz);
    assert_eq!(strict.report().rung, Rung::Converged);
    assert!(usual.report().error.unwrap() < 0.005);
    let text = usual.report().to_string();
    assert!(text.starts_with("fidelity hertz, 0.") && text.contains("of 1 % allowed"), "{text}");
}

#[test]
fn with_walls_the_framed_layer_is_the_measure() {
    let framed = Ladder::new(&scene("effects = ['walls']"), 1);
    assert_eq!((framed.report().top, framed.report().rung), (Rung::Layer, Rung::Converged));
    let free = Ladder::new(&scene(""), 1);
    let load =
        Contacts::from(Load { point: [0.6, -0.4], force: [0.0, 0.0, 1.2], ..Load::default() });
    let most = |ladder: &Ladder| ladder.displacement(&load).into_iter().fold(0.0f64, f64::max);
    assert!(most(&free) > 3.0 * most(&framed));
}

/// A scene of random indenter, geometry, material, tolerance and presses.
fn random_scene(seed: u64, walls: bool) -> Scene {
    let mut rng = crate::seeds::stream(seed, crate::seeds::Purpose::Noise);
    let mut draw = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
    let tolerance = 0.003 * 10f64.powf(draw(0.0, 1.0));
    let young = draw(0.15, 1.0);
    let depth = if walls { 2.5 } else { draw(1.5, 5.0) };
    let poisson = if walls { 0.5 } else { draw(0.4, 0.5) };
    let force = draw(0.1, 2.0);
    let [x, y] = [draw(-3.0, 1.0), draw(-3.0, 1.0)];
    let young = if walls { crate::contact::SILICONE_YOUNG_MPA } else { young };
    let effects = if walls { "effects = ['walls']" } else { "" };
    let axis = format!("length_mm = {}\nturn_deg = {}", draw(2.0, 10.0), draw(-90.0, 90.0));
    let indenter = match seed % 7 {
        0 => format!("kind = 'sphere'\nradius_mm = {}", draw(2.0, 15.0)),
        1 => format!("kind = 'punch'\nradius_mm = {}", draw(0.5, 4.0)),
        2 => format!("kind = 'corner'\nslope = {}", draw(0.2, 0.8)),
        3 => format!("kind = 'cylinder'\nradius_mm = {}\n{axis}", draw(2.0, 15.0)),
        4 => format!("kind = 'block'\nwidth_mm = {}\n{axis}", draw(0.5, 6.0)),
        5 => format!("kind = 'edge'\nslope = {}\n{axis}", draw(0.2, 0.8)),
        _ => "kind = 'point'".to_owned(),
    };
    let text = format!(
        "{effects}\ntolerance = {tolerance}\n[material]\nyoung_mpa = {young}\npoisson = {poisson}\n\
         [layer]\ndepth_mm = {depth}\n[indenter]\n{indenter}\n{SCAN}[[random]]\nat_s = 0\n\
         presses = 4\neach_s = 0.5\nx_mm = [{x}, {}]\ny_mm = [{y}, {}]\nfz_n = [0.05, {force}]\n\
         shear_of_limit = [0, 1]\nroll_mm = 1\n",
        x + 3.0,
        y + 3.0,
    );
    Scene::parse("random.toml", &text).unwrap()
}

#[test]
fn auto_keeps_its_tolerance_on_two_hundred_random_scenes_at_a_twentieth_of_the_cost() {
    let silicone = HalfSpace::new(crate::contact::SILICONE_YOUNG_MPA, 0.5);
    let framed = Support::Framed(Arc::new(Layer::new(silicone, 2.5, 1.9)));
    let (mut savings, mut faster) = (vec![], vec![]);
    for seed in 0..200 {
        let walls = seed % 20 == 0;
        let scene = random_scene(seed, walls);
        let ladder = if walls {
            Ladder::on(&scene, seed, silicone, framed.clone())
        } else {
            Ladder::new(&scene, seed)
        };
        let report = *ladder.report();
        let mut path = Path::new(&scene, seed);
        let [mut chosen_took, mut top_took] = [Duration::ZERO; 2];
        for frame in (0..scene.frames()).step_by(if walls { 401 } else { 101 }) {
            let at = path.at(frame as f64 / 1000.0);
            let (chosen, took) = timed(|| ladder.displacement(&at));
            chosen_took += took;
            let (best, took) = timed(|| ladder.on_rung(report.top, &at));
            top_took += took;
            let error = error(&chosen, &best);
            assert!(error <= report.tolerance, "scene {seed}, {at:?}: {error}, {report}");
        }
        savings.push(report.top_evaluations as f64 / report.evaluations as f64);
        faster.push(top_took.as_secs_f64() / chosen_took.as_secs_f64());
    }
    // In evaluations, which every machine counts alike, and in time.
    for mut ratios in [savings, faster] {
        ratios.sort_by(f64::total_cmp);
        assert!(ratios[100] >= 20.0, "{}", ratios[100]);
    }
}

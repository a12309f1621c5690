use super::*;
use crate::contact::{HalfSpace, Indenter};
use crate::load::Load;
use proptest::prelude::*;
use std::f64::consts::PI;

fn path(text: &str) -> Path {
    let text = format!("[scan]\nrate_hz = 1000\nduration_s = 100\n{text}");
    Path::new(&Scene::parse("test.toml", &text).unwrap(), 3)
}

fn one(path: &mut Path, time: f64) -> Option<Load> {
    path.at(time).whole()
}

const PRESS: &str = "[[press]]\nat_s = 1\nx_mm = 1\ny_mm = -2\nfz_n = 1.5\nfx_n = 0.6\n\
                     rise_s = 0.2\nhold_s = 0.6\nfall_s = 0.2\n";
const SLIDE: &str = "[[slide]]\nat_s = 1\nfrom_mm = [-3, 0]\nto_mm = [1, 3]\nfz_n = 0.9\n\
                     rise_s = 0.2\ntravel_s = 1.0\nfall_s = 0.2\n";

#[test]
fn press_rises_shears_and_ends() {
    let mut path = path(PRESS);
    assert_eq!(one(&mut path, 0.9), None);
    assert_eq!(one(&mut path, 1.2).unwrap().force, [0.0, 0.0, 1.5]);
    let held = one(&mut path, 1.5).unwrap();
    assert_eq!((held.point, held.slip), ([1.0, -2.0], false));
    assert!((held.force[0] - 0.6).abs() < 1e-12);
    assert_eq!(one(&mut path, 2.01), None);
}

#[test]
fn excess_shear_slips_at_friction_limit() {
    let mut path = path(&format!("[friction]\nmu = 0.2\n{PRESS}"));
    let held = one(&mut path, 1.5).unwrap();
    assert!(held.slip);
    assert!((held.force[0] - 0.2 * 1.5).abs() < 1e-12);
}

#[test]
fn slide_slips_in_motion_and_sticks_at_ends() {
    let mut path = path(SLIDE);
    assert!(!one(&mut path, 1.21).unwrap().slip);
    let middle = one(&mut path, 1.7).unwrap();
    assert!(middle.slip);
    assert!((middle.point[0] + 1.0).abs() < 1e-9 && (middle.point[1] - 1.5).abs() < 1e-9);
    assert!((middle.force[0] - 0.8 * 0.8 * 0.9).abs() < 1e-9, "along its way: {middle:?}");
    assert!((middle.force[1] - 0.6 * 0.8 * 0.9).abs() < 1e-9, "along its way: {middle:?}");
    let last = one(&mut path, 2.3).unwrap();
    assert_eq!((last.point, last.slip), ([1.0, 3.0], false));
}

#[test]
fn random_presses_follow_the_seed() {
    let text = "[scan]\nrate_hz = 100\nduration_s = 10\n[[random]]\nat_s = 0\npresses = 10\n\
                each_s = 1\nx_mm = [-3, 3]\ny_mm = [-3, 3]\nfz_n = [0.1, 1.8]\n";
    let scene = Scene::parse("test.toml", text).unwrap();
    let run = |seed| -> Vec<Option<Load>> {
        let mut path = Path::new(&scene, seed);
        (0..100).map(|i| one(&mut path, f64::from(i) * 0.1 + 0.05)).collect()
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn tap_is_half_a_sine() {
    let mut path = path("[[tap]]\nat_s = 1\nx_mm = 1\ny_mm = 2\nfz_n = 2\nwidth_s = 0.02\n");
    assert_eq!(one(&mut path, 0.999), None);
    let peak = one(&mut path, 1.01).unwrap();
    assert!((peak.force[2] - 2.0).abs() < 1e-12 && peak.point == [1.0, 2.0]);
    assert!((one(&mut path, 1.0 + 0.02 / 6.0).unwrap().force[2] - 1.0).abs() < 1e-9);
    assert_eq!(one(&mut path, 1.021), None);
}

#[test]
fn roll_moves_without_shear_or_slip() {
    let mut path = path(
        "[[roll]]\nat_s = 1\nfrom_mm = [-3, 0]\nto_mm = [1, 2]\nfz_n = 0.9\nrise_s = 0.2\n\
         travel_s = 1\nfall_s = 0.2\n",
    );
    let middle = one(&mut path, 1.7).unwrap();
    assert_eq!((middle.force, middle.slip), ([0.0, 0.0, 0.9], false));
    assert!((middle.point[0] + 1.0).abs() < 1e-9 && (middle.point[1] - 1.0).abs() < 1e-9);
}

#[test]
fn two_contacts_act_as_their_sum_wrench() {
    let second =
        PRESS.replace("x_mm = 1\ny_mm = -2\nfz_n = 1.5", "x_mm = -3\ny_mm = 2\nfz_n = 0.5");
    let mut path = path(&format!("{PRESS}{}", second.replace("fx_n = 0.6", "fx_n = -0.2")));
    let at = path.at(1.5);
    assert_eq!(at.loads().len(), 2);
    let whole = at.whole().unwrap();
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{whole:?}");
    near(whole.force[0], 0.4);
    near(whole.force[2], 2.0);
    near(whole.point[0], (1.5 - 1.5) / 2.0);
    near(whole.point[1], (-3.0 + 1.0) / 2.0);
    // Moments about the pad's middle, Σ x f_y − y f_x: of the parts and of the whole.
    let parts = 2.0 * 0.6 - 2.0 * -0.2;
    near(whole.torsion - whole.point[1] * whole.force[0], parts);
    assert_eq!(path.at(2.01).whole(), None);
}

#[test]
fn contact_persists_during_a_shorter_one() {
    let long = PRESS.replace("hold_s = 0.6", "hold_s = 6").replace("y_mm = -2", "y_mm = -4");
    let tap =
        |at: f64| format!("[[tap]]\nat_s = {at}\nx_mm = 0\ny_mm = 4\nfz_n = 1\nwidth_s = 0.1\n");
    let mut path = path(&format!("{long}{}{}", tap(2.0), tap(4.0)));
    let count = |time| path.at(time).loads().len();
    assert_eq!([1.5, 2.05, 3.0, 4.05, 5.0, 8.0].map(count), [1, 2, 1, 2, 1, 0]);
}

const TWIST: &str = "[[press]]\nat_s = 1\nx_mm = 0\ny_mm = 0\nfz_n = 1\ntorsion_nmm = 2\n\
                     rise_s = 0.2\nhold_s = 0.6\nfall_s = 0.2\n";

#[test]
fn torsion_slips_at_the_friction_limit() {
    // Friction limit of torsion: 3π/16·μPa for a sphere, π/4·μPa for a flat round punch.
    let skin = HalfSpace::new(crate::contact::SILICONE_YOUNG_MPA, 0.5);
    let a = skin.contact_radius(6.0, 1.0);
    let held = |text: &str| one(&mut path(&format!("{text}{TWIST}")), 1.5).unwrap();
    let sphere = held("");
    assert!(sphere.slip);
    assert!(
        (sphere.torsion / (3.0 * PI / 16.0 * 0.8 * a) - 1.0).abs() < 0.01,
        "{}",
        sphere.torsion
    );
    let punch = held("[indenter]\nkind = 'punch'\nradius_mm = 1.5\n");
    assert!((punch.torsion / (PI / 4.0 * 0.8 * 1.5) - 1.0).abs() < 0.01, "{}", punch.torsion);
    let wide = held("[indenter]\nkind = 'punch'\nradius_mm = 4\n");
    assert_eq!((wide.slip, wide.torsion), (false, 2.0));
    let tip = held("[indenter]\nkind = 'point'\n");
    assert_eq!((tip.slip, tip.torsion), (true, 0.0), "a tip has no lever");
}

#[test]
fn slip_matches_the_swept_limit_surface() {
    // Exact limit surface: the contact turns about a point at a distance c, so that friction is μp
    // along the velocity there ([Ospina2017] §2.3). The ellipse stays within 6 % of it.
    let (rule, mu) = (Indenter::Sphere { radius: 6.0 }.rule(40, 160), 0.8);
    let skin = HalfSpace::new(crate::contact::SILICONE_YOUNG_MPA, 0.5);
    let a = skin.contact_radius(6.0, 1.0);
    let most = 3.0 * PI / 16.0 * mu * a;
    let mut worst = 0.0f64;
    for c in [0.1, 0.3, 0.5, 0.8, 1.2, 2.0, 5.0] {
        let (mut shear, mut torsion) = (0.0, 0.0);
        for ([u, v], share) in rule.points() {
            let speed = (u + c).hypot(*v);
            shear += mu * share * (u + c) / speed;
            torsion += mu * share * a * ((u + c) * u + v * v) / speed;
        }
        worst = worst.max((f64::hypot(shear / mu, torsion / most) - 1.0).abs());
    }
    assert!((0.05..0.06).contains(&worst), "{worst}");
}

const STICK_SLIP: &str = "[friction]\nmu = 0.8\nmu_kinetic = 0.5\n[[slide]]\nat_s = 1\n\
                          from_mm = [-4, 0]\nto_mm = [4, 0]\nfz_n = 1\nrise_s = 0.2\n\
                          travel_s = 4\nfall_s = 0.2\n\
                          spring = { stiffness_n_mm = 0.5, mass_g = 20 }\n";

#[test]
fn stick_slip_matches_the_equation_of_motion() {
    // Closed form against the equation of motion, m s″ = k(vt − s) − friction, step by step.
    let mut path = path(STICK_SLIP);
    let (k, m, speed, step) = (0.5, 20e-6, 2.0, 1e-6);
    let (mut s, mut v, mut sticks) = (0.0, 0.0, true);
    let (mut slips, mut worst) = (0, 0.0f64);
    for i in 1..3_900_000 {
        let pull = k * (speed * f64::from(i) * step - s);
        if sticks && pull > 0.8 {
            (sticks, slips) = (false, slips + 1);
        }
        if !sticks {
            v += (pull - 0.5) / m * step;
            s += v * step;
            if v <= 0.0 && pull < 0.5 {
                (sticks, v) = (true, 0.0);
            }
        }
        if i % 1000 == 0 {
            let load = one(&mut path, 1.2 + f64::from(i) * step).unwrap();
            worst = worst.max((load.point[0] + 4.0 - s).abs());
        }
    }
    assert_eq!(slips, 5);
    assert!(worst < 0.01, "{worst} mm");
}

#[test]
fn stick_slip_has_static_and_kinetic_friction() {
    let mut path = path(STICK_SLIP);
    let loads: Vec<Load> =
        (0..40_000).filter_map(|i| one(&mut path, 1.2 + f64::from(i) * 1e-4)).collect();
    let (slipping, sticking): (Vec<&Load>, Vec<&Load>) = loads.iter().partition(|load| load.slip);
    assert!(slipping.iter().all(|load| (load.force[0] - 0.5).abs() < 1e-12));
    let highest = sticking.iter().fold(0.0f64, |m, load| m.max(load.force[0]));
    // After the first slip the force of the spring is (2μ_k − μ)P.
    let since = loads.iter().position(|load| load.slip).unwrap();
    let lowest = loads[since..].iter().fold(1.0f64, |m, load| m.min(load.force[0]));
    assert!((highest - 0.8).abs() < 1e-3 && (lowest - 0.2).abs() < 1e-3, "{highest} {lowest}");
    assert!(loads.windows(2).all(|pair| pair[1].point[0] >= pair[0].point[0] - 1e-12));
}

#[test]
fn spring_relaxes_during_release() {
    let mut path = path(STICK_SLIP);
    let loads: Vec<Load> =
        (0..199).filter_map(|i| one(&mut path, 5.2001 + f64::from(i) * 1e-3)).collect();
    assert_eq!(loads.len(), 199);
    assert!(loads.iter().all(|l| l.force[0] <= 0.8 * l.force[2] + 1e-12));
    assert!(loads.last().unwrap().slip && loads.last().unwrap().force[0] < 0.01);
    assert!((loads.last().unwrap().point[0] - 4.0).abs() < 0.01);
}

proptest! {
    #[test]
    fn friction_caps_shear_and_keeps_direction(
        qx in -3.0..3.0f64, qy in -3.0..3.0f64, p in 0.001..3.0f64, mu in 0.0..2.0f64,
    ) {
        let text = format!("[friction]\nmu = {mu}\n");
        let load = path(&text).grip.hold([0.0; 2], [qx, qy], 0.0, p).unwrap();
        let [fx, fy, fz] = load.force;
        prop_assert_eq!(fz, p);
        prop_assert!(fx.hypot(fy) <= mu * p * (1.0 + 1e-12));
        prop_assert!((fx * qy - fy * qx).abs() < 1e-9 && fx * qx + fy * qy >= 0.0);
        prop_assert_eq!(load.slip, qx.hypot(qy) > mu * p);
    }

    #[test]
    fn random_presses_keep_ranges_without_slip(time in 0.0..60.0f64) {
        let mut path = path(
            "[[random]]\nat_s = 0\npresses = 60\neach_s = 1\nx_mm = [-1.5, 1.5]\n\
             y_mm = [0, 2]\nfz_n = [0.2, 1.8]\nshear_of_limit = [0.2, 0.95]\nroll_mm = 2\n",
        );
        if let Some(Load { point: [x, y], force: [.., fz], slip, .. }) = one(&mut path, time) {
            prop_assert!(x.abs() <= 1.5 && (0.0..=2.0).contains(&y) && fz <= 1.8 && !slip);
        }
    }

    #[test]
    fn nothing_jumps(time in 0.9..2.6f64) {
        for text in [PRESS, SLIDE] {
            let mut path = path(text);
            let force = |load: Option<Load>| load.map_or([0.0; 3], |load| load.force);
            let (a, b) = (force(one(&mut path, time)), force(one(&mut path, time + 1e-4)));
            for (a, b) in a.iter().zip(b) {
                prop_assert!((a - b).abs() < 0.005);
            }
        }
    }
}

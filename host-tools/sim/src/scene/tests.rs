use super::*;
use crate::contact::Axis;

const SCAN: &str = "[scan]\nrate_hz = 1000\nduration_s = 10\n";
const PRESS: &str = "[[press]]\nat_s = 1\nx_mm = 0\ny_mm = 0\nfz_n = 1\nrise_s = 0.1\nhold_s = 1\n\
                     fall_s = 0.1\n";

fn refusal(text: &str) -> String {
    let message = Scene::parse("my.toml", text).unwrap_err().to_string();
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

fn refuses(text: &str, line: u32, words: &[&str]) {
    let message = refusal(text);
    assert!(message.starts_with(&format!("my.toml:{line}: ")), "{message}");
    for word in words {
        assert!(message.contains(word), "{message} lacks {word}");
    }
}

#[test]
fn built_in_scenes_share_one_device() {
    let first = Scene::load("press").unwrap();
    for (name, _) in built_in() {
        let scene = Scene::load(name).unwrap();
        assert!(!scene.description.is_empty(), "{name}");
        if scene.device.kind != Kind::Taxel4x4 {
            continue;
        }
        // A calibration made on one scene must hold on another.
        assert_eq!(scene.device.seed, first.device.seed, "{name}");
        assert_eq!(scene.material, first.material, "{name}");
        assert_eq!(scene.layer, first.layer, "{name}");
        let device = [Effect::GainSpread, Effect::OpticalCrosstalk, Effect::BridgeMismatch];
        assert!(device.iter().all(|effect| scene.has(*effect)), "{name}");
    }
}

#[test]
fn scene_loads_from_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("my.toml");
    std::fs::write(&path, format!("{SCAN}{PRESS}")).unwrap();
    let scene = Scene::load(path.to_str().unwrap()).unwrap();
    assert_eq!(scene.frames(), 10_000);
    assert_eq!(scene.device.bits, Bits::Sixteen);
    assert!(!scene.has(Effect::Noise));
}

#[test]
fn unknown_scene_points_to_the_known_names() {
    let message = Scene::load("tuor").unwrap_err().to_string();
    assert!(message.starts_with("tuor: no such scene"), "{message}");
    assert!(message.contains("taxel simulate --list"), "{message}");
}

#[test]
fn unknown_key_reports_line_and_known_keys() {
    let text = format!("{SCAN}[material]\nyuong_mpa = 0.2\n");
    refuses(&text, 5, &["yuong_mpa", "young_mpa", "poisson"]);
    refuses(&format!("{SCAN}[skin]\n"), 4, &["skin", "material"]);
    refuses(&format!("effects = ['noise', 'flikker']\n{SCAN}"), 1, &["flikker", "flicker"]);
}

#[test]
fn wrong_type_reports_line_and_key() {
    refuses(
        &format!("{SCAN}[indenter]\nradius_mm = 'six'\n"),
        5,
        &["`radius_mm`", "a text instead of a number", "0.5 to 1000"],
    );
    refuses("[scan]\nrate_hz = 1000.5\nduration_s = 1\n", 2, &["`rate_hz`"]);
    refuses(&format!("{SCAN}[device]\nbits = 14\n"), 5, &["`bits`", "12, 16"]);
    refuses(&format!("{SCAN}[device]\ncoating = 'rE'\n"), 5, &["`coating`", "rE", "bare", "F02"]);
}

#[test]
fn missing_key_is_reported() {
    refuses("[scan]\nrate_hz = 1000\n", 1, &["duration_s"]);
    assert!(refusal("").contains("scan"));
}

#[test]
fn impossible_values_report_allowed_range() {
    refuses(&format!("{SCAN}[material]\nyoung_mpa = -0.2\n"), 5, &["`young_mpa`", "0.001 to 100"]);
    refuses(&format!("{SCAN}[material]\npoisson = 0.6\n"), 5, &["`poisson`", "0 to 0.5"]);
    let first = format!("{SCAN}[material]\nfirst_cycle_ratio = 0.5\n");
    refuses(&first, 5, &["`first_cycle_ratio`", "0 to 0.4"]);
    refuses(&format!("{SCAN}[material]\nfollows = 'rE'\n"), 5, &["`follows`", "rE", "rA", "F02"]);
    refuses(&format!("{SCAN}[friction]\nmu = -1\n"), 5, &["`mu`", "0 to 10"]);
    refuses(&format!("{SCAN}[friction]\nmu = nan\n"), 5, &["`mu`", "0 to 10"]);
    refuses("[scan]\nrate_hz = 0\nduration_s = 1\n", 2, &["`rate_hz`", "1 to 20000"]);
}

#[test]
fn contact_off_the_pad_is_rejected() {
    let off = PRESS.replace("x_mm = 0", "x_mm = 5.5");
    refuses(&format!("{SCAN}{off}"), 6, &["`x_mm`", "off the pad", "-5 to 5"]);
    let slide = "[[slide]]\nat_s = 1\nfrom_mm = [0, 0]\nto_mm = [0, 7]\nfz_n = 1\nrise_s = 1\n\
                 travel_s = 1\nfall_s = 1\n";
    refuses(&format!("{SCAN}{slide}"), 7, &["`to_mm`", "off the pad"]);
}

#[test]
fn contacts_must_not_overlap_or_outlast_scene() {
    let second = PRESS.replace("at_s = 1", "at_s = 2");
    refuses(&format!("{SCAN}{PRESS}{second}"), 12, &["[[press]]", "0.00 mm", "apart"]);
    let late = PRESS.replace("at_s = 1", "at_s = 9");
    refuses(&format!("{SCAN}{late}"), 4, &["[[press]]", "duration_s"]);
    let later = PRESS.replace("at_s = 1", "at_s = 2.2");
    assert!(Scene::parse("my.toml", &format!("{SCAN}{PRESS}{later}")).is_ok());
    // The contact of a 6 mm sphere under a newton is 2.4 mm wide.
    let aside = |x: f64| second.replace("x_mm = 0", &format!("x_mm = {x}"));
    refuses(&format!("{SCAN}{PRESS}{}", aside(4.7)), 12, &["4.70 mm", "4.85 mm"]);
    assert!(Scene::parse("my.toml", &format!("{SCAN}{PRESS}{}", aside(4.9))).is_ok());
}

#[test]
fn crossing_paths_at_one_time_are_rejected() {
    let roll = |from: &str, to: &str| {
        format!(
            "[[roll]]\nat_s = 1\nfrom_mm = {from}\nto_mm = {to}\nfz_n = 0.1\nrise_s = 1\n\
             travel_s = 1\nfall_s = 1\n"
        )
    };
    let (across, up) = (roll("[-4, 0]", "[4, 0]"), roll("[0, -4]", "[0, 4]"));
    refuses(&format!("{SCAN}{across}{up}"), 12, &["[[roll]]", "0.00 mm"]);
    let beside = roll("[-4, 3]", "[4, 4]");
    assert!(Scene::parse("my.toml", &format!("{SCAN}{across}{beside}")).is_ok());
}

#[test]
fn four_contacts_at_once_and_random_alone() {
    let tap =
        |x: f64| format!("[[tap]]\nat_s = 1\nx_mm = {x}\ny_mm = 0\nfz_n = 0.01\nwidth_s = 1\n");
    let taps: String = [-4.0, -2.0, 0.0, 2.0].map(tap).concat();
    assert!(Scene::parse("my.toml", &format!("{SCAN}{taps}")).is_ok());
    refuses(&format!("{SCAN}{taps}{}", tap(4.0)), 28, &["[[tap]]", "number 5", "allowed are 4"]);
    let random = "[[random]]\nat_s = 0\npresses = 3\neach_s = 1\nx_mm = [3, 3]\ny_mm = [0, 0]\n\
                  fz_n = [1, 1]\n";
    refuses(&format!("{SCAN}{random}{}", tap(0.0)), 11, &["[[tap]]", "[[random]]", "alone"]);
}

#[test]
fn indenter_accepts_only_keys_of_its_kind() {
    let indenter = |text: &str| format!("{SCAN}[indenter]\n{text}\n");
    let parse = |text: &str| Scene::parse("my.toml", &indenter(text)).map(|scene| scene.indenter());
    let axis = |turn: f64| Axis { length: 8.0, turn };
    assert_eq!(parse("radius_mm = 4").unwrap(), Indenter::Sphere { radius: 4.0 });
    assert_eq!(parse("kind = 'point'").unwrap(), Indenter::Point);
    assert_eq!(parse("kind = 'punch'").unwrap(), Indenter::Punch { radius: 2.0 });
    assert_eq!(parse("kind = 'corner'").unwrap(), Indenter::Corner { slope: 0.5 });
    assert_eq!(parse("kind = 'edge'").unwrap(), Indenter::Edge { slope: 0.5, axis: axis(0.0) });
    assert_eq!(parse("kind = 'block'").unwrap(), Indenter::Block { width: 3.0, axis: axis(0.0) });
    let turned = Indenter::Cylinder { radius: 6.0, axis: axis(std::f64::consts::FRAC_PI_2) };
    assert_eq!(parse("kind = 'cylinder'\nturn_deg = 90").unwrap(), turned);
    refuses(&indenter("kind = 'ball'"), 5, &["`kind`", "ball", "sphere", "cylinder", "corner"]);
    refuses(&indenter("length_mm = 4"), 5, &["`length_mm`", "\"sphere\"", "`radius_mm`"]);
    refuses(&indenter("kind = 'edge'\nradius_mm = 4"), 6, &["\"edge\"", "`slope`, `length_mm`"]);
    refuses(&indenter("radius_mm = -4"), 5, &["`radius_mm`", "-4", "0.5 to 1000"]);
    refuses(&indenter("kind = 'corner'\nslope = 3"), 6, &["`slope`", "0.05 to 1"]);
}

#[test]
fn kinetic_friction_is_at_most_static() {
    let text = format!("{SCAN}[friction]\nmu = 0.5\nmu_kinetic = 0.6\n");
    refuses(&text, 6, &["`mu_kinetic`", "0.6", "0 to 0.5, which is `mu`"]);
    let scene = |text: &str| Scene::parse("my.toml", &format!("{SCAN}[friction]\n{text}")).unwrap();
    assert_eq!(scene("mu = 0.5\nmu_kinetic = 0.4\n").friction.mu_kinetic(), 0.4);
    assert_eq!(scene("mu = 0.5\n").friction.mu_kinetic(), 0.5);
}

#[test]
fn keys_of_every_act_are_checked() {
    let press = PRESS.replace("fz_n = 1\n", "fz_n = 1\ntorsion_nmm = 400\n");
    refuses(&format!("{SCAN}{press}"), 9, &["`torsion_nmm`", "-100 to 100"]);
    let tap = "[[tap]]\nat_s = 1\nx_mm = 0\ny_mm = 0\nfz_n = 1\nwidth_s = 0\n";
    refuses(&format!("{SCAN}{tap}"), 9, &["`width_s`", "0.001 to 86400"]);
    let slide = |spring: &str| {
        format!(
            "{SCAN}[[slide]]\nat_s = 1\nfrom_mm = [0, 0]\nto_mm = [0, 2]\nfz_n = 1\nrise_s = 1\n\
             travel_s = 1\nfall_s = 1\nspring = {spring}\n"
        )
    };
    refuses(&slide("{ stiffness_n_mm = 0, mass_g = 1 }"), 12, &["`stiffness_n_mm`", "0.01 to 100"]);
    refuses(&slide("{ stiffness_n_mm = 1, mass_g = -1 }"), 12, &["`mass_g`", "0.1 to 10000"]);
    refuses(&slide("{ stiffness_n_mm = 1 }"), 12, &["`spring`", "mass_g"]);
}

#[test]
fn frame_is_rejected_if_steps_exceed_it() {
    refuses("[scan]\nrate_hz = 10000\nduration_s = 1\n", 2, &["100 µs", "step_us", "150 µs"]);
}

#[test]
fn bench_rejects_an_unknown_sensor() {
    refuses(&format!("{SCAN}[bench]\nsensor = 4\n"), 5, &["`sensor`", "0 to 3"]);
}

#[test]
fn fidelity_names_a_rung_and_walls_have_limits() {
    refuses(&format!("fidelity = 'fine'\n{SCAN}"), 1, &["fidelity", "fine", "converged", "auto"]);
    refuses(&format!("tolerance = 0\n{SCAN}"), 1, &["`tolerance`", "0.00001 to 0.5"]);
    for walls in ["effects = ['walls']", "fidelity = 'layer'"] {
        for (line, words) in [
            ("[layer]\ndepth_mm = 9", ["`depth_mm` 9", "2.5 to 4"]),
            ("[layer]\nfacet_mm = 0.2", ["`facet_mm` 0.2", "1.6 to 1.9"]),
            ("[material]\npoisson = 0.3", ["`poisson` 0.3", "0.4 to 0.5"]),
        ] {
            refuses(&format!("{walls}\n{SCAN}{line}\n"), 1, &words);
        }
        assert!(Scene::parse("my.toml", &format!("{walls}\n{SCAN}")).is_ok());
    }
}

#[test]
fn reversed_range_is_rejected() {
    let random = "[[random]]\nat_s = 0\npresses = 3\neach_s = 1\nx_mm = [3, -3]\ny_mm = [0, 0]\n\
                  fz_n = [1, 1]\n";
    refuses(&format!("{SCAN}{random}"), 8, &["`x_mm`", "lower one first"]);
}

#[test]
fn temperature_ramps_only_when_listed() {
    let ramp = "[temperature]\nstart_c = 20\nend_c = 40\nfrom_s = 2\nramp_s = 4\n";
    let listed = Scene::parse("my.toml", &format!("effects = ['temperature']\n{SCAN}{ramp}"));
    let listed = listed.unwrap();
    let listed = listed.temperature().unwrap();
    let at = [0.0, 2.0, 3.0, 6.0, 10.0].map(|time| listed.at(time));
    assert_eq!(at, [20.0, 20.0, 25.0, 40.0, 40.0]);
    let unlisted = Scene::parse("my.toml", &format!("{SCAN}{ramp}")).unwrap();
    assert_eq!(unlisted.temperature(), None);
    refuses(&format!("{SCAN}[temperature]\nend_c = 400\n"), 5, &["`end_c`", "-40 to 125"]);
    refuses(&format!("{SCAN}[temperature]\nramp_s = 0\n"), 5, &["`ramp_s`", "0.001 to 86400"]);
}

#[test]
fn device_rejects_loads_beyond_its_laws() {
    let device = |kind: &str| format!("{SCAN}[device]\nkind = '{kind}'\n");
    let plate = "[[plate]]\nat_s = 1\nfz_n = 0.4\nrise_s = 0.1\ntravel_s = 1\nfall_s = 0.1\n";
    refuses(&device("taxel-5x5"), 5, &["`kind`", "taxel-4x4", "ohka-column"]);
    refuses(&format!("{SCAN}{plate}"), 4, &["[[plate]]", "ohka-column"]);
    let steep = plate.replace("fz_n = 0.4", "fz_n = 0.4\nstep_mm = 0.25");
    refuses(&format!("{}{steep}", device("ohka-column")), 6, &["0.3400 N", "up to 0.3 N"]);
    refuses(&format!("{}{PRESS}", device("ohka-micro")), 6, &["1.0000 N", "up to 0.012 N"]);
    let aside = PRESS.replace("x_mm = 0", "x_mm = 1").replace("fz_n = 1", "fz_n = 0.01");
    refuses(&format!("{}{aside}", device("ohka-micro")), 6, &["one feeler", "0, 0"]);
    refuses(&format!("{}{aside}", device("mems-3axis")), 6, &["one force sensor", "0, 0"]);
    let slide = "[[slide]]\nat_s = 1\nfrom_mm = [0, 0]\nto_mm = [1, 1]\nfz_n = 0.1\nrise_s = 1\n\
                 travel_s = 1\nfall_s = 1\n";
    refuses(&format!("{}{slide}", device("ohka-column")), 6, &["[[press]]", "[[plate]]"]);
    let listed = |effect: &str, kind: &str| format!("effects = ['{effect}']\n{}", device(kind));
    refuses(&listed("walls", "taxel-4x1"), 1, &["effects", "walls of the 4×4 finger", "leave"]);
    refuses(&listed("hysteresis", "ohka-micro"), 1, &["`hysteresis`", "facets"]);
    refuses(&listed("sun", "mems-array"), 1, &["`sun`", "phototransistors"]);
    refuses(&listed("response", "ohka-column"), 1, &["`response`", "force sensors"]);
    let layer = format!("fidelity = 'layer'\n{}", device("taxel-4x1"));
    refuses(&layer, 1, &["fidelity", "4×4 finger"]);
    refuses(&format!("{}surface = {{ sphere = 3 }}\n", device("mems-array")), 6, &["8 to 1000"]);
    refuses(&format!("{}[bench]\nsensor = 1\n", device("mems-3axis")), 7, &["no sensor 1"]);
}

/// Text of a press of `fz_n` newtons at a contact point.
fn press(at_s: f64, [x, y]: [f64; 2], fz_n: f64) -> String {
    format!(
        "[[press]]\nat_s = {at_s}\nx_mm = {x}\ny_mm = {y}\nfz_n = {fz_n}\nrise_s = 0.1\nhold_s = 1\n\
         fall_s = 0.1\n"
    )
}

#[test]
fn column_presses_stay_on_tip_within_limit() {
    let columns = format!("{SCAN}[device]\nkind = 'ohka-column'\n[indenter]\nkind = 'point'\n");
    let between = format!("{columns}{}", press(1.0, [0.0, 0.0], 0.1));
    refuses(&between, 8, &["0, 0 mm", "no column", "-2.5, -2.5", "1 mm in radius"]);
    let both = |x: f64, y: f64, at_s: f64| {
        let second = press(at_s, [x, y], 0.2);
        format!("{columns}{}{second}", press(1.0, [2.5, 2.5], 0.2))
    };
    refuses(&both(2.8, 2.2, 2.0), 16, &["0.4000 N", "2.2 s", "up to 0.3 N", "0.1000 N at most"]);
    for (x, y, at_s) in [(-2.5, 2.5, 2.0), (2.8, 2.2, 2.2)] {
        assert!(Scene::parse("my.toml", &both(x, y, at_s)).is_ok(), "{x} {y} {at_s}");
    }
}

#[test]
fn tolerance_below_layer_error_is_rejected() {
    let walls = "effects = ['walls']\n";
    let fine = format!("{walls}tolerance = 0.009\n{SCAN}");
    refuses(&fine, 2, &["`tolerance`", "0.009", "allowed are 0.01 to 0.5"]);
    assert!(Scene::parse("my.toml", &format!("{walls}tolerance = 0.01\n{SCAN}")).is_ok());
    assert!(Scene::parse("my.toml", &format!("tolerance = 0.009\n{SCAN}")).is_ok());
    // A rung that the scene names is used, whatever its error.
    let named = format!("fidelity = 'converged'\n{fine}");
    assert!(Scene::parse("my.toml", &named).is_ok());
}

#[test]
fn contact_shorter_than_a_scan_is_rejected() {
    let slow = "[scan]\nrate_hz = 200\nduration_s = 10\n";
    let tap = |width: f64| {
        format!("{slow}[[tap]]\nat_s = 1.001\nx_mm = 0\ny_mm = 0\nfz_n = 1\nwidth_s = {width}\n")
    };
    refuses(&tap(0.001), 4, &["touches for 0.001 s", "200 Hz", "`width_s` at least 0.01 s"]);
    assert!(Scene::parse("my.toml", &tap(0.01)).is_ok());
    let short = PRESS.replace("= 0.1", "= 0.002").replace("hold_s = 1", "hold_s = 0.003");
    refuses(&format!("{slow}{short}"), 4, &["0.007 s", "`hold_s`", "together at least 0.01 s"]);
    let row = "[[random]]\nat_s = 0\npresses = 3\neach_s = 0.01\nx_mm = [0, 0]\ny_mm = [0, 0]\n\
               fz_n = [1, 1]\n";
    refuses(&format!("{slow}{row}"), 4, &["0.008 s", "`each_s` at least 0.0125 s"]);
}

#[test]
fn contact_larger_than_the_pad_is_rejected() {
    let on = |head: &str, indenter: &str, place: [f64; 2], fz_n: f64| {
        format!("{head}{SCAN}[indenter]\n{indenter}\n{}", press(1.0, place, fz_n))
    };
    let walls = "effects = ['walls']\n";
    for head in ["", walls] {
        let line = if head.is_empty() { 6 } else { 7 };
        for radius in [300, 1000] {
            let large = on(head, &format!("radius_mm = {radius}"), [0.0, 0.0], 2.0);
            refuses(&large, line, &["[[press]]", "along x", "may reach 8 mm", "move it inwards"]);
        }
    }
    // The contact area at its largest counts, at its place.
    let cylinder = |turn: f64| format!("kind = 'cylinder'\nlength_mm = 10\nturn_deg = {turn}");
    refuses(&on("", &cylinder(0.0), [4.5, 0.0], 0.5), 8, &["9.50 mm along x"]);
    assert!(Scene::parse("my.toml", &on("", &cylinder(90.0), [4.5, 0.0], 0.5)).is_ok());
    refuses(&on("", "radius_mm = 6", [0.0, -4.99], 2.0), 6, &["8.05 mm along y"]);
    assert!(Scene::parse("my.toml", &on("", "radius_mm = 6", [4.9, -4.9], 2.0)).is_ok());
}

#[test]
fn contact_beyond_hertz_is_rejected() {
    let on = |indenter: &str, layer: &str, fz_n: f64| {
        format!("{SCAN}[layer]\n{layer}\n[indenter]\n{indenter}\n{}", press(1.0, [0.0; 2], fz_n))
    };
    let small = on("radius_mm = 2", "depth_mm = 20", 1.0);
    refuses(
        &small,
        8,
        &["1.68 mm", "`radius_mm` of 2", "0.7 of it, 1.40 mm", "`fz_n` of 0.575 at most"],
    );
    assert!(Scene::parse("my.toml", &on("radius_mm = 2", "depth_mm = 20", 0.575)).is_ok());
    let deep = on("radius_mm = 6", "depth_mm = 2", 2.0);
    refuses(
        &deep,
        8,
        &["1.56 mm", "`depth_mm` 2 mm", "0.7 of it, 1.40 mm", "`fz_n` of 1.702 at most"],
    );
    assert!(Scene::parse("my.toml", &on("radius_mm = 6", "depth_mm = 2", 1.702)).is_ok());
}

#[test]
fn grid_sets_its_presses_and_is_alone() {
    let grid = "[[grid]]\nat_s = 1\neach_s = 0.5\nx_mm = [-3, 3]\ncolumns = 3\ny_mm = [0, 0]\n\
                rows = 1\nforce_n = 0.2\nangle_deg = [60, 120]\nangles = 2\n";
    assert!(Scene::parse("my.toml", &format!("{SCAN}{grid}")).is_ok());
    let none = grid.replace("columns = 3", "columns = 0");
    refuses(&format!("{SCAN}{none}"), 8, &["`columns`", "1 to 1000"]);
    let press = PRESS.replace("at_s = 1", "at_s = 1.5");
    refuses(&format!("{SCAN}{grid}{press}"), 14, &["[[press]]", "[[grid]]", "alone"]);
}

#[test]
fn electronics_and_light_report_their_ranges() {
    for (table, key, allowed) in [
        ("electronics", "load_ohm = 1", "10 to 100000"),
        ("electronics", "pga_gain = 3", "1, 2, 4, 8, 16, 32, 64"),
        ("electronics", "time_constant_us = 0", "0.1 to 1000"),
        ("electronics", "oversampling = 12", "1, 2, 4, 8, 16, 32, 64, 128, 256"),
        ("electronics", "oversampling = 256", "`step_us` 30 µs"),
        ("electronics", "bridge_gain = 0", "1 to 100"),
        ("electronics", "ratiometric = 'yes'", "true or false"),
        ("electronics", "ripple_ratio = 0.9", "0 to 0.5"),
        ("electronics", "ripple_hz = 0", "1 to 1000000"),
        ("electronics", "gain = 3", "`pga_gain`"),
        ("light", "sun_ratio = 2", "0 to 1"),
        ("light", "sun_at_s = -1", "0 to 86400"),
        ("device", "wrong_side = ['r4c0']", "r0c0 to r3c3"),
    ] {
        let name = key.split(' ').next().unwrap();
        refuses(&format!("{SCAN}[{table}]\n{key}\n"), 5, &[name, allowed]);
    }
}

#[test]
fn fault_reports_missing_keys_and_parts() {
    let fault = |keys: &str, line: u32, words: &[&str]| {
        refuses(&format!("{SCAN}[[fault]]\nat_s = 1\n{keys}\n"), line, words);
    };
    fault("kind = 'flood'", 6, &["`kind`", "flood", "dead-led", "swapped-columns"]);
    fault("kind = 'dead-led'", 6, &["`kind`", "needs `channel`", "r0c0, r0c1", "r3c3"]);
    fault("kind = 'dead-led'\nchannel = 'c1'", 7, &["`channel`", "`c1`", "r0c0"]);
    fault("kind = 'shorted-channel'\nchannel = 'r0c0'", 7, &["`channel`", "c0, c1", "s3_d"]);
    fault("kind = 'broken-arm'\nchannel = 's0_r9'", 7, &["`channel`", "s0_r1", "s3_r8"]);
    fault("kind = 'stuck-channel'\nchannel = 'x'", 7, &["`channel`", "r0c0", "s0_a", "vref"]);
    fault(
        "kind = 'swapped-columns'\nchannel = 'c1'",
        6,
        &["`kind`", "needs `with`", "c0, c1, c2, c3"],
    );
    fault("kind = 'supply-dip'", 6, &["`kind`", "needs `ratio`", "0.3 to 1"]);
    fault("kind = 'supply-dip'\nratio = 0.1", 7, &["`ratio`", "0.3 to 1"]);
    fault("kind = 'supply-dip'\nratio = 0.8\nchannel = 'c1'", 8, &["`channel`", "`ratio`"]);
    fault("kind = 'dead-led'\nchannel = 'r0c0'\nratio = 1", 8, &["`ratio`", "`channel`"]);
    fault(
        "until_s = 0.5\nkind = 'supply-dip'\nratio = 0.8",
        6,
        &["`until_s`", "`at_s` 1 s", "later"],
    );
    fault("kind = 'dead-led'\nwhere = 'r0c0'", 7, &["where", "channel"]);
    let blind = format!(
        "{SCAN}[device]\ntaxels = false\nbridges = [true, false, true, true]\n[[fault]]\nat_s = 1\n"
    );
    refuses(&format!("{blind}kind = 'dead-led'\nchannel = 'r0c0'\n"), 10, &["no such part"]);
    let message = refusal(&format!("{blind}kind = 'broken-arm'\nchannel = 's1_r1'\n"));
    assert!(message.contains("s0_r8, s2_r1"), "{message}");
}

#[test]
fn too_deep_press_is_rejected_with_advice() {
    let words = ["`depth_mm`", "`fz_n`", "[indenter]", "[material]"];
    // A sphere of 6 mm with 2.379 N goes 1.75 mm deep (a²/R).
    refuses(&format!("{SCAN}{}", PRESS.replace("fz_n = 1", "fz_n = 2.38")), 4, &words);
    assert!(
        Scene::parse("my.toml", &format!("{SCAN}{}", PRESS.replace("fz_n = 1", "fz_n = 2.37")))
            .is_ok()
    );
    for indenter in ["sphere", "punch", "corner", "cylinder", "block", "edge", "point"] {
        let head = format!("{SCAN}[indenter]\nkind = '{indenter}'\n");
        refuses(&format!("{head}[material]\nyoung_mpa = 0.001\n{PRESS}"), 8, &words);
        assert!(Scene::parse("my.toml", &format!("{head}{PRESS}")).is_ok(), "{indenter}");
    }
    // A cold skin is softer; on a bench there is no skin.
    let cold = format!(
        "effects = ['temperature']\n{SCAN}[temperature]\nstart_c = -40\nend_c = 20\n{}",
        PRESS.replace("fz_n = 1", "fz_n = 2.37")
    );
    refuses(&cold, 8, &words);
    let bench = format!("{SCAN}[bench]\nsensor = 0\n{}", PRESS.replace("fz_n = 1", "fz_n = 9"));
    assert!(Scene::parse("my.toml", &bench).is_ok());
}

#[test]
fn facet_too_wide_for_its_depth_is_rejected() {
    let layer = "[layer]\ndepth_mm = 0.4\nfacet_mm = 1.9\n";
    let light = PRESS.replace("fz_n = 1", "fz_n = 0.01");
    refuses(&format!("{SCAN}{layer}{light}"), 7, &["`facet_mm` 1.9", "`depth_mm` 0.4", "4 times"]);
}

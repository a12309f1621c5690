//! Codes of a scene: effects of light, electronics and supply, and repeatability.

use taxel::scan::{Codes, Midpoints, TAXELS};
use taxel::units::Code;
use taxel_files::trace::Sample;
use taxel_sim::{Scene, Simulator};

const SCAN: &str = "[scan]\nrate_hz = 1000\nduration_s = 1\n";
const PRESS: &str = "[[press]]\nat_s = 0.3\nx_mm = -1.25\ny_mm = 1.25\nfz_n = 0.8\nrise_s = 0.1\n\
                     hold_s = 0.4\nfall_s = 0.1\n";
/// Index of a frame during the hold of the press.
const HELD: usize = 600;

fn run(text: &str) -> Vec<Sample> {
    Simulator::new(&Scene::parse("test.toml", text).unwrap(), 1).collect()
}

/// Runs a scene with listed effects, more keys of the scan and further tables.
fn scene(effects: &str, scan: &str, tables: &str) -> Vec<Sample> {
    run(&format!("effects = [{effects}]\n{SCAN}{scan}\n{tables}\n{PRESS}"))
}

fn lit(codes: &Codes) -> [f64; TAXELS] {
    let taxels = codes.taxels.unwrap();
    std::array::from_fn(|k| f64::from(taxels.lit[k / 4][k % 4].0))
}

fn lit_less_dark(sample: &Sample) -> [f64; TAXELS] {
    let dark = sample.scan.codes.taxels.unwrap().dark;
    let lit = lit(&sample.scan.codes);
    std::array::from_fn(|k| lit[k] - f64::from(dark[k % 4].0))
}

fn midpoints(sample: &Sample) -> [Code; 4] {
    let Midpoints { a, b, c, d } = sample.scan.codes.bridges[0].unwrap();
    [a, b, c, d]
}

fn codes(samples: &[Sample]) -> Vec<Codes> {
    samples.iter().map(|sample| sample.scan.codes).collect()
}

/// Coating of the device: part of the device; its lag is an effect.
const COATED: &str = "[device]\ncoating = 'F02'\n";
/// Tables in which every effect has work to do.
const TABLES: &str = "[light]\nsun_at_s = 0.5\n[temperature]\nend_c = 45\n";

#[test]
fn effect_changes_codes_only_when_listed() {
    let run = |effects: &str, tables: &str| {
        codes(&scene(effects, "step_us = 15", &format!("{COATED}{tables}")))
    };
    let plain = run("", "");
    assert!(run("", TABLES) == plain, "tables alone change nothing");
    for effect in [
        "noise",
        "ambient",
        "flicker",
        "sun",
        "settling",
        "supply-ripple",
        "gain-spread",
        "optical-crosstalk",
        "bridge-mismatch",
        "bridge-crosstalk",
        "stiffening",
        "hysteresis",
        "skin-response",
        "response",
        "temperature",
    ] {
        assert!(run(&format!("'{effect}'"), TABLES) != plain, "{effect}");
    }
}

/// Reading of a column 8 µs into a step of 12 µs, of which the conversions take the last four.
///
/// The column still has e^(−8/τ) of its difference from the light. The step before left e^(−12/τ)
/// of its own lag in that. τ is 7 µs over ln 9.
#[test]
fn short_step_spills_into_next_row_of_column() {
    let [settled, hasty] = ["", "'settling'"].map(|effects| {
        let sample = scene(effects, "step_us = 12", "")[HELD];
        (lit(&sample.scan.codes), sample.scan.codes.taxels.unwrap().dark)
    });
    let tau = 7.0 / 9f64.ln();
    let mut largest = [0.0f64; 2];
    for column in 0..4 {
        let mut before = f64::from(settled.1[column].0);
        let mut lag = 0.0;
        for k in (column..TAXELS).step_by(4) {
            let behind = before + lag - settled.0[k];
            let error = hasty.0[k] - settled.0[k];
            assert!((error - behind * (-8.0 / tau).exp()).abs() <= 1.0, "{k}: {error} {behind}");
            let side = usize::from(error > 0.0);
            largest[side] = largest[side].max(error.abs());
            (before, lag) = (settled.0[k], behind * (-12.0 / tau).exp());
        }
    }
    // Row 0 follows the dark step; row 3 follows the pressed row 2.
    assert!(largest[0] > 1000.0 && largest[1] > 200.0, "{largest:?}");
    let patient = scene("'settling'", "step_us = 40", "")[HELD];
    let errors = lit(&patient.scan.codes).into_iter().zip(settled.0);
    assert!(errors.into_iter().all(|(patient, settled)| (patient - settled).abs() <= 1.0));
}

#[test]
fn wrong_side_flags_darkening_taxels() {
    let text = format!(
        "effects = ['gain-spread']\n{SCAN}[device]\nwrong_side = ['r2c1', 'r2c2']\n{PRESS}"
    );
    let scene = Scene::parse("test.toml", &text).unwrap();
    let mut simulator = Simulator::new(&scene, 1);
    let rest = lit_less_dark(&simulator.next().unwrap());
    let held = lit_less_dark(&simulator.nth(HELD).unwrap());
    let flagged = simulator.wrong_side();
    assert_eq!(flagged.iter().filter(|flag| **flag).count(), 2);
    // For taxels that the press changes by more than a thousandth, the sign of the change must
    // agree.
    let moved = (0..TAXELS).filter(|k| (held[*k] / rest[*k] - 1.0).abs() > 1e-3);
    assert!(moved.clone().count() > 8);
    for k in moved {
        assert_eq!(held[k] < rest[k], flagged[k], "taxel {k}");
    }
}

#[test]
fn sun_raises_lit_and_dark_until_clipping() {
    let sunny =
        |ratio: f64| scene("'sun'", "", &format!("[light]\nsun_at_s = 0.1\nsun_ratio = {ratio}\n"));
    let samples = sunny(0.3);
    let dark = |t: usize| f64::from(samples[t].scan.codes.taxels.unwrap().dark[2].0);
    assert!((dark(150) - dark(50) - 0.3 * 65_535.0).abs() < 1.0);
    for (before, after) in lit_less_dark(&samples[50]).into_iter().zip(lit_less_dark(&samples[150]))
    {
        assert!((before - after).abs() <= 1.0);
    }
    assert!(lit(&sunny(0.8)[150].scan.codes).iter().all(|code| *code == 65_535.0));
}

#[test]
fn lamps_leave_their_change_since_dark() {
    let samples = scene("'flicker'", "", "[light]\nflicker_ratio = 0.05\nflicker_hz = 100\n");
    let rest = lit_less_dark(&scene("", "", "")[0]);
    let worst = samples[..250].iter().flat_map(|sample| {
        let now = lit_less_dark(sample);
        (0..TAXELS).map(move |k| (k, (now[k] - rest[k]).abs() / 65_535.0))
    });
    let mut rows = [0.0f64; 4];
    worst.for_each(|(k, error)| rows[k / 4] = rows[k / 4].max(error));
    for (row, error) in rows.into_iter().enumerate() {
        // Row r is read 30 µs·(r + 1) after the dark step, at the steepest part of the swing.
        let most = 0.05 * std::f64::consts::TAU * 100.0 * 30e-6 * (row + 1) as f64;
        assert!(
            error < 1.02 * most + 1.0 / 65_535.0 && error > 0.8 * most,
            "{row}: {error} {most}"
        );
    }
}

#[test]
fn ripple_reaches_non_ratiometric_codes_only() {
    let swing = |ratiometric: bool| {
        let keys = format!(
            "[electronics]\nratiometric = {ratiometric}\nripple_ratio = 0.01\nripple_hz = 90\n"
        );
        let samples = scene("'supply-ripple'", "", &keys);
        let a = samples[..250].iter().map(|sample| midpoints(sample)[0].0);
        let swing = a.clone().max().unwrap() - a.min().unwrap();
        let light = samples[..250].iter().map(|sample| lit(&sample.scan.codes)[0]);
        (swing, light.clone().fold(0.0, f64::max) - light.fold(65_535.0, f64::min))
    };
    let (own, light) = swing(true);
    assert_eq!(own, 0, "it cancels");
    assert!(light > 100.0, "but the LEDs swing: {light}");
    // The swing is ± 1 % of half the range.
    assert!((640..=656).contains(&swing(false).0), "{}", swing(false).0);
}

#[test]
fn amplified_light_clips_unless_load_is_smaller() {
    let at = |electronics: &str| {
        lit(&scene("", "", &format!("[electronics]\n{electronics}\n"))[HELD].scan.codes)
    };
    assert!(at("pga_gain = 64").iter().all(|code| *code == 65_535.0));
    let (plain, balanced) = (at(""), at("pga_gain = 64\nload_ohm = 250"));
    assert!(plain.iter().zip(balanced).all(|(a, b)| (a - b).abs() <= 1.0));
}

#[test]
fn warm_finger_dims_and_weakens() {
    let warm = scene("'temperature'", "", "[temperature]\nstart_c = 45\nend_c = 45\n");
    let cool = scene("", "", "");
    for (warm, cool) in lit_less_dark(&warm[100]).into_iter().zip(lit_less_dark(&cool[100])) {
        assert!((warm / cool - 0.9).abs() < 1e-3, "20 K at −0.5 %/K: {}", warm / cool);
    }
    let u_z = |samples: &[Sample]| {
        let u = |t: usize| {
            let [a, b, c, d] = midpoints(&samples[t]).map(|code| f64::from(code.0));
            (a + b) - (c + d)
        };
        u(HELD) - u(100)
    };
    // 298.15 K over 318.15 K, with a rounding error of a code or two of some hundreds.
    let ratio = u_z(&warm) / u_z(&cool);
    assert!((ratio - 298.15 / 318.15).abs() < 0.01, "{ratio}");
    let thermometer = warm[100].scan.codes.temperature.unwrap();
    let volts = f64::from(thermometer.0) / 65_535.0 * 3.3;
    assert!((30.0 + (volts - 0.76) / 2.5e-3 - 45.0).abs() < 0.05, "{volts}");
    assert_eq!(cool[100].scan.codes.temperature, None);
}

#[test]
fn truth_has_every_field() {
    let samples = scene("'noise'", "", "");
    let (before, held) = (samples[100].truth, samples[HELD].truth);
    assert_eq!(before.force, [Some(0.0); 3]);
    assert_eq!((before.point, before.contact, before.slip), ([None; 2], Some(false), Some(false)));
    assert_eq!(held.point, [Some(-1.25), Some(1.25)]);
    assert_eq!((held.contact, held.slip, held.torsion), (Some(true), Some(false), Some(0.0)));
    assert!(held.sensors.iter().flatten().all(Option::is_some));
    let z: f64 = held.sensors.iter().filter_map(|sensor| sensor[2]).sum();
    assert!((z - 0.8).abs() < 1e-9);
}

/// FNV-1a hash of every code and of the truth in millionths.
fn hash(samples: &[Sample]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut eat = |value: i64| {
        for byte in value.to_le_bytes() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    for Sample { scan, truth } in samples {
        let codes = &scan.codes;
        if let Some(taxels) = codes.taxels {
            taxels.lit.iter().chain([&taxels.dark]).flatten().for_each(|code| eat(code.0.into()));
        }
        for Midpoints { a, b, c, d } in codes.bridges.into_iter().flatten() {
            [a, b, c, d].into_iter().for_each(|code| eat(code.0.into()));
        }
        eat(codes.reference.map_or(-1, |code| code.0.into()));
        eat(codes.temperature.map_or(-1, |code| code.0.into()));
        let truth = truth.force.iter().chain(&truth.point).chain(truth.sensors.as_flattened());
        truth.for_each(|value| eat(value.map_or(i64::MIN, |value| (value * 1e6).round() as i64)));
    }
    hash
}

/// Every bit is fixed, with noise, on any machine.
///
/// If this number changes, every simulated trace has changed and earlier recordings no longer
/// repeat; the changelog must say so.
#[test]
fn finger_codes_match_their_golden_hash() {
    let all = "'noise', 'ambient', 'flicker', 'sun', 'settling', 'supply-ripple', 'gain-spread', \
               'optical-crosstalk', 'bridge-mismatch', 'bridge-crosstalk', 'stiffening', \
               'hysteresis', 'skin-response', 'response', 'temperature'";
    let found = hash(&scene(all, "", &format!("{COATED}{TABLES}")));
    assert_eq!(found, 0xd40a_e9be_6955_3954, "{found:#018x}");
}

/// A press and a tap for each device, with all effects that act on it.
#[test]
fn other_devices_match_their_golden_hashes() {
    let light =
        "'noise', 'ambient', 'flicker', 'settling', 'supply-ripple', 'gain-spread', 'temperature'";
    let bridges = "'noise', 'supply-ripple', 'bridge-mismatch', 'bridge-crosstalk', 'response', \
                   'temperature'";
    let skin = "'optical-crosstalk', 'stiffening', 'hysteresis', 'skin-response'";
    let finger = format!("{light}, {skin}, 'bridge-mismatch', 'bridge-crosstalk', 'response'");
    let on = |x: f64, y: f64, force: f64| {
        format!(
            "[[press]]\nat_s = 0.1\nx_mm = {x}\ny_mm = {y}\nfz_n = {force}\nfx_n = {}\nrise_s = 0.1\n\
             hold_s = 0.3\nfall_s = 0.1\n[[tap]]\nat_s = 0.7\nx_mm = {x}\ny_mm = {y}\nfz_n = {force}\n\
             width_s = 0.02\n",
            0.3 * force
        )
    };
    let sheet = format!(
        "[material]\nyoung_mpa = 0.476\npoisson = 0.499\n[indenter]\nradius_mm = 20\n{}",
        on(0.2, -0.3, 0.1)
    );
    let pinned = [
        ("taxel-4x4", format!("{finger}, 'walls'"), on(0.6, -0.4, 1.2), 0x6100_47b6_28fc_4d69),
        ("taxel-4x1", format!("{light}, {skin}"), on(0.6, -0.4, 1.2), 0x54b9_1f9c_ce3d_c3fc),
        ("mems-3axis", bridges.to_owned(), on(0.0, 0.0, 0.8), 0xf814_cc3c_7db4_2cb4),
        ("mems-array", bridges.to_owned(), on(0.6, -0.4, 1.2), 0x57d3_989f_befc_53a8),
        ("ohka-micro", light.to_owned(), on(0.0, 0.0, 0.005), 0x4697_c20e_c42b_ed86),
        ("ohka-sheet", light.to_owned(), sheet, 0x4c4b_65d9_8728_9148),
        ("ohka-column", light.to_owned(), on(2.5, -2.5, 0.1), 0xe352_061e_a282_1f1d),
    ];
    let mut changed = vec![];
    for (kind, effects, acts, pinned) in pinned {
        let surface = if kind == "mems-array" { "surface = { sphere = 12 }\n" } else { "" };
        let text = format!(
            "effects = [{effects}]\n{SCAN}[device]\nkind = '{kind}'\n{surface}[temperature]\nend_c = 45\n{acts}"
        );
        let found = hash(&run(&text));
        if found != pinned {
            changed.push(format!("{kind}: {found:#018x}"));
        }
    }
    assert_eq!(changed, Vec::<String>::new());
}

//! Tests of evaluating, comparing and adjusting calibrations.

use std::fmt::Write as _;
use std::path::Path;

use crate::common::{In, json, write_trace};
use taxel::calibration::Calibration;
use taxel::estimate::quantised::{Net, QuantisedNet};
use taxel::estimate::slip::Slip;
use taxel::scan::TaxelCodes;
use taxel::units::Code;
use taxel_files::calibration;
use taxel_files::trace::Sample;
use taxel_sim::scene::Changes;
use taxel_sim::{Scene, Simulator};

/// Calibration of the virtual finger with net and sensors only, as by `calibrate fit --net-only`.
const VIRTUAL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");

/// Young's modulus of a skin that is a tenth softer, as a change of a scene.
const SOFT: &str = "material.young_mpa=0.2145";

/// Presses the finger of the built-in scenes at nine places with `newtons`, 0.4 s each.
///
/// With `by_hand` the pad is pressed before, briefly and twice as hard.
fn nine_presses(
    directory: &Path,
    (newtons, by_hand): (f64, bool),
    seed: u64,
    set: &[&str],
) -> Vec<Sample> {
    let mut scene = String::from(
        r#"
description = "Nine weights put down one after the other"
effects = ["noise", "ambient", "flicker", "gain-spread", "optical-crosstalk", "bridge-mismatch", "bridge-crosstalk"]
[scan]
rate_hz = 500
duration_s = 7.5
[device]
seed = 1
bits = 16
[indenter]
radius_mm = 6
[friction]
mu = 0.8
"#,
    );
    let mut press = |at: f64, [x, y]: [f64; 2], newtons: f64, hold: f64| {
        let _ = write!(
            scene,
            "[[press]]\nat_s = {at:.2}\nx_mm = {x}\ny_mm = {y}\nfz_n = {newtons}\nrise_s = 0.05\n\
             hold_s = {hold}\nfall_s = 0.05\n"
        );
    };
    let first = if by_hand { 5.5 } else { 0.7 };
    for i in (0..25).filter(|_| by_hand) {
        let place = [i % 5, i / 5].map(|k| 2.0 * f64::from(k - 2));
        press(0.7 + 0.16 * f64::from(i), place, 2.0 * newtons, 0.02);
    }
    for i in 0..9 {
        let place = [i % 3, i / 3].map(|k| 3.0 * f64::from(k - 1));
        press(first + 0.7 * f64::from(i), place, newtons, 0.4);
    }
    scene = scene.replace("= 7.5", &format!("= {}", first + 6.8));
    let path = directory.join("nine.toml");
    std::fs::write(&path, scene).unwrap();
    simulated(path.to_str().unwrap(), seed, set)
}

fn tour(seed: u64, set: &[&str]) -> Vec<Sample> {
    simulated("tour", seed, set)
}

fn simulated(scene: &str, seed: u64, set: &[&str]) -> Vec<Sample> {
    let set = set.iter().map(ToString::to_string).collect();
    let changes = Changes { reference: false, set };
    Simulator::new(&Scene::load_changed(scene, &changes).unwrap(), seed).collect()
}

/// Ages the LEDs of a finger: each has another brightness.
fn faded(samples: &[Sample]) -> Vec<Sample> {
    let gain = |k: usize| 1.0 + 0.15 * (7.3 * k as f64).sin();
    let lit = |codes: &TaxelCodes, k: usize| {
        f64::from(codes.lit[k / 4][k % 4].0) - f64::from(codes.dark[k % 4].0)
    };
    let age = |sample: &Sample| {
        let mut sample = *sample;
        let codes = sample.scan.codes.taxels.as_mut().unwrap();
        let before = *codes;
        for k in 0..16 {
            let code = gain(k) * lit(&before, k) + f64::from(before.dark[k % 4].0);
            codes.lit[k / 4][k % 4] = Code(code.round().clamp(0.0, 65535.0) as u16);
        }
        sample
    };
    samples.iter().map(age).collect()
}

fn rmse(folder: &In<'_>, calibration: &str, data: &str, target: &str) -> f64 {
    let args = ["calibrate", "evaluate", "--calibration", calibration, "--data", data, "--json"];
    json(&folder.succeeds(&args))[target]["rmse"].as_f64().unwrap()
}

fn withheld(folder: &In<'_>, calibration: &str, data: &str) -> u64 {
    let args = ["calibrate", "evaluate", "--calibration", calibration, "--data", data, "--json"];
    let found = json(&folder.succeeds(&args));
    found["fz_n"]["withheld"].as_object().unwrap().values().filter_map(|n| n.as_u64()).sum()
}

#[test]
fn nine_presses_correct_drifted_gains() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let presses = nine_presses(directory.path(), (1.0, false), 3, &[SOFT]);
    write_trace(directory.path(), "young.csv", &tour(5, &[]), true);
    write_trace(directory.path(), "old.csv", &faded(&tour(5, &[SOFT])), true);
    write_trace(directory.path(), "presses.csv", &faded(&presses), true);
    let adjust = ["calibrate", "adjust", "--calibration", VIRTUAL, "--data", "presses.csv"];
    let outcome =
        json(&folder.succeeds(&[&adjust[..], &["--out", "today.toml", "--json"]].concat()));
    assert_eq!(outcome["presses"], 9, "{outcome}");
    let gains: Vec<f64> =
        outcome["taxel_gains"].as_array().unwrap().iter().map(|g| g.as_f64().unwrap()).collect();
    let wrong = |k: usize| gains[k] / (1.0 + 0.15 * (7.3 * k as f64).sin()) - 1.0;
    let worst = (0..16).map(|k| wrong(k).abs()).fold(0.0, f64::max);
    eprintln!("{outcome}\nworst gain {worst:.3}");
    assert!(worst < 0.01, "{gains:?}");
    let stiffness = outcome["stiffness"].as_f64().unwrap();
    assert!((stiffness * 1.1 - 1.0).abs() < 0.06, "{outcome}");

    // Judged on another recording, with contacts and forces that the presses lack.
    let mut bias_only = calibration::read(VIRTUAL).unwrap();
    let today = calibration::read(directory.path().join("today.toml")).unwrap();
    bias_only.taxels.as_mut().unwrap().bias = today.taxels.as_ref().unwrap().bias;
    calibration::write(directory.path().join("bias.toml"), &bias_only).unwrap();
    for target in ["fz_n", "fx_n", "fy_n"] {
        let young = rmse(&folder, VIRTUAL, "young.csv", target);
        let bias = rmse(&folder, "bias.toml", "old.csv", target);
        let mended = rmse(&folder, "today.toml", "old.csv", target);
        eprintln!("{target}: young {young:.4}, bias alone {bias:.4}, adjusted {mended:.4}");
        assert!(mended < 0.5 * bias, "{target}: {bias} → {mended}");
        assert!(mended < 2.0 * young, "{target}: {young} once, {mended} now");
    }
    assert!(withheld(&folder, "today.toml", "old.csv") <= withheld(&folder, VIRTUAL, "young.csv"));

    // `compare` finds the same changes.
    let compared = folder.succeeds(&[
        "calibrate",
        "compare",
        VIRTUAL,
        "today.toml",
        "--data",
        "old.csv",
        "--json",
    ]);
    let drift = json(&compared);
    let light =
        drift["changes"].as_array().unwrap().iter().find(|c| c["what"] == "unloaded light, RMS");
    let light = light.unwrap()["by"].as_f64().unwrap();
    assert!((9.0..12.0).contains(&light), "15 % of a sine is 10.6 % RMS: {light}");
    let met = drift["met"].as_array().unwrap().iter().find(|m| m["target"] == "fz_n").unwrap();
    assert!(met["after"].as_f64() < met["before"].as_f64(), "{met}");
}

#[test]
fn recording_of_another_serial_is_not_adjusted_to() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    folder.succeeds(&["record", "--port", "sim:press", "--duration", "1", "--out", "a.mcap"]);
    let mut other = calibration::read(VIRTUAL).unwrap();
    other.serial = "F-0042".parse().unwrap();
    calibration::write(directory.path().join("other.toml"), &other).unwrap();
    let adjust =
        ["calibrate", "adjust", "--data", "a.mcap", "--weight", "1", "--out", "today.toml"];
    let error = folder.fails(1, &[&adjust[..], &["--calibration", "other.toml"]].concat());
    let told = "a.mcap: recorded with the calibration of finger `VIRTUAL-4X4`, but --calibration is of `F-0042`";
    assert!(error.contains(told), "{error}");
    assert!(!directory.path().join("today.toml").exists());
    // A record without a name is anybody's.
    other.serial.clear();
    calibration::write(directory.path().join("other.toml"), &other).unwrap();
    let error = folder.fails(1, &[&adjust[..], &["--calibration", "other.toml"]].concat());
    assert!(!error.contains("recorded with"), "{error}");
}

#[test]
fn known_weight_replaces_reference_columns() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let presses = faded(&nine_presses(directory.path(), (0.4905, true), 4, &[SOFT]));
    write_trace(directory.path(), "50g.csv", &presses, false);
    let adjust = ["calibrate", "adjust", "--calibration", VIRTUAL, "--data", "50g.csv"];
    // Without the weight the force of the presses is unknown.
    let error = folder.fails(1, &[&adjust[..], &["--out", "none.toml"]].concat());
    assert!(error.contains("no force labels: give --reference or --weight"), "{error}");
    let weighed = ["--weight", "0.4905", "--out", "today.toml", "--json"];
    let outcome = json(&folder.succeeds(&[&adjust[..], &weighed].concat()));
    let errors = outcome["errors"].as_array().unwrap();
    let normal = errors.iter().find(|error| error["quantity"] == "fz_n").unwrap();
    let [before, after] = ["zeroed", "after"].map(|when| normal[when].as_f64().unwrap());
    eprintln!("{outcome}");
    assert!(after < 0.3 * before, "{before} → {after}");
    let error = folder.fails(2, &[&adjust[..], &["--weight=-1", "--out", "none.toml"]].concat());
    assert!(error.contains("newtons"), "{error}");
}

/// Writes the load cell's file: its clock is 40 s ahead, and 0.3 % fast.
fn write_cell(folder: &Path, samples: &[Sample]) {
    let rows = samples.iter().step_by(4).map(|sample| {
        let seconds = 40.0 + 1.003 * sample.scan.time.0 as f64 * 1e-6;
        let [fx, fy, fz] = sample.truth.force.map(Option::unwrap);
        format!("{seconds:.6},{fx:.5},{fy:.5},{fz:.5}\n")
    });
    std::fs::write(
        folder.join("cell.csv"),
        "t_s,fx_n,fy_n,fz_n\n".to_owned() + &rows.collect::<String>(),
    )
    .unwrap();
}

#[test]
fn adjust_and_compare_align_load_cell_clock() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let presses = faded(&nine_presses(directory.path(), (1.0, false), 3, &[SOFT]));
    write_trace(directory.path(), "presses.csv", &presses, false);
    write_cell(directory.path(), &presses);
    write_trace(directory.path(), "old.csv", &faded(&tour(5, &[SOFT])), true);
    let with_cell = ["--data", "presses.csv", "--reference", "cell.csv", "--json"];
    let adjust = ["calibrate", "adjust", "--calibration", VIRTUAL, "--out", "today.toml"];
    let outcome = json(&folder.succeeds(&[&adjust[..], &with_cell].concat()));
    let aligned = |key: &str| outcome["alignments"][0][key].as_f64().unwrap();
    assert!((aligned("offset_s") - 40.0).abs() < 5e-3, "{outcome}");
    assert!((aligned("rate") - 0.003).abs() < 5e-4, "{outcome}");
    assert_eq!(outcome["presses"], 9, "{outcome}");
    let (once, now) =
        (rmse(&folder, VIRTUAL, "old.csv", "fz_n"), rmse(&folder, "today.toml", "old.csv", "fz_n"));
    eprintln!("fz: {once:.4} aged, {now:.4} adjusted");
    assert!(now < 0.5 * once, "{once} {now}");

    let compare = ["calibrate", "compare", VIRTUAL, "today.toml"];
    let drift = json(&folder.succeeds(&[&compare[..], &with_cell].concat()));
    let met = drift["met"].as_array().unwrap().iter().find(|m| m["target"] == "fz_n").unwrap();
    assert!(met["after"].as_f64() < met["before"].as_f64(), "{met}");

    // Weight and reference exclude each other.
    let both = [&adjust[..], &with_cell, &["--weight", "1"]].concat();
    let error = folder.fails(2, &both);
    assert!(error.contains("'--reference <FILE>' cannot be used with"), "{error}");
    let error = folder.fails(2, &[&compare[..], &["--reference", "cell.csv"]].concat());
    assert!(error.contains("--data"), "{error}");
}

#[test]
fn compare_reports_missing_sections() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let whole = calibration::read(VIRTUAL).unwrap();
    let write = |name: &str, calibration: &Calibration| {
        calibration::write(directory.path().join(name), calibration).unwrap();
    };
    let mut other = whole.clone();
    other.serial = "F-0099".try_into().unwrap();
    other.date += 86_400;
    other.sensors[2] = None;
    let float = other.net.as_ref().and_then(Net::float);
    other.net = float.and_then(|net| QuantisedNet::new(net, 0.6)).map(Net::Quantised);
    other.slip = Some(Slip::usual(0.5));
    write("other.toml", &other);
    let mut narrow = whole.clone();
    let Some(Net::Float(net)) = &mut narrow.net else { panic!("a net in f32") };
    net.units.truncate(3);
    write("narrow.toml", &narrow);
    let bare = Calibration { taxels: None, net: None, model: None, warmth: None, ..whole.clone() };
    write("bare.toml", &bare);

    let ran = folder.taxel(&["calibrate", "compare", VIRTUAL, "other.toml"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for line in [
        "they are of different fingers (`VIRTUAL-4X4` and `F-0099`): their changes are not drift",
        "the net is in f32 in the first, in 16 bits in the second",
        "the nets differ; give a recording with references (--data) to compare them in newtons",
        "s2 is only in the first",
        "slip is only in the second",
    ] {
        assert!(ran.err.contains(&format!("taxel: warning: {line}\n")), "{line}: {}", ran.err);
    }
    assert!(ran.out.starts_with("the second was made 1day after the first\n"), "{}", ran.out);
    // One line per change, unit last.
    for line in ran.out.lines().skip(1) {
        assert!(line.ends_with(" %") || line.ends_with(" mN"), "{line}");
    }
    assert!(ran.out.lines().any(|line| line.starts_with("s1 ")) && !ran.out.contains("s2 "));

    let of =
        |second: &str| json(&folder.succeeds(&["calibrate", "compare", VIRTUAL, second, "--json"]));
    assert_eq!(of("other.toml")["seconds"], 86_400);
    assert!(of("narrow.toml")["warnings"][0].as_str().unwrap().starts_with("the nets differ"));
    let changes = of("narrow.toml")["changes"].clone();
    let by = |change: &serde_json::Value| change["by"].as_f64().unwrap().abs();
    assert!(changes.as_array().unwrap().iter().all(|change| by(change) < 1e-6), "{changes}");
    let warned = of("bare.toml")["warnings"].to_string();
    assert!(warned.contains("the optical matrix is only in the first"), "{warned}");

    let text = std::fs::read_to_string(directory.path().join("other.toml")).unwrap();
    std::fs::write(directory.path().join("corrupt.toml"), text.replacen("T11:", "T12:", 1))
        .unwrap();
    for pair in [["corrupt.toml", "other.toml"], ["other.toml", "corrupt.toml"]] {
        let error = folder.fails(1, &[&["calibrate", "compare"][..], &pair].concat());
        assert!(error.starts_with("taxel: corrupt.toml:3: `crc32`: says "), "{error}");
    }
}

#[test]
fn unchanged_finger_keeps_its_gains() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    write_trace(
        directory.path(),
        "presses.csv",
        &nine_presses(directory.path(), (1.0, false), 8, &[]),
        true,
    );
    let outcome = json(&folder.succeeds(&[
        "calibrate",
        "adjust",
        "--calibration",
        VIRTUAL,
        "--data",
        "presses.csv",
        "--out",
        "today.toml",
        "--json",
    ]));
    for gain in outcome["taxel_gains"].as_array().unwrap() {
        assert!((gain.as_f64().unwrap() - 1.0).abs() < 0.04, "{outcome}");
    }
    for gains in outcome["sensor_gains"].as_array().unwrap() {
        for gain in gains.as_array().unwrap() {
            assert!((gain.as_f64().unwrap() - 1.0).abs() < 0.02, "{outcome}");
        }
    }
}

#[test]
fn reference_of_wrong_sign_changes_no_gain() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let mut presses = nine_presses(directory.path(), (1.0, false), 8, &[]);
    let turn = |force: &mut Option<f64>| *force = force.map(|f| -f);
    for sample in &mut presses {
        let truth = &mut sample.truth;
        truth.force.iter_mut().chain(truth.sensors.iter_mut().flatten()).for_each(turn);
    }
    write_trace(directory.path(), "presses.csv", &presses, true);
    let ran = folder.taxel(&[
        "calibrate",
        "adjust",
        "--calibration",
        VIRTUAL,
        "--data",
        "presses.csv",
        "--out",
        "today.toml",
    ]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for warning in ["stay", "mN of F_z are left on presses", "is the reference's sign right"] {
        assert!(ran.err.contains(warning), "{warning}: {}", ran.err);
    }
    let (old, new) = (
        calibration::read(VIRTUAL).unwrap(),
        calibration::read(directory.path().join("today.toml")).unwrap(),
    );
    assert_eq!(old.net, new.net);
    for (old, new) in old.sensors.iter().flatten().zip(new.sensors.iter().flatten()) {
        // Compares only the row of z, because the shear under a weight is too small to fit.
        assert_eq!(old.sensitivity.0[2], new.sensitivity.0[2]);
    }
}

#[test]
fn report_is_one_page_with_plots_and_warnings() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let (judged, fitted) = (tour(9, &[]), nine_presses(directory.path(), (1.0, false), 2, &[]));
    write_trace(directory.path(), "judged.csv", &judged, true);
    write_trace(directory.path(), "fitted.csv", &fitted, true);
    let report = ["calibrate", "report", "--calibration", VIRTUAL, "--json"];
    let report = [&report[..], &["--force", "--out", "report.html"]].concat();
    let ran = folder
        .taxel(&[&report[..], &["--data", "judged.csv", "--fitted-to", "fitted.csv"]].concat());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let found = json(&ran.out);
    let figures = found["trials"][0]["figures"].as_array().unwrap();
    let of = |target: &str| figures.iter().find(|f| f["target"] == target).unwrap();
    // The figures of `evaluate`, and further ones.
    let fz = of("fz_n");
    let evaluated = rmse(&folder, VIRTUAL, "judged.csv", "fz_n");
    assert!((fz["rmse"].as_f64().unwrap() - evaluated).abs() < 1e-12);
    let noise = fz["noise"].as_f64().unwrap();
    assert!((1e-5..5e-3).contains(&noise), "{noise}");
    assert!(fz["hysteresis_percent"].as_f64().unwrap() < 5.0, "{fz}");
    assert_eq!(of("fx_n")["crosstalk_percent"].as_array().unwrap().len(), 2);
    assert!(found["trials"][0]["angle"]["rms_deg"].as_f64().unwrap() < 10.0);
    let s0 =
        found["about"]["parts"].as_array().unwrap().iter().find(|p| p["name"] == "s0").unwrap();
    assert!((1.0..2.0).contains(&s0["condition"].as_f64().unwrap()), "{s0}");
    // Presses straight down cannot support a net for fx and fy.
    for warning in ["no shear in x", "no shear in y", "fitted to 1 recording", "extrapolated"] {
        assert!(ran.err.contains(warning), "{warning}: {}", ran.err);
    }
    // The tour has nine contacts, and a slide counts again after each second.
    assert_eq!(found["verdict"]["needs"][0]["met"], true, "{}", found["verdict"]);
    assert_eq!(found["errors"][0]["quantity"], "normal force");
    let page = std::fs::read_to_string(directory.path().join("report.html")).unwrap();
    assert!(page.find("Good for") < page.find("Calibrated 20"));
    assert!(
        page.matches("<svg").count() >= 8 && page.contains("[Ospina2017] table 1.2"),
        "{}",
        page.len()
    );
    assert!(page.contains("RMS error as the record states it"));
    assert!(!page.contains("src=") && !page.contains("NaN") && !page.contains("inf "));
    assert!(page.len() < 3_000_000, "{}", page.len());

    let same = [&report[..], &["--data", "judged.csv", "--fitted-to", "judged.csv"]].concat();
    let ran = folder.taxel(&same);
    assert!(ran.err.contains("no forecast"));
    assert_eq!(json(&ran.out)["verdict"]["good_for"], serde_json::json!([]), "{}", ran.out);
}

/// Writes noisy presses of another sensor's skin, as one of several recordings.
fn skin(name: &str, seed: f64, folder: &Path) {
    let row = |i: i32| {
        let t = f64::from(i) * 0.02;
        let noise = |k: f64| 0.5 * (12.9898 * (f64::from(i) + k).powi(2) + seed).sin();
        let fz = 5.0 * (0.9 * t + seed).sin().max(0.0);
        let fx = 0.8 * fz * (0.37 * t + seed).sin();
        let m = [30.0 * fz + noise(0.1), 8.0 * fz + 20.0 * fx + noise(0.2), fz * fz + noise(0.3)];
        format!("{t:.2},{:.3},{:.3},{:.3},{fx:.4},{fz:.4}\n", m[0], m[1], m[2])
    };
    let table = "t_s,m0,m1,m2,fx_n,fz_n\n".to_owned() + &(0..1500).map(row).collect::<String>();
    std::fs::write(folder.join(name), table).unwrap();
}

#[test]
fn table_model_gets_report_and_comparison() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    for (name, seed) in [("a.csv", 0.0), ("b.csv", 2.0), ("unseen.csv", 4.0)] {
        skin(name, seed, directory.path());
    }
    let fit = ["calibrate", "fit", "--model", "ridge", "--inputs", "m*", "--targets", "fx_n,fz_n"];
    let first = ["--data", "a.csv", "--data", "b.csv", "--serial", "skin 7", "--out", "first.toml"];
    folder.succeeds(&[&fit[..], &first].concat());
    let report = ["calibrate", "report", "--calibration", "first.toml", "--out", "page.html"];
    let data = ["--data", "unseen.csv", "--fitted-to", "a.csv", "--fitted-to", "b.csv", "--json"];
    let ran = folder.taxel(&[&report[..], &data].concat());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let found = json(&ran.out);
    let figures = found["trials"][0]["figures"].as_array().unwrap();
    let fz = figures.iter().find(|f| f["target"] == "fz_n").unwrap();
    let evaluated = rmse(&folder, "first.toml", "unseen.csv", "fz_n");
    assert!((fz["rmse"].as_f64().unwrap() - evaluated).abs() < 1e-12, "{fz}");
    for figure in ["bias", "sigma", "max", "percent", "hysteresis_percent", "noise", "resolution"] {
        assert!(fz[figure].is_number(), "{figure}: {fz}");
    }
    assert_eq!(fz["crosstalk_percent"][0][0], "fx_n");
    let part = &found["about"]["parts"][0];
    assert_eq!(
        (&found["about"]["serial"], &part["model"]),
        (&"skin 7".into(), &"m0, m1, m2 → fx_n, fz_n: linear 3-2".into())
    );
    assert!(part["condition_of_data"].as_f64().unwrap() > 1.0, "{part}");
    // Two plots: inputs in their two directions, and fz over fx.
    assert_eq!(found["coverage"].as_array().unwrap().len(), 2);
    assert!(ran.err.contains("fitted to 2 recordings"), "{}", ran.err);
    let page = std::fs::read_to_string(directory.path().join("page.html")).unwrap();
    assert!(page.contains("skin 7") && page.contains("[Ospina2017] table 1.2"));
    assert!(page.matches("<svg").count() == 6 && !page.contains("NaN"), "{}", page.len());

    let second = ["--data", "a.csv", "--serial", "skin 7", "--out", "second.toml"];
    folder.succeeds(&[&fit[..], &second].concat());
    let compare = ["calibrate", "compare", "first.toml", "second.toml", "--data", "unseen.csv"];
    let drift = json(&folder.succeeds(&[&compare[..], &["--json"]].concat()));
    let met = drift["met"].as_array().unwrap().iter().find(|m| m["target"] == "fz_n").unwrap();
    assert!((met["before"].as_f64().unwrap() - evaluated).abs() < 1e-12, "{met}");
    // Each target in the middle and along each of the three inputs.
    assert_eq!(drift["changes"].as_array().unwrap().len(), 8);
    // A finger's record cannot be compared with a table's model.
    let error = folder.fails(1, &["calibrate", "compare", "first.toml", VIRTUAL]);
    assert!(error.contains("a finger calibration where a table one is needed"), "{error}");
}

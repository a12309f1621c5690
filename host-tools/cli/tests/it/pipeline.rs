//! Tests from a scene to forces: simulate, fit, evaluate and replay, as a user runs them.

use std::path::{Path, PathBuf};

use crate::common::In;
use taxel_files::trace::{Sample, TraceReader};

fn figures(json: &str, target: &str) -> (f64, u64) {
    let json: serde_json::Value = serde_json::from_str(json).unwrap();
    for figure in ["rmse", "sigma", "max", "bias"] {
        assert!(json[target][figure].is_number(), "{target} lacks {figure}: {json}");
    }
    (json[target]["rmse"].as_f64().unwrap(), json[target]["n"].as_u64().unwrap())
}

fn asset() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/virtual-finger.cal.toml")
}

/// Fits on a load cell with an error of 6 mN, as in [Ospina2017]. Evaluates on other forces by the
/// truth, because a recording's own reference would add its errors to the sensor's.
#[test]
fn fit_errs_less_than_its_load_cell() {
    // [Ospina2017] tables 1.2 and 1.3: σ 4 to 6 mN and maximum 16 to 28 mN bare; 7.8 mN and more
    // coated.
    let coated = ["device.coating=rA", "friction.mu=0.45", "random.fz_n=[0.8, 1.3]"];
    for (set, sigma, max) in [(&[][..], 3e-3, 12e-3), (&coated, 8e-3, f64::INFINITY)] {
        let folder = tempfile::tempdir().unwrap();
        let folder = In(folder.path());
        let simulate = |set: &[&str], seed: &str, out: &str| {
            let set = set.iter().flat_map(|change| ["--set", change]);
            let words = ["simulate", "--scene", "mems", "--seed", seed, "--out", out];
            folder.succeeds(&words.into_iter().chain(set).collect::<Vec<_>>());
        };
        simulate(set, "11", "erring.csv");
        simulate(&[set, &["bench.reference_n=0"]].concat(), "12", "truth.csv");
        folder.succeeds(&[
            "calibrate",
            "fit",
            "--model",
            "least-squares",
            "--data",
            "erring.csv",
            "--out",
            "cal.toml",
        ]);
        let judged = folder.succeeds(&[
            "calibrate",
            "evaluate",
            "--data",
            "truth.csv",
            "--calibration",
            "cal.toml",
            "--json",
        ]);
        let judged: serde_json::Value = serde_json::from_str(&judged).unwrap();
        for target in ["s0_fx_n", "s0_fy_n", "s0_fz_n"] {
            let figure = |name| judged[target][name].as_f64().unwrap();
            let found = (figure("sigma"), figure("max"));
            assert!(found.0 <= sigma && found.1 <= max, "{set:?} {target} {found:?}");
            assert_eq!(judged[target]["n"], 61_000);
        }
    }
}

#[test]
fn bench_sensor_is_fitted_to_one_millinewton() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    folder.succeeds(&["simulate", "--scene", "bench-s0", "--seed", "11", "--out", "bench.csv"]);
    let fit = folder.succeeds(&[
        "calibrate",
        "fit",
        "--data",
        "bench.csv@0..10",
        "--sensor",
        "0",
        "--out",
        "s0.toml",
    ]);
    assert!(fit.starts_with("s0: "), "{fit}");
    let judged = folder.succeeds(&[
        "calibrate",
        "evaluate",
        "--data",
        "bench.csv@10..",
        "--calibration",
        "s0.toml",
        "--json",
    ]);
    for target in ["s0_fx_n", "s0_fy_n", "s0_fz_n"] {
        let (rmse, n) = figures(&judged, target);
        assert!(rmse < 1e-3 && n > 4000, "{target} {rmse} {n}");
    }
    folder.succeeds(&[
        "replay",
        "bench.csv@10..",
        "--calibration",
        "s0.toml",
        "--out",
        "frames.csv",
    ]);
    let frames = std::fs::read_to_string(folder.0.join("frames.csv")).unwrap();
    // Header with the calibration used, then the columns.
    assert!(frames.contains("# calibration_crc=") && frames.contains("# replayed=bench.csv\n"));
    assert!(frames.contains("# simulated="), "frames of a simulated trace say so");
    let frames: Vec<_> = frames.lines().filter(|line| !line.starts_with('#')).collect();
    assert!(frames[0].starts_with(
        "t_us,seq,status,fx_n,fy_n,fz_n,x_mm,y_mm,contact,slip,slip_margin,friction,grip_n,s0_fx_n"
    ));
    assert_eq!(frames.len() as u64, 1 + figures(&judged, "s0_fz_n").1);
}

/// Evaluates on unseen presses and shear: other seeds of the calibration's scenes.
#[test]
fn built_in_calibration_holds_on_unseen_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    let asset = asset();
    let calibration = asset.to_str().unwrap();
    for scene in ["presses", "shear"] {
        let simulate = ["simulate", "--scene", scene, "--seed", "97", "--out", "trace.csv"];
        folder.succeeds(&[&simulate[..], &["--force"]].concat());
        let judged = folder.succeeds(&[
            "calibrate",
            "evaluate",
            "--data",
            "trace.csv",
            "--calibration",
            calibration,
            "--json",
        ]);
        for (target, most) in
            [("fx_n", 1e-3), ("fy_n", 1e-3), ("fz_n", 3e-3), ("x_mm", 0.2), ("y_mm", 0.2)]
        {
            assert!(figures(&judged, target).0 < most, "{target}: {judged}");
        }
    }
}

#[test]
fn table_is_fitted_by_column_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    let rows = (0..400).map(|i| {
        let (a, b) = ((f64::from(i) * 0.37).sin(), (f64::from(i) * 0.11).cos());
        format!("{},{a},{b},{}\n", f64::from(i) * 0.01, 3.0 * a - 2.0 * b + 1.0)
    });
    let table = "t_s,m0,m1,force_n\n".to_owned() + &rows.collect::<String>();
    std::fs::write(folder.0.join("skin.csv"), table).unwrap();
    let fit = ["calibrate", "fit", "--data", "skin.csv@0..3", "--out", "skin.toml"];
    // `*` matches neither the time nor the target.
    let columns = ["--inputs", "*", "--targets", "force_n", "--hidden", "4"];
    folder.succeeds(&[&fit[..], &columns[..]].concat());
    let model = std::fs::read_to_string(folder.0.join("skin.toml")).unwrap();
    assert!(model.contains("inputs = [\"m0\", \"m1\"]"), "{model}");
    let judged = folder.succeeds(&[
        "calibrate",
        "evaluate",
        "--data",
        "skin.csv@3..",
        "--calibration",
        "skin.toml",
        "--json",
    ]);
    assert!(figures(&judged, "force_n").0 < 0.1, "{judged}");
    let error = folder
        .fails(1, &["replay", "skin.csv", "--calibration", "skin.toml", "--out", "frames.csv"]);
    assert!(error.contains("skin.toml:2: `kind`: a table calibration"), "{error}");
}

#[test]
fn reference_clock_is_aligned_with_sensor() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    // Presses of uneven length and height, one every 2 s.
    let force = |t: f64| {
        let i = (t / 2.0).floor();
        let share = (t - 2.0 * i) / (1.2 + 0.6 * (5.0 * i * i).sin());
        let peak = 3.0 + 2.0 * (7.0 * i).sin();
        if share < 1.0 { peak * (std::f64::consts::PI * share).sin() } else { 0.0 }
    };
    let skin = (0..3000).map(|i| f64::from(i) * 0.02).map(|t| {
        format!(
            "{t:.2},{:.4},{:.4}\n",
            7.0 - 2.0 * force(t),
            0.3 * force(t) + 0.01 * (9.0 * t).sin()
        )
    });
    let cell = (0..4800)
        .map(|i| f64::from(i) * 0.0125)
        .map(|t| format!("{:.0},{:.4}\n", 1e6 * (5.0 + 1.01 * t), force(t)));
    let write = |name: &str, text: String| std::fs::write(folder.0.join(name), text).unwrap();
    write("skin.csv", "t_s,m0,m1\n".to_owned() + &skin.collect::<String>());
    write("cell.csv", "t_us,force_n\n".to_owned() + &cell.collect::<String>());
    let fit = ["calibrate", "fit", "--model", "ridge", "--out", "skin.toml", "--force", "--json"];
    let columns = ["--inputs", "m*", "--targets", "force_n"];
    let files = ["--data", "skin.csv", "--reference", "cell.csv"];
    let outcome = folder.succeeds(&[&fit[..], &columns[..], &files[..]].concat());
    let outcome: serde_json::Value = serde_json::from_str(&outcome).unwrap();
    let found = |key: &str| outcome["alignments"][0][key].as_f64().unwrap();
    assert!((found("offset_s") - 5.0).abs() < 0.005, "{outcome}");
    assert!((found("rate") - 0.01).abs() < 2e-4 && found("residual_s") < 0.005, "{outcome}");
    assert!(outcome["parts"][0]["residual"][0].as_f64().unwrap() < 0.05, "{outcome}");
    let twice = ["--data", "skin.csv", "--data", "skin.csv", "--reference", "cell.csv"];
    let error = folder.fails(1, &[&fit[..], &columns[..], &twice[..]].concat());
    assert!(error.contains("1 --reference for 2 --data; give one for each"), "{error}");
}

#[test]
fn paper_model_is_fitted_and_evaluated() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    let rows = (0..400).map(f64::from).map(|i| {
        let (a, b) = (0.3 * (0.37 * i).sin(), 0.2 * (0.11 * i).cos());
        format!("{a},{b},{},{}\n", 1.5 * a + 0.4 * a * a, 2.0 * b - b * b * b)
    });
    let table = "c0,c1,u0_mm,u1_mm\n".to_owned() + &rows.collect::<String>();
    std::fs::write(folder.0.join("gap.csv"), table).unwrap();
    let fit = ["calibrate", "fit", "--data", "gap.csv", "--model", "gap", "--force"];
    let fit = [&fit[..], &["--out", "gap.toml"]].concat();
    folder.succeeds(&[&fit[..], &["--inputs", "c*", "--targets", "u0_mm,u1_mm"]].concat());
    let evaluate = ["calibrate", "evaluate", "--data", "gap.csv", "--calibration", "gap.toml"];
    let judged = folder.succeeds(&[&evaluate[..], &["--json"]].concat());
    assert!(figures(&judged, "u1_mm").0 < 1e-5, "{judged}");
    let error = folder.fails(1, &[&fit[..], &["--inputs", "c*", "--targets", "u0_mm"]].concat());
    assert!(error.contains("gap: 2 inputs and 1 targets where it takes 2 (signals)"), "{error}");
}

#[test]
fn impossible_fit_is_refused_with_reason() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    std::fs::write(folder.0.join("other.csv"), "t_s,m0,force_n\n0,1,2\n").unwrap();
    std::fs::write(folder.0.join("empty.csv"), "").unwrap();
    let cases: [(&[&str], &str); 5] = [
        (&["--data", "other.csv"], "other.csv:1: not a taxel trace; name the columns"),
        (&["--data", "empty.csv"], "empty.csv: no header"),
        (&["--data", "absent.csv"], "absent.csv: No such file"),
        (
            &["--data", "other.csv", "--inputs", "q*", "--targets", "force_n"],
            "other.csv:1: `q*`: no column matches; this file has t_s, m0, force_n",
        ),
        (
            &["--data", "other.csv", "--inputs", "m0", "--targets", "m0"],
            "other.csv:1: `m0`: a target cannot be an input as well; ",
        ),
    ];
    for (args, message) in cases {
        let args = [&["calibrate", "fit", "--out", "cal.toml"], args].concat();
        let error = folder.fails(1, &args);
        assert!(error.starts_with(&format!("taxel: {message}")), "{error}\n lacks {message}");
    }
    assert!(!folder.0.join("cal.toml").exists());
}

/// Compares the memory of one minute and ten minutes, with a new press every 0.5 s.
#[cfg(unix)]
#[test]
fn trace_length_does_not_change_memory() {
    use nix::sys::resource::{UsageWho, getrusage};
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    // Peak memory of the largest child so far, in kilobytes on Linux.
    let largest = |minutes: u32| {
        let scene = format!(
            "effects = ['noise', 'flicker']\n[scan]\nrate_hz = 200\nduration_s = {}\n[[random]]\n\
             at_s = 0\npresses = {}\neach_s = 0.5\nx_mm = [-2, 2]\ny_mm = [-2, 2]\nfz_n = [0.3, 1]\n",
            60 * minutes,
            120 * minutes
        );
        std::fs::write(folder.0.join("long.toml"), scene).unwrap();
        folder.succeeds(&["simulate", "--scene", "long.toml", "--out", "long.csv", "--force"]);
        let size = std::fs::metadata(folder.0.join("long.csv")).unwrap().len();
        (getrusage(UsageWho::RUSAGE_CHILDREN).unwrap().max_rss(), size)
    };
    let (short, long) = (largest(1), largest(10));
    assert!(long.1 > 9 * short.1, "{short:?} {long:?}");
    assert!(long.0 < short.0 + 1024, "{short:?} {long:?}");
}

#[test]
fn trace_has_thermometer_if_scene_has_temperature() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    for listed in [true, false] {
        let effects = if listed { "'temperature'" } else { "" };
        let scene = format!("effects = [{effects}]\n[scan]\nrate_hz = 100\nduration_s = 0.1\n");
        std::fs::write(folder.0.join("warm.toml"), scene).unwrap();
        folder.succeeds(&["simulate", "--scene", "warm.toml", "--out", "warm.csv", "--force"]);
        let trace = std::fs::read_to_string(folder.0.join("warm.csv")).unwrap();
        let header = trace.lines().find(|line| line.starts_with("t_us")).unwrap();
        assert_eq!(header.split(',').any(|name| name == "aux_temp"), listed, "{header}");
    }
}

/// Simulates ten by twelve feelers through sixteen channels. A scan is one feeler, 120 scans are
/// the sheet.
#[test]
fn feeler_sheet_sums_to_its_force() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    let said = folder.succeeds(&["simulate", "--scene", "sheet-press", "--out", "sheet.csv"]);
    assert!(said.starts_with("sheet.csv: 18000 scans"), "{said}");
    let text = std::fs::read_to_string(folder.0.join("sheet.csv")).unwrap();
    let names = text.lines().find(|line| line.starts_with("t_us")).unwrap();
    assert!(
        names.contains("lit_r3c3") && names.contains("slip") && !names.contains("bridge"),
        "{names}"
    );
    let trace = TraceReader::open(folder.0.join("sheet.csv")).unwrap();
    let scans: Vec<Sample> = trace.map(Result::unwrap).collect();
    let normal = |sample: &Sample| sample.truth.force[2].unwrap();
    let bright = |sample: &Sample| -> f64 {
        let lit = sample.scan.codes.taxels.unwrap().lit;
        lit.as_flattened().iter().map(|code| f64::from(code.0)).sum()
    };
    // While 0.1 N is held, the light of the sheet is proportional to the pressure.
    let (rest, held) = (&scans[..120], &scans[4800..4920]);
    let force: f64 = held.iter().map(normal).sum();
    // A trace has six decimals.
    assert!((force - 0.1).abs() < 120.0 * 0.5e-6, "{force}");
    let per_newton = |k: usize| (bright(&held[k]) - bright(&rest[k])) / normal(&held[k]);
    let pressed: Vec<usize> = (0..120).filter(|k| normal(&held[*k]) > 3e-3).collect();
    assert!(pressed.len() > 8, "{pressed:?}");
    for k in pressed.iter().copied() {
        let [x, y] = held[k].truth.point.map(Option::unwrap);
        let feeler = (x + 2.7) / 0.6 + 10.0 * (y + 3.3) / 0.6;
        assert!((feeler - k as f64).abs() < 1e-6, "{k}");
        assert!((per_newton(k) / per_newton(pressed[0]) - 1.0).abs() < 0.03, "{k}");
        assert_eq!((held[k].truth.contact, held[k].truth.slip), (Some(true), Some(false)));
    }
    // At half the friction limit the rim slips and the middle sticks.
    let slips = scans[12_960..13_080].iter().filter(|s| s.truth.slip == Some(true)).count();
    assert!((4..30).contains(&slips), "{slips}");
}

#[test]
fn full_disk_is_reported_with_fix() {
    if !Path::new("/dev/full").exists() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let error = In(folder.path()).fails(1, &["simulate", "--scene", "press", "--out", "/dev/full"]);
    assert!(error.contains("free some space"), "{error}");
}

#[test]
fn simulate_reports_fidelity_and_its_error() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    let said = folder.succeeds(&["simulate", "--scene", "press", "--out", "a.csv"]);
    let begins = "a.csv: 2000 scans; fidelity hertz, 0.";
    assert!(said.starts_with(begins) && said.contains("% off converged of 1 % allowed"), "{said}");
    // A sensor without facets has no fidelity to report.
    let said = folder.succeeds(&["simulate", "--scene", "bench-s0", "--out", "b.csv"]);
    assert!(!said.contains("fidelity"), "{said}");
}

#[test]
fn simulate_counts_taxels_past_light_peak() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    let said = |scene: &str| {
        let press = "[scan]\nrate_hz = 100\nduration_s = 1\n[[press]]\nat_s = 0.1\nx_mm = 1.25\ny_mm = 1.25\n\
                     fz_n = 1\nrise_s = 0.1\nhold_s = 0.5\nfall_s = 0.1\n";
        std::fs::write(folder.0.join("mine.toml"), format!("{press}{scene}")).unwrap();
        folder.succeeds(&["simulate", "--scene", "mine.toml", "--out", "a.csv", "--force"])
    };
    assert!(!said("").contains("peak"), "{}", said(""));
    let near = said("[layer]\ngap_mm = 1.2\n");
    assert!(near.contains("; 1 taxel came past the peak of its light curve: r2c2"), "{near}");
    let assembled = said("[device]\nwrong_side = ['r0c1', 'r3c3']\n");
    assert!(assembled.contains("2 taxels came past the peak") && assembled.contains("r0c1, r3c3"));
}

#[test]
fn no_command_overwrites_what_it_reads() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    folder.succeeds(&["simulate", "--scene", "press", "--out", "a.csv"]);
    let before = std::fs::read(folder.0.join("a.csv")).unwrap();
    let asset = asset();
    let (calibration, fit) = (asset.to_str().unwrap(), ["calibrate", "fit", "--data"]);
    let commands: [&[&str]; 5] = [
        &["replay", "a.csv", "--out", "./a.csv"],
        &[&fit[..], &["a.csv@0..1", "--out", "a.csv"]].concat(),
        &[&fit[..], &["b.csv", "--reference", "a.csv", "--out", "a.csv"]].concat(),
        &[
            "calibrate",
            "adjust",
            "--data",
            "a.csv",
            "--calibration",
            calibration,
            "--out",
            calibration,
        ],
        &["record", "--port", "file:a.csv", "--out", "a.csv"],
    ];
    for args in commands {
        let error = folder.fails(1, args);
        assert!(error.contains("would overwrite what is read from"), "{error}");
    }
    assert_eq!(std::fs::read(folder.0.join("a.csv")).unwrap(), before);
    // The output path is checked before a fit that may take minutes.
    let error = folder.fails(1, &[&fit[..], &["a.csv", "--out", "no/such/b.toml"]].concat());
    assert_eq!(
        error,
        "taxel: no/such/b.toml: there is no folder no/such; make it, or choose another\n"
    );
}

#[test]
fn empty_stretch_is_reported_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = In(folder.path());
    folder.succeeds(&["simulate", "--scene", "press", "--out", "a.csv"]);
    let asset = asset();
    let calibration = asset.to_str().unwrap();
    let commands: [&[&str]; 3] = [
        &["replay", "a.csv@500..600", "--out", "b"],
        &["calibrate", "evaluate", "--data", "a.csv@500..600", "--calibration", calibration],
        &["calibrate", "fit", "--data", "a.csv@500..600", "--out", "b"],
    ];
    for args in commands {
        let error = folder.fails(1, args);
        assert!(error.contains("check the stretch FILE@FROM..TO"), "{error}");
    }
    assert!(!folder.0.join("b").exists());
}

/// Tests that take 14 s of real time.
mod endurance {
    use super::*;

    /// Fits the codes of a live finger to a load cell that another computer logged.
    #[test]
    fn live_codes_and_load_cell_log_are_fitted() {
        let folder = tempfile::tempdir().unwrap();
        let folder = In(folder.path());
        let record = ["record", "--port", "sim:tour", "--duration", "14", "--out", "live.csv"];
        folder.succeeds(&[&record[..], &["--fields", "codes,force,point"]].concat());
        folder.succeeds(&["simulate", "--scene", "tour", "--seed", "3", "--out", "truth.csv"]);
        // The load cell's clock: 40 s ahead, and 0.4 % fast.
        let cell = TraceReader::open(folder.0.join("truth.csv")).unwrap().map(|sample| {
            let sample = sample.unwrap();
            let [fx, fy, fz] = sample.truth.force.map(Option::unwrap);
            let seconds = 40.0 + 1.004 * sample.scan.time.0 as f64 * 1e-6;
            format!("{seconds:.6},{fx:.5},{fy:.5},{fz:.5}\n")
        });
        let cell = "t_s,fx_n,fy_n,fz_n\n".to_owned() + &cell.collect::<String>();
        std::fs::write(folder.0.join("cell.csv"), cell).unwrap();

        let fit =
            ["calibrate", "fit", "--data", "live.csv", "--out", "cal.toml", "--model", "ridge"];
        // The finger's own estimate of the force is no reference.
        let error = folder.fails(1, &fit);
        assert!(error.contains("fz_n") && error.contains("--reference"), "{error}");
        let given = [&fit[..], &["--reference", "cell.csv", "--json"]].concat();
        let outcome: serde_json::Value = serde_json::from_str(&folder.succeeds(&given)).unwrap();
        let found = |key: &str| outcome["alignments"][0][key].as_f64().unwrap();
        // A frame is the mean of its millisecond, and a live stream begins with any scan.
        assert!((found("offset_s") - 40.0).abs() < 0.02, "{outcome}");
        assert!((found("rate") - 0.004).abs() < 1e-3, "{outcome}");

        let judge = ["calibrate", "evaluate", "--data", "live.csv", "--reference", "cell.csv"];
        let judged =
            folder.succeeds(&[&judge[..], &["--calibration", "cal.toml", "--json"]].concat());
        let (rmse, rows) = figures(&judged, "fz_n");
        assert!(rmse < 0.15 && rows > 10_000, "{judged}");

        // Codes as `taxel record` writes them.
        folder.succeeds(&["export", "live.csv", "--out", "live.mcap"]);
        let judge = ["calibrate", "evaluate", "--data", "live.mcap", "--reference", "cell.csv"];
        let packed =
            folder.succeeds(&[&judge[..], &["--calibration", "cal.toml", "--json"]].concat());
        assert_eq!(packed, judged);
        let table = ["--data", "live.mcap", "--inputs", "lit_*", "--targets", "fz_n"];
        let error =
            folder.fails(1, &[&["calibrate", "fit", "--out", "any.toml"], &table[..]].concat());
        assert!(error.contains("`taxel export live.mcap --out columns.csv`"), "{error}");
    }
}

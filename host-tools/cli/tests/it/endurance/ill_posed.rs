//! Tests of fits to recordings with deliberate faults. Each gives a sane calibration with a
//! warning, or a refusal with a reason; never a bad record in silence.

use std::fmt::Write as _;
use std::path::Path;

use crate::common::{In, json, write_trace};
use taxel::units::Code;
use taxel_files::trace::{Sample, Truth};
use taxel_sim::{Scene, Simulator};

/// Options besides the recordings: none, which chooses by what is left out, and the net alone.
const WAYS: [&[&str]; 2] = [&[], &["--model", "mlp", "--net-only"]];

/// Expected end of a fit.
enum End<'w> {
    /// Refused, with these words in the one line on standard error, and no record.
    Refused(&'w str),
    /// Fitted, with these words in a warning (dots stand for any text). On a recording without
    /// faults the RMS error is below so many newtons.
    Warned(&'w str, f64),
}

/// Fits `data` in each way, and evaluates on `unseen`.
fn fits(
    folder: &In<'_>,
    what: &[&str],
    data: &[&str],
    (target, unseen): (&str, &str),
    end: &End<'_>,
) {
    for way in WAYS {
        let _ = std::fs::remove_file(folder.0.join("cal.toml"));
        let data = data.iter().flat_map(|file| ["--data", file]);
        let fit = ["calibrate", "fit", "--out", "cal.toml"].into_iter().chain(data);
        let typed: Vec<&str> = fit.chain(what.iter().copied()).chain(way.iter().copied()).collect();
        match *end {
            End::Refused(words) => {
                let said = folder.fails(1, &typed);
                assert!(said.contains(words), "{typed:?}: {said}");
                assert!(!folder.0.join("cal.toml").exists(), "{typed:?}");
            }
            End::Warned(words, most) => {
                let ran = folder.taxel(&typed);
                assert_eq!(ran.code, Some(0), "{typed:?}: {}", ran.err);
                let warned = |line: &str| {
                    line.starts_with("taxel: warning:")
                        && words.split('…').all(|w| line.contains(w))
                };
                assert!(ran.err.lines().any(warned), "{typed:?}: {}", ran.err);
                let judge = ["calibrate", "evaluate", "--calibration", "cal.toml", "--json"];
                let judged = folder.succeeds(&[&judge[..], &["--data", unseen]].concat());
                let judged: serde_json::Value = serde_json::from_str(&judged).unwrap();
                let rmse = judged[target]["rmse"].as_f64().unwrap();
                assert!(rmse < most, "{typed:?}: {rmse} N");
            }
        }
    }
}

/// Writes a sensor of three channels at 50 Hz; every row goes through `spoil`.
fn table(
    folder: &Path,
    name: &str,
    rows: usize,
    from: f64,
    spoil: impl Fn(usize, f64, &mut [f64; 4]),
) {
    let mut text = String::from("t_s,m0,m1,m2,force_n\n");
    for i in 0..rows {
        let t = from + 0.02 * i as f64;
        let noise = |k: usize| (12.9898 * ((3 * i + k) as f64).powi(2)).sin();
        let f = load(t);
        let mut row = [
            90.0 + 30.0 * f + 0.5 * noise(0),
            12.0 * f + 1.2 * f * f + 0.5 * noise(1),
            20.0 * (0.4 * t).sin() + 5.0 * f,
            f,
        ];
        spoil(i, t, &mut row);
        let [a, b, c, force] = row;
        writeln!(text, "{t:.2},{a},{b},{c},{force}").unwrap();
    }
    std::fs::write(folder.join(name), text).unwrap();
}

/// Force of presses of uneven length and height, one after the other.
fn load(t: f64) -> f64 {
    let i = (t / 2.5).floor();
    let share = (t - 2.5 * i - 0.2) / (1.4 + 0.6 * (5.0 * i * i).sin());
    let peak = 6.0 + 4.0 * (7.0 * i).sin();
    if (0.0..1.0).contains(&share) { peak * (std::f64::consts::PI * share).sin() } else { 0.0 }
}

#[test]
fn faulty_table_is_refused_or_warned_about() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let write = |name: &str, rows: usize, from: f64, spoil: &dyn Fn(usize, f64, &mut [f64; 4])| {
        table(folder.0, name, rows, from, spoil);
    };
    write("good.csv", 600, 0.0, &|_, _, _| {});
    write("unseen.csv", 600, 60.0, &|_, _, _| {});
    write("joined-unseen.csv", 600, 60.0, &|_, _, row| row[2] = 0.25 * row[0] + 7.0);
    write("joined.csv", 600, 0.0, &|_, _, row| row[2] = 0.25 * row[0] + 7.0);
    write("constant.csv", 600, 0.0, &|_, _, row| row[2] = 3.5);
    write("few.csv", 12, 0.4, &|_, _, _| {});
    write("loose.csv", 600, 0.0, &|i, _, row| match i % 40 {
        7 => row[3] = 60.0,
        29 => row[1] = -900.0,
        _ => {}
    });
    write("runs.csv", 600, 0.0, &|i, _, row| match i {
        0..10 | 200..216 | 590.. => row[3] = 60.0,
        400..412 => row[1] = -900.0,
        _ => {}
    });
    let hangs = |i: usize, of: usize, row: &mut [f64; 4]| {
        if (7 * i) % of < of.div_ceil(7) {
            row[3] = 60.0;
        }
    };
    write("fifteen.csv", 600, 0.0, &|i, _, row| hangs(i, 20, row));
    write("quarter.csv", 600, 0.0, &|i, _, row| hangs(i, 4, row));
    write("turned.csv", 600, 40.0, &|_, _, row| row[3] = -row[3]);
    write("off.csv", 600, 0.0, &|_, t, row| row[3] = load(1.03 * t));
    // The load cell is unplugged between two presses, and plugged in between two others.
    write("dead.csv", 600, 0.0, &|i, _, row| {
        if (125..250).contains(&i) {
            row[3] = 0.0;
        }
    });
    write("short.csv", 150, 0.0, &|i, _, row| {
        if (70..80).contains(&i) {
            row[3] = 40.0;
        }
    });
    let restamped = |name: &str, from: &str, stamp: &dyn Fn(f64) -> f64| {
        let text = std::fs::read_to_string(folder.0.join(from)).unwrap();
        let lines = text.lines().map(|line| match line.split_once(',') {
            Some((t, rest)) if t != "t_s" => format!("{},{rest}\n", stamp(t.parse().unwrap())),
            _ => format!("{line}\n"),
        });
        std::fs::write(folder.0.join(name), lines.collect::<String>()).unwrap();
    };
    restamped("rounded.csv", "off.csv", &|t| (10.0 * t + 1e-6).floor() / 10.0);
    restamped("hangs.csv", "good.csv", &|t| t.min(6.0));
    restamped("back.csv", "good.csv", &|t| if t > 6.0 { t - 6.0 } else { t });
    let good = std::fs::read_to_string(folder.0.join("good.csv")).unwrap();
    let timeless: String =
        good.lines().map(|line| format!("{}\n", line.split_once(',').unwrap().1)).collect();
    std::fs::write(folder.0.join("timeless.csv"), timeless).unwrap();

    let what = ["--inputs", "m*", "--targets", "force_n", "--hidden", "4"];
    let judged = ("force_n", "unseen.csv");
    let fits = |data: &[&str], judged, end| fits(&folder, &what, data, judged, &end);
    let joined = ("force_n", "joined-unseen.csv");
    fits(&["joined.csv"], joined, End::Warned("m0, m2: together they are linearly dependent", 0.2));
    fits(&["constant.csv"], judged, End::Warned("m2: the same value in every row", 0.2));
    fits(&["few.csv"], judged, End::Refused("12 usable rows where at least"));
    fits(&["loose.csv"], judged, End::Warned("loose.csv: 30 of 600 rows (5 %) stand far out", 0.2));
    fits(&["runs.csv"], judged, End::Warned("runs.csv: 48 of 600 rows (8 %) stand far out", 0.2));
    let fifteen = "fifteen.csv: 90 of 600 rows (15 %) stand far out";
    fits(&["fifteen.csv"], judged, End::Warned(fifteen, 0.2));
    let quarter = "quarter.csv: 150 of 600 rows (25 %) stand far out";
    fits(&["good.csv", "quarter.csv"], judged, End::Refused(quarter));
    let against = "turned.csv: force_n has the opposite sign of";
    fits(&["good.csv", "turned.csv"], judged, End::Refused(against));
    fits(&["good.csv", "turned.csv", "unseen.csv"], judged, End::Refused(against));
    let turned = ("force_n", "turned.csv");
    let negative = "turned.csv: force_n: always negative";
    fits(&["turned.csv"], turned, End::Warned(negative, 0.3));
    fits(&["off.csv"], judged, End::Warned("off.csv: the reference fits far better", 0.2));
    let dead = "dead.csv: in … of 600 rows … the reference stays at zero while the inputs show";
    fits(&["dead.csv"], judged, End::Warned(dead, 0.2));
    let short = "short.csv: 10 of 150 rows (7 %) stand far out";
    fits(&["short.csv"], judged, End::Warned(short, 0.5));
    fits(&["timeless.csv"], judged, End::Warned("timeless.csv: no time column", 0.2));
    fits(&["rounded.csv"], judged, End::Warned("rounded.csv: the reference fits far better", 0.2));
    let hangs = "hangs.csv: 300 rows have one time, 6 s, so that it was not checked";
    fits(&["hangs.csv"], judged, End::Warned(hangs, 0.2));
    fits(&["back.csv"], judged, End::Refused("back.csv:303: `t_s`: after 6 s comes 0.0"));
}

/// Writes a finger pressed for 8 s at 200 Hz, with shear up to `shear` of the friction limit. Every
/// row goes through `spoil`.
fn finger(
    folder: &Path,
    name: &str,
    (seed, shear): (u64, f64),
    spoil: impl Fn(usize, &mut Sample),
) {
    let mut samples = pressed(seed, shear);
    for (row, sample) in samples.iter_mut().enumerate() {
        sample.truth.sensors = [[None; 3]; 4];
        spoil(row, sample);
    }
    write_trace(folder, name, &samples, true);
}

/// Samples of such a finger with the force on each sensor.
fn pressed(seed: u64, shear: f64) -> Vec<Sample> {
    let scene = format!(
        "effects = ['noise', 'ambient', 'gain-spread', 'optical-crosstalk']\n\
                 [scan]\nrate_hz = 200\nduration_s = 9\n[device]\nseed = 3\nbits = 16\n\
                 [indenter]\nradius_mm = 6\n[friction]\nmu = 0.8\n\
                 [[random]]\nat_s = 1\npresses = 26\neach_s = 0.3\nx_mm = [-2, 2]\ny_mm = [-2, 2]\n\
                 fz_n = [0.4, 2]\nshear_of_limit = [0, {shear}]\n"
    );
    let simulator = Simulator::new(&Scene::parse("presses.toml", &scene).unwrap(), seed);
    // No contact points: only the net is fitted here.
    let bare =
        |sample: Sample| Sample { truth: Truth { point: [None; 2], ..sample.truth }, ..sample };
    simulator.map(bare).collect()
}

#[test]
fn fit_reports_omitted_sensors_axes_and_rows() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let write = |name: &str, seed: u64, spoil: &dyn Fn(usize, &mut Sample)| {
        let mut samples = pressed(seed, 0.9);
        samples.iter_mut().enumerate().for_each(|(row, sample)| spoil(row, sample));
        write_trace(folder.0, name, &samples, true);
    };
    let fit = [
        "calibrate",
        "fit",
        "--out",
        "cal.toml",
        "--force",
        "--model",
        "ridge",
        "--json",
        "--data",
    ];
    let fitted = |more: &[&str]| {
        let ran = folder.taxel(&[&fit[..], more].concat());
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        (json(&ran.out), ran.err)
    };
    let part = |found: &serde_json::Value, name: &str| {
        let parts = found["parts"].as_array().unwrap().iter();
        parts.clone().find(|part| part["part"].as_str().unwrap().starts_with(name)).cloned()
    };

    // One cell of s0 is empty, and s1 has no z at all.
    write("holes.csv", 1, &|row, sample| {
        sample.truth.sensors[1][2] = None;
        if row == 700 {
            sample.truth.sensors[0][1] = None;
        }
    });
    let (found, said) = fitted(&["holes.csv"]);
    let (s0, s2) = (part(&found, "s0").unwrap(), part(&found, "s2").unwrap());
    assert_eq!(s0["rows"].as_u64().unwrap() + 1, s2["rows"].as_u64().unwrap());
    assert!(part(&found, "s1").is_none());
    let why =
        "s1: its matrix S was not fitted: holes.csv: no row has all of s1_fx_n, s1_fy_n, s1_fz_n";
    assert!(said.contains(&format!("taxel: warning: {why}")), "{said}");

    write("loose.csv", 1, &|i, sample| {
        sample.truth.sensors = [[None; 3]; 4];
        if i % 40 == 7 {
            sample.truth.force[2] = sample.truth.force[2].map(|f| f + 30.0);
        }
    });
    let (found, said) = fitted(&["loose.csv"]);
    let left_out = part(&found, "linear").unwrap()["left_out"].as_u64().unwrap();
    assert!(left_out > 5 && said.contains(&format!("loose.csv: {left_out} of ")), "{said}");
    table(folder.0, "table.csv", 600, 0.0, |i, _, row| {
        if i % 40 == 7 {
            row[3] = 60.0;
        }
    });
    let (found, _) = fitted(&["table.csv", "--inputs", "m*", "--targets", "force_n"]);
    assert_eq!(found["parts"][0]["left_out"], 15);

    for (name, from) in [("two.csv", 40.0), ("three.csv", 80.0)] {
        table(folder.0, name, 600, from, |_, _, _| {});
    }
    let net = |data: &[&str]| {
        let fit = ["calibrate", "fit", "--out", "cal.toml", "--force", "--json", "--inputs", "m*"];
        let fit = fit.into_iter().chain(["--model", "mlp"]);
        let data = data.iter().flat_map(|file| ["--data", file]);
        let typed: Vec<&str> =
            fit.into_iter().chain(["--targets", "force_n"]).chain(data).collect();
        let ran = folder.taxel(&typed);
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        (json(&ran.out)["parts"][0].clone(), ran.err)
    };
    let (of_three, said) = net(&["table.csv", "two.csv", "three.csv"]);
    assert_eq!(of_three["chosen"]["left_out"], "recordings", "{of_three}");
    let widths = of_three["chosen"]["widths"].as_array().unwrap().iter();
    assert_eq!(widths.map(|w| w["hidden"].as_u64().unwrap()).collect::<Vec<_>>(), [4, 8, 16]);
    assert!(!said.contains("hidden units as usual"), "{said}");
    let (of_two, said) = net(&["two.csv", "three.csv"]);
    assert!(of_two["chosen"].is_null(), "{of_two}");
    assert!(
        said.contains("taxel: warning: mlp: 16 hidden units as usual, not chosen by"),
        "{said}"
    );

    write("still.csv", 1, &|_, sample| sample.truth.force[0] = Some(0.0));
    let refused = folder.fails(1, &[&fit[..], &["still.csv"]].concat());
    assert!(refused.contains("net: fx_n: the same throughout"), "{refused}");
    write("one-way.csv", 1, &|_, sample| {
        sample.truth.force[0] = sample.truth.force[0].map(f64::abs);
    });
    let (_, said) = fitted(&["one-way.csv"]);
    assert!(said.contains("taxel: warning: fx goes one way only (0.00 … "), "{said}");

    // Only the normal force on s0: neither the net nor the array of total forces needs its S.
    let alike = |_: usize, sample: &mut Sample| {
        let midpoints = sample.scan.codes.bridges[0].as_mut().unwrap();
        (midpoints.c, midpoints.d) = (midpoints.a, midpoints.b);
    };
    write("alike.csv", 1, &alike);
    let (found, said) = fitted(&["alike.csv"]);
    assert!(part(&found, "array").is_some() && part(&found, "s0").is_none());
    assert!(said.contains("s0: the loads do not determine every axis"), "{said}");
    let (found, said) = fitted(&["alike.csv", "--net-only"]);
    assert!(part(&found, "linear").is_some() && part(&found, "s0").is_none());
    assert!(said.contains("s0: its matrix S was not fitted: s0: the loads do not"), "{said}");
}

fn taxel(sample: &mut Sample, row: usize, column: usize) -> &mut Code {
    &mut sample.scan.codes.taxels.as_mut().unwrap().lit[row][column]
}

#[test]
fn faulty_finger_recording_is_refused_or_warned() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let write = |name: &str, seed: u64, spoil: &dyn Fn(usize, &mut Sample)| {
        finger(folder.0, name, (seed, 0.0), spoil);
    };
    let join = |_: usize, sample: &mut Sample| {
        let taxels = sample.scan.codes.taxels.as_mut().unwrap();
        taxels.dark[0] = taxels.dark[1];
        taxels.lit[0][0] = taxels.lit[0][1];
    };
    write("unseen.csv", 2, &|_, _| {});
    write("joined-unseen.csv", 2, &join);
    write("joined.csv", 1, &join);
    write("constant-unseen.csv", 2, &|_, sample| *taxel(sample, 1, 2) = Code(25_000));
    write("constant.csv", 1, &|_, sample| *taxel(sample, 1, 2) = Code(25_000));
    write("loose.csv", 1, &|i, sample| match i % 40 {
        7 => sample.truth.force[2] = sample.truth.force[2].map(|f| f + 30.0),
        29 => *taxel(sample, 1, 1) = Code(60_000),
        _ => {}
    });
    let hangs = |sample: &mut Sample| sample.truth.force[2] = Some(12.0);
    write("runs.csv", 1, &|i, sample| match i {
        0..20 | 600..640 | 1700.. => hangs(sample),
        1000..1030 => *taxel(sample, 1, 1) = Code(60_000),
        _ => {}
    });
    write("fifteen.csv", 1, &|i, sample| {
        if matches!(i % 20, 3 | 9 | 15) {
            hangs(sample);
        }
    });
    write("quarter.csv", 1, &|i, sample| {
        if i % 4 == 1 {
            hangs(sample);
        }
    });
    write("turned.csv", 1, &|_, sample| {
        sample.truth.force = sample.truth.force.map(|f| f.map(|f| -f));
    });
    let mut late = Vec::new();
    finger(folder.0, "good.csv", (1, 0.0), |_, _| {});
    finger(folder.0, "sheared.csv", (1, 0.9), |_, _| {});
    finger(folder.0, "shear-turned.csv", (2, 0.9), |_, sample| {
        let [x, y, z] = sample.truth.force;
        sample.truth.force = [x.map(|x| -x), y.map(|y| -y), z];
    });
    let good: Vec<Sample> = taxel_files::trace::TraceReader::open(folder.0.join("good.csv"))
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    for (i, sample) in good.iter().enumerate() {
        let then = good[(1.03 * i as f64) as usize % good.len()].truth;
        late.push(Sample { truth: then, ..*sample });
    }
    write_trace(folder.0, "off.csv", &late, true);

    let what = ["--hidden", "4"];
    let judged = ("fz_n", "unseen.csv");
    let fits = |data: &[&str], judged, end| fits(&folder, &what, data, judged, &end);
    let joined = ("fz_n", "joined-unseen.csv");
    fits(&["joined.csv"], joined, End::Warned("taxels r0c0, r0c1 are linearly dependent", 0.1));
    let constant = ("fz_n", "constant-unseen.csv");
    fits(&["constant.csv"], constant, End::Warned("lit_r1c2 reads the same in every row", 0.1));
    fits(&["good.csv@0..1.06"], judged, End::Refused("usable rows where at least"));
    fits(&["loose.csv"], judged, End::Warned("loose.csv: … stand far out", 0.1));
    fits(&["runs.csv"], judged, End::Warned("runs.csv: … stand far out", 0.1));
    fits(&["fifteen.csv"], judged, End::Warned("fifteen.csv: … (15 %) stand far out", 0.1));
    fits(&["quarter.csv"], judged, End::Refused("quarter.csv: "));
    fits(&["quarter.csv"], judged, End::Refused("which is more than can be left out"));
    let negative = "turned.csv: fz_n is negative where something presses";
    fits(&["turned.csv"], judged, End::Refused(negative));
    fits(&["good.csv", "turned.csv"], judged, End::Refused(negative));
    let against = "shear-turned.csv: fx_n, fy_n have the opposite sign of sheared.csv";
    fits(&["sheared.csv", "shear-turned.csv"], judged, End::Refused(against));
    fits(&["off.csv"], judged, End::Warned("off.csv: the reference fits far better", 0.1));
}

/// Writes a force sensor on the bench at 250 Hz; every row goes through `spoil`.
fn bench(folder: &Path, name: &str, seed: u64, spoil: impl Fn(usize, &mut Sample)) {
    let scene = "effects = ['noise', 'bridge-mismatch', 'bridge-crosstalk']\n\
                 [scan]\nrate_hz = 250\nduration_s = 13\n[device]\nseed = 1\nbits = 16\n\
                 [indenter]\nradius_mm = 6\n[friction]\nmu = 0.8\n[bench]\nsensor = 0\n\
                 [[random]]\nat_s = 1\npresses = 24\neach_s = 0.5\nx_mm = [0, 0]\ny_mm = [0, 0]\n\
                 fz_n = [0.3, 1.2]\nshear_of_limit = [0, 0.95]\n";
    let simulator = Simulator::new(&Scene::parse("bench.toml", scene).unwrap(), seed);
    let mut samples: Vec<Sample> = simulator.collect();
    samples.iter_mut().enumerate().for_each(|(row, sample)| {
        sample.truth.sensors = [[None; 3]; 4];
        spoil(row, sample);
    });
    write_trace(folder, name, &samples, true);
}

#[test]
fn faulty_sensor_recording_is_refused_or_warned() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let write = |name: &str, seed: u64, spoil: &dyn Fn(usize, &mut Sample)| {
        bench(folder.0, name, seed, spoil);
    };
    write("unseen.csv", 2, &|_, _| {});
    write("joined.csv", 1, &|_, sample| {
        let midpoints = sample.scan.codes.bridges[0].as_mut().unwrap();
        (midpoints.c, midpoints.d) = (midpoints.a, midpoints.b);
    });
    let stuck = |_: usize, sample: &mut Sample| {
        sample.scan.codes.bridges[0].as_mut().unwrap().c = Code(31_000);
    };
    write("constant.csv", 1, &stuck);
    write("constant-unseen.csv", 2, &stuck);
    write("loose.csv", 1, &|i, sample| match i % 40 {
        7 => sample.truth.force[2] = sample.truth.force[2].map(|f| f + 9.0),
        29 => sample.scan.codes.bridges[0].as_mut().unwrap().a = Code(60_000),
        _ => {}
    });
    let turn = |_: usize, sample: &mut Sample| {
        sample.truth.force = sample.truth.force.map(|f| f.map(|f| -f));
    };
    write("turned.csv", 1, &turn);
    write("turned-unseen.csv", 2, &turn);
    write("good.csv", 3, &|_, _| {});
    let good: Vec<Sample> = taxel_files::trace::TraceReader::open(folder.0.join("good.csv"))
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    let off: Vec<Sample> = (0..good.len())
        .map(|i| {
            let truth = good[(1.03 * i as f64) as usize % good.len()].truth;
            Sample { truth, ..good[i] }
        })
        .collect();
    write_trace(folder.0, "off.csv", &off, true);

    let fits = |data: &[&str], judged, end| fits(&folder, &[], data, judged, &end);
    let judged = ("fz_n", "unseen.csv");
    fits(&["joined.csv"], judged, End::Refused("the loads do not determine every axis"));
    let constant = ("fz_n", "constant-unseen.csv");
    fits(&["constant.csv"], constant, End::Warned("bridge_s0_c reads the same in every row", 0.02));
    fits(&["good.csv@0.9..0.948"], judged, End::Refused("unloaded stretch"));
    fits(&["loose.csv"], judged, End::Warned("loose.csv: … (3 %) stand far out", 0.005));
    let turned = ("fz_n", "turned-unseen.csv");
    fits(&["turned.csv"], turned, End::Warned("look at the reference's sign", 0.005));
    let against = "turned.csv: fx_n, fy_n, fz_n have the opposite sign of good.csv";
    fits(&["good.csv", "turned.csv"], judged, End::Refused(against));
    fits(&["off.csv"], judged, End::Warned("off.csv: the reference fits far better", 0.005));
}

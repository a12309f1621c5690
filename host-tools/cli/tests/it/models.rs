//! Tests of every family of models, from a simulated recording to a record judged on another one.

use std::fmt::Write as _;
use std::path::Path;

use crate::common::{In, json};
use taxel_calibrate::recording::Recording;
use taxel_files::trace::Sample;
use taxel_papers::column::{CENTRES, quadrants};
use taxel_papers::feeler::Spot;
use taxel_sim::systems::column::LIGHT_PER_MM2;
use taxel_sim::{Scene, Simulator};

/// Fits `fit.csv` with the options `typed`, and evaluates on `unseen.csv`. Returns the RMS errors
/// of the targets, all of which the record must have.
fn judged(folder: &In<'_>, typed: &str, targets: &[&str]) -> Vec<f64> {
    let fit = "calibrate fit --data fit.csv --out cal.toml --force --serial bench-7 --json";
    let typed: Vec<&str> = fit.split(' ').chain(typed.split(' ')).collect();
    let fitted = json(&folder.succeeds(&typed));
    assert_eq!(
        (&fitted["calibration"], &fitted["interrupted"]),
        (&"cal.toml".into(), &false.into())
    );
    assert!(fitted["parts"][0]["rows"].as_u64().unwrap() > 0, "{fitted}");
    let record = std::fs::read_to_string(folder.0.join("cal.toml")).unwrap();
    assert!(record.contains("serial = \"bench-7\""), "{record}");
    let judge = "calibrate evaluate --data unseen.csv --calibration cal.toml --json";
    let judged = json(&folder.succeeds(&judge.split(' ').collect::<Vec<_>>()));
    let rmse = |target: &&str| judged[*target]["rmse"].as_f64().unwrap();
    let errors = targets.iter().map(rmse).collect();
    eprintln!("{}: {errors:?}", typed[9..].join(" "));
    errors
}

fn simulate(scene: &str, seed: u64) -> Vec<Sample> {
    Simulator::new(&Scene::parse("mine.toml", scene).unwrap(), seed).collect()
}

/// Scene of presses with shear on the finger of the built-in scenes, a new one every 0.5 s.
const SHEARED: &str = "effects = ['noise', 'ambient', 'gain-spread', 'optical-crosstalk', 'bridge-mismatch', \
    'bridge-crosstalk']\n[scan]\nrate_hz = 200\nduration_s = 13\n[device]\nseed = 3\nbits = 16\n\
    [indenter]\nradius_mm = 6\n[friction]\nmu = 0.8\n[[random]]\nat_s = 1\npresses = 24\neach_s = 0.5\n\
    x_mm = [-2, 2]\ny_mm = [-2, 2]\nfz_n = [0.4, 2]\nshear_of_limit = [0, 0.6]\n";

/// Uses the trace itself as the table: raw codes in, forces out.
#[test]
fn general_models_hold_on_unseen_presses() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    std::fs::write(folder.0.join("mine.toml"), SHEARED).unwrap();
    for (seed, out) in [("1", "fit.csv"), ("2", "unseen.csv")] {
        folder.succeeds(&["simulate", "--scene", "mine.toml", "--seed", seed, "--out", out]);
    }
    // Limits of the RMS errors in newtons; the RMS force is 0.75 N.
    for (model, most) in [
        ("least-squares", 0.2),
        ("ridge", 0.2),
        ("cubic", 0.03),
        ("quadratic", 0.03),
        ("mlp --hidden 4", 0.025),
        ("skip --hidden 4", 0.025),
    ] {
        let typed = format!("--inputs lit_* --targets fz_n --model {model}");
        let error = judged(&folder, &typed, &["fz_n"])[0];
        assert!(error < most, "{model}: {error} N");
    }
    // [Ospina2017]'s matrix, from all force sensors together.
    for model in ["least-squares", "ridge"] {
        let typed = format!("--inputs bridge_* --targets fx_n,fy_n,fz_n --model {model}");
        let errors = judged(&folder, &typed, &["fx_n", "fy_n", "fz_n"]);
        assert!(errors.iter().all(|error| *error < 2e-3), "{errors:?}");
    }
}

#[test]
fn net_forms_hold_on_unseen_presses() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    std::fs::write(folder.0.join("mine.toml"), SHEARED).unwrap();
    for (seed, out) in [("1", "fit.csv"), ("2", "unseen.csv")] {
        folder.succeeds(&["simulate", "--scene", "mine.toml", "--seed", seed, "--out", out]);
    }
    for (typed, section) in [
        ("--model mlp --hidden 6", "[force]"),
        ("--model skip --hidden 6", "skip = [["),
        ("--model ridge", "skip = [["),
        ("--model least-squares", "skip = [["),
        ("--model skip --hidden 6 --form q15", "[quantised]"),
    ] {
        // So few presses do not suffice for shear.
        let error = judged(&folder, &format!("{typed} --net-only"), &["fz_n"])[0];
        assert!(error < 0.12, "{typed}: {error} N");
        let record = std::fs::read_to_string(folder.0.join("cal.toml")).unwrap();
        assert!(record.contains(section), "{typed} has no {section}");
    }
}

/// Writes a row for each press: light gained by the four taxels, displacements of their facets,
/// position and angle.
fn line_of_four(directory: &Path, scene: &str, seed: u64, out: &str) {
    let mut run = Simulator::new(&Scene::load(scene).unwrap(), seed);
    let mut rows = Vec::new();
    while let Some(sample) = run.next() {
        let taxels = sample.scan.codes.taxels.unwrap();
        let light =
            |c: usize| (f64::from(taxels.lit[0][c].0) - f64::from(taxels.dark[c].0)) / 65535.0;
        let light: [f64; 4] = std::array::from_fn(light);
        rows.push((sample, light, *run.displacement().unwrap()));
    }
    let mean = |rows: &[&(Sample, [f64; 4], _)], c: usize| {
        rows.iter().map(|row| row.1[c]).sum::<f64>() / rows.len() as f64
    };
    let unloaded: Vec<_> = rows[..250].iter().collect();
    let mut text = String::from("c1,c2,c3,c4,u1_mm,u2_mm,u3_mm,u4_mm,p_mm,theta_deg\n");
    let touches = |row: &(Sample, _, _)| row.0.truth.contact == Some(true);
    for press in rows.chunk_by(|a, b| touches(a) == touches(b)).filter(|run| touches(&run[0])) {
        let force = |row: &(Sample, _, _), axis: usize| row.0.truth.force[axis].unwrap();
        let most = press.iter().map(|row| force(row, 2)).fold(0.0, f64::max);
        let held: Vec<_> = press.iter().filter(|row| force(row, 2) > 0.999 * most).collect();
        for c in 0..4 {
            write!(text, "{:.7},", mean(&held, c) - mean(&unloaded, c)).unwrap();
        }
        for u in &held[0].2[..4] {
            write!(text, "{u:.7},").unwrap();
        }
        let angle = most.atan2(force(held[0], 0)).to_degrees();
        writeln!(text, "{:.4},{angle:.4}", held[0].0.truth.point[0].unwrap()).unwrap();
    }
    std::fs::write(directory.join(out), text).unwrap();
}

#[test]
fn row_and_gap_models_fit_simulated_presses() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    line_of_four(folder.0, "line-fit", 1, "fit.csv");
    line_of_four(folder.0, "line-trial", 2, "unseen.csv");
    let row = "--model row --inputs u1_mm,u2_mm,u3_mm,u4_mm --targets p_mm,theta_deg";
    let errors = judged(&folder, row, &["p_mm", "theta_deg"]);
    // [DeMaria2011]'s largest errors are 0.3 mm and 10 degrees.
    assert!(errors[0] < 0.3 && errors[1] < 10.0, "{errors:?}");
    let auto = "--model auto --inputs c* --targets p_mm,theta_deg";
    let errors = judged(&folder, auto, &["p_mm", "theta_deg"]);
    assert!(errors[0] < 0.15 && errors[1] < 5.0, "{errors:?}");
    let depths = ["u1_mm", "u2_mm", "u3_mm", "u4_mm"];
    let gap = format!("--model gap --inputs c* --targets {}", depths.join(","));
    let errors = judged(&folder, &gap, &depths);
    assert!(errors.iter().all(|error| *error < 0.02), "{errors:?}");
}

/// Pairs each sample with its signals.
fn signals(samples: Vec<Sample>) -> Vec<([f32; 16], Sample)> {
    let recording = Recording { name: "simulated".to_owned(), samples };
    let bias = recording.bias(None).unwrap();
    let rows = recording.signals(&bias, None).into_iter().map(|signals| signals.taxels.unwrap());
    rows.zip(recording.samples).collect()
}

/// Writes the feeler of [Ohka2005], sheared along x and y at some normal forces. A row is 50 ms,
/// the paper's step.
fn feeler(directory: &Path, seed: u64, normal: &[f64], out: &str) {
    let mut scene = format!(
        "effects = ['noise', 'ambient', 'flicker', 'gain-spread']\n[scan]\nrate_hz = 500\nduration_s = {}\n\
         [device]\nkind = 'ohka-micro'\nseed = 1\nbits = 16\n[friction]\nmu = 10\n",
        1 + 4 * normal.len()
    );
    for (i, (normal, axis)) in normal.iter().zip(["fx_n", "fy_n"].into_iter().cycle()).enumerate() {
        let at = 1 + 4 * i;
        write!(
            scene,
            "[[press]]\nat_s = {at}\nx_mm = 0\ny_mm = 0\nfz_n = {normal}\n{axis} = 0.01\nrise_s = 0.2\n\
             hold_s = 3.2\nfall_s = 0.2\n"
        )
        .unwrap();
    }
    let rows: Vec<([f64; 3], [f64; 3])> = signals(simulate(&scene, seed))
        .into_iter()
        .map(|(c, sample)| {
            let spot = Spot::measure(&c.map(|c| -c), 4, 160.0);
            let [x, y] = spot.centroid.map(f64::from);
            ([spot.integral.into(), x, y], sample.truth.force.map(Option::unwrap))
        })
        .collect();
    let steps = rows.chunks_exact(25).filter(|step| step.iter().all(|(_, f)| f[2] > 0.002));
    let means: Vec<[f64; 6]> = steps
        .map(|step| {
            let mean = |k: usize| {
                let value = |(g, f): &([f64; 3], [f64; 3])| if k < 3 { g[k] } else { f[k - 3] };
                step.iter().map(value).sum::<f64>() / step.len() as f64
            };
            std::array::from_fn(mean)
        })
        .collect();
    // Position of the centroid without shear.
    let rest = [1, 2].map(|k| {
        let still: Vec<f64> =
            means.iter().filter(|m| m[3].abs() + m[4].abs() < 2e-5).map(|m| m[k]).collect();
        still.iter().sum::<f64>() / still.len() as f64
    });
    let mut text = String::from("G,ux_um,uy_um,fx_n,fy_n,fz_n\n");
    for [g, x, y, fx, fy, fz] in means {
        writeln!(text, "{g},{},{},{fx},{fy},{fz}", x - rest[0], y - rest[1]).unwrap();
    }
    std::fs::write(directory.join(out), text).unwrap();
}

#[test]
fn feeler_model_fits_simulated_shear() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    feeler(folder.0, 1, &[0.0022, 0.0022, 0.0065, 0.0065, 0.0109, 0.0109], "fit.csv");
    feeler(folder.0, 2, &[0.0044, 0.0044, 0.0087, 0.0087], "unseen.csv");
    let typed = "--model feeler --inputs G,ux_um,uy_um --targets fx_n,fy_n,fz_n";
    let errors = judged(&folder, typed, &["fx_n", "fy_n", "fz_n"]);
    // 5 % of the shear of 10 mN; for the normal force the resolution of the load cells of
    // [Ohka2005].
    assert!(errors[0].max(errors[1]) < 5e-4 && errors[2] < 1e-4, "{errors:?}");
}

/// Writes one of [Ohka2004]'s columns, pressed and sheared: the areas of its four cones.
fn column(directory: &Path, seed: u64, scale: f64, out: &str) {
    let mut scene = String::from(
        "effects = ['noise', 'ambient', 'flicker', 'gain-spread']\n[scan]\nrate_hz = 500\nduration_s = 10\n\
         [device]\nkind = 'ohka-column'\nseed = 1\nbits = 16\n[friction]\nmu = 0.4\n",
    );
    for i in 0..6 {
        let normal = scale * (0.05 + 0.04 * f64::from(i));
        let (axis, at) = (["fx_n", "fy_n"][i as usize % 2], 1.0 + 1.5 * f64::from(i));
        write!(
            scene,
            "[[press]]\nat_s = {at}\nx_mm = 2.5\ny_mm = -2.5\nfz_n = {normal}\n{axis} = {}\nrise_s = 0.2\n\
             hold_s = 0.9\nfall_s = 0.2\n",
            0.3 * normal
        )
        .unwrap();
    }
    let which = CENTRES.iter().position(|centre| *centre == [2.5, -2.5]).unwrap();
    let mut text = String::from("S1,S2,S3,S4,fx_n,fy_n,fz_n\n");
    for (c, sample) in signals(simulate(&scene, seed)).into_iter().step_by(5) {
        let areas = quadrants(&c)[which].map(|light| f64::from(light) / LIGHT_PER_MM2);
        let [fx, fy, fz] = sample.truth.force.map(Option::unwrap);
        let [s1, s2, s3, s4] = areas;
        writeln!(text, "{s1},{s2},{s3},{s4},{fx},{fy},{fz}").unwrap();
    }
    std::fs::write(directory.join(out), text).unwrap();
}

#[test]
fn column_model_fits_simulated_shear() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    column(folder.0, 1, 1.0, "fit.csv");
    column(folder.0, 2, 0.9, "unseen.csv");
    let typed = "--model column --inputs S1,S2,S3,S4 --targets fx_n,fy_n,fz_n";
    let errors = judged(&folder, typed, &["fx_n", "fy_n", "fz_n"]);
    // 2 % of 0.25 N and of 0.07 N.
    assert!(errors[2] < 0.005 && errors[0].max(errors[1]) < 0.0014, "{errors:?}");
}

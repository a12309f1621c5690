//! Fingers that other programs made, fitted and judged by the default command.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde_json::Value;

use super::{Verdict, calibrate, moving};

/// Noise of a load cell, newtons, and largest error of a press's place, mm.
const NOISE: [f64; 2] = [0.006, 0.1];
/// Largest error under noisy labels, over that under exact ones.
const NOISIER: f64 = 1.5;
/// Largest error of a disturbed finger over that of the same one undisturbed.
const DISTURBED: f64 = 3.0;
/// Largest share of values beyond three of their stated standard deviations.
const BEYOND: f64 = 0.02;

/// Recordings of one finger and its trials.
pub(super) struct Finger {
    pub name: String,
    /// Recordings to fit, and the load cell's logs if they have no reference.
    fitted: Vec<String>,
    cells: Vec<String>,
    noisy: bool,
    trials: Vec<Trial>,
    /// Whether its slides, grasps and faults are judged too.
    moves: bool,
}

/// A recording to judge with its limits.
struct Trial {
    file: String,
    /// Part of the finger that is judged.
    only: &'static str,
    /// Largest RMS error of F_x and F_y, and of F_z, in newtons.
    shear: Option<f64>,
    normal: Option<f64>,
    /// Largest RMS distance of the contact point, in millimetres.
    place: Option<f64>,
    /// Whether few values may lie beyond their stated deviations.
    stated: bool,
    /// Whether its errors are compared with those of the first trial.
    disturbed: bool,
}

impl Trial {
    fn new(file: &str, only: &'static str) -> Self {
        let (shear, normal, place) = (None, None, None);
        Self { file: file.into(), only, shear, normal, place, stated: false, disturbed: false }
    }

    fn limits(mut self, [shear, normal]: [f64; 2], place: Option<f64>) -> Self {
        (self.shear, self.normal, self.place) = (Some(shear), Some(normal), place);
        self
    }

    fn stated(mut self) -> Self {
        self.stated = true;
        self
    }

    fn disturbed(mut self) -> Self {
        self.disturbed = true;
        self
    }
}

/// Lists the fingers.
pub(super) fn fingers() -> Vec<Finger> {
    let path = |file: &str| format!("independent/{file}.csv");
    let pair = |device: &str| ["presses", "shear"].map(|run| path(&format!("{device}_{run}")));
    let finger = |name: &str, device: &str, noisy, trials| Finger {
        name: name.into(),
        fitted: pair(device).into(),
        cells: Vec::new(),
        noisy,
        trials,
        moves: device == "d21" && !noisy,
    };
    let mut all = Vec::new();
    for device in ["d21", "d22", "d23"] {
        for (noisy, more) in [(false, 1.0), (true, NOISIER)] {
            let trial = path(&format!("{device}_trial"));
            let mut trials = vec![
                Trial::new(&trial, "both").limits([more * 0.002; 2], Some(more * 0.05)),
                Trial::new(&trial, "matrix")
                    .limits([more * 0.020, more * 0.002], Some(more * 0.05)),
            ];
            if device == "d21" && !noisy {
                let files = ["d21_trial_lag", "d21_trial_led"].map(path);
                trials.extend(files.iter().map(|file| Trial::new(file, "both").disturbed()));
            }
            let labels = if noisy { ", noisy labels" } else { "" };
            all.push(finger(&format!("{device}{labels}"), device, noisy, trials));
        }
    }
    let runs = ["d24_presses", "d24_shear"];
    let mut cell = finger("d24, codes and a load cell", "d24", false, {
        let file = path("d24_trial");
        vec![Trial::new(&file, "both").limits([0.002, 0.003], Some(0.05))]
    });
    cell.fitted = runs.map(|run| path(&format!("{run}_codes"))).into();
    cell.cells = runs.map(|run| path(&format!("{run}_cell"))).into();
    all.push(cell);
    let (ideal, real, punch) = (path("d41_ideal_trial"), path("d41_real_trial"), path("d41_punch"));
    all.push(finger(
        "d41, ideal",
        "d41_ideal",
        false,
        vec![
            Trial::new(&ideal, "both").limits([0.002, 0.003], None).stated(),
            Trial::new(&ideal, "matrix").limits([0.060, 0.005], Some(0.13)).stated(),
            Trial::new(&punch, "both").stated(),
            Trial::new(&punch, "matrix").stated(),
        ],
    ));
    all.push(finger(
        "d41, real",
        "d41_real",
        false,
        vec![
            Trial::new(&real, "both").limits([0.010, 0.015], Some(0.2)).stated(),
            Trial::new(&real, "matrix").stated(),
        ],
    ));
    all
}

/// Fits and judges a finger.
pub(super) fn judged(finger: &Finger, data: &Path) -> Result<Vec<Verdict>> {
    let folder = tempfile::tempdir()?;
    let path = |file: &String| data.join(file).display().to_string();
    let mut fitted: Vec<String> = finger.fitted.iter().map(path).collect();
    if finger.noisy {
        for (i, file) in fitted.iter_mut().enumerate() {
            let noisy = folder.path().join(format!("noisy-{i}.csv"));
            let text = std::fs::read_to_string(&*file).with_context(|| file.clone())?;
            std::fs::write(&noisy, with_noise(&text, i as u64)?)?;
            *file = noisy.display().to_string();
        }
    }
    let cells: Vec<String> = finger.cells.iter().map(path).collect();
    let out = folder.path().join("judged.toml").display().to_string();
    let mut fit = vec!["fit", "--out", &out];
    fit.extend(fitted.iter().flat_map(|file| ["--data", file]));
    fit.extend(cells.iter().flat_map(|file| ["--reference", file]));
    calibrate(&finger.name, &fit)?;
    let (mut verdicts, mut first) = (Vec::new(), None);
    for trial in &finger.trials {
        let unseen = path(&trial.file);
        let mut words = vec!["evaluate", "--data", &unseen, "--calibration", &out];
        if trial.only != "both" {
            words.extend(["--only", trial.only]);
        }
        let found = calibrate(&finger.name, &words)?;
        let own = errors(&found);
        let first = *first.get_or_insert(own);
        let name = Path::new(&trial.file).file_stem().unwrap_or_default().to_string_lossy();
        let mut put = |what: &str, limit: Option<f64>, reached: f64| {
            let Some(limit) = limit else { return };
            let what = format!("{name} {} {what}", trial.only);
            verdicts.push(Verdict { what, limit, reached, digits: 4 });
        };
        let limit = |own: Option<f64>, first: f64| {
            if trial.disturbed { Some(DISTURBED * first) } else { own }
        };
        put("fx, fy", limit(trial.shear, first[0]), own[0]);
        put("fz", limit(trial.normal, first[1]), own[1]);
        put("place, mm", limit(trial.place, first[2]), own[2]);
        let beyond = found.as_object().into_iter().flatten();
        let beyond = beyond.filter_map(|(_, of)| of["beyond_3_sigma"].as_f64());
        let stated = trial.stated.then_some(BEYOND);
        put("beyond 3 sigma, share", stated, beyond.fold(f64::NAN, f64::max));
    }
    if finger.moves {
        verdicts.extend(moving::judged(&out, &data.join("independent"))?);
    }
    Ok(verdicts)
}

/// RMS errors: the larger of F_x and F_y, F_z, and the distance of the contact point.
fn errors(found: &Value) -> [f64; 3] {
    let rmse = |target: &str| found[target]["rmse"].as_f64().unwrap_or(f64::NAN);
    let [x, y] = ["fx_n", "fy_n"].map(rmse);
    [if x > y { x } else { y }, rmse("fz_n"), rmse("x_mm").hypot(rmse("y_mm"))]
}

/// Adds a load cell's noise to each row's forces, and an error to each press's place.
fn with_noise(text: &str, seed: u64) -> Result<String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut columns: Option<[usize; 5]> = None;
    let (mut at, mut away) = ([f64::NAN; 2], [0.0; 2]);
    let mut noisy = String::new();
    for line in text.lines() {
        let Some([fx, fy, fz, x, y]) = columns else {
            if !line.starts_with('#') {
                let names: Vec<&str> = line.split(',').collect();
                let at = |name: &str| names.iter().position(|n| *n == name);
                let found = ["fx_n", "fy_n", "fz_n", "x_mm", "y_mm"].map(at);
                ensure!(found.iter().all(Option::is_some), "no labels to make noisy in: {line}");
                columns = Some(found.map(Option::unwrap_or_default));
            }
            noisy += &format!("{line}\n");
            continue;
        };
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let read = |cells: &[String], k: usize| cells[k].parse::<f64>();
        for k in [fx, fy, fz] {
            let unit: f64 = StandardNormal.sample(&mut random);
            cells[k] = format!("{:.5}", read(&cells, k)? + NOISE[0] * unit);
        }
        let place = [read(&cells, x)?, read(&cells, y)?];
        if place != at {
            (at, away) = (place, [0; 2].map(|_| random.random_range(-NOISE[1]..NOISE[1])));
        }
        for (k, (place, away)) in [x, y].into_iter().zip(place.into_iter().zip(away)) {
            cells[k] = format!("{:.5}", place + away);
        }
        noisy += &format!("{}\n", cells.join(","));
    }
    Ok(noisy)
}

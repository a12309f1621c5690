//! Ablation: error of the finger with each effect of a real one on or off.
//!
//! Every run uses the commands that a user types: simulate, fit, evaluate.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde_json::Value;

use crate::command;
use crate::table::Table;

/// Fits and judges simulated fingers, one for each effect, into
/// host-tools/research/data/ablation.csv and docs/accuracy.md
#[derive(Args)]
pub struct Ablation {
    /// Devices of the rows `ideal finger` and `reference finger`; the others have device 1
    #[arg(long, default_value_t = 5)]
    devices: u32,
    /// Only draw the table from the CSV file that is there
    #[arg(long)]
    draw: bool,
}

/// Effects beyond those of the built-in scenes, with their names in the table.
const EFFECTS: [(&str, &str); 11] = [
    ("settling", "phototransistors lag"),
    ("walls", "skin on its frame"),
    ("stiffening", "stiffening under strain"),
    ("hysteresis", "first-cycle softening"),
    ("skin-response", "skin lags"),
    ("response", "force sensors lag"),
    ("creep", "slow creep"),
    ("self-heating", "LEDs warm by themselves"),
    ("nonlinearity", "converter off by 2 steps"),
    ("diffuse-facet", "diffuse facets"),
    ("bench-error", "load cell and placement off"),
];

const IDEAL: &str = "ideal finger";
const REFERENCE: &str = "reference finger";
const HEADER: &str = "finger,device,part,fx / mN,fy / mN,fz / mN,point middle / mm,point pad / mm,beyond 3 sigma / %,within 1 sigma / %";

/// Judged recordings: scene, seed and changes; the last one is the whole pad.
const JUDGED: [(&str, &str, &[&str]); 3] = [
    ("shear", "31", &["scan.duration_s=16", "random.presses=70"]),
    ("shear", "32", &["scan.duration_s=41", "random.presses=40", "random.each_s=1.0"]),
    ("presses", "33", &["scan.duration_s=16", "random.presses=70"]),
];

/// A simulated finger: the ideal or the reference one, with one effect switched.
struct Finger {
    name: String,
    reference: bool,
    switched: Option<String>,
}

fn fingers() -> Vec<Finger> {
    let plain = |name: &str, reference| Finger { name: name.into(), reference, switched: None };
    let mut all = vec![plain(IDEAL, false), plain(REFERENCE, true)];
    for (effect, _) in EFFECTS {
        all.push(Finger {
            name: format!("{REFERENCE} without {effect}"),
            reference: true,
            switched: Some(format!("effects.{effect}=false")),
        });
        all.push(Finger {
            name: format!("{IDEAL} with {effect}"),
            reference: false,
            switched: Some(format!("effects.{effect}=true")),
        });
    }
    all
}

pub const TABLE: Table = Table { task: "ablation", page: "docs/accuracy.md", section: table };

/// Runs what is not yet in the CSV file, and draws the table.
pub fn run(arguments: &Ablation) -> Result<()> {
    let path = TABLE.csv();
    let mut text = std::fs::read_to_string(&path).unwrap_or_else(|_| format!("{HEADER}\n"));
    if !arguments.draw {
        for finger in fingers() {
            let devices = if finger.switched.is_none() { arguments.devices } else { 1 };
            for device in 1..=devices {
                if text.lines().any(|line| line.starts_with(&format!("{},{device},", finger.name)))
                {
                    continue;
                }
                text += &rows(&finger, device)?;
                std::fs::write(&path, &text)?;
                eprintln!("{}, device {device}: done", finger.name);
            }
        }
    }
    TABLE.draw()
}

fn taxel(words: &[&str]) -> Result<Vec<u8>> {
    let name = format!("taxel{}", std::env::consts::EXE_SUFFIX);
    let taxel = std::env::current_exe()?.with_file_name(name);
    let output = command(&taxel, Path::new(".")).args(words).output().with_context(|| {
        format!("{}: does not start; build it as this program was built", taxel.display())
    })?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "`taxel {}`: {said}", words.join(" "));
    Ok(output.stdout)
}

/// Simulates, fits and judges a finger; a row for the matrix alone, one for all sensors.
fn rows(finger: &Finger, device: u32) -> Result<String> {
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name).display().to_string();
    let device_key = format!("device.seed={device}");
    let simulate = |scene: &str, seed: &str, out: &str, more: &[&str]| {
        let kind = if finger.reference { "reference" } else { "ideal" };
        let mut words = vec!["simulate", "--scene", scene, "--seed", seed, "--out", out];
        words.extend(["--finger", kind, "--set", &device_key]);
        words.extend(finger.switched.iter().flat_map(|switched| ["--set", switched]));
        words.extend(more.iter().flat_map(|change| ["--set", change]));
        taxel(&words).map(|_| ())
    };
    let (presses, shear, out) = (path("presses.csv"), path("shear.csv"), path("finger.toml"));
    simulate("presses", "1", &presses, &[])?;
    simulate("shear", "2", &shear, &[])?;
    taxel(&["calibrate", "fit", "--data", &presses, "--data", &shear, "--out", &out])?;
    let mut text = String::new();
    for part in ["matrix", "both"] {
        let mut judged = Vec::new();
        for (i, (scene, seed, changes)) in JUDGED.iter().enumerate() {
            let file = path(&format!("unseen-{i}.csv"));
            if !Path::new(&file).exists() {
                // A bench's error is no error of the finger.
                let exact = ["effects.bench-error=false"];
                simulate(scene, seed, &file, &[changes, &exact[..]].concat())?;
            }
            let mut words = vec!["calibrate", "evaluate", "--data", &file, "--calibration", &out];
            words.extend(if part == "matrix" { &["--only", "matrix"][..] } else { &[] });
            words.push("--json");
            let found: Value = serde_json::from_slice(&taxel(&words)?)?;
            judged.push((found, touched(&std::fs::read_to_string(&file)?)?));
        }
        let force = |target: &str| 1e3 * over_contacts(&judged[..2], target);
        let point = |of: &[(Value, f64)]| over_rows(of, "x_mm").hypot(over_rows(of, "y_mm"));
        let shares = |figure: &'static str| {
            judged.iter().flat_map(move |(found, _)| {
                let targets = ["fx_n", "fy_n", "fz_n", "x_mm", "y_mm"];
                targets.into_iter().filter_map(move |target| found[target][figure].as_f64())
            })
        };
        let within: Vec<f64> = shares("within_1_sigma").collect();
        let _ = writeln!(
            text,
            "{},{device},{part},{:.2},{:.2},{:.2},{:.4},{:.4},{:.2},{:.1}",
            finger.name,
            force("fx_n"),
            force("fy_n"),
            force("fz_n"),
            point(&judged[..2]),
            point(&judged[2..]),
            100.0 * shares("beyond_3_sigma").fold(f64::NAN, f64::max),
            100.0 * within.iter().sum::<f64>() / within.len() as f64,
        );
    }
    Ok(text)
}

/// Number of a trace's rows with at least 0.1 N.
fn touched(trace: &str) -> Result<f64> {
    let mut lines = trace.lines().filter(|line| !line.starts_with('#'));
    let header = lines.next().context("an empty trace")?;
    let at = header.split(',').position(|name| name == "fz_n").context("a trace without fz_n")?;
    let force = |line: &str| line.split(',').nth(at).and_then(|cell| cell.parse::<f64>().ok());
    Ok(lines.filter_map(force).filter(|force| *force >= 0.1).count() as f64)
}

/// RMS of a target: squares of all rows, over the rows in contact.
fn over_contacts(judged: &[(Value, f64)], target: &str) -> f64 {
    let contacts: f64 = judged.iter().map(|(_, contacts)| contacts).sum();
    (squares(judged, target).0 / contacts).sqrt()
}

fn over_rows(judged: &[(Value, f64)], target: &str) -> f64 {
    let (squares, rows) = squares(judged, target);
    (squares / rows).sqrt()
}

/// Sum of a target's squared errors, and number of its values.
fn squares(judged: &[(Value, f64)], target: &str) -> (f64, f64) {
    let of = |found: &Value| {
        let figure = |name: &str| found[target][name].as_f64();
        let (rmse, n) = (figure("rmse").unwrap_or(f64::NAN), figure("n").unwrap_or(0.0));
        (n * rmse * rmse, n)
    };
    let each = judged.iter().map(|(found, _)| of(found));
    each.fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
}

type Figures = Vec<f64>;

/// Mean figures of each finger and part.
fn means(text: &str) -> Result<BTreeMap<(String, String), (Figures, usize)>> {
    let mut means: BTreeMap<(String, String), (Figures, usize)> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let (Some([name, _, part]), Some(figures)) = (cells.first_chunk(), cells.get(3..)) else {
            continue;
        };
        let figures: Figures = figures.iter().map(|c| c.parse()).collect::<Result<_, _>>()?;
        let entry = means.entry(((*name).into(), (*part).into()));
        let (sum, n) = entry.or_insert_with(|| (vec![0.0; figures.len()], 0));
        sum.iter_mut().zip(&figures).for_each(|(sum, figure)| *sum += figure);
        *n += 1;
    }
    means.values_mut().for_each(|(sum, n)| sum.iter_mut().for_each(|s| *s /= *n as f64));
    Ok(means)
}

/// Draws the table: F_x, F_y, F_z in mN and the contact point in mm.
fn table(text: &str) -> Result<String> {
    let means = means(text)?;
    let figures = |name: &str, part: &str| {
        let found = means.get(&(name.to_owned(), part.to_owned()));
        found.with_context(|| format!("no row `{name}`, {part}; run `taxel-research ablation`"))
    };
    let cell = |name: &str, part: &str| -> Result<String> {
        let (f, _) = figures(name, part)?;
        Ok(format!("{:.0} / {:.0} / {:.0}, {:.2} ({:.2})", f[0], f[1], f[2], f[3], f[4]))
    };
    let mut table = "| simulated finger | devices | matrix alone | matrix and force sensors |\n\
                     |---|---|---|---|\n"
        .to_owned();
    let mut row = |label: &str, name: &str| -> Result<()> {
        // A row that has not been run is left out.
        let Ok((_, n)) = figures(name, "matrix") else { return Ok(()) };
        writeln!(table, "| {label} | {n} | {} | {} |", cell(name, "matrix")?, cell(name, "both")?)?;
        Ok(())
    };
    row("**reference**, all effects", REFERENCE)?;
    for (effect, words) in EFFECTS {
        row(&format!("reference without: {words}"), &format!("{REFERENCE} without {effect}"))?;
    }
    row("**ideal**, none of them", IDEAL)?;
    for (effect, words) in EFFECTS {
        row(&format!("ideal with: {words}"), &format!("{IDEAL} with {effect}"))?;
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::root;

    #[test]
    fn readme_has_the_reference_finger_of_the_table() {
        let text = std::fs::read_to_string(TABLE.csv()).unwrap();
        assert!(text.starts_with(HEADER));
        let table = table(&text).unwrap();
        let row = table.lines().find(|line| line.starts_with("| **reference**")).unwrap();
        let cells: Vec<&str> = row.split(" | ").skip(2).collect();
        let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
        assert!(readme.contains(&format!("| reference finger | {}", cells.join(" | "))));
    }

    #[test]
    fn reference_finger_states_its_errors() {
        let text = std::fs::read_to_string(TABLE.csv()).unwrap();
        let means = means(&text).unwrap();
        let figures = |part: &str| means[&(REFERENCE.into(), part.into())].0.clone();
        let [matrix, both] = ["matrix", "both"].map(figures);
        // The aim is a hundredth; a normal distribution has 68 % within one.
        let mut worst_without = 0.0f64;
        for line in text.lines().filter(|line| line.starts_with(REFERENCE)) {
            let mut shares = line.rsplit(',').map(|cell| cell.parse::<f64>().unwrap());
            let (within, beyond) = (shares.next().unwrap(), shares.next().unwrap());
            let whole = line.starts_with(&format!("{REFERENCE},"));
            assert!(within > 68.0 && (!whole || beyond <= 1.0), "{line}");
            worst_without = worst_without.max(if whole { 0.0 } else { beyond });
        }
        let page = std::fs::read_to_string(root().join("docs/accuracy.md")).unwrap();
        let beyond =
            format!("{:.1} % of its values (matrix alone) and {:.1} %", matrix[5], both[5]);
        let within = format!("within one are {:.0} and {:.0} % of all", matrix[6], both[6]);
        let shear = |of: &[f64]| of[0].max(of[1]);
        let alone = format!(
            "normal force to {:.0} mN, shear to {:.0} mN and contact point to {:.2} mm with the matrix",
            matrix[2],
            shear(&matrix),
            matrix[4]
        );
        let all = format!(
            "force to {:.0} mN and contact point to {:.2} mm with force sensors",
            shear(&both).max(both[2]),
            both[3].max(both[4])
        );
        let without = format!("at most {worst_without:.1} % with one effect left out");
        for said in [beyond, within, without, alone, all] {
            assert!(page.contains(&said), "docs/accuracy.md should say: {said}");
        }
    }

    #[test]
    fn each_effect_is_one_of_a_real_finger() {
        let real = taxel_sim::scene::REAL;
        assert!(EFFECTS.iter().all(|(effect, _)| real.contains(effect)));
    }

    #[test]
    fn errors_count_over_rows_in_contact() {
        let found = serde_json::json!({ "fz_n": { "rmse": 0.01, "n": 400 } });
        let error = over_contacts(&[(found, 100.0)], "fz_n");
        assert!((error - 0.02).abs() < 1e-12);
        assert_eq!(touched("# simulated=x\nt_us,fz_n\n1,0.2\n2,0.05\n").unwrap(), 1.0);
    }
}

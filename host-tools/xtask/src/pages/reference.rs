//! Simulates the reference finger for what the other tables lack, by the commands of a user.
//!
//! Fits it with four kinds of labels, as labs have them, and measures a data sheet's figures.
//! Writes host-tools/research/data/reference.csv and labels.csv.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;

use super::measure::{self, Run};
use crate::marks;
use crate::run::{program, root, target};

/// Figures of the reference finger: resolution, hysteresis, times, temperature.
pub const FIGURES: &str = "host-tools/research/data/reference.csv";
/// Errors of the reference finger by the labels of its calibration.
pub const LABELS: &str = "host-tools/research/data/labels.csv";

/// Labels of a calibration, and columns that the recordings lack beside the simulator's.
///
/// Those of [`CELL`] and [`SIX_AXES`] are in the log of a load cell with noise and a clock of its
/// own.
const KINDS: [(&str, &[&str]); 4] = [
    ("force on each sensor, contact point", &[]),
    ("total force, contact point", &["s0_", "s1_", "s2_", "s3_", "torsion_nmm"]),
    (CELL, &[]),
    (SIX_AXES, &[]),
];

/// Labels of a load cell alone.
pub const CELL: &str = "load cell's log";

/// Labels of a load cell that has moments.
pub const SIX_AXES: &str = "six-axis load cell's log";

/// Judged recordings, those of `taxel-research ablation`: scene, seed, duration, presses, time of
/// each.
const JUDGED: [(&str, &str, u32, u32, f64); 3] =
    [("shear", "31", 16, 70, 0.2), ("shear", "32", 41, 40, 1.0), ("presses", "33", 16, 70, 0.2)];

/// Scenes of the calibration, with their seeds.
const SCENES: [(&str, &str); 2] = [("presses", "1"), ("shear", "2")];

/// Parts of the finger that are judged.
const PARTS: [&str; 2] = ["matrix", "both"];

/// Largest force of the loop in newtons; the calibration's, too.
const MOST_N: f64 = 2.0;

/// Folder of the runs, and the program.
struct Bench {
    folder: PathBuf,
    taxel: PathBuf,
}

impl Bench {
    fn new() -> Result<Self> {
        let folder = target().join("reference-finger");
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder)?;
        let name = format!("taxel{}", std::env::consts::EXE_SUFFIX);
        let taxel = std::env::current_exe()?.with_file_name(name);
        ensure!(
            taxel.exists(),
            "{}: not there; build it first: `cargo build --bin taxel`",
            taxel.display()
        );
        Ok(Self { folder, taxel })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn taxel(&self, words: &[&str]) -> Result<Vec<u8>> {
        let output = program(&self.taxel, &self.folder).args(words).output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "`taxel {}`: {said}", words.join(" "));
        Ok(output.stdout)
    }

    /// Simulates a scene on device 1 of the reference finger.
    fn simulate(
        &self,
        scene: &str,
        seed: &str,
        out: &str,
        changes: &[String],
        more: &[&str],
    ) -> Result<()> {
        let mut words = vec!["simulate", "--scene", scene, "--seed", seed, "--out", out];
        words.extend(["--finger", "reference", "--set", "device.seed=1"]);
        words.extend(changes.iter().flat_map(|change| ["--set", change]));
        words.extend(more);
        self.taxel(&words).map(|_| ())
    }

    /// Simulates a scene of this text, and what the finger makes of it with or without its sensors.
    fn run(&self, name: &str, scene: &str, part: &str) -> Result<Run> {
        let (file, trace, frames) = (
            format!("{name}.toml"),
            format!("{name}-{part}.csv"),
            format!("{name}-{part}-frames.csv"),
        );
        std::fs::write(self.path(&file), scene)?;
        let mut changes = vec!["effects.bench-error=false".to_owned()];
        if part == "matrix" {
            changes.push("device.bridges=[false, false, false, false]".to_owned());
        }
        self.simulate(&file, "41", &trace, &changes, &["--force"])?;
        self.taxel(&[
            "replay",
            &trace,
            "--calibration",
            &calibration(0),
            "--out",
            &frames,
            "--force",
        ])?;
        Run::read(&self.path(&trace), &self.path(&frames))
    }

    /// Fits the finger with each kind of labels, and writes the errors on recordings of others.
    fn labels(&self) -> Result<String> {
        let mut text =
            "labels,part,fx / mN,fy / mN,fz / mN,point middle / mm,point pad / mm\n".to_owned();
        for (i, (scene, seed, duration_s, presses, each_s)) in JUDGED.iter().enumerate() {
            let changes = [
                "effects.bench-error=false".to_owned(),
                format!("scan.duration_s={duration_s}"),
                format!("random.presses={presses}"),
                format!("random.each_s={each_s:.1}"),
            ];
            self.simulate(scene, seed, &format!("judged-{i}.csv"), &changes, &[])?;
        }
        for (kind, (name, lacking)) in KINDS.iter().enumerate() {
            let out = calibration(kind);
            for part in PARTS {
                // The force sensors would show the matrix alone its lag behind a load cell's log.
                let by_cell = [CELL, SIX_AXES].contains(name);
                let lacking = if by_cell && part == "matrix" { &["bridge_"] } else { *lacking };
                if by_cell || part == PARTS[0] {
                    self.fitted(name, lacking, &out)?;
                }
                let judged = self.judged(&out, part)?;
                let force = |axis| 1e3 * rms(&judged[..2], axis, true);
                let place = |of| rms(of, "x_mm", false).hypot(rms(of, "y_mm", false));
                let (middle, pad) = (place(&judged[..2]), place(&judged[2..]));
                let [fx, fy, fz] = ["fx_n", "fy_n", "fz_n"].map(force);
                writeln!(text, "\"{name}\",{part},{fx:.2},{fy:.2},{fz:.2},{middle:.4},{pad:.4}")?;
            }
            eprintln!("{name}: fitted and judged");
        }
        Ok(text)
    }

    /// Fits the finger from its recordings without the columns that these begin with.
    fn fitted(&self, labels: &str, lacking: &[&str], out: &str) -> Result<()> {
        let (by_cell, axes) = match labels {
            SIX_AXES => (true, "6"),
            _ => (labels == CELL, "3"),
        };
        let mut words = ["calibrate", "fit", "--force", "--out", out].map(str::to_owned).to_vec();
        for (scene, seed) in SCENES {
            let (whole, cell) = (format!("{scene}.csv"), format!("{scene}-cell.csv"));
            let more = ["--force", "--cell", &cell, "--cell-axes", axes];
            let more = if by_cell { &more[..] } else { &more[..1] };
            self.simulate(scene, seed, &whole, &[], more)?;
            let text = without(&std::fs::read_to_string(self.path(&whole))?, lacking)?;
            std::fs::write(self.path(&whole), text)?;
            words.extend(["--data".to_owned(), whole]);
            if by_cell {
                words.extend(["--reference".to_owned(), cell]);
            }
        }
        if labels == SIX_AXES {
            words.extend(["--cell-at", "0,0,25"].map(str::to_owned));
        }
        self.taxel(&words.iter().map(String::as_str).collect::<Vec<_>>()).map(|_| ())
    }

    /// Errors on each judged recording, and the number of its rows in contact.
    fn judged(&self, calibration: &str, part: &str) -> Result<Vec<(Value, f64)>> {
        let judge = |i: usize| {
            let file = format!("judged-{i}.csv");
            let mut words = vec!["calibrate", "evaluate", "--json", "--data", &file];
            words.extend(["--calibration", calibration]);
            words.extend(if part == "matrix" { &["--only", "matrix"][..] } else { &[] });
            let found = serde_json::from_slice(&self.taxel(&words)?)?;
            let truth = measure::columns(&self.path(&file))?;
            let touched = truth["fz_n"].iter().filter(|n| n.is_some_and(|n| n >= 0.1)).count();
            Ok((found, touched as f64))
        };
        (0..JUDGED.len()).map(judge).collect()
    }

    /// Measures a data sheet's figures with the first calibration.
    fn figures(&self) -> Result<String> {
        let mut text = "figure,part,value,unit\n".to_owned();
        for part in PARTS {
            let mut put = |figure: &str, value: f64, unit: &str| {
                writeln!(text, "{figure},{part},{value:.4},{unit}")
            };
            let hold = self.run("hold", &press(4000, 3.5, 1.0, [0.1, 3.0, 0.1]), part)?;
            for (column, unit, scale) in [
                ("fx_n", "mN", 1e3),
                ("fy_n", "mN", 1e3),
                ("fz_n", "mN", 1e3),
                ("x_mm", "µm", 1e3),
                ("y_mm", "µm", 1e3),
            ] {
                put(&format!("sigma {column}"), scale * hold.sigma(column, [2.0, 3.0])?, unit)?;
            }
            let touch = self.run("touch", &press(1000, 4.0, 0.2, [2.0, 0.5, 0.5]), part)?;
            put("detection threshold", 1e3 * touch.threshold()?, "mN")?;
            let step = self.run("step", &press(4000, 1.8, 1.0, [0.001, 1.3, 0.1]), part)?;
            let end_n = step.force([1.3, 1.5])?;
            put("settles within 10 %", 1e3 * step.settles(end_n, 0.1, 1.6)?, "ms")?;
            put("settles within 5 %", 1e3 * step.settles(end_n, 0.05, 1.6)?, "ms")?;
            put("bandwidth", 0.35 / step.rises(end_n, 1.6)?, "Hz")?;
            let cycles: String =
                [0.5, 3.0, 5.5].map(|at| contact(at, MOST_N, [1.0, 0.001, 1.0])).concat();
            let cycles = self.run("loop", &(head(1000, 8.0) + &cycles), part)?;
            let width = cycles.loop_width([5.5, 6.5], [6.501, 7.501], MOST_N)?;
            put("hysteresis", 1e2 * width / MOST_N, "% of 2 N")?;
            let held = self.run("creep", &press(250, 62.0, 1.0, [0.1, 60.5, 0.1]), part)?;
            let (early, late) = (held.force([1.5, 1.7])?, held.force([60.4, 60.6])?);
            put("creep in a minute", 1e2 * (late - early), "% of the load")?;
            put("warmed by 10 K at 0.5 N", self.warmed(0.5, part)?, "mN")?;
            put("warmed by 10 K at 1.5 N", self.warmed(1.5, part)?, "mN")?;
            eprintln!("{part}: measured");
        }
        Ok(text)
    }

    /// Largest change in mN of presses of `force_n` from the first, while the finger warms by 10 K.
    ///
    /// Nothing compensates: the calibration has no recording of warming, and no bias is taken.
    fn warmed(&self, force_n: f64, part: &str) -> Result<f64> {
        let starts = || (0..10u32).map(|i| 0.5 + 3.0 * f64::from(i));
        let presses: String = starts().map(|at| contact(at, force_n, [0.2, 0.6, 0.2])).collect();
        let warming = "[temperature]\nstart_c = 25\nend_c = 35\nfrom_s = 1\nramp_s = 29\n";
        let scene = head(250, 31.0).replace("effects = []", "effects = [\"temperature\"]");
        let run = self.run("warming", &(scene + warming + &presses), part)?;
        let held = starts().map(|at| run.force([at + 0.3, at + 0.7]));
        let held = held.collect::<Result<Vec<f64>>>()?;
        Ok(held.iter().fold(0.0, |most: f64, n| most.max(1e3 * (n - held[0]).abs())))
    }
}

/// Name of the calibration from the labels of this number.
fn calibration(kind: usize) -> String {
    format!("finger-{kind}.cal.toml")
}

/// Head of a scene: the sphere of the calibration on a device of 16 bits.
fn head(rate_hz: u32, duration_s: f64) -> String {
    format!(
        "effects = []\n[scan]\nrate_hz = {rate_hz}\nduration_s = {duration_s:.1}\n[device]\nbits = 16\n\
         [indenter]\nradius_mm = 6\n[friction]\nmu = 0.8\n"
    )
}

/// Press of a scene, between four taxels and off the middle.
fn contact(at_s: f64, force_n: f64, [rise, hold, fall]: [f64; 3]) -> String {
    format!(
        "[[press]]\nat_s = {at_s}\nx_mm = 0.6\ny_mm = -0.4\nfz_n = {force_n}\nrise_s = {rise}\n\
         hold_s = {hold}\nfall_s = {fall}\n"
    )
}

/// Scene of one press after 0.3 s.
fn press(rate_hz: u32, duration_s: f64, force_n: f64, times: [f64; 3]) -> String {
    head(rate_hz, duration_s) + &contact(0.3, force_n, times)
}

/// Removes the columns whose names begin with one of these.
fn without(trace: &str, lacking: &[&str]) -> Result<String> {
    let header = trace.lines().find(|line| !line.starts_with('#')).context("an empty trace")?;
    let kept: Vec<bool> = header
        .split(',')
        .map(|name| !lacking.iter().any(|start| name.starts_with(start)))
        .collect();
    let row = |line: &str| {
        let cells = line.split(',').zip(&kept).filter(|(_, kept)| **kept).map(|(cell, _)| cell);
        cells.collect::<Vec<_>>().join(",") + "\n"
    };
    let lines = trace.lines();
    Ok(lines
        .map(|line| if line.starts_with('#') { format!("{line}\n") } else { row(line) })
        .collect())
}

/// RMS of a target over the rows in contact, or over the rows with a value.
fn rms(judged: &[(Value, f64)], target: &str, over_contacts: bool) -> f64 {
    let (mut squares, mut rows) = (0.0, 0.0);
    for (found, contacts) in judged {
        let figure = |name: &str| found[target][name].as_f64().unwrap_or(f64::NAN);
        squares += figure("n") * figure("rmse").powi(2);
        rows += if over_contacts { *contacts } else { figure("n") };
    }
    (squares / rows).sqrt()
}

/// Simulates, fits and measures; writes both tables. With `check`, fails if one differs.
pub fn simulate(check: bool) -> Result<()> {
    let bench = Bench::new()?;
    keep(LABELS, &bench.labels()?, check)?;
    keep(FIGURES, &bench.figures()?, check)
}

fn keep(path: &str, text: &str, check: bool) -> Result<()> {
    let file = root().join(path);
    if !marks::whole(&file, text.as_bytes(), check)? || !check {
        return Ok(());
    }
    compare(path, &std::fs::read_to_string(file).unwrap_or_default(), text)
}

/// Fails with the first line that differs.
fn compare(path: &str, kept: &str, today: &str) -> Result<()> {
    let equal = kept.lines().zip(today.lines()).take_while(|(kept, today)| kept == today).count();
    let line = |text: &str| text.lines().nth(equal).map(str::to_owned);
    match (line(kept), line(today)) {
        (None, None) => Ok(()),
        (kept, today) => bail!(
            "{path}:{}: {}, but today's simulation gives {}; run `cargo xtask pages --simulate`",
            equal + 1,
            kept.unwrap_or_else(|| "no line".into()),
            today.unwrap_or_else(|| "none".into())
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_removed_by_their_beginning() {
        let trace = "# simulated=x\nt_us,s0_fx_n,fx_n,x_mm\n1,2,3,4\n";
        assert_eq!(without(trace, &["s0_", "x_mm"]).unwrap(), "# simulated=x\nt_us,fx_n\n1,3\n");
        assert!(without("# a\n", &[]).is_err());
    }

    #[test]
    fn stale_table_is_named_with_its_line() {
        assert!(compare("a.csv", "a,1\nb,2\n", "a,1\nb,2\n").is_ok());
        let error = |kept, today| compare("a.csv", kept, today).unwrap_err().to_string();
        let remedy = "run `cargo xtask pages --simulate`";
        assert_eq!(
            error("a,1\nb,2\n", "a,1\nb,3\n"),
            format!("a.csv:2: b,2, but today's simulation gives b,3; {remedy}")
        );
        assert_eq!(
            error("a,1\nb,2\n", "a,1\n"),
            format!("a.csv:2: b,2, but today's simulation gives none; {remedy}")
        );
    }

    #[test]
    fn errors_of_several_recordings_are_summed() {
        let found = |rmse: f64, n: u32| serde_json::json!({ "fz_n": { "rmse": rmse, "n": n } });
        let judged = [(found(0.01, 400), 100.0), (found(0.02, 100), 100.0)];
        let squares = 400.0 * 0.01f64.powi(2) + 100.0 * 0.02f64.powi(2);
        assert!((rms(&judged, "fz_n", true) - (squares / 200.0).sqrt()).abs() < 1e-12);
        assert!((rms(&judged, "fz_n", false) - (squares / 500.0).sqrt()).abs() < 1e-12);
    }
}

//! `taxel calibrate fit`.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use taxel_fit::LeftOut;
use taxel_fit::align::Alignment;
use taxel_fit::finger::{self, FitOptions, Part, Subject};
use taxel_fit::model::Family;
use taxel_fit::network::{NetOptions, Progress};
use taxel_fit::recording::Recording;
use taxel_fit::table::{self, TableOptions, TableRecording};
use taxel_formats::stretch::Stretch;
use taxel_formats::{calibration, table as formats, trace};

use super::words;
use crate::interrupt::Interrupt;
use crate::output;

/// Fits a calibration to recordings.
///
/// A taxel trace is recognised by its header. What to fit is found from the recordings: where the load is
/// on one MEMS sensor alone, its matrix S and offset b by least squares; else the net from the 16 taxels
/// to the force by Levenberg–Marquardt. Any other CSV is fitted with --inputs and --targets. Ctrl-C keeps
/// the best net so far.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A recording, or a stretch of it in seconds; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]", required = true)]
    data: Vec<Stretch>,
    /// Calibration to write.
    #[arg(long, value_name = "CAL.toml")]
    out: PathBuf,
    /// Input columns of any CSV; `*` stands for any text.
    #[arg(long, value_name = "PATTERN", value_delimiter = ',', requires = "targets")]
    inputs: Vec<String>,
    /// Reference columns of any CSV.
    #[arg(long, value_name = "NAME", value_delimiter = ',', requires = "inputs")]
    targets: Vec<String>,
    /// Reference that another clock logged, one for each --data, with a time column t_s or t_us: offset and
    /// rate are found from the load that both saw. Its columns are --targets, or fx_n, fy_n, fz_n.
    #[arg(long, value_name = "FILE")]
    reference: Vec<PathBuf>,
    /// Fit this MEMS sensor from force on it alone, whatever the recordings look like.
    #[arg(long, value_name = "0…3", value_parser = clap::value_parser!(u8).range(0..4), conflicts_with_all = ["inputs", "hidden"])]
    sensor: Option<u8>,
    /// Family of the model: auto (what does best on stretches left out), mlp (one hidden layer of tanh
    /// units), skip (the same with a linear path past them), ridge (linear, with a decay), least-squares
    /// (linear); of any CSV also cubic (additive) and quadratic (with products), and the papers' own laws:
    /// row (002, the line of four), feeler (000), column (001), gap (signal to displacement).
    #[arg(long, value_name = "NAME", default_value_t = Family::default())]
    model: Family,
    /// Hidden tanh units [default: 12 for normal force alone, else 16; found by --model auto].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    hidden: Option<u8>,
    /// Fit the net alone, as 002 does: no model of the skin and no array of sensors, which need the columns
    /// of the contact point.
    #[arg(long)]
    net_only: bool,
    /// Seed of the net's starting weights.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Serial number of the finger, kept in the record.
    #[arg(long, default_value = "", value_parser = serial)]
    serial: heapless::String<32>,
    /// Print the outcome as JSON.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel calibrate fit --data presses.csv --data shear.csv@0..30 --out finger.toml
  taxel calibrate fit --data bench.csv@0..6 --out s0.toml
  taxel calibrate fit --data press.csv --inputs 'm*' --targets force_n --model auto --out skin.toml";

fn serial(text: &str) -> Result<heapless::String<32>, String> {
    text.try_into().map_err(|_| "at most 32 bytes fit the record".to_owned())
}

/// What a fit brought, as JSON.
#[derive(Serialize)]
struct Outcome {
    calibration: PathBuf,
    parts: Vec<Fit>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    alignments: Vec<Aligned>,
    warnings: Vec<String>,
    interrupted: bool,
}

/// Where a reference's time lies: t′ = offset + (1 + rate)·t.
#[derive(Serialize)]
struct Aligned {
    reference: PathBuf,
    offset_s: f64,
    rate: f64,
    residual_s: f64,
    correlation: f64,
}

impl Aligned {
    fn new(reference: &Path, found: Alignment) -> Self {
        let Alignment { offset, rate, residual, correlation } = found;
        let reference = reference.to_owned();
        Self { reference, offset_s: offset, rate, residual_s: residual, correlation }
    }

    fn describe(&self) -> String {
        format!(
            "{}: clock {:+.4} s, {:+.3} % fast, within {:.1} ms; correlation {:.4}",
            self.reference.display(),
            self.offset_s,
            1e2 * self.rate,
            1e3 * self.residual_s,
            self.correlation
        )
    }
}

/// One thing that was fitted.
#[derive(Serialize)]
struct Fit {
    part: String,
    rows: usize,
    left_out: usize,
    residual: Vec<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    condition: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    chosen: Option<Chosen>,
}

/// How a model was chosen, errors in the targets' units.
#[derive(Serialize)]
struct Chosen {
    left_out: &'static str,
    line: Vec<f64>,
    bent: Vec<f64>,
    apart: Vec<f64>,
    hidden: usize,
}

impl From<taxel_fit::Chosen> for Chosen {
    fn from(chosen: taxel_fit::Chosen) -> Self {
        let left_out = match chosen.left_out {
            LeftOut::Recordings => "recordings",
            LeftOut::Stretches => "stretches",
        };
        let taxel_fit::Chosen { line, bent, apart, hidden, .. } = chosen;
        Self { left_out, line, bent, apart, hidden }
    }
}

impl Chosen {
    fn describe(&self) -> String {
        let milli = |errors: &[f64]| {
            errors.iter().map(|e| format!("{:.2}", e * 1e3)).collect::<Vec<_>>().join(" ")
        };
        let line = milli(&self.line);
        let mut text = format!("  on {} left out: straight line {line} mN", self.left_out);
        if !self.bent.is_empty() {
            text += &format!(", bent {} mN", milli(&self.bent));
        }
        if !self.apart.is_empty() {
            text += &format!("; {} units, {} mN from it", self.hidden, milli(&self.apart));
        }
        text
    }
}

impl Fit {
    fn new(part: Part) -> Self {
        Self {
            part: part.name,
            rows: part.rows,
            left_out: part.faulty,
            residual: part.residual,
            condition: part.condition,
            chosen: part.chosen.map(Chosen::from),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A file is wrong, or the recordings do not make a calibration.
pub fn run(args: Args) -> anyhow::Result<()> {
    output::keep(args.data.iter().map(|data| data.path.as_path()), &args.out)?;
    let interrupt = Interrupt::watch()?;
    let bar = ProgressBar::new(0);
    bar.set_style(ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}")?);
    let mut progress = |progress: Progress| {
        bar.set_length(progress.of as u64);
        bar.set_position(progress.step as u64);
        bar.set_message(format!("{}: error {:.4}", progress.part, progress.error));
    };
    anyhow::ensure!(
        args.reference.is_empty() || args.reference.len() == args.data.len(),
        "{} --reference for {} --data; give one for each",
        args.reference.len(),
        args.data.len()
    );
    let mut alignments = Vec::new();
    let (parts, warnings) = if args.inputs.is_empty() {
        fit_finger(&args, &mut alignments, &mut progress, &interrupt)?
    } else {
        fit_table(&args, &mut alignments, &mut progress, &interrupt)?
    };
    bar.finish_and_clear();
    report(
        Outcome {
            calibration: args.out,
            parts: parts.into_iter().map(Fit::new).collect(),
            alignments,
            warnings,
            interrupted: interrupt.came(),
        },
        args.json,
    )
}

type Fitted = anyhow::Result<(Vec<Part>, Vec<String>)>;

fn fit_finger(
    args: &Args,
    alignments: &mut Vec<Aligned>,
    progress: &mut dyn FnMut(Progress),
    stop: &Interrupt,
) -> Fitted {
    for data in &args.data {
        anyhow::ensure!(
            trace::is_trace(&data.path)?,
            "{}:1: not a taxel trace; name the columns of other files with --inputs and --targets",
            data.path.display()
        );
    }
    let mut recordings = args.data.iter().map(Recording::read).collect::<Result<Vec<_>, _>>()?;
    for (recording, path) in recordings.iter_mut().zip(&args.reference) {
        let reference = formats::read(&Stretch::whole(path), &["f*_n"])?;
        alignments.push(Aligned::new(path, recording.align(&reference)?));
    }
    let options = FitOptions {
        subject: args.sensor.map_or(Subject::Found, |sensor| Subject::Sensor(sensor.into())),
        family: args.model,
        hidden: args.hidden.map(usize::from),
        net: NetOptions { seed: args.seed, ..NetOptions::default() },
        net_only: args.net_only,
        serial: args.serial.clone(),
        date: super::now(),
        ..FitOptions::default()
    };
    let fitted = finger::fit(&recordings, &options, progress, stop.flag())?;
    calibration::write(&args.out, &fitted.calibration)?;
    Ok((fitted.parts, fitted.warnings))
}

fn fit_table(
    args: &Args,
    alignments: &mut Vec<Aligned>,
    progress: &mut dyn FnMut(Progress),
    stop: &Interrupt,
) -> Fitted {
    let (inputs, targets) = (words(&args.inputs), words(&args.targets));
    let mut recordings = Vec::new();
    for (i, data) in args.data.iter().enumerate() {
        recordings.push(match args.reference.get(i) {
            None => TableRecording::read(data, &inputs, &targets)?,
            Some(path) => {
                let reference = formats::read(&Stretch::whole(path), &targets)?;
                let (recording, found) =
                    TableRecording::aligned(formats::read(data, &inputs)?, reference)?;
                alignments.push(Aligned::new(path, found));
                recording
            }
        });
    }
    let options = TableOptions {
        family: args.model,
        hidden: args.hidden.map(usize::from),
        net: NetOptions { seed: args.seed, ..NetOptions::default() },
    };
    let fitted = table::fit(&recordings, &options, progress, stop.flag())?;
    calibration::write_table(&args.out, &fitted.model)?;
    let part = Part {
        name: fitted.name,
        rows: fitted.rows,
        faulty: 0,
        condition: None,
        chosen: fitted.chosen,
        effective: Some(fitted.effective),
        residual: fitted.model.residual.iter().map(|r| f64::from(*r)).collect(),
    };
    Ok((vec![part], fitted.warnings))
}

fn report(outcome: Outcome, json: bool) -> anyhow::Result<()> {
    for warning in &outcome.warnings {
        output::note(format_args!("taxel: warning: {warning}"));
    }
    if outcome.interrupted {
        output::note(format_args!("taxel: stopped early: the best net so far was kept"));
    }
    if json {
        return output::json(&outcome);
    }
    for aligned in &outcome.alignments {
        output::line(aligned.describe())?;
    }
    for fit in &outcome.parts {
        let residual: Vec<String> =
            fit.residual.iter().map(|r| format!("{:.2}", r * 1e3)).collect();
        output::line(format!(
            "{}: {} rows, RMS error of the fit {} mN",
            fit.part,
            fit.rows,
            residual.join(" ")
        ))?;
        if let Some(chosen) = &fit.chosen {
            output::line(chosen.describe())?;
        }
    }
    output::line(format!("wrote {}", outcome.calibration.display()))
}

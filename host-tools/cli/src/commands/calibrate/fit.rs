//! `taxel calibrate fit`.

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use taxel_fit::LeftOut;
use taxel_fit::finger::{self, FitOptions, Part, Subject};
use taxel_fit::model::Family;
use taxel_fit::network::{NetOptions, Progress};
use taxel_fit::recording::Recording;
use taxel_fit::table::{self, TableOptions, TableRecording};
use taxel_formats::stretch::Stretch;
use taxel_formats::{calibration, trace};

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
    /// Fit this MEMS sensor from force on it alone, whatever the recordings look like.
    #[arg(long, value_name = "0…3", value_parser = clap::value_parser!(u8).range(0..4), conflicts_with_all = ["inputs", "hidden"])]
    sensor: Option<u8>,
    /// Family of the model: auto (what does best on stretches left out), mlp (one hidden layer of tanh
    /// units), skip (the same with a linear path past them), ridge (linear); of any CSV also cubic
    /// (additive) and quadratic (with products).
    #[arg(long, value_name = "NAME", default_value_t = Family::default())]
    model: Family,
    /// Hidden tanh units [default: 12 for normal force alone, else 16; found by --model auto].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    hidden: Option<u8>,
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
    warnings: Vec<String>,
    interrupted: bool,
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
    let (parts, warnings) = if args.inputs.is_empty() {
        fit_finger(&args, &mut progress, &interrupt)?
    } else {
        fit_table(&args, &mut progress, &interrupt)?
    };
    bar.finish_and_clear();
    report(
        Outcome {
            calibration: args.out,
            parts: parts.into_iter().map(Fit::new).collect(),
            warnings,
            interrupted: interrupt.came(),
        },
        args.json,
    )
}

type Fitted = anyhow::Result<(Vec<Part>, Vec<String>)>;

fn fit_finger(args: &Args, progress: &mut dyn FnMut(Progress), stop: &Interrupt) -> Fitted {
    for data in &args.data {
        anyhow::ensure!(
            trace::is_trace(&data.path)?,
            "{}:1: not a taxel trace; name the columns of other files with --inputs and --targets",
            data.path.display()
        );
    }
    let recordings = args.data.iter().map(Recording::read).collect::<Result<Vec<_>, _>>()?;
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let options = FitOptions {
        subject: args.sensor.map_or(Subject::Found, |sensor| Subject::Sensor(sensor.into())),
        family: args.model,
        hidden: args.hidden.map(usize::from),
        net: NetOptions { seed: args.seed, ..NetOptions::default() },
        serial: args.serial.clone(),
        date: since_epoch.as_secs(),
        ..FitOptions::default()
    };
    let fitted = finger::fit(&recordings, &options, progress, stop.flag())?;
    calibration::write(&args.out, &fitted.calibration)?;
    Ok((fitted.parts, fitted.warnings))
}

fn fit_table(args: &Args, progress: &mut dyn FnMut(Progress), stop: &Interrupt) -> Fitted {
    let (inputs, targets) = (words(&args.inputs), words(&args.targets));
    let recordings = args
        .data
        .iter()
        .map(|data| TableRecording::read(data, &inputs, &targets))
        .collect::<Result<Vec<_>, _>>()?;
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

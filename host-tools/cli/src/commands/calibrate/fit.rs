//! `taxel calibrate fit`.

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use serde::Serialize;
use taxel::condition::LagCompensation;
use taxel_calibrate::Form;
use taxel_calibrate::coverage::Coverage;
use taxel_calibrate::finger::{self, Channel, FitOptions, Fitted, Part, Subject};
use taxel_files::calibration;
use taxel_files::stretch::Stretch;
use taxel_regress::LeftOut;
use taxel_regress::error::FitError;
use taxel_regress::model::Family;
use taxel_regress::network::{NetOptions, Progress};
use taxel_regress::table::{self, TableOptions};

use super::data::{self, Aligned};
use crate::commands::simulate::seed;
use crate::interrupt::{DEADLINE, Interrupt};
use crate::output::{self, Overwrite};

/// Time after Ctrl-C in which the current stage may end by itself.
const PATIENCE: Duration = Duration::from_millis(350);
const _: () = assert!(
    2 * PATIENCE.as_millis() <= DEADLINE.as_millis(),
    "the best record is kept before the process ends"
);

/// Fits a calibration to recordings.
///
/// The recordings decide what is fitted. Codes and the force on the finger give the net from the
/// 16 taxels to the force, a model of the skin, which gives the contact point as well, and the
/// matrix of the force sensors as one array. A load on one force sensor alone gives its matrix S
/// and offset b. Any other CSV is fitted with --inputs and --targets. Ctrl-C keeps the best so far.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A recording, or a stretch of it in seconds; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]", required = true)]
    data: Vec<Stretch>,
    /// Calibration to write.
    #[arg(long, value_name = "CAL.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Input columns of any CSV; `*` stands for any text.
    #[arg(long, value_name = "PATTERN", value_delimiter = ',', requires = "targets")]
    inputs: Vec<String>,
    /// Reference columns of any CSV.
    #[arg(long, value_name = "NAME", value_delimiter = ',', requires = "inputs")]
    targets: Vec<String>,
    /// Reference that another clock logged, one for each --data, with a time column t_s or t_us.
    /// Offset and rate of its clock are found from the load in both. Its columns are --targets, or
    /// fx_n, fy_n, fz_n.
    #[arg(long, value_name = "FILE", group = "references")]
    reference: Vec<PathBuf>,
    #[command(flatten)]
    cell: data::Cell,
    /// Fit this MEMS sensor from force on it alone, whatever the recordings contain.
    #[arg(long, value_name = "0…3", value_parser = clap::value_parser!(u8).range(0..4), conflicts_with_all = ["inputs", "hidden"])]
    sensor: Option<u8>,
    /// Family of the model: auto (the best on stretches left out; for a finger model of the skin,
    /// net and array), mlp (one hidden layer of tanh
    /// units), skip (mlp with a linear path past the units), ridge (linear, with a decay),
    /// least-squares (linear). For any CSV also cubic (additive), quadratic (with products), and
    /// the papers' own laws: row ([DeMaria2011], the line of four), feeler ([Ohka2005]), column
    /// ([Ohka2004]), gap (signal to displacement).
    #[arg(long, value_name = "NAME", default_value_t = Family::Auto)]
    model: Family,
    /// Standard deviation of the reference's forces, at least that where nothing is touched
    /// [default: that].
    #[arg(long, value_name = "NEWTONS", value_parser = noise, conflicts_with = "inputs")]
    reference_noise: Option<f64>,
    /// Hidden tanh units [default: the best on recordings left out, if there are three or more;
    /// else 12 for normal force alone, 16 with shear; found by --model auto].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    hidden: Option<u8>,
    /// Keep only the net, as [DeMaria2011] does. The record then has no model of the skin and no
    /// array of sensors.
    #[arg(long)]
    net_only: bool,
    /// Number format of the net in the record: f32, or q15 (16 bits: less time on a Cortex-M4; the
    /// report states the loss of accuracy).
    #[arg(long, value_enum, default_value_t = NetForm::F32)]
    form: NetForm,
    /// Seed of the net's starting weights.
    #[arg(long, default_value_t = 0, value_parser = seed)]
    seed: u64,
    /// Serial number of the finger or sensor, kept in the record.
    #[arg(long, default_value = "", value_parser = serial)]
    serial: heapless::String<32>,
    /// Print the outcome as JSON.
    #[arg(long)]
    json: bool,
}

/// [`Form`] as a command-line value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum NetForm {
    F32,
    Q15,
}

impl From<NetForm> for Form {
    fn from(form: NetForm) -> Self {
        match form {
            NetForm::F32 => Self::F32,
            NetForm::Q15 => Self::Q15,
        }
    }
}

const EXAMPLES: &str = "\
Examples:
  taxel calibrate fit --data presses.csv --reference cell.csv --out finger.toml
  taxel calibrate fit --data presses.csv --data shear.csv@0..30 --out finger.toml
  taxel calibrate fit --data bench.csv@0..6 --out s0.toml
  taxel calibrate fit --data press.csv --inputs 'm*' --targets force_n --model auto --out skin.toml";

fn noise(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(newtons) if (0.0..10.0).contains(&newtons) => Ok(newtons),
        _ => Err("expected newtons, as in 0.006 for 6 mN".into()),
    }
}

fn serial(text: &str) -> Result<heapless::String<32>, String> {
    text.try_into().map_err(|_| "at most 32 bytes fit the record".to_owned())
}

/// Result of a fit, as JSON.
#[derive(Serialize)]
struct Outcome {
    calibration: PathBuf,
    parts: Vec<Fit>,
    #[serde(skip_serializing_if = "Option::is_none")]
    coverage: Option<Coverage>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    choices: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    channels: Vec<Channel>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    alignments: Vec<Aligned>,
    warnings: Vec<String>,
    interrupted: bool,
}

impl Outcome {
    fn new(args: &Args, parts: Vec<Part>, alignments: Vec<Aligned>, warnings: Vec<String>) -> Self {
        let calibration = args.out.clone();
        // With --reference, --targets may name columns of a finger's force.
        let targets: &[String] = if args.inputs.is_empty() { &[] } else { &args.targets };
        let parts = parts.into_iter().map(|part| Fit::new(part, targets)).collect();
        let (choices, channels) = (Vec::new(), Vec::new());
        Self {
            calibration,
            parts,
            coverage: None,
            choices,
            channels,
            alignments,
            warnings,
            interrupted: false,
        }
    }
}

/// Part of a calibration that was fitted.
#[derive(Serialize)]
struct Fit {
    part: String,
    /// Targets of a table's model, whose names carry the units. Empty for a finger's parts, which
    /// estimate forces.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    targets: Vec<String>,
    rows: usize,
    left_out: usize,
    residual: Vec<f64>,
    held_out: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    condition: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    chosen: Option<Chosen>,
}

/// Comparison of models, with errors in the targets' units.
#[derive(Serialize)]
struct Chosen {
    left_out: &'static str,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    widths: Vec<Width>,
    line: Vec<f64>,
    bent: Vec<f64>,
    apart: Vec<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    skin: Vec<f64>,
    hidden: usize,
}

/// Errors of one width of the net on the held-out recordings.
#[derive(Serialize)]
struct Width {
    hidden: usize,
    error: Vec<f64>,
}

impl From<taxel_regress::Tried> for Width {
    fn from(taxel_regress::Tried { hidden, error }: taxel_regress::Tried) -> Self {
        Self { hidden, error }
    }
}

impl From<taxel_regress::Chosen> for Chosen {
    fn from(chosen: taxel_regress::Chosen) -> Self {
        let left_out = match chosen.left_out {
            LeftOut::Recordings => "recordings",
            LeftOut::Stretches => "stretches",
        };
        let taxel_regress::Chosen { line, bent, apart, skin, hidden, widths, .. } = chosen;
        let widths = widths.into_iter().map(Width::from).collect();
        Self { left_out, widths, line, bent, apart, skin, hidden }
    }
}

impl Chosen {
    fn describe(&self, format_errors: impl Fn(&[f64]) -> String) -> String {
        if !self.widths.is_empty() {
            let each = self
                .widths
                .iter()
                .map(|w| format!("{} units {}", w.hidden, format_errors(&w.error)));
            return format!(
                "  on {} left out: {}",
                self.left_out,
                each.collect::<Vec<_>>().join("; ")
            );
        }
        let line = format_errors(&self.line);
        let mut text = format!("  on {} left out: straight line {line}", self.left_out);
        if !self.bent.is_empty() {
            text += &format!("; bent {}", format_errors(&self.bent));
        }
        if !self.apart.is_empty() {
            text += &format!("; {} units, from it {}", self.hidden, format_errors(&self.apart));
        }
        if !self.skin.is_empty() {
            let (units, skin) = (self.hidden, format_errors(&self.skin));
            text += &format!("; {units} units, taught by the model of the skin, {skin}");
        }
        text
    }
}

impl Fit {
    fn new(part: Part, targets: &[String]) -> Self {
        Self {
            part: part.name,
            targets: targets.to_vec(),
            rows: part.rows,
            left_out: part.left_out,
            residual: part.residual,
            held_out: part.held_out,
            condition: part.condition,
            chosen: part.chosen.map(Chosen::from),
        }
    }

    /// Formats one error per target: in millinewtons, or each column with its own.
    fn format_errors(&self, errors: &[f64]) -> String {
        if self.targets.is_empty() {
            let milli: Vec<String> = errors.iter().map(|e| format!("{:.2}", e * 1e3)).collect();
            return format!("{} mN", milli.join(" "));
        }
        let each = self.targets.iter().zip(errors).map(|(name, e)| format!("{name} {e:.4}"));
        each.collect::<Vec<_>>().join(", ")
    }
}

/// Runs the command.
///
/// A file is invalid, or the recordings do not suffice for a calibration.
pub fn run(args: Args) -> anyhow::Result<()> {
    let data = args.data.iter().map(|data| data.path.as_path());
    output::keep(
        data.chain(args.reference.iter().map(PathBuf::as_path)),
        &args.out,
        args.overwrite,
    )?;
    let interrupt = Interrupt::watch()?;
    // A stage that does not end in time ends with the process, before there is a record.
    interrupt.outcome("; nothing was written");
    let bar = super::bar("reading the recordings")?;
    let best = Mutex::new(None);
    let (send, receive) = mpsc::channel();
    let mut outcome = thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let send = send;
            let mut progress = |progress| drop(send.send(progress));
            if args.inputs.is_empty() {
                // On a terminal only: elsewhere a refused fit prints one line.
                let show = |coverage: &Coverage| bar.println(coverage.to_string());
                fit_finger(&args, &best, &show, &mut progress, &interrupt)
            } else {
                fit_table(&args, &mut progress, &interrupt)
            }
        });
        let mut since = None;
        loop {
            match receive.recv_timeout(Duration::from_millis(50)) {
                Ok(Progress { part, step, of, error }) => {
                    bar.set_length(of as u64);
                    bar.set_position(step as u64);
                    bar.set_message(format!("{part}: error {error:.4}"));
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            // A table's net ends after each of its steps, which are short.
            if interrupt.came()
                && args.inputs.is_empty()
                && since.get_or_insert_with(Instant::now).elapsed() > PATIENCE
            {
                // The stage does not end at once: it ends with the process. The earlier ones are
                // kept.
                interrupt.finishing();
                bar.finish_and_clear();
                let best = best.lock().ok().and_then(|mut best| best.take());
                let kept = best.ok_or_else(|| FitError::Stopped.into()).and_then(|best| {
                    let outcome = finish(&args, best, Vec::new())?;
                    report(Outcome { interrupted: true, ..outcome }, args.json, false)
                });
                if let Err(error) = &kept {
                    output::note(format_args!("taxel: {error}"));
                }
                std::process::exit(kept.is_err().into());
            }
        }
        let ended = worker.join();
        ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })?;
    outcome.interrupted = interrupt.came();
    let unseen = bar.is_hidden();
    bar.finish_and_clear();
    report(outcome, args.json, unseen)
}

/// Writes a finger's calibration.
fn finish(args: &Args, fitted: Fitted, alignments: Vec<Aligned>) -> anyhow::Result<Outcome> {
    calibration::write(&args.out, &fitted.calibration)?;
    let mut channels = fitted.channels;
    channels.extend(data::other_reference_columns(&alignments));
    let outcome = Outcome::new(args, fitted.parts, alignments, fitted.warnings);
    Ok(Outcome { channels, choices: fitted.choices, ..outcome })
}

fn fit_finger(
    args: &Args,
    best: &Mutex<Option<Fitted>>,
    show: &dyn Fn(&Coverage),
    progress: &mut dyn FnMut(Progress),
    stop: &Interrupt,
) -> anyhow::Result<Outcome> {
    // A lag is looked for where it is compensated.
    let lag = (args.net_only || args.sensor.is_some()).then(LagCompensation::default);
    let data::Read { recordings, alignments } =
        data::traces(&args.data, (&args.reference, args.cell), lag)?;
    let matrix = recordings
        .iter()
        .flat_map(|recording| &recording.samples)
        .any(|sample| sample.scan.codes.taxels.is_some());
    let coverage = if matrix && args.sensor.is_none() { Coverage::of(&recordings) } else { None };
    if let Some(coverage) = coverage.as_ref().filter(|_| !args.json) {
        show(coverage);
    }
    let options = FitOptions {
        subject: args.sensor.map_or(Subject::Found, |sensor| Subject::Sensor(sensor.into())),
        family: args.model,
        hidden: args.hidden.map(usize::from),
        net: NetOptions { seed: args.seed, ..NetOptions::default() },
        net_only: args.net_only,
        reference_noise: args.reference_noise,
        clock_hides_lag: alignments.iter().any(Aligned::hides_lag),
        form: args.form.into(),
        serial: args.serial.clone(),
        date: super::now(),
        ..FitOptions::default()
    };
    let mut keep = |fitted: &Fitted| {
        if let Ok(mut best) = best.lock() {
            *best = Some(fitted.clone());
        }
    };
    let fitted = finger::fit_keeping(&recordings, &options, progress, &mut keep, stop.flag())?;
    stop.finishing();
    Ok(Outcome { coverage, ..finish(args, fitted, alignments)? })
}

fn fit_table(
    args: &Args,
    progress: &mut dyn FnMut(Progress),
    stop: &Interrupt,
) -> anyhow::Result<Outcome> {
    anyhow::ensure!(
        args.form == NetForm::F32,
        "--form q15: 16 bits are for the 16 taxels of a finger, whose firmware runs them; a table's model (--inputs) \
         is kept in f32: leave --form out"
    );
    let data::Read { recordings, alignments } =
        data::tables(&args.data, &args.reference, &args.inputs, &args.targets)?;
    let options = TableOptions {
        family: args.model,
        hidden: args.hidden.map(usize::from),
        net: NetOptions { seed: args.seed, ..NetOptions::default() },
    };
    let mut fitted = table::fit(&recordings, &options, progress, stop.flag())?;
    fitted.model.serial = args.serial.as_str().to_owned();
    fitted.model.date = super::now();
    stop.finishing();
    calibration::write_table(&args.out, &fitted.model)?;
    let part = Part {
        name: fitted.model.shape(),
        rows: fitted.rows,
        left_out: fitted.left_out,
        condition: fitted.condition,
        chosen: fitted.chosen,
        effective: Some(fitted.effective),
        residual: fitted.model.residual.iter().map(|r| f64::from(*r)).collect(),
        held_out: false,
    };
    Ok(Outcome::new(args, vec![part], alignments, fitted.warnings))
}

/// Prints the outcome, and the coverage if nobody has seen it before the fit.
fn report(outcome: Outcome, json: bool, unseen: bool) -> anyhow::Result<()> {
    for warning in &outcome.warnings {
        output::note(format_args!("taxel: warning: {warning}"));
    }
    if outcome.interrupted {
        output::note(format_args!("taxel: stopped early: the best net so far was kept"));
    }
    if json {
        return output::json(&outcome);
    }
    if let Some(coverage) = outcome.coverage.as_ref().filter(|_| unseen) {
        output::line(coverage)?;
    }
    for aligned in &outcome.alignments {
        output::line(aligned.describe())?;
    }
    for fit in &outcome.parts {
        let (residual, rows) = (fit.format_errors(&fit.residual), fit.rows);
        let condition =
            fit.condition.map_or_else(String::new, |c| format!("; condition number {c:.1}"));
        let of = if fit.held_out { "on rows left out" } else { "of the fit" };
        output::line(format!("{}: {rows} rows, RMS error {of} {residual}{condition}", fit.part))?;
        if let Some(chosen) = &fit.chosen {
            output::line(chosen.describe(|errors| fit.format_errors(errors)))?;
        }
    }
    for choice in &outcome.choices {
        output::line(choice)?;
    }
    print_channels(&outcome.channels)?;
    output::line(format!("wrote {}", outcome.calibration.display()))
}

/// Prints the table of the recorded channels: used for what, or not and why.
fn print_channels(channels: &[Channel]) -> anyhow::Result<()> {
    let width = channels.iter().map(|channel| channel.columns.len()).max().unwrap_or(0);
    for Channel { columns, used, why } in channels {
        let verdict = if used.is_empty() {
            format!("not used: {why}")
        } else {
            format!("used: {}", used.join(", "))
        };
        output::line(format!("{columns:width$}  {verdict}"))?;
    }
    Ok(())
}

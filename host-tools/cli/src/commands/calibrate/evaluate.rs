//! `taxel calibrate evaluate`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;
use taxel_calibrate::evaluate::{self, Only};
use taxel_files::calibration::{self, Kind};
use taxel_files::stretch::Stretch;
use taxel_regress::metrics::TargetMetrics;
use taxel_regress::table::{self, TableModel, TableRecording};

use super::data;
use crate::output;

/// Evaluates a calibration on recordings that it was not fitted to.
///
/// Every reference column is compared with the finger's estimate, computed by the same code as on
/// the chip. Error is estimate − reference; bias is its mean, sigma its standard deviation, max the
/// largest absolute error, and "beyond" the share of the values that are off by more than three of
/// the standard deviations that they state. Rows without an estimate are counted by reason.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A recording, or a stretch of it in seconds; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]", required = true)]
    data: Vec<Stretch>,
    /// Reference that another clock logged, one for each --data, as for `calibrate fit`.
    #[arg(long, value_name = "FILE", group = "references")]
    reference: Vec<PathBuf>,
    #[command(flatten)]
    cell: data::Cell,
    /// Evaluate one part of a finger, as if it had only that.
    #[arg(long, value_enum, value_name = "PART")]
    only: Option<PartName>,
    /// Calibration to evaluate.
    #[arg(long, value_name = "CAL.toml")]
    calibration: PathBuf,
    /// Print one JSON object with an entry per target: rmse, sigma, max, bias, n, withheld,
    /// and within_1_sigma and beyond_3_sigma where the finger states its error. With several
    /// --data it has such an object for each file.
    #[arg(long)]
    json: bool,
}

/// [`Only`] as a command-line value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum PartName {
    Matrix,
    Array,
}

impl From<PartName> for Only {
    fn from(part: PartName) -> Self {
        match part {
            PartName::Matrix => Self::Matrix,
            PartName::Array => Self::Array,
        }
    }
}

const EXAMPLES: &str = "\
Examples:
  taxel calibrate evaluate --data unseen.csv --calibration finger.toml
  taxel calibrate evaluate --data shear.csv@30.. --calibration finger.toml --json";

/// Figures of a target; `None` if no row could be compared.
#[derive(Serialize)]
struct Figures<'m> {
    rmse: Option<f64>,
    sigma: Option<f64>,
    max: Option<f64>,
    bias: Option<f64>,
    n: usize,
    /// Shares of the values off by at most one and by more than three of the standard deviations
    /// that they state.
    #[serde(skip_serializing_if = "Option::is_none")]
    within_1_sigma: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    beyond_3_sigma: Option<f64>,
    withheld: &'m BTreeMap<String, usize>,
}

impl<'m> Figures<'m> {
    fn new(metrics: &'m TargetMetrics) -> Self {
        let figures = metrics.figures.as_ref();
        Self {
            rmse: figures.map(|f| f.rmse),
            sigma: figures.map(|f| f.sigma),
            max: figures.map(|f| f.max),
            bias: figures.map(|f| f.bias),
            n: figures.map_or(0, |f| f.n),
            within_1_sigma: metrics.within,
            beyond_3_sigma: metrics.beyond,
            withheld: &metrics.withheld,
        }
    }
}

/// Runs the command.
///
/// A file is invalid, or calibration and recording do not match.
pub fn run(args: Args) -> anyhow::Result<()> {
    let judged: Vec<(String, Vec<TargetMetrics>)> = match calibration::kind(&args.calibration)? {
        Kind::Finger => {
            let calibration = calibration::read(&args.calibration)?;
            let only = args.only.map_or(Only::Both, Only::from);
            let read = data::traces(&args.data, (&args.reference, args.cell), calibration.lag)?;
            read.note();
            let judge = |recording| {
                let (calibration, recording) = only.of(&calibration, recording);
                let metrics = evaluate::finger(&calibration, &recording);
                (recording.name, metrics)
            };
            read.recordings.iter().map(judge).collect()
        }
        Kind::Table => {
            anyhow::ensure!(
                args.only.is_none(),
                "--only: {} is a table's model, which has no parts: leave --only out",
                args.calibration.display()
            );
            let model: TableModel = calibration::read_table(&args.calibration)?;
            let read = data::tables(&args.data, &args.reference, &model.inputs, &model.targets)?;
            read.note();
            let judge = |recording: &TableRecording| {
                let evaluation = table::evaluate(&model, recording)?;
                if evaluation.beyond_range > 0 {
                    output::note(format_args!(
                        "taxel: warning: {} rows have inputs beyond the trained range",
                        evaluation.beyond_range
                    ));
                }
                Ok((recording.name(), evaluation.targets))
            };
            read.recordings.iter().map(judge).collect::<anyhow::Result<_>>()?
        }
    };
    for note in data::simulated(&args.data)? {
        output::note(format_args!("taxel: {note}"));
    }
    for (name, metrics) in &judged {
        anyhow::ensure!(
            metrics.iter().any(|m| m.figures.is_some() || !m.withheld.is_empty()),
            "{name}: nothing to judge; the recording needs reference columns (fx_n fy_n fz_n x_mm y_mm) of \
             something that the calibration estimates"
        );
    }
    if let [(_, metrics)] = &judged[..] {
        return print(metrics, args.json);
    }
    if args.json {
        let files: BTreeMap<&str, _> =
            judged.iter().map(|(name, metrics)| (name.as_str(), targets(metrics))).collect();
        return output::json(&files);
    }
    for (name, metrics) in &judged {
        output::line(format!("{name}:"))?;
        print(metrics, false)?;
    }
    Ok(())
}

fn targets(metrics: &[TargetMetrics]) -> BTreeMap<&str, Figures<'_>> {
    metrics.iter().map(|m| (m.target.as_str(), Figures::new(m))).collect()
}

fn print(metrics: &[TargetMetrics], json: bool) -> anyhow::Result<()> {
    if json {
        return output::json(&targets(metrics));
    }
    output::line(format!(
        "{:<12} {:>10} {:>10} {:>10} {:>10} {:>8} {:>8}  withheld",
        "target", "rmse", "sigma", "max", "bias", "n", "beyond"
    ))?;
    for metrics in metrics {
        let figures = Figures::new(metrics);
        let cell = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.5}"));
        let withheld: Vec<String> =
            metrics.withheld.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
        output::line(format!(
            "{:<12} {:>10} {:>10} {:>10} {:>10} {:>8} {:>8}  {}",
            metrics.target,
            cell(figures.rmse),
            cell(figures.sigma),
            cell(figures.max),
            cell(figures.bias),
            figures.n,
            figures.beyond_3_sigma.map_or("-".to_owned(), |b| format!("{:.1} %", 100.0 * b)),
            withheld.join(", ")
        ))?;
    }
    Ok(())
}

//! `taxel calibrate evaluate`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;
use taxel_calibrate::evaluate;
use taxel_files::calibration::{self, Kind};
use taxel_files::stretch::Stretch;
use taxel_regress::metrics::TargetMetrics;
use taxel_regress::table::{self, TableModel};

use super::data;
use crate::output;

/// Evaluates a calibration on a recording that it was not fitted to.
///
/// Every reference column is compared with the finger's estimate, computed by the same code as on
/// the chip. Error is estimate − reference; bias is its mean, sigma its standard deviation, max the
/// largest absolute error. Rows without an estimate are counted by reason.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The recording, or a stretch of it in seconds.
    #[arg(long, value_name = "FILE[@FROM..TO]")]
    data: Stretch,
    /// Reference that another clock logged, as for `calibrate fit`.
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,
    /// Calibration to evaluate.
    #[arg(long, value_name = "CAL.toml")]
    calibration: PathBuf,
    /// Print one JSON object with an entry per target: rmse, sigma, max, bias, n, withheld.
    #[arg(long)]
    json: bool,
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
            withheld: &metrics.withheld,
        }
    }
}

/// Runs the command.
///
/// A file is invalid, or calibration and recording do not match.
pub fn run(args: Args) -> anyhow::Result<()> {
    let (stretch, reference) = (std::slice::from_ref(&args.data), args.reference.as_slice());
    let metrics = match calibration::kind(&args.calibration)? {
        Kind::Finger => {
            let calibration = calibration::read(&args.calibration)?;
            let read = data::traces(stretch, reference)?;
            read.note();
            read.recordings.iter().flat_map(|r| evaluate::finger(&calibration, r)).collect()
        }
        Kind::Table => {
            let model: TableModel = calibration::read_table(&args.calibration)?;
            let read = data::tables(stretch, reference, &model.inputs, &model.targets)?;
            read.note();
            let mut metrics = Vec::new();
            for recording in &read.recordings {
                let evaluation = table::evaluate(&model, recording)?;
                if evaluation.beyond_range > 0 {
                    output::note(format_args!(
                        "taxel: warning: {} rows have inputs beyond the trained range",
                        evaluation.beyond_range
                    ));
                }
                metrics.extend(evaluation.targets);
            }
            metrics
        }
    };
    anyhow::ensure!(
        metrics.iter().any(|m| m.figures.is_some() || !m.withheld.is_empty()),
        "{}: nothing to judge; the recording needs reference columns (fx_n fy_n fz_n x_mm y_mm) of \
         something that the calibration estimates",
        args.data.path.display()
    );
    print(&metrics, args.json)
}

fn print(metrics: &[TargetMetrics], json: bool) -> anyhow::Result<()> {
    if json {
        let targets: BTreeMap<&str, Figures> =
            metrics.iter().map(|m| (m.target.as_str(), Figures::new(m))).collect();
        return output::json(&targets);
    }
    output::line(format!(
        "{:<12} {:>10} {:>10} {:>10} {:>10} {:>8}  withheld",
        "target", "rmse", "sigma", "max", "bias", "n"
    ))?;
    for metrics in metrics {
        let figures = Figures::new(metrics);
        let cell = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.5}"));
        let withheld: Vec<String> =
            metrics.withheld.iter().map(|(reason, n)| format!("{n} {reason}")).collect();
        output::line(format!(
            "{:<12} {:>10} {:>10} {:>10} {:>10} {:>8}  {}",
            metrics.target,
            cell(figures.rmse),
            cell(figures.sigma),
            cell(figures.max),
            cell(figures.bias),
            figures.n,
            withheld.join(", ")
        ))?;
    }
    Ok(())
}

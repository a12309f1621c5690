//! `taxel calibrate compare`.

use std::path::PathBuf;
use std::time::Duration;

use taxel_calibrate::report::drift;
use taxel_files::calibration::{self, Kind};
use taxel_files::stretch::Stretch;
use taxel_regress::table::TableModel;

use super::data;
use crate::output;

/// Shows the differences of two calibrations of one finger, or two models of one sensor.
///
/// Offsets of the force sensors are in newtons, their gains and the unloaded light of the taxels in
/// percent. For a table's model: the change of its output at the middle of the inputs' range and
/// along each input. With --data (recordings with references): the error of both.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The earlier calibration.
    #[arg(value_name = "OLD.toml")]
    first: PathBuf,
    /// The later one.
    #[arg(value_name = "NEW.toml")]
    second: PathBuf,
    /// A recording with references; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]")]
    data: Vec<Stretch>,
    /// Reference that another clock logged, one for each --data, as for `calibrate fit`.
    #[arg(long, value_name = "FILE", requires = "data", group = "references")]
    reference: Vec<PathBuf>,
    #[command(flatten)]
    cell: data::Cell,
    /// Print the same as one JSON object.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel calibrate compare finger.toml today.toml
  taxel calibrate compare finger.toml today.toml --data unseen.csv";

/// Runs the command.
///
/// A file is invalid.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let drift = match calibration::kind(&args.first)? {
        Kind::Finger => {
            let first = calibration::read(&args.first)?;
            let second = calibration::read(&args.second)?;
            let read =
                data::traces(&args.data, (&args.reference, args.cell), first.lag.or(second.lag))?;
            read.note();
            drift::compare(&first, &second, &read.recordings)
        }
        Kind::Table => {
            let first: TableModel = calibration::read_table(&args.first)?;
            let second: TableModel = calibration::read_table(&args.second)?;
            anyhow::ensure!(
                first.inputs == second.inputs && first.targets == second.targets,
                "{}: {} → {} where {} has {} → {}; compare models of the same columns",
                args.second.display(),
                second.inputs.join(", "),
                second.targets.join(", "),
                args.first.display(),
                first.inputs.join(", "),
                first.targets.join(", ")
            );
            let read = data::tables(&args.data, &args.reference, &first.inputs, &first.targets)?;
            read.note();
            drift::compare_tables(&first, &second, &read.recordings)
        }
    };
    for warning in &drift.warnings {
        output::note(format_args!("taxel: warning: {warning}"));
    }
    if args.json {
        return output::json(&drift);
    }
    let apart = humantime::format_duration(Duration::from_secs(drift.seconds.unsigned_abs()));
    let order = if drift.seconds < 0 { "before" } else { "after" };
    output::line(format!("the second was made {apart} {order} the first"))?;
    for change in &drift.changes {
        output::line(format!(
            "{:<8} {:<24} {:>+10.3} {}",
            change.part, change.what, change.by, change.unit
        ))?;
    }
    for met in &drift.met {
        output::line(format!(
            "{}: {} RMSE {:.5} → {:.5} {}",
            met.recording, met.target, met.before, met.after, met.unit
        ))?;
    }
    Ok(())
}

//! `taxel calibrate report`.

use std::path::PathBuf;
use std::time::{Duration, UNIX_EPOCH};

use humantime::format_rfc3339_seconds;
use taxel_calibrate::report::{html, judge, table};
use taxel_files::calibration::{self, Kind};
use taxel_files::stretch::Stretch;
use taxel_regress::error::FitError;
use taxel_regress::table::TableModel;

use super::data::Aligned;
use super::{bar, data, now, show};
use crate::interrupt::Interrupt;
use crate::output::{self, Overwrite};

/// Writes an HTML page on a calibration: verdict, errors over the pad, figures, plots, warnings.
///
/// The page begins with what the finger is good for, by needs that it lists. Each --data is a
/// recording that the calibration was not fitted to. Its reference columns are compared with the
/// finger's estimates, next to the papers' tables. With --fitted-to the page
/// shows the range of those recordings, and warns where they cannot support the calibration.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group(clap::ArgGroup::new("references").multiple(true).args(["reference", "fitted_reference"])))]
pub struct Args {
    /// A recording to evaluate on, or a stretch of it in seconds; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]", required = true)]
    data: Vec<Stretch>,
    /// Reference that another clock logged, one for each --data, as for `calibrate fit`.
    #[arg(long, value_name = "FILE")]
    reference: Vec<PathBuf>,
    #[command(flatten)]
    cell: data::Cell,
    /// A recording that the calibration was fitted to; may be given several times.
    #[arg(long, value_name = "FILE[@FROM..TO]")]
    fitted_to: Vec<Stretch>,
    /// Reference that another clock logged, one for each --fitted-to.
    #[arg(long, value_name = "FILE")]
    fitted_reference: Vec<PathBuf>,
    /// Calibration to report on.
    #[arg(long, value_name = "CAL.toml")]
    calibration: PathBuf,
    /// Page to write; it needs no other file and no network.
    #[arg(long, value_name = "REPORT.html")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Print the same as one JSON object.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Example:
  taxel calibrate report --data unseen.csv --fitted-to presses.csv --calibration finger.toml --out finger.html";

/// Runs the command.
///
/// A file is invalid, or a recording has no reference to compare with.
pub fn run(args: Args) -> anyhow::Result<()> {
    let inputs = args.data.iter().chain(&args.fitted_to).map(|data| data.path.as_path());
    let references = args.reference.iter().chain(&args.fitted_reference).map(PathBuf::as_path);
    output::keep(
        inputs.chain(references).chain([args.calibration.as_path()]),
        &args.out,
        args.overwrite,
    )?;
    let bar = bar("reading the recordings")?;
    // While it reads, Ctrl-C ends the process as the system does.
    let watch = || {
        let interrupt = Interrupt::watch()?;
        interrupt.outcome("; nothing was written");
        anyhow::Ok(interrupt)
    };
    let (mut report, interrupt) = match calibration::kind(&args.calibration)? {
        Kind::Finger => {
            let calibration = calibration::read(&args.calibration)?;
            let judged = data::traces(&args.data, (&args.reference, args.cell), calibration.lag)?;
            let fitted = data::traces(
                &args.fitted_to,
                (&args.fitted_reference, args.cell),
                calibration.lag,
            )?;
            judged.note();
            let hidden: Vec<bool> = judged.alignments.iter().map(Aligned::hides_lag).collect();
            let interrupt = watch()?;
            let (recordings, fitted) = (&judged.recordings, &fitted.recordings);
            let (mut progress, stop) = (|progress| show(&bar, progress), interrupt.flag());
            let report = judge(&calibration, recordings, fitted, &hidden, &mut progress, stop);
            let mut report = match report {
                Err(FitError::Stopped) => anyhow::bail!("stopped early; nothing was written"),
                report => report?,
            };
            report.channels.extend(data::other_columns(&args.data)?);
            report.channels.extend(data::other_reference_columns(&judged.alignments));
            (report, interrupt)
        }
        Kind::Table => {
            let model: TableModel = calibration::read_table(&args.calibration)?;
            let read = |stretches, references| {
                data::tables(stretches, references, &model.inputs, &model.targets)
            };
            let judged = read(&args.data, &args.reference)?;
            let fitted = read(&args.fitted_to, &args.fitted_reference)?;
            judged.note();
            let interrupt = watch()?;
            (table::judge(&model, &judged.recordings, &fitted.recordings), interrupt)
        }
    };
    for trial in &report.trials {
        anyhow::ensure!(
            !trial.figures.is_empty(),
            "{}: nothing to judge; the recording needs reference columns (fx_n fy_n fz_n x_mm y_mm) of \
             something that the calibration estimates",
            trial.recording
        );
    }
    report.simulated = data::simulated(&args.data)?;
    let date =
        |seconds| format_rfc3339_seconds(UNIX_EPOCH + Duration::from_secs(seconds)).to_string();
    let page = html::page(&report, &date(now()), &date(report.about.date));
    interrupt.finishing();
    bar.finish_and_clear();
    taxel_files::save(&args.out, page)?;
    for warning in report.warnings.iter().chain(&report.simulated) {
        output::note(format_args!("taxel: warning: {warning}"));
    }
    if args.json {
        return output::json(&report);
    }
    output::line(format!("wrote {}", args.out.display()))
}

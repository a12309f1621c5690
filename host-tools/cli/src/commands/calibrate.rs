//! `taxel calibrate`: records for, fits, evaluates, adjusts and transfers calibrations.

mod adjust;
mod compare;
mod data;
mod evaluate;
mod fit;
mod record;
mod report;
mod transfer;

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use indicatif::{ProgressBar, ProgressStyle};
use taxel_regress::network::Progress;

/// Records for, fits, evaluates, adjusts and transfers calibrations.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples, from a recorded press to a finger that says newtons:
  taxel calibrate record --out presses.mcap
  taxel calibrate fit --data presses.mcap --reference cell.csv --out finger.toml
  taxel calibrate evaluate --data unseen.csv --calibration finger.toml
  taxel calibrate upload --calibration finger.toml
  taxel calibrate adjust --data weights.csv --calibration finger.toml --out today.toml";

#[derive(clap::Subcommand)]
enum Command {
    Record(record::Args),
    Fit(fit::Args),
    Evaluate(evaluate::Args),
    Report(report::Args),
    Compare(compare::Args),
    Adjust(adjust::Args),
    Upload(transfer::UploadArgs),
    Download(transfer::DownloadArgs),
}

/// Runs the command.
///
/// The subcommand failed.
pub fn run(args: Args) -> anyhow::Result<()> {
    match args.command {
        Command::Record(args) => record::run(args),
        Command::Fit(args) => fit::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Report(args) => report::run(args),
        Command::Compare(args) => compare::run(&args),
        Command::Adjust(args) => adjust::run(args),
        Command::Upload(args) => transfer::upload(args),
        Command::Download(args) => transfer::download(args),
    }
}

/// Returns the seconds since 1970-01-01 UTC.
fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs()
}

/// Progress bar of a long command, drawn from the first second.
fn bar(message: &'static str) -> anyhow::Result<ProgressBar> {
    let bar = ProgressBar::new(0);
    bar.set_style(ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {eta}")?);
    bar.set_message(message);
    bar.enable_steady_tick(Duration::from_millis(100));
    Ok(bar)
}

/// Shows progress on a bar.
fn show(bar: &ProgressBar, Progress { part, step, of, .. }: Progress) {
    bar.set_length(of as u64);
    bar.set_position(step as u64);
    bar.set_message(part);
}

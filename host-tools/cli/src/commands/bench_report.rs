//! `taxel bench-report`.

mod judge;
mod page;

use std::path::PathBuf;

use taxel_files::bench;

use crate::output::{self, Overwrite};
use judge::Judged;

/// Writes an HTML page on a filled-in form of the bench protocol: verdict first, then every step.
///
/// The form is that of the board: docs/bench-stm32g431.csv or docs/bench-stm32f411.csv. A number is
/// compared with the limits of its step; a step without a value is not measured, and never met.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Filled-in form; docs/bench-protocol.md says how.
    #[arg(value_name = "FORM.csv")]
    form: PathBuf,
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
  taxel bench-report bench-stm32g431.csv --out bench.html";

/// Runs the command.
///
/// The form has an error, or the page cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    output::keep([args.form.as_path()], &args.out, args.overwrite)?;
    let judged = Judged::new(bench::read(&args.form)?);
    taxel_files::save(&args.out, page::page(&judged))?;
    if args.json {
        return output::json(&judged.json());
    }
    output::line(judged.verdict())?;
    output::line(format!("wrote {}", args.out.display()))
}

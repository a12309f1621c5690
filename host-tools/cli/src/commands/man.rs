//! `taxel man`: the help as manual pages.

use std::path::PathBuf;

use anyhow::Context;
use clap::CommandFactory;

use crate::output;

/// Writes a manual page for `taxel` and each of its commands.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Folder to write to; created if missing.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
}

const EXAMPLES: &str = "\
Example, after which `man taxel-record` is there:
  taxel man --out ~/.local/share/man/man1";

/// Runs the command.
///
/// # Errors
/// The folder cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let out = args.out.display();
    let write = || {
        std::fs::create_dir_all(&args.out)?;
        clap_mangen::generate_to(crate::Cli::command(), &args.out)
    };
    write().with_context(|| format!("{out}: choose a folder that you may write"))?;
    output::line(format_args!("manual pages in {out}; `man {out}/taxel.1` shows the first"))
}

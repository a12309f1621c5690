//! `taxel completions`: completion scripts for shells.

use clap::CommandFactory;
use clap_complete::Shell;

use crate::output;

/// Prints the completions for a shell.
#[derive(clap::Args)]
#[command(
    after_help = "Example: taxel completions bash > ~/.local/share/bash-completion/completions/taxel"
)]
pub struct Args {
    /// Shell.
    shell: Shell,
}

/// Runs the command.
///
/// # Errors
/// Standard output is closed.
pub fn run(args: Args) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut crate::Cli::command(), "taxel", &mut script);
    output::line(String::from_utf8_lossy(&script).trim_end())
}

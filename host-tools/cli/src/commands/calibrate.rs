//! `taxel calibrate`: from recordings to a calibration, what it is worth, and onto the finger and back.

mod evaluate;
mod fit;
mod transfer;

/// Fits, judges and transfers calibrations.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    Fit(fit::Args),
    Evaluate(evaluate::Args),
    Upload(transfer::UploadArgs),
    Download(transfer::DownloadArgs),
}

/// Runs the command.
///
/// # Errors
/// What the subcommand says.
pub fn run(args: Args) -> anyhow::Result<()> {
    match args.command {
        Command::Fit(args) => fit::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Upload(args) => transfer::upload(args),
        Command::Download(args) => transfer::download(args),
    }
}

/// Column names as the readers of tables take them.
fn words(list: &[String]) -> Vec<&str> {
    list.iter().map(String::as_str).collect()
}

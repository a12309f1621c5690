//! Research tasks that need data or programs from outside this repository.

mod ablation;
mod coverage;
mod detection;
mod effects;
mod idle;
mod peers;
mod slip;
mod specification;
mod table;

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::{Context, Result, ensure};
use clap::{Parser, Subcommand};

/// Compares calibration with its specification, and the core's net with other libraries
#[derive(Parser)]
#[command(name = "taxel-research")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Fits and judges recordings that are not in the repository; fails where a limit is missed
    Judge(specification::Judge),
    Ablation(ablation::Ablation),
    Coverage(coverage::Coverage),
    Detection(detection::Detection),
    Effects(effects::Effects),
    Idle(idle::Idle),
    Slip(slip::Slip),
    /// Counts cycles of the 16-16-3 net in other libraries into host-tools/emulator/data/peers.csv
    Peers,
}

fn main() -> ExitCode {
    let done = match Arguments::parse().task {
        Task::Judge(judge) => specification::judge(&judge),
        Task::Ablation(arguments) => ablation::run(&arguments),
        Task::Coverage(arguments) => coverage::run(&arguments),
        Task::Detection(arguments) => detection::run(&arguments),
        Task::Effects(arguments) => effects::run(&arguments),
        Task::Idle(arguments) => idle::run(&arguments),
        Task::Peers => peers::count(),
        Task::Slip(arguments) => slip::run(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("taxel-research: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Root folder of the repository.
fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).unwrap_or(here).to_owned()
}

/// Returns a command in `folder` that reads no input.
fn command(name: impl AsRef<OsStr>, folder: &Path) -> Command {
    let mut command = Command::new(name);
    command.current_dir(folder).stdin(Stdio::null());
    command
}

/// Runs a command to its end and fails unless it succeeds.
fn run(command: &mut Command) -> Result<()> {
    let name = command.get_program().to_string_lossy().into_owned();
    let status = command.status().with_context(|| format!("`{name}` does not start"))?;
    ensure!(status.success(), "`{name}` ended with {status}; its messages are above");
    Ok(())
}

/// Runs a command and returns the last line that it prints.
fn answer(command: &mut Command) -> Result<String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.stderr(Stdio::inherit()).output();
    let output = output.with_context(|| format!("`{name}` does not start"))?;
    ensure!(output.status.success(), "`{name}` ended with {}", output.status);
    let text = String::from_utf8(output.stdout)?;
    Ok(text.lines().next_back().with_context(|| format!("`{name}` prints nothing"))?.to_owned())
}

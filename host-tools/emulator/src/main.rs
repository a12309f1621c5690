//! A Cortex-M4F machine that counts: instructions exactly, cycles as modelled from the core's manual.

mod bench;
mod block;
mod clock;
mod cost;
mod isa;
mod machine;
mod profile;
mod report;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Parser, Subcommand};
use cycles::host::Inputs;
use taxel_formats::trace::TraceReader;

use crate::profile::Profiler;

/// A Cortex-M4F machine: exact instructions, modelled cycles
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// What every stage of the core costs
    Cycles(Cycles),
}

#[derive(Args)]
struct Cycles {
    /// The bench image, `boards/cycles`
    image: PathBuf,
    /// Calibration of the finger that the scans are of
    #[arg(long)]
    calibration: PathBuf,
    /// Trace CSV with a `contact` column
    #[arg(long)]
    scans: PathBuf,
    /// Only stages whose name contains this
    #[arg(long, default_value = "")]
    filter: String,
    /// Also writes the table here
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Shows which functions the cycles go to
    #[arg(long)]
    profile: bool,
    /// Fails where a stage has become dearer than in this CSV
    #[arg(long)]
    against: Option<PathBuf>,
}

fn main() -> ExitCode {
    let Arguments { task: Task::Cycles(cycles) } = Arguments::parse();
    match count(&cycles) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("taxel-emulator: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn count(arguments: &Cycles) -> Result<()> {
    let elf = read(&arguments.image)?;
    let calibration = taxel_formats::calibration::read(&arguments.calibration)?;
    let mut record = [0; taxel::calibration::MAX_BYTES];
    let record = match calibration.to_bytes(&mut record) {
        Ok(record) => record,
        Err(error) => bail!("{}: {error:?}", arguments.calibration.display()),
    };
    let [free, touched] = scans(&arguments.scans)?;
    let inputs = Inputs { record, free: &free, touched: &touched };
    let profiler = arguments.profile.then(|| Profiler::new(&arguments.image)).transpose()?;
    let wanted = |name: &str| name.contains(&arguments.filter);
    let stages = bench::run(&elf, &inputs, |stage, clock| {
        if let Some(profiler) = &profiler
            && wanted(&stage.name)
        {
            report::profile(&stage.name, &profiler.shares(stage, clock));
        }
    })?;
    let stages: Vec<_> = stages.into_iter().filter(|stage| wanted(&stage.name)).collect();
    ensure!(!stages.is_empty(), "--filter {}: no stage has that in its name", arguments.filter);
    report::table(&stages);
    if let Some(path) = &arguments.csv {
        std::fs::write(path, report::csv(&stages))
            .with_context(|| format!("{}: not written", path.display()))?;
    }
    match &arguments.against {
        Some(path) => report::compare(path, &stages),
        None => Ok(()),
    }
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| path.display().to_string())
}

/// The scans of a trace in postcard: without contact, and in contact.
fn scans(path: &Path) -> Result<[Vec<u8>; 2]> {
    let mut parts = [Vec::new(), Vec::new()];
    for sample in TraceReader::open(path)? {
        let sample = sample?;
        let Some(contact) = sample.truth.contact else {
            bail!("{}: needs a column `contact`", path.display());
        };
        parts[usize::from(contact)].extend(postcard::to_stdvec(&sample.scan)?);
    }
    ensure!(
        parts.iter().all(|part| !part.is_empty()),
        "{}: needs scans with contact and scans without",
        path.display()
    );
    Ok(parts)
}

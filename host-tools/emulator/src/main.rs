//! Counts what the core's stages cost, and runs the whole board.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Parser, Subcommand};
use cycles::host::Inputs;
use taxel_formats::trace::TraceReader;

use taxel_emulator::board::cpu::{Board, End};
use taxel_emulator::board::finger::Finger;
use taxel_emulator::board::host::Host;
use taxel_emulator::board::{capture, time};
use taxel_emulator::profile::Profiler;
use taxel_emulator::{bench, report};

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
    /// Runs the board's image
    Board(RunBoard),
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

#[derive(Args)]
struct RunBoard {
    /// The firmware, `boards/stm32g431`
    image: PathBuf,
    /// Virtual seconds
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
    /// Writes what went over the USB here, as Linux's usbmon would
    #[arg(long)]
    pcap: Option<PathBuf>,
}

/// Lets the board run with nobody at its port; says how fast that was.
fn run_board(arguments: &RunBoard) -> Result<()> {
    let elf = read(&arguments.image)?;
    let host = Host::new(arguments.pcap.is_some());
    let mut board = Board::new(&elf, Finger::new(Vec::new()), host)?;
    let start = Instant::now();
    let time = (arguments.seconds * time::HZ as f64) as time::Tick;
    if let End::Reset(cause) = board.run(time)? {
        bail!("the board reset itself: {cause:?}");
    }
    let real = start.elapsed().as_secs_f64();
    println!(
        "{:.3} virtual seconds in {real:.3}: {:.1} million instructions a second; {} frames scanned",
        time::seconds(board.now()),
        board.instructions() as f64 / real / 1e6,
        board.chip().finger.seen.len()
    );
    for (number, text) in &board.chip().host.descriptors.strings {
        println!("USB string {number}: {text}");
    }
    match (&arguments.pcap, &board.chip().host.capture) {
        (Some(path), Some(urbs)) => std::fs::write(path, capture::pcap(urbs))
            .with_context(|| format!("{}: not written", path.display())),
        _ => Ok(()),
    }
}

fn main() -> ExitCode {
    let done = match Arguments::parse().task {
        Task::Cycles(cycles) => count(&cycles),
        Task::Board(arguments) => run_board(&arguments),
    };
    match done {
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

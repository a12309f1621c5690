//! `taxel replay`: a trace through the core, on this machine or on the emulated microcontroller.

use std::path::PathBuf;

use clap::ValueEnum;
use indicatif::ProgressBar;
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::finger::Finger;
use taxel::frame::{Fields, Frame, Status};
use taxel_formats::frames::FramesWriter;
use taxel_formats::stretch::Stretch;
use taxel_formats::trace::{Sample, TraceReader};
use taxel_link::emulated;
use taxel_link::fields;

use crate::interrupt::Interrupt;
use crate::output;

/// Plays a trace through the core and writes what the finger says of it.
///
/// The frames are the same byte for byte wherever they are computed.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The trace, or a stretch of it in seconds.
    #[arg(value_name = "TRACE.csv[@FROM..TO]")]
    trace: Stretch,
    /// Calibration of the finger; without one there is no force.
    #[arg(long, value_name = "CAL.toml")]
    calibration: Option<PathBuf>,
    /// Frames to write.
    #[arg(long, value_name = "FRAMES.csv")]
    out: PathBuf,
    /// Where the core runs.
    #[arg(long, value_enum, default_value_t = Core::Host)]
    on: Core,
    /// Fields of the frames: codes, signals, sensors, force, point, estimates, all.
    #[arg(long, value_name = "LIST", default_value = "estimates", value_parser = fields::parse)]
    fields: Fields,
}

const EXAMPLES: &str = "\
Examples:
  taxel replay shear.csv@30.. --calibration finger.toml --out frames.csv
  taxel replay shear.csv --calibration finger.toml --out frames.csv --on mps2-an386";

#[derive(Clone, Copy, ValueEnum)]
enum Core {
    /// This machine.
    Host,
    /// The firmware on a Cortex-M4F under QEMU.
    #[value(name = "mps2-an386")]
    Mps2An386,
}

/// Runs the command.
///
/// # Errors
/// A file is wrong, or the emulator is missing.
pub fn run(args: Args) -> anyhow::Result<()> {
    let calibration =
        args.calibration.as_ref().map(taxel_formats::calibration::read).transpose()?;
    let interrupt = Interrupt::watch()?;
    let samples = samples(&args.trace)?;
    let mut sink =
        Sink { frames: FramesWriter::create(&args.out, args.fields)?, count: 0, withheld: 0 };
    match args.on {
        Core::Host => on_host(samples, calibration, args.fields, &mut sink, &interrupt)?,
        Core::Mps2An386 => on_board(samples, calibration, args.fields, &mut sink)?,
    }
    sink.frames.finish()?;
    output::line(format!(
        "{}: {} frames, {} of them with a force withheld{}",
        args.out.display(),
        sink.count,
        sink.withheld,
        if interrupt.came() { "; stopped early" } else { "" }
    ))
}

/// Where frames go, and what is counted of them.
struct Sink {
    frames: FramesWriter,
    count: usize,
    withheld: usize,
}

impl Sink {
    fn take(&mut self, frame: &Frame) -> Result<(), taxel_formats::FileError> {
        const WITHHOLDING: Status =
            Status(Status::SATURATED.0 | Status::DEAD_TAXEL.0 | Status::OUT_OF_RANGE.0);
        self.count += 1;
        self.withheld += usize::from(frame.status.0 & WITHHOLDING.0 != 0);
        self.frames.write(frame)
    }
}

/// The samples of a stretch, line by line.
fn samples(
    stretch: &Stretch,
) -> anyhow::Result<impl Iterator<Item = Result<Sample, taxel_formats::FileError>> + use<>> {
    let wanted = stretch.clone();
    let seconds = |sample: &Sample| sample.scan.time.0 as f64 * 1e-6;
    let ended = wanted.clone();
    Ok(TraceReader::open(&stretch.path)?
        .take_while(move |s| s.as_ref().map_or(true, |s| !ended.ended(seconds(s))))
        .filter(move |s| s.as_ref().map_or(true, |s| wanted.contains(seconds(s)))))
}

fn on_host(
    samples: impl Iterator<Item = Result<Sample, taxel_formats::FileError>>,
    calibration: Option<Calibration>,
    fields: Fields,
    sink: &mut Sink,
    interrupt: &Interrupt,
) -> anyhow::Result<()> {
    let (finger, mut state) = Finger::new(calibration);
    for (seq, sample) in (0u32..).zip(samples) {
        if interrupt.came() {
            break;
        }
        let estimate = finger.estimate(&mut state, &sample?.scan);
        sink.take(&estimate.frame(seq, fields))?;
    }
    Ok(())
}

fn on_board(
    samples: impl Iterator<Item = Result<Sample, taxel_formats::FileError>>,
    calibration: Option<Calibration>,
    fields: Fields,
    sink: &mut Sink,
) -> anyhow::Result<()> {
    let scans = samples.map(|s| s.map(|s| s.scan)).collect::<Result<Vec<_>, _>>()?;
    let mut buffer = [0; MAX_BYTES];
    let record = match &calibration {
        None => None,
        Some(calibration) => Some(
            calibration
                .to_bytes(&mut buffer)
                .map_err(|e| anyhow::anyhow!("not a record: {e:?}"))?,
        ),
    };
    let bar = ProgressBar::new(scans.len() as u64);
    let mut written = Ok(());
    let replay = emulated::replay(&scans, record, fields, |frame| {
        bar.inc(1);
        if written.is_ok() {
            written = sink.take(frame);
        }
    })?;
    bar.finish_and_clear();
    written?;
    eprintln!(
        "{}: at most {} instructions a scan",
        replay.info.identity.board,
        replay.worst_instructions()
    );
    Ok(())
}

//! `taxel replay`: a trace through the core, on this machine or on the emulated microcontroller.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::bail;
use clap::ValueEnum;
use indicatif::ProgressBar;
use taxel::calibration::Calibration;
use taxel::finger::Finger;
use taxel::frame::{Fields, Frame};
use taxel::measured::{Measured, NoValue};
use taxel::units::{FullScale, Newtons};
use taxel_formats::FileError;
use taxel_formats::frames::{Cell, cells, columns};
use taxel_formats::stretch::Stretch;
use taxel_formats::trace::{Sample, cut};
use taxel_link::emulated;
use taxel_link::fields;
use taxel_recording::{Header, Recorder, Scans};

use crate::finger::record;
use crate::interrupt::Interrupt;
use crate::output;

/// Plays a trace through the core and writes what the finger says of it.
///
/// The frames are the same byte for byte wherever they are computed.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The trace or recording, or a stretch of it in seconds.
    #[arg(value_name = "TRACE.csv[@FROM..TO]")]
    trace: Stretch,
    /// Calibration of the finger [default: a recording's own]; without one there is no force.
    #[arg(long, value_name = "CAL.toml")]
    calibration: Option<PathBuf>,
    /// Frames to write: .csv, .mcap or .parquet.
    #[arg(long, value_name = "FRAMES.csv")]
    out: PathBuf,
    /// Where the core runs.
    #[arg(long, value_enum, default_value_t = Core::Host)]
    on: Core,
    /// Fields of the frames: codes, signals, sensors, force, point, slip, torsion, contacts,
    /// estimates, all.
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
    let inputs = [args.trace.path.as_path()].into_iter().chain(args.calibration.as_deref());
    output::keep(inputs, &args.out)?;
    let calibration =
        args.calibration.as_ref().map(taxel_formats::calibration::read).transpose()?;
    let interrupt = Interrupt::watch()?;
    let scans = Scans::open(&args.trace.path)?;
    let calibration = calibration.or(scans.calibration);
    let mut samples = cut(scans.samples, &args.trace).peekable();
    let full_scale = match samples.peek() {
        Some(Ok(sample)) => sample.scan.codes.full_scale,
        Some(Err(error)) => return Err(error.clone().into()),
        None => bail!("{}: no scans; check the stretch FILE@FROM..TO", args.trace.path.display()),
    };
    // As in a trace, 12 bits go without saying.
    let scaled = full_scale != FullScale::BITS_12 && args.fields.contains(Fields::CODES);
    let header = match scaled {
        true => Header::default().with("full_scale", full_scale.top().0),
        false => Header::default(),
    };
    let uncalibrated = calibration.is_none();
    let frames = Recorder::create(&args.out, &header, &columns(args.fields))?;
    let mut sink = Sink { frames, fields: args.fields, row: Vec::new(), count: 0, withheld: 0 };
    match args.on {
        Core::Host => on_host(samples, calibration, args.fields, &mut sink, &interrupt)?,
        Core::Mps2An386 => on_board(samples, calibration, args.fields, &mut sink, &interrupt)?,
    }
    sink.frames.finish()?;
    output::line(format!(
        "{}: {} frames, {}{}",
        args.out.display(),
        sink.count,
        if uncalibrated {
            "without forces: give a --calibration".to_owned()
        } else {
            format!("{} of them with a force withheld", sink.withheld)
        },
        if interrupt.came() { "; stopped early" } else { "" }
    ))
}

/// Where frames go, and what is counted of them.
struct Sink {
    frames: Recorder,
    fields: Fields,
    row: Vec<Cell>,
    count: usize,
    withheld: usize,
}

impl Sink {
    fn take(&mut self, frame: &Frame) -> Result<(), FileError> {
        let mut forces = frame.sensors.iter().flatten().chain(&frame.force);
        self.count += 1;
        self.withheld += usize::from(forces.any(|force| withheld(force.z)));
        self.row.clear();
        cells(frame, self.fields, &mut self.row);
        self.frames.write(&self.row)
    }
}

/// The finger could measure it, but not now.
fn withheld(force: Measured<Newtons>) -> bool {
    match force {
        Ok(_) => false,
        Err(NoValue::Uncalibrated | NoValue::Absent | NoValue::NotEstimated) => false,
        Err(_) => true,
    }
}

fn on_host(
    samples: impl Iterator<Item = Result<Sample, FileError>>,
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
    samples: impl Iterator<Item = Result<Sample, FileError>>,
    calibration: Option<Calibration>,
    fields: Fields,
    sink: &mut Sink,
    interrupt: &Interrupt,
) -> anyhow::Result<()> {
    let scans = samples.map(|s| s.map(|s| s.scan)).collect::<Result<Vec<_>, _>>()?;
    let record = calibration.as_ref().map(record).transpose()?;
    let bar = ProgressBar::new(scans.len() as u64);
    let mut written = Ok(());
    let replay = emulated::replay(&scans, record.as_deref(), fields, |frame| {
        bar.inc(1);
        written = sink.take(frame);
        if written.is_err() || interrupt.came() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    bar.finish_and_clear();
    written?;
    if let Some(replay) = replay {
        output::note(format_args!(
            "{}: at most {} instructions a scan, {} bytes of stack",
            replay.info.identity.board,
            replay.worst_instructions(),
            replay.stack.map_or("unknown".to_owned(), |stack| stack.to_string())
        ));
    }
    Ok(())
}

//! `taxel replay`: computes a trace's frames, on this machine or on an emulated board.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::{anyhow, bail};
use clap::ValueEnum;
use indicatif::ProgressBar;
use taxel::calibration::Calibration;
use taxel::finger::{Estimate, Finger, FingerState, Wanted};
use taxel::frame::schema::FIELD_NAMES;
use taxel::frame::{Fields, Frame};
use taxel::measured::{Measured, NoValue};
use taxel::units::{FullScale, Newtons};
use taxel_client::fields;
use taxel_files::calibration::{self, date, record_crc};
use taxel_files::frames::{Cell, cells, columns};
use taxel_files::recording::{Existing, Header, Recorder, Scans};
use taxel_files::stretch::Stretch;
use taxel_files::trace::{Sample, cut};
use taxel_files::{FileError, Pending};

use crate::emulated::{Board, Replay, Settings};
use crate::finger::record;
use crate::interrupt::Interrupt;
use crate::output::{self, Overwrite};

/// Plays a trace through the core and writes the frames.
///
/// The same codes give the same frames, byte for byte, on every platform. A recording is computed
/// with the settings of its finger: filter, method of the contact point, bias. On a board its own
/// firmware runs on the emulator (`cargo xtask emulator`) with the trace on its pins. Its
/// converters make their own codes, and times are the board's; with `--bits 12` the frames are this
/// machine's, byte for byte.
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
    #[command(flatten)]
    overwrite: Overwrite,
    /// Platform that runs the core.
    #[arg(long, value_enum, default_value_t = Core::Host)]
    on: Core,
    /// Reads each code again as a converter of so many bits; a board's has 12, without
    /// oversampling.
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u8).range(8..=16))]
    bits: Option<u8>,
    #[arg(long, value_name = "LIST", default_value = "estimates", value_parser = fields::parse,
          help = format!("Fields of the frames: {FIELD_NAMES}"))]
    fields: Fields,
}

const EXAMPLES: &str = "\
Examples:
  taxel replay shear.csv@30.. --calibration finger.toml --out frames.csv
  taxel replay shear.csv --calibration finger.toml --out frames.csv --on stm32g431 --fields all";

/// Bits of a board's converter.
const BOARD_BITS: u8 = 12;

/// Header key of the codes' full scale.
const FULL_SCALE: &str = "full_scale";

#[derive(Clone, Copy, ValueEnum)]
enum Core {
    /// This machine.
    Host,
    /// The product's own image on the emulator.
    #[value(name = "stm32g431")]
    Stm32G431,
    /// The Black Pill's own image on the emulator.
    #[value(name = "stm32f411")]
    Stm32F411,
}

/// Runs the command.
///
/// A file is invalid, or the emulator is missing.
pub fn run(args: Args) -> anyhow::Result<()> {
    let inputs = [args.trace.path.as_path()].into_iter().chain(args.calibration.as_deref());
    output::keep(inputs, &args.out, args.overwrite)?;
    let calibration = args.calibration.as_ref().map(calibration::read).transpose()?;
    let interrupt = Interrupt::watch()?;
    let scans = Scans::open_from(&args.trace.path, args.trace.from())?;
    scans.remarks.iter().for_each(output::note);
    let header = replayed(scans.header, &args, calibration.as_ref())?;
    let calibration = calibration.or(scans.calibration);
    let bits = args.bits.and_then(|bits| FullScale::new(u16::MAX >> (16 - bits)));
    let mut samples = cut(scans.samples, &args.trace)
        .map(|mut sample| {
            if let (Ok(Sample { scan, .. }), Some(full_scale)) = (&mut sample, bits) {
                scan.codes = scan.codes.rescaled(full_scale);
            }
            sample
        })
        .peekable();
    let full_scale = match samples.peek() {
        Some(Ok(sample)) => sample.scan.codes.full_scale,
        Some(Err(error)) => return Err(error.clone().into()),
        None => bail!("{}: no scans; check the stretch FILE@FROM..TO", args.trace.path.display()),
    };
    let uncalibrated = calibration.is_none();
    let sink = match args.on {
        Core::Host => {
            let finger = header.finger(calibration);
            on_host(samples, finger, Sink::create(&args, header, full_scale)?, &interrupt)?
        }
        Core::Stm32G431 => {
            on_board(Board::Stm32G431, samples, calibration, &args, header, &interrupt)?
        }
        Core::Stm32F411 => {
            on_board(Board::Stm32F411, samples, calibration, &args, header, &interrupt)?
        }
    };
    interrupt.finishing();
    sink.frames.finish().map_err(|error| sink.pending.named(error))?;
    sink.pending.commit()?;
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

/// Builds the header of the frames. It has the recording's facts, with the calibration and fields
/// used here.
fn replayed(
    recorded: Header,
    args: &Args,
    calibration: Option<&Calibration>,
) -> anyhow::Result<Header> {
    let header = recorded
        .with("replayed", args.trace.path.display())
        .with("fields", fields::list(args.fields));
    let header = if header.biased() && header.bias().is_none() {
        header.with("biased", false)
    } else {
        header
    };
    let (Some(calibration), Some(path)) = (calibration, &args.calibration) else {
        return Ok(header);
    };
    let crc = record_crc(calibration).map_err(|error| anyhow!("{}: {error}", path.display()))?;
    Ok(Header {
        calibration: Some(calibration::to_text(path, calibration)?),
        ..header
            .with("calibration_serial", &calibration.serial)
            .with("calibration_date", date::to_text(calibration.date))
            .with("calibration_crc", format!("{:08x}", crc))
    })
}

/// Frame writer that counts frames and missing forces.
struct Sink {
    pending: Pending,
    frames: Recorder,
    fields: Fields,
    row: Vec<Cell>,
    count: usize,
    withheld: usize,
}

impl Sink {
    fn create(args: &Args, header: Header, full_scale: FullScale) -> Result<Self, FileError> {
        // 12 bits are the default and left out, as in a trace.
        let said = full_scale != FullScale::BITS_12 || header.facts.contains_key(FULL_SCALE);
        let header = match said {
            true => header.with(FULL_SCALE, full_scale.top().0),
            false => header,
        };
        let pending = Pending::new(&args.out)?;
        let columns = columns(args.fields);
        let frames = Recorder::derived(pending.path(), &header, &columns, Existing::Replace);
        let frames = frames.map_err(|error| pending.named(error))?;
        Ok(Self { pending, frames, fields: args.fields, row: Vec::new(), count: 0, withheld: 0 })
    }

    fn take(&mut self, frame: &Frame) -> Result<(), FileError> {
        let mut forces = frame.sensors.iter().flatten().chain(&frame.force);
        self.count += 1;
        self.withheld += usize::from(forces.any(|force| withheld(force.z)));
        self.row.clear();
        cells(frame, self.fields, &mut self.row);
        self.frames.write(&self.row).map_err(|error| self.pending.named(error))
    }
}

/// Whether a force that the finger can estimate has no value in this frame.
fn withheld(force: Measured<Newtons>) -> bool {
    match force {
        Ok(_) => false,
        Err(NoValue::Uncalibrated | NoValue::Absent | NoValue::NotEstimated) => false,
        Err(_) => true,
    }
}

fn on_host(
    samples: impl Iterator<Item = Result<Sample, FileError>>,
    (finger, mut state): (Finger, FingerState),
    mut sink: Sink,
    interrupt: &Interrupt,
) -> anyhow::Result<Sink> {
    // As a board does that streams these fields: what they do not need stays off.
    let wanted = Wanted { fields: sink.fields, due: true };
    let mut estimate = Estimate::NOTHING;
    for (seq, sample) in (0u32..).zip(samples) {
        if interrupt.came() {
            break;
        }
        let scan = sample?.scan;
        finger.update(&mut estimate, &mut state, &scan, wanted);
        sink.take(&estimate.frame(&scan.codes, seq, sink.fields).into())?;
    }
    Ok(sink)
}

/// Replays on an emulated board. The full scale of the codes is known only once the board runs.
fn on_board(
    board: Board,
    samples: impl Iterator<Item = Result<Sample, FileError>>,
    calibration: Option<Calibration>,
    args: &Args,
    header: Header,
    interrupt: &Interrupt,
) -> anyhow::Result<Sink> {
    let settings = settings(&header, args)?;
    let scans = samples.map(|s| s.map(|s| s.scan)).collect::<Result<Vec<_>, _>>()?;
    let record = calibration.as_ref().map(record).transpose()?;
    let bar = ProgressBar::new(scans.len() as u64);
    let replay = Replay::prepare(board, &scans, record.as_deref(), &settings)?;
    let mut sink = Sink::create(args, header, replay.full_scale())?;
    let mut written = Ok(());
    replay.run(|frame| {
        bar.inc(1);
        taken(sink.take(frame), &mut written, interrupt)
    })?;
    bar.finish_and_clear();
    written?;
    Ok(sink)
}

/// Returns the settings for an emulated board. A bias taken on command is an error, because a board
/// averages its bias from its own scans only.
fn settings(header: &Header, args: &Args) -> anyhow::Result<Settings> {
    if header.bias().is_some() {
        bail!(
            "{}: recorded with a bias taken on command, which a board cannot be given; replay it `--on host`",
            args.trace.path.display()
        );
    }
    if let Some(bits) = args.bits.filter(|bits| *bits != BOARD_BITS) {
        bail!("--bits {bits}: a board's converter has 12 bits; give `--bits {BOARD_BITS}`");
    }
    let (filter_hz, point_method) = (header.filter_hz(), header.point_method());
    Ok(Settings { fields: args.fields, filter_hz, point_method, single: args.bits.is_some() })
}

/// Keeps the write's result; breaks if it failed or after an interrupt.
fn taken(
    result: Result<(), FileError>,
    written: &mut Result<(), FileError>,
    interrupt: &Interrupt,
) -> ControlFlow<()> {
    *written = result;
    if written.is_err() || interrupt.came() {
        ControlFlow::Break(())
    } else {
        ControlFlow::Continue(())
    }
}

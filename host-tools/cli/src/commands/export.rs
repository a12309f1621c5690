//! `taxel export`: converts a recording to another file format.

use std::path::{Path, PathBuf};

use anyhow::bail;
use indicatif::ProgressBar;
use taxel_files::frames::Cell;
use taxel_files::recording::{Existing, Recorder, Recording};
use taxel_files::stretch::Stretch;
use taxel_files::{FileError, Pending};

use crate::interrupt::Interrupt;
use crate::output::{self, Overwrite, waiting};

/// Converts a recording, or a stretch of it, to another format; recovers a damaged one.
///
/// File names select the format: .mcap, .parquet or .csv. CSV keeps neither the calibration nor the
/// reasons for missing values.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The recording, or a stretch of it in seconds of device time.
    #[arg(value_name = "FRAMES.mcap[@FROM..TO]")]
    recording: Stretch,
    /// File to write.
    #[arg(long, value_name = "FRAMES.parquet")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

const EXAMPLES: &str = "\
Examples:
  taxel export press.mcap --out press.parquet
  taxel export press.mcap@12..15 --out cut.csv
  taxel export cut-short.mcap --out whole.mcap";

/// Runs the command.
///
/// The file is no recording, or damaged, or the output cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    let path = &args.recording.path;
    output::keep([path.as_path()], &args.out, args.overwrite)?;
    let interrupt = Interrupt::watch()?;
    let mut recording = Recording::open_from(path, args.recording.from())?;
    if !recording.whole {
        output::note(recording.cut_short(path));
    }
    // Begun at the first frame, so that an export without frames keeps an existing file.
    let mut out = None;
    let time = recording.position("t_us");
    let bar = ProgressBar::new_spinner();
    let (mut count, mut damage, mut times) = (0, None::<FileError>, None);
    while !interrupt.came() {
        let row = match recording.next() {
            None => break,
            Some(Ok(row)) => row,
            Some(Err(error)) => {
                damage.get_or_insert(error);
                continue;
            }
        };
        let seconds = match time.and_then(|at| row.get(at)) {
            Some(Cell::Whole(micros)) => Stretch::seconds(*micros),
            _ => f64::NEG_INFINITY,
        };
        times = Some((times.map_or(seconds, |(first, _)| first), seconds));
        if args.recording.ended(seconds) {
            break;
        }
        if args.recording.contains(seconds) {
            if out.is_none() {
                out = Some(begin(&args.out, &recording)?);
            }
            if let Some((pending, frames)) = &mut out {
                frames.write(&row).map_err(|error| pending.named(error))?;
            }
            count += 1;
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    if let Some((pending, frames)) = out {
        interrupt.finishing();
        let finish = || frames.finish().map_err(|error| pending.named(error));
        waiting(format!("writing {}", args.out.display()), finish)?;
        pending.commit()?;
    } else if !interrupt.came() {
        let read = times.map(|(first, last)| {
            format!("the frames read have times from {first:.3} s to {last:.3} s")
        });
        bail!(match (damage, read) {
            (None, None) => FileError::new(path, "no frame in it"),
            (None, Some(read)) => FileError::new(path, "no frame within this stretch").mend(read),
            (Some(error), None) => error.mend("no frame of it can be read: record again"),
            (Some(error), Some(read)) => {
                error.mend(format!("no frame within this stretch: {read}"))
            }
        });
    }
    let out = args.out.display();
    match damage {
        Some(error) => {
            bail!(error.mend(format!("{out} has the {count} frames that could be read")))
        }
        None if interrupt.came() => {
            output::line(format_args!("{out}: {count} frames; stopped early"))
        }
        None => output::line(format_args!("{out}: {count} frames")),
    }
}

/// Begins the file, which has its name only when it is whole.
fn begin(out: &Path, recording: &Recording) -> Result<(Pending, Recorder), FileError> {
    let pending = Pending::new(out)?;
    let (header, columns) = (&recording.header, &recording.columns);
    let frames = Recorder::derived(pending.path(), header, columns, Existing::Replace);
    let frames = frames.map_err(|error| pending.named(error))?;
    Ok((pending, frames))
}

//! `taxel calibrate record`.

use std::io::IsTerminal;
use std::ops::ControlFlow;
use std::path::PathBuf;

use taxel::frame::Frame;
use taxel_calibrate::guide::{Guide, Known};

use crate::commands::record;
use crate::finger::{PortArg, address, checked_by_finger};
use crate::output::{self, Overwrite};
use crate::stream::Next;

/// Records presses for a calibration, and tells what to press next until they are enough.
///
/// Begins with a second without a touch. Then a map of the pad shows where it was pressed lightly,
/// half as hard and hard (l, m, h), which way it was pushed sideways, and a sentence asks for what
/// is missing: presses in any order count. The file is that of `taxel record`, with the codes. A
/// finger without a calibration knows no newtons: strengths are relative to the hardest presses,
/// and without force sensors a push counts for the direction that was asked for. Log the load cell
/// at the same time, for `calibrate fit --reference`. Ctrl-C keeps what was recorded.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// File to write; may be given more than once.
    #[arg(long, value_name = "PRESSES.mcap", required = true)]
    out: Vec<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Frames a second [default: as the finger is set].
    #[arg(long, value_name = "HZ", value_parser = checked_by_finger)]
    rate: Option<u16>,
    /// Serve the live page at this address during the recording; prints its URL.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    page: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  taxel calibrate record --port /dev/ttyACM0 --out presses.mcap
  taxel calibrate record --port sim:presses --out presses.csv";

/// Runs the command.
///
/// As `taxel record`; or the finger has no optical matrix.
pub fn run(args: Args) -> anyhow::Result<()> {
    let Args { port, out, overwrite, rate, page } = args;
    let names = out.iter().map(|out| out.display().to_string()).collect::<Vec<_>>().join(", ");
    let new: Vec<PathBuf> = out.iter().filter(|out| !out.exists()).cloned().collect();
    let (duration, fields, hold_row) = (None, None, None);
    let record =
        record::Args { port, out, overwrite, duration, fields, rate, hold_row, page, json: false };
    // Elsewhere than on a terminal each change of the step is a line of its own.
    let terminal = std::io::stderr().is_terminal();
    let mut guide: Option<Guide> = None;
    let (mut told, mut begun, mut refused) = (None, false, false);
    let recorded = record::guided(record, |info, next| {
        let second = u16::try_from(info.rate_millihertz / 1000).unwrap_or(u16::MAX);
        let guide = guide.get_or_insert_with(|| Guide::new(second));
        match next {
            Next::Frame(received) => {
                let codes = received.frame.codes.filter(|codes| codes.taxels.is_some());
                let Some(codes) = codes else {
                    refused = !begun;
                    anyhow::bail!(
                        "{names}: the frames have no codes of the optical matrix, which shows where \
                         it is pressed; use `taxel record`"
                    );
                };
                begun = true;
                guide.add(received.frame.time, &codes, known(&received.frame));
            }
            Next::Progress(words) if terminal => {
                **words =
                    format!("{words}; Ctrl-C ends it\n  {}\n{}", guide.step(), guide.picture());
            }
            Next::Progress(_) => {}
            Next::Again(_) => guide.restart(),
        }
        if guide.is_done() {
            return Ok(ControlFlow::Break(()));
        }
        let step = (!terminal).then(|| guide.step());
        if let Some(step) = step.filter(|step| told.as_ref() != Some(step)) {
            output::note(&step);
            told = Some(step);
        }
        Ok(ControlFlow::Continue(()))
    });
    if refused {
        // The new file has no row, and a former one was not replaced. A device or a pipe stays.
        for file in new.iter().filter(|file| file.is_file()) {
            let _ = std::fs::remove_file(file);
        }
    }
    recorded?;
    let Some(guide) = guide else { return Ok(()) };
    if !guide.is_done() {
        return output::line(format_args!(
            "ended early; next: {}\n{}",
            guide.step(),
            guide.picture()
        ));
    }
    for left_out in guide.left_out() {
        output::note(format_args!("taxel: warning: not recorded: {left_out}"));
    }
    output::line(guide.picture())?;
    output::note(guide.step());
    Ok(())
}

/// Force and place of a calibrated finger; `None` without a normal force.
fn known(frame: &Frame) -> Option<Known> {
    let force = frame.force.as_ref()?;
    let newtons = |axis: taxel::measured::Measured<taxel::units::Newtons>| {
        axis.ok().map(|newtons| f64::from(newtons.0))
    };
    let [x, y] = [force.x, force.y].map(|axis| newtons(axis).unwrap_or(0.0));
    let place = frame.point.and_then(Result::ok);
    let place = place.map(|point| [point.x, point.y].map(|c| f64::from(c.0)));
    Some(Known { force: [x, y, newtons(force.z)?], place })
}

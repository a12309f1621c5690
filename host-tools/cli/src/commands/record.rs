//! `taxel record`: the stream into a file.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::bail;
use taxel::frame::Fields;
use taxel_formats::frames::FramesWriter;
use taxel_link::{Port, fields};

use crate::finger::PortArg;
use crate::interrupt::Interrupt;
use crate::{output, stream};

/// Records the stream as CSV until Ctrl-C, or for a while.
///
/// What has come is in the file within a second, whatever happens to this program.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// File to write.
    #[arg(long, value_name = "FRAMES.csv")]
    out: PathBuf,
    /// Seconds of device time to record.
    #[arg(long, value_name = "SEC", value_parser = stream::seconds)]
    duration: Option<f64>,
    /// Fields to record, with commas between: codes, signals, sensors, force, point, slip,
    /// torsion, contacts, estimates, all
    /// [default: as the finger is set].
    #[arg(long, value_name = "LIST", value_parser = fields::parse)]
    fields: Option<Fields>,
    /// Frames a second [default: as the finger is set].
    #[arg(long, value_name = "HZ")]
    rate: Option<u16>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// How often the file is brought up to date.
const FLUSH: Duration = Duration::from_millis(500);

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached or goes away, or the file cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    if let Port::File(trace) = &args.port.port {
        output::keep([trace.as_path()], &args.out)?;
    }
    let interrupt = Interrupt::watch()?;
    let client = args.port.connect()?;
    if let Some(hz) = args.rate {
        client.set_rate(hz)?;
    }
    if let Some(fields) = args.fields {
        client.set_fields(fields)?;
    }
    let mut file = FramesWriter::create(&args.out, client.info()?.fields)?;
    if args.duration.is_none() && std::io::stderr().is_terminal() {
        output::note(format_args!(
            "recording {} into {}; Ctrl-C ends it",
            client.port(),
            args.out.display()
        ));
    }
    let mut flushed = Instant::now();
    let recorded = stream::run(&client, args.duration, &interrupt, |received| {
        file.write(&received.frame)?;
        if received.at.duration_since(flushed) >= FLUSH {
            file.flush()?;
            flushed = received.at;
        }
        Ok(())
    })?;
    file.finish()?;
    let summary = recorded.summary;
    if let Some(error) = recorded.broken {
        bail!("{error}; {} has the {} frames until then", args.out.display(), summary.frames);
    }
    if args.json {
        return output::json(&summary);
    }
    output::line(format_args!(
        "{}: {} frames, {} lost, {:.1} Hz, {:.3} s",
        args.out.display(),
        summary.frames,
        summary.lost,
        summary.rate_hz,
        summary.duration_s
    ))
}

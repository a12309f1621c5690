//! `taxel record`: the stream into a file.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::bail;
use taxel::frame::Fields;
use taxel::frame::schema::FIELD_NAMES;
use taxel_client::{Port, ReconnectingClient, RoundTrips, fields};

use crate::Files;
use crate::commands::view::page;
use crate::finger::{PortArg, address};
use crate::interrupt::Interrupt;
use crate::output::{Overwrite, waiting};
use crate::stream::Next;
use crate::{output, stream};

/// Records the stream until Ctrl-C, or for a while.
///
/// The file's name tells its kind: .mcap (Foxglove opens it), .parquet (tables) or .csv. What has come is in
/// the file within a second, whatever happens to this program. Each row has the device's time and that of
/// this host; the file knows the finger, its settings and its calibration. A recording with the codes is a
/// port of its own, `file:FRAMES.mcap`, and can be computed again by `taxel replay`. A finger that goes is
/// waited for, and set as it was; the column `connection` then counts one up.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    port: PortArg,
    /// File to write; may be given more than once.
    #[arg(long, value_name = "FRAMES.mcap", required = true)]
    out: Vec<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Seconds of device time to record.
    #[arg(long, value_name = "SEC", value_parser = stream::seconds)]
    duration: Option<f64>,
    #[arg(long, value_name = "LIST", value_parser = fields::parse, help = format!(
        "Fields to record, with commas between: {FIELD_NAMES} [default: as the finger is set]"
    ))]
    fields: Option<Fields>,
    /// Frames a second [default: as the finger is set].
    #[arg(long, value_name = "HZ")]
    rate: Option<u16>,
    /// Serve the live page meanwhile, here; prints its address.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    page: Option<String>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel record --port /dev/ttyACM0 --fields all --out press.mcap
  taxel record --port sim:tour --duration 5 --out frames.csv --out frames.parquet
  taxel record --port usb --rate 4000 --fields all --out grasp.mcap --page 127.0.0.1:8173";

/// Runs the command.
///
/// # Errors
/// The finger cannot be reached or goes away, or the file cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    if let Port::File(trace) = &args.port.port {
        args.out.iter().try_for_each(|out| output::keep([trace.as_path()], out))?;
    }
    output::apart(&args.out)?;
    let interrupt = Interrupt::watch()?;
    let client = Arc::new(args.port.connect()?);
    if let Some(hz) = args.rate {
        client.set_rate(hz)?;
    }
    if let Some(fields) = args.fields {
        client.set_fields(fields)?;
    }
    let steady = Arc::new(ReconnectingClient::of(Arc::clone(&client)));
    // The page asks for the taxels, which the files then have as well.
    let page = args.page.as_deref().map(|address| page(&steady, Some(address))).transpose()?;
    page.iter().for_each(|(server, _)| output::note(server.url()));
    let serial = steady.remember(&client)?.identity.serial;
    let mut files = Files::create(&client, &args.out, args.overwrite.existing())?;
    let names: Vec<_> = args.out.iter().map(|out| out.display().to_string()).collect();
    let names = names.join(", ");
    if args.duration.is_none() && std::io::stderr().is_terminal() {
        output::note(format_args!("recording {} into {names}; Ctrl-C ends it", client.port()));
    }
    // Who asks how long a question takes has to wait for the answer, which frames must not.
    let echoes = RoundTrips::of(&steady);
    let recorded = stream::run(&steady, true, args.duration, &interrupt, |next| match next {
        Next::Frame(received) => {
            echoes.try_iter().for_each(|echo| files.echo(echo));
            page.iter().for_each(|(_, tap)| tap.take(received));
            Ok(files.write(received)?)
        }
        Next::Again(client) => {
            let other = client.info()?.identity.serial;
            if other != serial {
                bail!("{}: another finger, {other}, instead of {serial}", client.port());
            }
            files.reconnected();
            page.iter().for_each(|(_, tap)| tap.again(client));
            Ok(())
        }
    });
    let finished = waiting(format!("writing {names}"), || files.finish());
    let recorded = recorded?;
    finished?;
    let summary = recorded.summary;
    if let Some(error) = recorded.broken {
        bail!("{error}; {names} has the {} frames until then", summary.frames);
    }
    if args.json {
        return output::json(&summary);
    }
    let gaps = match summary.gaps {
        0 => String::new(),
        gaps => format!("; the finger was gone {gaps}×, {:.1} s in all", summary.gap_s),
    };
    output::line(format_args!(
        "{names}: {} frames, {} lost, {:.1} Hz, {:.3} s{gaps}",
        summary.frames, summary.lost, summary.rate_hz, summary.duration_s
    ))
}

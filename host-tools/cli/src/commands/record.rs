//! `taxel record`: writes the stream to files.

use std::io::IsTerminal;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::bail;
use taxel::frame::Fields;
use taxel::frame::schema::FIELD_NAMES;
use taxel::wire::message::Info;
use taxel_client::{Client, LinkError, Port, Problem, ReconnectingClient, RoundTrips, fields};

use crate::Files;
use crate::commands::view::page;
use crate::finger::{PortArg, address, checked_by_finger};
use crate::interrupt::Interrupt;
use crate::output::{Overwrite, waiting};
use crate::stream::Next;
use crate::{output, stream};

/// Records the stream until Ctrl-C or the end of --duration.
///
/// The file name selects the format: .mcap (Foxglove opens it), .parquet (tables) or .csv. Received
/// frames reach the file within a second, even if this program is killed. Each row has device time
/// and host time; the file holds the finger's identity, settings and calibration. By default it
/// holds the codes as well, so that it can be fitted (`taxel calibrate fit`), computed again
/// (`taxel replay`) and played as a finger (the port `file:FRAMES.mcap`). A finger that is
/// unplugged is waited for and its settings are restored; the column `connection` then counts up by
/// one.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    pub port: PortArg,
    /// File to write; may be given more than once.
    #[arg(long, value_name = "FRAMES.mcap", required = true)]
    pub out: Vec<PathBuf>,
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Seconds of device time to record.
    #[arg(long, value_name = "SEC", value_parser = stream::seconds)]
    pub duration: Option<f64>,
    #[arg(long, value_name = "LIST", value_parser = fields::parse, help = format!(
        "Fields to record, with commas between: {FIELD_NAMES} [default: as the finger is set, \
         and codes]"
    ))]
    pub fields: Option<Fields>,
    /// Frames a second [default: as the finger is set].
    #[arg(long, value_name = "HZ", value_parser = checked_by_finger)]
    pub rate: Option<u16>,
    /// Hold an LED row on in every step, to test the wiring: codes are those of this row, and there
    /// are no estimates. Ends with the recording.
    #[arg(long, value_name = "ROW", value_parser = clap::value_parser!(u8).range(0..4))]
    pub hold_row: Option<u8>,
    /// Serve the live page at this address during the recording; prints its URL.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    pub page: Option<String>,
    /// Print the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

const EXAMPLES: &str = "\
Examples:
  taxel record --port /dev/ttyACM0 --fields all --out press.mcap
  taxel record --port sim:tour --duration 5 --out frames.csv --out frames.parquet
  taxel record --port usb --rate 4000 --fields all --out grasp.mcap --page 127.0.0.1:8173
  taxel record --port usb --hold-row 2 --fields codes --duration 60 --out row2.csv";

/// Runs the command.
///
/// The finger cannot be reached or is unplugged, or the file cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    guided(args, |_, _| Ok(ControlFlow::Continue(())))
}

/// Records until `guide` breaks off, which sees every item of the stream before it is written.
///
/// As [`run`], and what `guide` reports.
pub fn guided(
    args: Args,
    mut guide: impl FnMut(&Info, &mut Next<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<()> {
    if let Port::File(trace) = &args.port.port {
        args.out.iter().try_for_each(|out| output::keep([trace.as_path()], out, args.overwrite))?;
    }
    output::apart(&args.out)?;
    let interrupt = Interrupt::watch()?;
    let client = Arc::new(args.port.connect()?);
    if let Some(hz) = args.rate {
        client.set_rate(hz)?;
    }
    let before = match args.fields {
        Some(fields) => client.set_fields(fields).map(|()| None)?,
        None => add_codes(&client)?,
    };
    if args.hold_row.is_some() {
        client.hold_row(args.hold_row)?;
    }
    let steady = Arc::new(ReconnectingClient::of(Arc::clone(&client)));
    // The page adds the taxels to the fields, so that the files have them as well.
    let page = args.page.as_deref().map(|address| page(&steady, Some(address))).transpose()?;
    page.iter().for_each(|(server, _)| output::note(server.url()));
    let info = steady.remember(&client)?;
    let mut files = Files::create(&client, &args.out, args.overwrite.existing())?;
    let names: Vec<_> = args.out.iter().map(|out| out.display().to_string()).collect();
    let names = names.join(", ");
    if args.duration.is_none() && std::io::stderr().is_terminal() {
        output::note(format_args!("recording {} into {names}; Ctrl-C ends it", client.port()));
    }
    // Measured in its own thread, because a round trip blocks until the reply and frames must not
    // wait.
    let echoes = RoundTrips::of(&steady);
    let recorded = stream::run(&steady, true, args.duration, &interrupt, |mut next| {
        let flow = guide(&info, &mut next)?;
        match &next {
            Next::Frame(received) => {
                echoes.try_iter().for_each(|echo| files.echo(echo));
                page.iter().for_each(|(_, tap)| tap.take(received));
                files.write(received)?;
            }
            Next::Again(client) => {
                let other = client.info()?.identity.serial;
                let serial = &info.identity.serial;
                if other != *serial {
                    bail!("{}: another finger, {other}, instead of {serial}", client.port());
                }
                if args.hold_row.is_some() {
                    client.hold_row(args.hold_row)?;
                }
                files.reconnected();
                page.iter().for_each(|(_, tap)| tap.again(client));
            }
            Next::Progress(_) => {}
        }
        Ok(flow)
    });
    interrupt.finishing();
    let finished = waiting(format!("writing {names}"), || files.finish());
    // A recording started from the page ends with its tap.
    let page = page.map(|(server, _)| server);
    let hold_row = args.hold_row.is_some();
    stream::leave(steady, &interrupt, move |steady| {
        drop((page, echoes, client));
        if let (Some(fields), Some(client)) = (before, steady.client()) {
            // A finger that is gone has lost them as well.
            let _ = client.set_fields(fields);
        }
        if hold_row {
            // A link without an end, such as a UART's, would leave the row on. One that broke has
            // ended.
            let _ = steady.client().map(|client| client.hold_row(None));
        }
    });
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

/// Adds the codes to the fields of a finger's frames. Returns the fields from before if they
/// differ.
fn add_codes(client: &Client) -> Result<Option<Fields>, LinkError> {
    let fields = client.info()?.fields;
    if fields.contains(Fields::CODES) {
        return Ok(None);
    }
    match client.set_fields(fields | Fields::CODES) {
        Ok(()) => Ok(Some(fields)),
        // A recording without codes is played without them.
        Err(error) if matches!(error.problem(), Some(Problem::Refusal { .. })) => Ok(None),
        Err(error) => Err(error),
    }
}

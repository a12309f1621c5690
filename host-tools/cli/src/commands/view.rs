//! `taxel view`: the live page.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use taxel_client::{Port, ReconnectingClient};
use taxel_files::calibration;

use crate::browser;
use crate::finger::{address, steady};
use crate::interrupt::Interrupt;
use crate::output;
use crate::view::{Feed, Server, Source, Tap};

/// Interval at which the loop checks whether to stop.
const LOOK: Duration = Duration::from_millis(100);

/// Shows fingers live in the browser until Ctrl-C, or a recording with a scrubber.
///
/// Prints the page's address, and opens it if there is a display. A finger that is not connected,
/// or is unplugged, is waited for; its settings are restored. For a finger on another machine:
/// `ssh -L 8173:127.0.0.1:8173 HOST taxel view --port …`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The finger: usb, usb:SERIAL, a serial device, tcp:HOST:PORT, file:PATH or sim:SCENE; may be
    /// given more than once.
    #[arg(long, value_name = "PORT", default_value = "usb")]
    port: Vec<Port>,
    /// Address of the page. One that other machines reach has a token, which the printed address
    /// contains: everyone who has it can command the finger.
    #[arg(long, value_name = "HOST:PORT", default_value = PAGE, value_parser = address)]
    listen: String,
    /// Calibration of a virtual finger, or to compute a recording's codes again with [default: a
    /// built-in scene's own; a recording's frames as recorded].
    #[arg(long, value_name = "CAL")]
    calibration: Option<PathBuf>,
    /// Serve the page without opening a browser.
    #[arg(long)]
    no_browser: bool,
    /// Folder for recordings started from the page.
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    folder: PathBuf,
}

/// Default address of the page.
const PAGE: &str = "127.0.0.1:8173";

const EXAMPLES: &str = "\
Examples:
  taxel view
  taxel view --port /dev/ttyACM0
  taxel view --port sim:tour --port sim:stick-slip
  taxel view --port file:press.mcap --listen 127.0.0.1:0";

/// Runs the command.
///
/// # Errors
/// A file cannot be read, or the address is taken.
pub fn run(args: Args) -> anyhow::Result<()> {
    let interrupt = Interrupt::watch()?;
    let mut feeds = Vec::new();
    for port in args.port {
        let source = match port {
            Port::File(path) => {
                let given = args.calibration.as_deref().map(calibration::read).transpose()?;
                Source::File(path, given.map(Box::new))
            }
            port => {
                let finger = steady(port, args.calibration.as_deref())?;
                Source::Finger(Box::new(finger), args.folder.clone())
            }
        };
        feeds.push(Feed::start(source)?);
    }
    let server = Server::start(&args.listen, feeds)?;
    output::line(server.url())?;
    if !args.no_browser {
        browser::open(&server.url());
    }
    while !interrupt.came() {
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Serves the page of a finger whose frames another command takes. Without `address`: at the
/// default address, or at a free port if that is taken.
///
/// The finger does not reply, or the address is taken.
pub fn page(
    finger: &Arc<ReconnectingClient>,
    address: Option<&str>,
) -> anyhow::Result<(Server, Tap)> {
    let feed = || Feed::tapped(finger, PathBuf::from("."));
    let (usual, tap) = feed()?;
    match (Server::start(address.unwrap_or(PAGE), vec![usual]), address) {
        (Ok(server), _) => Ok((server, tap)),
        (Err(error), Some(_)) => Err(error.into()),
        (Err(_), None) => {
            let (other, tap) = feed()?;
            Ok((Server::start("127.0.0.1:0", vec![other])?, tap))
        }
    }
}

//! `taxel serve`: a virtual finger for other programs.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use taxel_client::Port;

use crate::finger::{address, closed, scene_calibration};
use crate::interrupt::Interrupt;
use crate::output;
use crate::virtual_finger::{Outcome, Source, VirtualFinger};

/// Interval at which the loop checks whether to stop.
const LOOK: Duration = Duration::from_millis(100);

/// Serves a virtual finger for other programs to connect to, until Ctrl-C.
///
/// Prints the port, then waits. Serves one program at a time; the finger keeps its settings in
/// between.
#[derive(clap::Args)]
#[command(after_help = "Example: taxel serve --port sim:tour --tcp 127.0.0.1:5000 &
         taxel record --port tcp:127.0.0.1:5000 --duration 5 --out frames.csv")]
pub struct Args {
    /// The finger: sim:SCENE or file:TRACE.csv.
    #[arg(long, value_name = "PORT")]
    port: Port,
    /// Address of the finger; port 0 takes any free port [default: a pseudo-terminal].
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    tcp: Option<String>,
    /// Let every machine that reaches the address command the finger; there is no password.
    #[arg(long, requires = "tcp")]
    open: bool,
    /// Calibration of the finger [default: a built-in scene's own].
    #[arg(long, value_name = "CAL")]
    calibration: Option<PathBuf>,
}

/// Runs the command.
///
/// The port is not a virtual finger, the address is taken, or the trace is damaged.
pub fn run(args: Args) -> anyhow::Result<()> {
    let interrupt = Interrupt::watch()?;
    args.tcp.iter().try_for_each(|address| closed(address, args.open))?;
    let (source, scene) = match &args.port {
        Port::Sim(scene) => (Source::scene(scene)?, scene.as_str()),
        Port::File(trace) => (Source::trace(trace)?, ""),
        other => {
            bail!("{other}: already a port of its own; serve takes sim:SCENE or file:TRACE.csv")
        }
    };
    let calibration = scene_calibration(args.calibration.as_deref(), scene)?;
    let finger = match &args.tcp {
        Some(address) => VirtualFinger::on_tcp(address, source, calibration.as_ref())?,
        None => VirtualFinger::on_pty(source, calibration.as_ref())?,
    };
    output::line(finger.port())?;
    while !interrupt.came() {
        match finger.outcome() {
            Some(Outcome::Finished) => break,
            Some(Outcome::Failed(error)) => return Err(error.into()),
            None => std::thread::sleep(LOOK),
        }
    }
    Ok(())
}

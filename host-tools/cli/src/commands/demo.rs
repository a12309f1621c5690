//! `taxel demo`: a virtual finger, a real client, and the accuracy of the frames.
//!
//! The client connects to the finger as to hardware, through the operating system. Only the truth
//! does not pass through that connection.

mod emulated;
mod live;
mod score;

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;
use taxel::frame::Frame;
use taxel_client::{Client, ReconnectingClient};
use taxel_files::trace::Truth;

use crate::browser;
use crate::commands::view::page;
use crate::emulated::Board;
use crate::finger::{address, closed, scene_calibration};
use crate::interrupt::Interrupt;
use crate::stream::Next;
use crate::virtual_finger::{Source, VirtualFinger};
use crate::{output, stream};
use live::Live;
use score::{Accuracy, Score};

/// Runs a virtual finger and shows its frames in the browser and here, without hardware.
///
/// The page is always served, and opened if there is a display.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Scene: a built-in name, or the path of a TOML file.
    #[arg(long, default_value = "tour")]
    scene: String,
    /// Seconds to run [default: until Ctrl-C].
    #[arg(long, value_name = "SEC", value_parser = stream::seconds)]
    duration: Option<f64>,
    /// Show nothing until the summary: no page, no browser.
    #[arg(long)]
    headless: bool,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
    /// Calibration of the finger.
    #[arg(long, value_name = "CAL")]
    calibration: Option<PathBuf>,
    /// Put the finger behind this TCP address instead of a pseudo-terminal.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    tcp: Option<String>,
    /// Let every machine that reaches the address command the finger; there is no password.
    #[arg(long, requires = "tcp")]
    open: bool,
    /// Run a board's own firmware on the emulator instead; `cargo xtask emulator` builds both.
    #[arg(long, conflicts_with = "tcp")]
    emulated: bool,
    /// Board whose firmware runs.
    #[arg(long, requires = "emulated", value_enum, default_value_t = Board::Stm32G431)]
    board: Board,
}

const EXAMPLES: &str = "\
Examples:
  taxel demo
  taxel demo --scene stick-slip --duration 5 --headless --json
  taxel demo --emulated";

/// Finger whose true values are known.
trait Performer {
    /// Name of the finger.
    fn name(&self) -> String;
    /// Connects to the finger, as to hardware.
    fn connect(&mut self) -> anyhow::Result<Client>;
    /// Returns the true values in the scan of `frame`, if known.
    fn truth(&self, frame: &Frame) -> Option<Truth>;
}

impl Performer for VirtualFinger {
    fn name(&self) -> String {
        format!("virtual finger at {}", self.port())
    }

    fn connect(&mut self) -> anyhow::Result<Client> {
        Ok(Client::open(self.port())?)
    }

    fn truth(&self, frame: &Frame) -> Option<Truth> {
        self.truth().take(frame.time)
    }
}

/// Summary of a run, as JSON.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    stream: stream::Summary,
    /// Root mean square error per target, over the frames in contact.
    #[serde(flatten)]
    accuracy: Accuracy,
    /// Resident memory of this process in bytes, if the system reports it.
    memory_start: Option<u64>,
    memory_end: Option<u64>,
}

/// Runs the command.
///
/// The scene or the calibration is invalid, or the finger cannot be reached.
pub fn run(args: Args) -> anyhow::Result<()> {
    let interrupt = Interrupt::watch()?;
    let calibration = scene_calibration(args.calibration.as_deref(), &args.scene)?;
    if args.emulated {
        let board = emulated::OnBoard::start(args.board, &args.scene, calibration)?;
        return perform(board, &args, &interrupt);
    }
    args.tcp.iter().try_for_each(|address| closed(address, args.open))?;
    let source = Source::scene(&args.scene)?;
    let finger = match &args.tcp {
        Some(address) => VirtualFinger::on_tcp(address, source, calibration.as_ref())?,
        None if cfg!(unix) => VirtualFinger::on_pty(source, calibration.as_ref())?,
        None => VirtualFinger::on_tcp("127.0.0.1:0", source, calibration.as_ref())?,
    };
    perform(finger, &args, &interrupt)
}

fn perform(mut finger: impl Performer, args: &Args, interrupt: &Interrupt) -> anyhow::Result<()> {
    let client = Arc::new(finger.connect()?);
    let steady = Arc::new(ReconnectingClient::of(Arc::clone(&client)));
    let page = if args.headless { None } else { Some(page(&steady, None)?) };
    if let Some((server, _)) = &page {
        output::note(format_args!("{}, scene {}", finger.name(), args.scene));
        output::note(format_args!("watch it at {}", server.url()));
        browser::open(&server.url());
    }
    let mut live = Live::new(!args.headless);
    let mut score = Score::default();
    let memory_start = resident();
    let ended = stream::run(&steady, false, args.duration, interrupt, |next| {
        let Next::Frame(received) = next else { return Ok(ControlFlow::Continue(())) };
        if let Some(truth) = finger.truth(&received.frame) {
            score.add(&received.frame, &truth);
        }
        live.show(received, &client.counts());
        page.iter().for_each(|(_, tap)| tap.take(received));
        Ok(ControlFlow::Continue(()))
    })?;
    live.clear();
    let page = page.map(|(server, _)| server);
    stream::leave(steady, interrupt, |_| drop((page, client)));
    if let Some(error) = ended.broken {
        return Err(error);
    }
    let report = Report {
        stream: ended.summary,
        accuracy: score.accuracy(),
        memory_start,
        memory_end: resident(),
    };
    if args.json { output::json(&report) } else { output::line(as_text(&report)) }
}

fn as_text(report: &Report) -> String {
    let Report { stream, accuracy, .. } = report;
    let mut text = format!(
        "{:.1} s: {} frames, {} lost, {:.1} Hz",
        stream.duration_s, stream.frames, stream.lost, stream.rate_hz
    );
    for (target, rmse, compared) in accuracy.rows() {
        text += &match rmse {
            Some(rmse) => format!("\n{target:5} RMSE {rmse:.4} over {compared} frames in contact"),
            None => format!("\n{target:5} no value to compare with the truth"),
        };
    }
    if let (Some(start), Some(end)) = (report.memory_start, report.memory_end) {
        let mebibytes = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        text += &format!(
            "\nmemory {:.1} MiB at the start, {:.1} MiB at the end",
            mebibytes(start),
            mebibytes(end)
        );
    }
    text
}

fn resident() -> Option<u64> {
    memory_stats::memory_stats().map(|stats| stats.physical_mem as u64)
}

//! A finger without hardware: the firmware's own session and instrument, in a thread of this process,
//! behind a pseudo-terminal or a TCP port, in real time.
//!
//! ```text
//! Source ──samples──▶ PacedBoard ──scans──▶ run_session ◀──bytes──▶ pty / TCP
//!                         └──truth──▶ TruthLog
//! ```
//! Nothing in here knows what a frame is. A program that talks to it cannot tell it from a finger,
//! except that the truth is known.

mod board;
mod player;
#[cfg(unix)]
mod pty;
mod recorded;
mod source;
mod tcp;
mod truth;

use std::error::Error;
use std::io;
use std::net::ToSocketAddrs;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::instrument::Instrument;
use taxel::session::Board;
use taxel::wire::message::Refusal;
use taxel_files::FileError;
use tokio::sync::oneshot;
use tokio::task::{LocalSet, spawn_local};

pub use source::Source;
pub use truth::TruthLog;

use board::PacedBoard;
use player::Player;
use taxel_client::{Device, LinkError, Port, Problem};
use taxel_files::error::one_line;

/// Bytes kept for a host that reads late: some three seconds of the default stream. More would only make old
/// what it reads then.
const BACKLOG: usize = 256 * 1024;

/// End of a virtual finger that was not stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Its scans were over.
    Finished,
    /// Its trace could not be read further.
    Failed(FileError),
}

/// Set before the link closes: a client that sees the end of it finds the reason here.
type Ending = Arc<Mutex<Option<Outcome>>>;

/// A finger that lives in a thread. Dropping it pulls the cable.
pub struct VirtualFinger {
    port: Port,
    truth: TruthLog,
    outcome: Ending,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl VirtualFinger {
    /// A finger behind a pseudo-terminal: a serial device like that of a real one. One host at a time;
    /// as with any UART the finger does not notice when a host leaves.
    ///
    /// # Errors
    /// There is no such thing here, the source is empty, or the calibration is not valid.
    #[cfg(unix)]
    pub fn on_pty(source: Source, calibration: Option<&Calibration>) -> Result<Self, LinkError> {
        let open = |error: io::Error| {
            Problem::Open(one_line(&error.to_string()))
                .at(&Port::Serial("pseudo-terminal".to_owned()))
        };
        let pty = pty::Pty::open().map_err(open)?;
        let port = Port::Serial(pty.name().to_owned());
        Self::start(port, source, calibration, async move |board, instrument| {
            pty.serve(board, instrument).await
        })
    }

    /// A finger behind a pseudo-terminal, which this platform does not have.
    ///
    /// # Errors
    /// Always.
    #[cfg(not(unix))]
    pub fn on_pty(_: Source, _: Option<&Calibration>) -> Result<Self, LinkError> {
        Err(Problem::Unsupported.at(&Port::Serial("pseudo-terminal".to_owned())))
    }

    /// A finger behind a TCP port; port 0 takes any that is free. One host after the other, the
    /// settings stay.
    ///
    /// # Errors
    /// The address is taken, the source is empty, or the calibration is not valid.
    pub fn on_tcp(
        address: impl ToSocketAddrs,
        source: Source,
        calibration: Option<&Calibration>,
    ) -> Result<Self, LinkError> {
        let nowhere = Port::Tcp { host: "virtual finger".to_owned(), port: 0 };
        let listener = tcp::listen(address)
            .map_err(|error| Problem::Open(one_line(&error.to_string())).at(&nowhere))?;
        let port = match listener.local_addr() {
            Ok(address) => Port::Tcp { host: address.ip().to_string(), port: address.port() },
            Err(error) => return Err(Problem::Open(one_line(&error.to_string())).at(&nowhere)),
        };
        Self::start(port, source, calibration, async move |board, instrument| {
            tcp::serve(listener, board, instrument).await
        })
    }

    /// Plays a recording behind a TCP port: computed from its codes, or its frames as recorded.
    ///
    /// # Errors
    /// The file cannot be read, or the calibration is not valid.
    pub fn of_file(path: &Path, calibration: Option<&Calibration>) -> Result<Self, LinkError> {
        let Some(player) = Player::open(path)? else {
            return Self::on_tcp("127.0.0.1:0", Source::trace(path)?, calibration);
        };
        let here = Port::File(path.to_owned());
        let failed = |error: io::Error| Problem::Open(one_line(&error.to_string())).at(&here);
        let listener = tcp::listen("127.0.0.1:0").map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let port = Port::Tcp { host: address.ip().to_string(), port: address.port() };
        let outcome = Ending::default();
        let ending = Arc::clone(&outcome);
        let (stop, stopped) = oneshot::channel::<()>();
        let play = async move {
            tokio::select! {
                played = player.serve(listener, &ending) => played,
                _ = stopped => Ok(()),
            }
        };
        let thread = Self::thread(&here, move |runtime| runtime.block_on(play))?;
        let truth = TruthLog::default();
        Ok(Self { port, truth, outcome, stop: Some(stop), thread: Some(thread) })
    }

    /// A thread for it. A link that breaks or never was ends it: the client at its other end says so.
    fn thread(
        port: &Port,
        live: impl FnOnce(&tokio::runtime::Runtime) -> io::Result<()> + Send + 'static,
    ) -> Result<JoinHandle<()>, LinkError> {
        let run = move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
            let _ = runtime.and_then(|runtime| live(&runtime));
        };
        let thread = std::thread::Builder::new().name("virtual-finger".to_owned()).spawn(run);
        thread.map_err(|error| Problem::Open(one_line(&error.to_string())).at(port))
    }

    fn start(
        port: Port,
        source: Source,
        calibration: Option<&Calibration>,
        serve: impl AsyncFnOnce(&mut PacedBoard, &mut Instrument) -> io::Result<()> + Send + 'static,
    ) -> Result<Self, LinkError> {
        let calibration = calibration.or(source.calibration());
        let record = calibration.map(record).transpose().map_err(|problem| problem.at(&port))?;
        let truth = TruthLog::default();
        let outcome = Ending::default();
        let mut board = PacedBoard::new(source, truth.clone(), Arc::clone(&outcome))?;
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = Self::thread(&port, move |runtime| {
            // A task of its own, because only its waker stays equal to its clones: the session's pipe
            // compares them, and with the waker of `block_on` it would wake itself forever.
            let session = async move {
                let mut instrument = instrument(&mut board, record.as_deref());
                tokio::select! {
                    served = serve(&mut board, &mut instrument) => served,
                    _ = stopped => Ok(()),
                }
            };
            LocalSet::new().block_on(runtime, async { spawn_local(session).await? })
        })?;
        Ok(Self { port, truth, outcome, stop: Some(stop), thread: Some(thread) })
    }

    /// Port that the finger listens on.
    #[must_use]
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// True values of the scans.
    #[must_use]
    pub fn truth(&self) -> &TruthLog {
        &self.truth
    }

    /// End of the finger, if it ended by itself.
    #[must_use]
    pub fn outcome(&self) -> Option<Outcome> {
        self.outcome.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Device for VirtualFinger {
    fn outcome(&self) -> Option<Result<(), Box<dyn Error + Send + Sync>>> {
        self.outcome().map(|outcome| match outcome {
            Outcome::Finished => Ok(()),
            Outcome::Failed(error) => Err(error.into()),
        })
    }
}

impl Drop for VirtualFinger {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A finger that panicked has nothing more to say.
            let _ = thread.join();
        }
    }
}

fn record(calibration: &Calibration) -> Result<Vec<u8>, Problem> {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration.to_bytes(&mut buffer).map_err(refused)?;
    Ok(record.to_vec())
}

fn refused(error: taxel::calibration::CalibrationError) -> Problem {
    Problem::Refusal { command: "calibration", refusal: Refusal::Calibration(error) }
}

fn instrument(board: &mut PacedBoard, record: Option<&[u8]>) -> Instrument {
    let mut instrument = Instrument::new(board.identity());
    if let Some(record) = record {
        // It was made by `record` above, so that it installs; otherwise the frames say uncalibrated.
        let _ = instrument.install(record, board.store());
    }
    // A record ends with its CRC; without one, the bias belongs to none.
    let crc =
        record.and_then(|record| record.last_chunk()).map_or(0, |crc| u32::from_le_bytes(*crc));
    board.keep(crc);
    instrument.restore(board.store(), |_| Err(Refusal::Unsupported));
    instrument
}

/// Scans while no host is there, as a finger does.
async fn idle(board: &mut PacedBoard, instrument: &mut Instrument) {
    while let Some(scan) = board.scan().await {
        let _ = instrument.scan(&scan);
    }
}

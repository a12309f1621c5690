//! Simulated finger that runs the firmware's own session and instrument in a thread. It is reached
//! through a pseudo-terminal or a TCP port, in real time.
//!
//! ```text
//! Source ──samples──▶ PacedBoard ──scans──▶ run_session ◀──bytes──▶ pty / TCP
//!                         └──truth──▶ TruthLog
//! ```
//! No module here depends on the contents of frames. A connected program cannot distinguish the
//! virtual finger from hardware, except that the truth is known.

mod board;
mod hosts;
mod player;
#[cfg(unix)]
mod pty;
mod recorded;
mod source;
mod tcp;
mod truth;

use std::error::Error;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
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

/// Bytes buffered for a host that reads late: about 3 s of the default stream. A larger buffer
/// would only make the frames older.
const BACKLOG: usize = 256 * 1024;

/// End of a virtual finger by itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All scans were served.
    Finished,
    /// The trace could not be read further.
    Failed(FileError),
}

/// Outcome shared with the thread. Set before the link closes, so that a client that sees the end
/// finds the reason.
type Ending = Arc<Mutex<Option<Outcome>>>;

/// Virtual finger in a thread. Dropping it unplugs it.
pub struct VirtualFinger {
    port: Port,
    truth: TruthLog,
    outcome: Ending,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl VirtualFinger {
    /// Starts a finger behind a pseudo-terminal, a serial device like that of hardware. Serves one
    /// host at a time; as on any UART, the finger does not notice when a host leaves.
    ///
    /// Pseudo-terminals are unsupported here, the source is empty, or the calibration is invalid.
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

    /// Fails, because this platform has no pseudo-terminals.
    ///
    /// # Errors
    /// Always.
    #[cfg(not(unix))]
    pub fn on_pty(_: Source, _: Option<&Calibration>) -> Result<Self, LinkError> {
        Err(Problem::Unsupported.at(&Port::Serial("pseudo-terminal".to_owned())))
    }

    /// Starts a finger behind a TCP port; port 0 selects a free one. Serves one host after the
    /// other; settings stay in between.
    ///
    /// The address is taken, the source is empty, or the calibration is invalid.
    pub fn on_tcp(
        address: impl ToSocketAddrs,
        source: Source,
        calibration: Option<&Calibration>,
    ) -> Result<Self, LinkError> {
        let addresses: Vec<_> = address.to_socket_addrs().into_iter().flatten().collect();
        let named = |address: &SocketAddr| Port::Tcp {
            host: address.ip().to_string(),
            port: address.port(),
        };
        let failed = |error: io::Error| {
            let port =
                addresses.first().map_or_else(|| Port::Tcp { host: String::new(), port: 0 }, named);
            Problem::Served(one_line(&error.to_string())).at(&port)
        };
        let listener = tcp::listen(addresses.as_slice()).map_err(failed)?;
        let port = named(&listener.local_addr().map_err(failed)?);
        Self::start(port, source, calibration, async move |board, instrument| {
            tcp::serve(listener, board, instrument).await
        })
    }

    /// Plays a recording behind a TCP port: computed from its codes, or as its recorded frames.
    ///
    /// The file cannot be read, or the calibration is invalid.
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

    /// Runs `live` in a thread. A failed link ends the thread without a message, because the client
    /// at the other end reports it.
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
            // The session needs its own task, because only a task's waker equals its clones. The
            // session's pipe compares wakers, and with the waker of `block_on` would wake itself
            // endlessly.
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

    /// Outcome, if the finger ended by itself.
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
            // The panic of the thread is already on standard error.
            let _ = thread.join();
        }
    }
}

fn record(calibration: &Calibration) -> Result<Vec<u8>, Problem> {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration.to_bytes(&mut buffer).map_err(refused)?;
    calibration.rehearse().map_err(refused)?;
    Ok(record.to_vec())
}

fn refused(error: taxel::calibration::CalibrationError) -> Problem {
    Problem::Refusal { command: "calibration", refusal: Refusal::Calibration(error) }
}

fn instrument(board: &mut PacedBoard, record: Option<&[u8]>) -> Instrument {
    let mut instrument = Instrument::new(board.identity());
    if let Some(record) = record {
        // It cannot fail: `record` has checked and rehearsed the record, and a flash in memory
        // always writes.
        let _ = instrument.install(record, board.store());
    }
    // A record ends with its CRC. Without a record the bias belongs to CRC 0.
    let crc =
        record.and_then(|record| record.last_chunk()).map_or(0, |crc| u32::from_le_bytes(*crc));
    board.keep(crc);
    instrument.restore(board.store(), |_| Err(Refusal::Unsupported));
    instrument
}

/// Scans while no host is connected, as hardware does.
async fn idle(board: &mut PacedBoard, instrument: &mut Instrument) {
    while let Some(scan) = board.scan().await {
        let _ = instrument.scan(&scan);
    }
}

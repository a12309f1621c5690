//! Pseudo-terminal of a virtual finger.

use std::io;
use std::os::fd::OwnedFd;

use embedded_io_adapters::tokio_1::FromTokio;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use taxel::instrument::Instrument;
use taxel::session::{Buffers, Pace, SessionError, run_session};
use tokio::net::unix::pipe;

use super::BACKLOG;
use super::board::PacedBoard;

/// Both ends: the finger's, and the end that hosts open by name.
pub(super) struct Pty {
    finger: OwnedFd,
    /// Held open so that the pair outlives every host. Otherwise the finger would read errors while
    /// no host is connected.
    host: OwnedFd,
    name: String,
}

impl Pty {
    pub(super) fn open() -> io::Result<Self> {
        let OpenptyResult { master: finger, slave: host } = openpty(None, None)?;
        let mut mode = tcgetattr(&host)?;
        cfmakeraw(&mut mode);
        tcsetattr(&host, SetArg::TCSANOW, &mode)?;
        fcntl(&finger, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        let name = nix::unistd::ttyname(&host)?.display().to_string();
        Ok(Self { finger, host, name })
    }

    /// Path of the device.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Serves hosts until the scans end.
    pub(super) async fn serve(
        self,
        board: &mut PacedBoard,
        instrument: &mut Instrument,
    ) -> io::Result<()> {
        // The runtime treats a terminal in raw mode as two pipes, one per direction.
        let rx = pipe::Receiver::from_owned_fd_unchecked(self.finger.try_clone()?)?;
        let mut tty = pipe::Sender::from_owned_fd_unchecked(self.finger)?;
        // The kernel's worker may delay a terminal's bytes by 1 s on a busy machine, and buffers
        // only a few kilobytes.
        let (tx, mut kept) = tokio::io::duplex(BACKLOG);
        let (rx, tx) = (FromTokio::new(rx), FromTokio::new(tx));
        let mut buffers = Buffers::new();
        let (ended, sent) = tokio::join!(
            run_session(rx, tx, board, instrument, &mut buffers, Pace::Live),
            tokio::io::copy(&mut kept, &mut tty),
        );
        drop(self.host);
        sent?;
        match ended {
            Ok(_) => Ok(()),
            Err(SessionError::Read(error) | SessionError::Write(error)) => Err(error),
        }
    }
}

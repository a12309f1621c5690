//! A virtual finger's pseudo-terminal.

use std::fs::File;
use std::io::{self, Read as _, Write as _};
use std::os::fd::OwnedFd;

use embedded_io_async::{ErrorType, Read, Write};
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use taxel::instrument::Instrument;
use taxel::session::{Pace, SessionError, run_session};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

use super::board::PacedBoard;

/// Both ends: the finger's, and the one that hosts open by name.
pub(super) struct Pty {
    finger: File,
    /// Held open so that the pair outlives every host: without it the finger would read errors from
    /// the moment one leaves until the next one comes.
    host: OwnedFd,
    name: String,
}

impl Pty {
    pub(super) fn open() -> io::Result<Self> {
        let OpenptyResult { master, slave } = openpty(None, None)?;
        let mut mode = tcgetattr(&slave)?;
        cfmakeraw(&mut mode);
        tcsetattr(&slave, SetArg::TCSANOW, &mode)?;
        fcntl(&master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        let name = nix::unistd::ttyname(&slave)?.display().to_string();
        Ok(Self { finger: master.into(), host: slave, name })
    }

    /// The device's path.
    pub(super) fn name(&self) -> &str {
        &self.name
    }
}

/// Until the scans are over.
pub(super) async fn serve(
    pty: Pty,
    board: &mut PacedBoard,
    instrument: &mut Instrument,
) -> io::Result<()> {
    let Pty { finger, host, .. } = pty;
    let finger = AsyncFd::register(finger)?;
    let ended = run_session(Half(&finger), Half(&finger), board, instrument, Pace::Live).await;
    drop(host);
    match ended {
        Ok(_) => Ok(()),
        Err(SessionError::Read(error) | SessionError::Write(error)) => Err(error),
    }
}

struct Half<'f>(&'f AsyncFd<File>);

impl ErrorType for Half<'_> {
    type Error = io::Error;
}

impl Read for Half<'_> {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.async_io(Interest::READABLE, |mut file| file.read(buffer)).await
    }
}

impl Write for Half<'_> {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.async_io(Interest::WRITABLE, |mut file| file.write(bytes)).await
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

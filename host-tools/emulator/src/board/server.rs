//! TCP server of the emulated port; connecting opens the serial port.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use super::cpu::{Board, End};
use super::time::{HZ, Tick, micros, seconds};

/// Virtual time between two exchanges of bytes.
const SLICE: Tick = micros(1_000);
/// Most bytes waiting for the client, beyond which the host stops reading.
const MOST: usize = 1 << 16;
/// Interval for offering waiting bytes to the client again.
const WAIT: Duration = Duration::from_millis(1);
/// Longest boot time of the board.
const BOOT: Tick = micros(2_000_000);

/// Board behind a TCP port.
pub struct Server {
    board: Board,
    listener: TcpListener,
    client: Option<TcpStream>,
    unsent: Vec<u8>,
    /// Whether virtual time waits for the client; otherwise it follows real time, or is slower.
    waits: bool,
}

impl Server {
    /// Boots the board and listens on `address`.
    ///
    /// With `waits`, virtual time stops until the client has taken all bytes, and otherwise runs as
    /// fast as it can.
    pub fn new(mut board: Board, address: &str, waits: bool) -> Result<Self> {
        board.finger().keeps = false;
        while !board.host().is_ready() || board.finger().first().is_none() {
            if board.now() > BOOT {
                bail!(
                    "the board did not enumerate and scan within {:.1} virtual seconds",
                    seconds(board.now())
                );
            }
            step(&mut board)?;
        }
        let listener =
            TcpListener::bind(address).with_context(|| format!("listening on {address}"))?;
        listener.set_nonblocking(true)?;
        Ok(Self { board, listener, client: None, unsent: Vec::new(), waits })
    }

    /// Line with the port's address and the board's time in microseconds at which the scene began.
    pub fn greeting(&mut self) -> Result<String> {
        let port = self.listener.local_addr()?.port();
        let chip = self.board.chip().common();
        let began = chip.finger.first().and_then(|first| chip.device_us(first)).unwrap_or(0);
        Ok(format!("tcp:127.0.0.1:{port} scene at {began} us"))
    }

    /// Serves one client after the other, without end.
    pub fn serve(mut self) -> Result<()> {
        let (start, begin) = (Instant::now(), self.board.now());
        loop {
            step(&mut self.board)?;
            self.accept()?;
            self.exchange();
            if self.waits {
                while !self.unsent.is_empty() {
                    std::thread::sleep(WAIT);
                    self.exchange();
                }
                continue;
            }
            let virtual_time =
                Duration::from_secs_f64((self.board.now() - begin) as f64 / HZ as f64);
            std::thread::sleep(virtual_time.saturating_sub(start.elapsed()));
        }
    }

    fn accept(&mut self) -> Result<()> {
        if self.client.is_some() {
            return Ok(());
        }
        match self.listener.accept() {
            Ok((client, _)) => {
                client.set_nonblocking(true)?;
                // Frames are sent at once, not collected.
                client.set_nodelay(true)?;
                self.client = Some(client);
                self.board.host().open(true);
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    fn exchange(&mut self) {
        let Some(client) = &mut self.client else { return };
        let host = &mut self.board.host();
        self.unsent.extend(host.take_received());
        let mut bytes = [0; 4096];
        let read = match client.read(&mut bytes) {
            Ok(0) => Err(ErrorKind::UnexpectedEof),
            Ok(count) => {
                host.send(&bytes[..count]);
                Ok(())
            }
            Err(error) => Err(error.kind()),
        };
        let written = client.write(&self.unsent).map_err(|error| error.kind());
        if let Ok(count) = written {
            self.unsent.drain(..count);
        }
        host.reading = self.unsent.len() < MOST;
        if [read, written.map(|_| ())]
            .iter()
            .any(|done| matches!(done, Err(kind) if *kind != ErrorKind::WouldBlock))
        {
            // The client has disconnected.
            host.open(false);
            host.reading = true;
            self.client = None;
            self.unsent.clear();
        }
    }
}

/// Runs the board for a millisecond; a board that resets itself starts again.
fn step(board: &mut Board) -> Result<()> {
    match board.run(SLICE)? {
        End::Time => {}
        End::Reset(cause) => {
            eprintln!("{:.6} s: the board resets: {cause:?}", seconds(board.now()));
        }
        End::Bootloader => {
            bail!("{:.6} s: the board is in its ROM's bootloader", seconds(board.now()));
        }
    }
    Ok(())
}

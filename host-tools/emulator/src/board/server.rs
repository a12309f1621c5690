//! TCP server of the emulated port; connecting opens the serial port.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use taxel::wire::MAX_PACKET;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::Message;

use super::cpu::{Board, End};
use super::time::{HZ, Tick, micros, seconds};

/// Virtual time between two exchanges of bytes.
const SLICE: Tick = micros(1_000);
/// Most bytes waiting for the client, beyond which the host stops reading.
const MOST: usize = 1 << 16;
/// Longest boot time of the board.
const BOOT: Tick = micros(2_000_000);
/// Virtual silence after which no more bytes are expected from the board.
const SILENCE: Tick = micros(10_000_000);

/// Board behind a TCP port.
pub struct Server {
    board: Board,
    listener: TcpListener,
    client: Option<TcpStream>,
    /// Bytes of the board that the client has not got yet.
    unsent: Vec<u8>,
}

impl Server {
    /// Boots the board and listens on `address`.
    pub fn new(mut board: Board, address: &str) -> Result<Self> {
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
        Ok(Self { board, listener, client: None, unsent: Vec::new() })
    }

    /// Line with the port's address and the board's time in microseconds at which the scene began.
    pub fn greeting(&mut self) -> Result<String> {
        let port = self.listener.local_addr()?.port();
        let chip = self.board.chip().common();
        let began = chip.finger.first().and_then(|first| chip.device_us(first)).unwrap_or(0);
        Ok(format!("tcp:127.0.0.1:{port} scene at {began} us"))
    }

    /// Serves one client after the other, without end. Virtual time follows real time, or is
    /// slower.
    pub fn serve(mut self) -> Result<()> {
        self.listener.set_nonblocking(true)?;
        let (start, begin) = (Instant::now(), self.board.now());
        loop {
            step(&mut self.board)?;
            self.accept()?;
            self.exchange();
            let virtual_time =
                Duration::from_secs_f64((self.board.now() - begin) as f64 / HZ as f64);
            std::thread::sleep(virtual_time.saturating_sub(start.elapsed()));
        }
    }

    /// Serves one client after the other, without end, in virtual time that waits for the client.
    ///
    /// Time passes while a request is unanswered, and without end once the client has closed its
    /// sending side. So the same requests reach the board at the same instants, and the client gets
    /// the same bytes, however slow client and machine are.
    pub fn replay(mut self) -> Result<()> {
        loop {
            let (client, _) = self.listener.accept()?;
            // Frames are sent at once, not collected.
            client.set_nodelay(true)?;
            self.board.host().open(true);
            while !(self.board.host().is_ready() && self.board.host().is_open()) {
                step(&mut self.board)?;
            }
            // Bytes of an earlier client's stream.
            self.unsent = Vec::new();
            self.board.host().take_received();
            self.take_turns(&client)?;
            self.board.host().open(false);
        }
    }

    /// Gives each request its time. After the last one the board runs until the client is gone.
    fn take_turns(&mut self, client: &TcpStream) -> Result<()> {
        let mut messages = Deframer::<MAX_PACKET>::default();
        let mut ends_reply = |byte| {
            let message = messages.push::<Message>(byte);
            matches!(message, Some(Ok(Message::Version { .. } | Message::Reply { .. })))
        };
        let mut last = Vec::new();
        for request in BufReader::new(client).split(0) {
            let Ok(request) = request else { return Ok(()) };
            // Each packet begins with a zero, too. A client repeats a request whose reply is late
            // by real time.
            if request.is_empty() || request == last {
                continue;
            }
            self.board.host().send(&request);
            self.board.host().send(&[0]);
            if !self.pass_on(client, &mut ends_reply)? {
                return Ok(());
            }
            last = request;
        }
        self.pass_on(client, |_| false).map(|_| ())
    }

    /// Runs the board and sends its bytes to the client, the last one for which `is_last` holds.
    ///
    /// Returns false if the client is gone, or the board silent.
    fn pass_on(
        &mut self,
        mut client: &TcpStream,
        mut is_last: impl FnMut(u8) -> bool,
    ) -> Result<bool> {
        let mut heard = self.board.now();
        loop {
            let last = self.unsent.iter().position(|byte| is_last(*byte));
            let count = last.map_or(self.unsent.len(), |last| last + 1);
            if client.write_all(&self.unsent[..count]).is_err() {
                return Ok(false);
            }
            self.unsent.drain(..count);
            if last.is_some() || self.board.now() > heard + SILENCE {
                return Ok(last.is_some());
            }
            step(&mut self.board)?;
            self.unsent = self.board.host().take_received();
            if !self.unsent.is_empty() {
                heard = self.board.now();
            }
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

//! Client on the emulated port that sends an ordinary client's commands in virtual time.

use anyhow::{Result, bail};
use taxel::frame::{Frame, Status};
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{CHUNK, Command, Message, Refusal, Request, Response};
use taxel::wire::{MAX_PACKET, pack};

use super::cpu::{Board, End};
use super::time::{Tick, micros, seconds};

/// Interval at which the client reads the port.
const LOOK: Tick = micros(1_000);
/// Longest time for an answer.
///
/// It is the slowest erasure of a slot, 550 ms on the STM32F411, and 100 ms.
const PATIENCE: Tick = micros(650_000);
/// Time within which the board may erase its flash again.
const REST: Tick = micros(2_500_000);
/// Longest time for an enumeration.
const ENUMERATION: Tick = micros(1_000_000);

/// Board with a client at its port.
pub struct Session {
    /// Board at the other end.
    pub board: Board,
    deframer: Deframer,
    tag: u8,
    /// Frames received with their times, oldest first.
    pub frames: Vec<(Tick, Frame)>,
    /// Number of packets that could not be decoded.
    pub bad: usize,
    /// Messages received besides frames, oldest first.
    pub replies: Vec<Message>,
    /// Time of the last byte from the board.
    heard: Tick,
    /// Longest time without a byte from the board, which may be set back.
    pub silence: Tick,
    /// Longest time for an answer.
    pub patience: Tick,
}

impl Session {
    /// Waits for enumeration and opens the port.
    pub fn open(board: Board) -> Result<Self> {
        Self::open_within(board, ENUMERATION)
    }

    /// Opens the port of a board that takes at most `patience` for its enumeration.
    pub fn open_within(board: Board, patience: Tick) -> Result<Self> {
        let mut session = Self {
            board,
            deframer: Deframer::default(),
            tag: 0,
            frames: Vec::new(),
            bad: 0,
            replies: Vec::new(),
            heard: 0,
            silence: 0,
            patience: PATIENCE,
        };
        session.enumerate(patience)?;
        Ok(session)
    }

    /// Runs for `time`; an unexpected reset is an error.
    pub fn run(&mut self, time: Tick) -> Result<()> {
        let until = self.board.now() + time;
        while self.board.now() < until {
            let step = LOOK.min(until - self.board.now());
            match self.board.run(step)? {
                End::Time => {}
                end => bail!("{:.6} s: the board ended: {end:?}", seconds(self.board.now())),
            }
            self.look();
        }
        Ok(())
    }

    fn until(
        &mut self,
        what: &str,
        patience: Tick,
        mut done: impl FnMut(&mut Self) -> bool,
    ) -> Result<()> {
        let end = self.board.now() + patience;
        while !done(self) {
            if self.board.now() >= end {
                bail!("{:.6} s: still waiting until {what}", seconds(self.board.now()));
            }
            self.run(LOOK)?;
        }
        Ok(())
    }

    fn look(&mut self) {
        let now = self.board.now();
        let bytes = self.board.host().take_received();
        self.silence = self.silence.max(now - self.heard);
        if !bytes.is_empty() {
            self.heard = now;
        }
        for byte in bytes {
            match self.deframer.push::<Message>(byte) {
                Some(Ok(Message::Frame(frame))) => self.frames.push((now, frame)),
                Some(Ok(message)) => self.replies.push(message),
                Some(Err(_)) => self.bad += 1,
                None => {}
            }
        }
    }

    /// Number of frames from the first one with `status` on.
    ///
    /// `None` if their codes differ, scan by scan, from the converted ones.
    pub fn seen_in_order_since(&mut self, status: Status) -> Option<usize> {
        let begin = self.frames.iter().position(|(_, frame)| frame.status.contains(status))?;
        let codes = self.frames.iter().skip(begin).map(|(_, frame)| frame.codes);
        let codes = codes.collect::<Option<Vec<_>>>()?;
        let seen: Vec<_> = self.board.finger().seen.iter().map(|scan| scan.codes).collect();
        seen.windows(codes.len()).any(|seen| seen == codes).then_some(codes.len())
    }

    /// Uploads a calibration record and commits it.
    pub fn upload(&mut self, record: &[u8]) -> Result<()> {
        self.ask(Command::CalibrationBegin { length: u16::try_from(record.len())? })?;
        for (i, bytes) in record.chunks(CHUNK).enumerate() {
            let Ok(data) = heapless::Vec::from_slice(bytes) else {
                bail!("a chunk of the calibration is too long")
            };
            self.ask(Command::CalibrationChunk { offset: u16::try_from(i * CHUNK)?, data })?;
        }
        self.ask(Command::CalibrationCommit)?;
        Ok(())
    }

    /// Waits for a board that was reset or plugged in again, and opens its port.
    pub fn reopen(&mut self) -> Result<()> {
        (self.deframer, self.tag) = (Deframer::default(), 0);
        self.replies.clear();
        self.frames.clear();
        // The host must notice the board's absence first.
        self.run(LOOK)?;
        self.enumerate(ENUMERATION)
    }

    fn enumerate(&mut self, patience: Tick) -> Result<()> {
        self.until("the port is open", patience, |session| {
            let host = &mut session.board.host();
            if host.is_ready() && !host.is_open() {
                host.open(true);
            }
            host.is_ready() && host.is_open()
        })
    }

    /// Sends a command and waits for its response. Erasures of flash are a second apart.
    pub fn ask(&mut self, command: Command) -> Result<Response> {
        let erases = matches!(
            command,
            Command::CalibrationBegin { .. } | Command::SaveSettings | Command::SaveBias
        );
        let last = self.board.now() + REST;
        loop {
            match self.reply(&command)? {
                Ok(response) => return Ok(response),
                Err(Refusal::Busy) if erases && self.board.now() < last => self.run(REST / 100)?,
                Err(refusal) => bail!("{command:?} is answered with {refusal:?}"),
            }
        }
    }

    fn reply(&mut self, command: &Command) -> Result<Result<Response, Refusal>> {
        self.tag = self.tag.wrapping_add(1);
        let (tag, what) = (self.tag, format!("{command:?}"));
        let mut buffer = [0; MAX_PACKET];
        match pack(&Request { tag, command: command.clone() }, &mut buffer) {
            Ok(packet) => self.board.host().send(packet),
            Err(error) => bail!("{what}: {error:?}"),
        }
        self.until(&format!("{what} is answered"), self.patience, |session| {
            !session.replies.is_empty()
        })?;
        match self.replies.remove(0) {
            Message::Reply { tag: its, result } if its == tag => Ok(result),
            other => bail!("{what} is answered with {other:?}"),
        }
    }
}

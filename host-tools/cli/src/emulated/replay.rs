//! A whole trace through the emulated board, nothing lost.

use std::io::{ErrorKind, Read, Write};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use taxel::frame::Frame;
use taxel::scan::Scan;
use taxel::session::Pace;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{CHUNK, Command, Info, Message, PROTOCOL, Request, Response};
use taxel::wire::{MAX_PACKET, pack};

use super::{Emulated, EmulatedError, ICOUNT_SHIFT, Image, Settings};
use taxel_client::Problem;

/// The tag of the last [`Info`], which comes unasked.
const FAREWELL: u8 = 0;
/// A board that says nothing for so long hangs.
const PATIENCE: Duration = Duration::from_secs(30);

/// What a replay brought, besides its frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// What the firmware said of itself after the last scan.
    pub info: Info,
    /// The most bytes of stack that it used.
    pub stack: Option<u32>,
}

impl Replay {
    /// Instructions that the dearest scan took, from its codes to its frame.
    #[must_use]
    pub fn worst_instructions(&self) -> u64 {
        let nanoseconds_a_tick = 1_000_000_000 / u64::from(self.info.identity.tick_hz.max(1));
        (u64::from(self.info.cost.worst) * nanoseconds_a_tick) >> ICOUNT_SHIFT
    }
}

/// Plays `scans` back through the firmware, with a calibration record if there is one. `frame` is given
/// one frame a scan, in order, and may end the replay: then there is no [`Replay`].
///
/// # Errors
/// The board does not start, refuses the calibration, or does not send every frame.
pub fn replay(
    scans: &[Scan],
    calibration: Option<&[u8]>,
    settings: &Settings,
    mut frame: impl FnMut(&Frame) -> ControlFlow<()>,
) -> Result<Option<Replay>, EmulatedError> {
    let image = Image::new(scans, Pace::Lossless)?;
    let mut board = Emulated::start(&image)?;
    let (reader, writer) =
        board.take_link().ok_or_else(|| EmulatedError::Stopped("it has no link".to_owned()))?;
    let mut link = Link { reader, writer, deframer: Deframer::default(), tag: FAREWELL };
    let mut received = 0;
    let talk = prepare(&mut link, &image, calibration, settings).and_then(|()| {
        let mut heard = Heard::Nothing;
        while let Some(message) = link.next()? {
            match message {
                Message::Frame(sent) if sent.seq as usize == received => {
                    received += 1;
                    if frame(&sent).is_break() {
                        return Ok(Heard::Enough);
                    }
                }
                Message::Reply { tag: FAREWELL, result: Ok(Response::Info(last)) } => {
                    heard = Heard::Farewell(Box::new(last));
                }
                _ => return Err(EmulatedError::Lost { received, expected: scans.len() }),
            }
        }
        Ok(heard)
    });
    let heard = match talk {
        // Dropping the board ends it.
        Ok(Heard::Enough) => return Ok(None),
        // A board that stopped can say why.
        Err(EmulatedError::Stopped(_)) => Heard::Nothing,
        Ok(heard) => heard,
        Err(error) => return Err(error),
    };
    let stack = board.wait()?;
    match heard {
        Heard::Farewell(info) if received == scans.len() => Ok(Some(Replay { info: *info, stack })),
        _ => Err(EmulatedError::Lost { received, expected: scans.len() }),
    }
}

/// What the board's stream came to.
enum Heard {
    /// It ended without a farewell.
    Nothing,
    /// Whoever takes the frames has enough of them.
    Enough,
    /// Its last word.
    Farewell(Box<Info>),
}

fn prepare(
    link: &mut Link,
    image: &Image,
    calibration: Option<&[u8]>,
    settings: &Settings,
) -> Result<(), EmulatedError> {
    match link.ask(Command::Version)? {
        Message::Version { protocol: PROTOCOL, .. } => {}
        Message::Version { protocol: theirs, firmware, .. } => {
            return Err(EmulatedError::Finger(Problem::Protocol { theirs, firmware }));
        }
        _ => return Err(EmulatedError::Finger(Problem::Confused("version"))),
    }
    if let Some(record) = calibration {
        let length = u16::try_from(record.len()).unwrap_or(u16::MAX);
        link.set("calibration", Command::CalibrationBegin { length })?;
        for (offset, chunk) in (0..).step_by(CHUNK).zip(record.chunks(CHUNK)) {
            let data = chunk.iter().copied().collect();
            link.set("calibration", Command::CalibrationChunk { offset, data })?;
        }
        link.set("calibration", Command::CalibrationCommit)?;
    }
    link.set("rate", Command::SetRate { hz: image.scan_hz() })?;
    if settings.filter_hz > 0 {
        link.set("filter", Command::SetFilter { hz: settings.filter_hz })?;
    }
    link.set("point", Command::SetPointMethod(settings.point_method))?;
    link.set("fields", Command::SetFields(settings.fields))?;
    link.set("stream", Command::Stream(true))
}

/// A conversation in which nothing may be lost: every question has its answer, or it is an error.
/// ([`crate::Client`] is made for links that lose things, and for programs that read too slowly.)
struct Link {
    reader: Box<dyn Read + Send>,
    writer: Box<dyn Write + Send>,
    deframer: Deframer,
    tag: u8,
}

impl Link {
    /// The next message; `None` when there will be none.
    fn next(&mut self) -> Result<Option<Message>, EmulatedError> {
        let deadline = Instant::now() + PATIENCE;
        let mut byte = [0];
        loop {
            match self.reader.read(&mut byte) {
                Ok(0) => return Ok(None),
                Ok(_) => match self.deframer.push(byte[0]) {
                    None => {}
                    Some(Ok(message)) => return Ok(Some(message)),
                    Some(Err(error)) => return Err(EmulatedError::Garbled(error)),
                },
                Err(error) if error.kind() != ErrorKind::TimedOut => {
                    return Err(EmulatedError::System { what: "reading from the board", error });
                }
                Err(_) if Instant::now() > deadline => return Err(EmulatedError::Hangs),
                Err(_) => {}
            }
        }
    }

    /// Sends a request and waits for its answer.
    fn ask(&mut self, command: Command) -> Result<Message, EmulatedError> {
        self.tag = self.tag.wrapping_add(1).max(FAREWELL + 1);
        let mut buffer = [0; MAX_PACKET];
        let request = Request { tag: self.tag, command };
        let packet = pack(&request, &mut buffer).map_err(EmulatedError::Garbled)?;
        // A board that no longer reads has stopped, and its output ends too.
        let _ = self.writer.write_all(packet).and_then(|()| self.writer.flush());
        self.next()?.ok_or_else(|| EmulatedError::Stopped("it closed the link".to_owned()))
    }

    /// As [`Self::ask`], for what is either done or refused.
    fn set(&mut self, name: &'static str, command: Command) -> Result<(), EmulatedError> {
        match self.ask(command)? {
            Message::Reply { tag, result: Ok(Response::Done | Response::Rate { .. }) }
                if tag == self.tag =>
            {
                Ok(())
            }
            Message::Reply { result: Err(refusal), .. } => {
                Err(EmulatedError::Finger(Problem::Refusal { command: name, refusal }))
            }
            _ => Err(EmulatedError::Finger(Problem::Confused(name))),
        }
    }
}

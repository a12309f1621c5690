//! Playback of recorded frames as a finger, each at its own time.
//!
//! Nothing is computed, so that only the fields can be chosen. A recording with codes is played as
//! a full finger by [`super::Source::trace`].

use std::io;
use std::net::TcpListener;
use std::path::Path;
use std::sync::PoisonError;
use std::time::Duration;

use taxel::frame::{Frame, Status};
use taxel::units::FullScale;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{
    BoardHealth, CHUNK, CalibrationId, Command, Cost, Counters, Identity, Info, Message, PROTOCOL,
    Refusal, Request, Response,
};
use taxel::wire::{MAX_PACKET, pack};
use taxel_files::FileError;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, sleep_until};

use super::hosts::{Host, Hosts};
use super::recorded::Recorded;
use super::{Ending, Outcome};
use taxel_client::LinkError;

/// Recording with its position.
pub(super) struct Player {
    frames: Recorded,
    next: Option<Frame>,
    /// A moment of this machine and its device time in microseconds, while it plays.
    origin: Option<(Instant, u64)>,
    info: Info,
}

impl Player {
    /// Opens a recording of frames; `None` if it has codes, or is a trace.
    pub(super) fn open(path: &Path) -> Result<Option<Self>, LinkError> {
        let Some(mut frames) = Recorded::without_codes(path).map_err(LinkError::device)? else {
            return Ok(None);
        };
        let info = info(path, &frames);
        let Some(first) = frames.next().transpose().map_err(LinkError::device)? else {
            let error = FileError::new(path, "no frames").mend("record for longer");
            return Err(LinkError::device(error));
        };
        Ok(Some(Self { frames, next: Some(first), origin: None, info }))
    }

    /// Serves one host after the other until the frames end. Sets `ending` before the link closes.
    pub(super) async fn serve(mut self, listener: TcpListener, ending: &Ending) -> io::Result<()> {
        let mut hosts = Hosts::new(listener)?;
        loop {
            let mut host = hosts.next().await?;
            let ended = tokio::select! {
                biased;
                ended = self.converse(&mut host) => ended,
                never = hosts.refuse() => match never {},
            };
            // A host that leaves with an error does not stop the next one.
            if let Ok(Some(outcome)) = ended {
                *ending.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
                return Ok(());
            }
            self.play(false);
        }
    }

    async fn converse(&mut self, host: &mut Host) -> io::Result<Option<Outcome>> {
        let (rx, mut tx) = host.stream.split();
        let mut rx = host.request.as_slice().chain(rx);
        let mut deframer = Deframer::<MAX_PACKET>::default();
        let mut bytes = [0; 256];
        loop {
            let playing = self.origin.is_some();
            let message = tokio::select! {
                length = rx.read(&mut bytes) => {
                    let length = length?;
                    if length == 0 {
                        return Ok(None);
                    }
                    for byte in bytes.get(..length).unwrap_or_default() {
                        if let Some(Ok(request)) = deframer.push::<Request>(*byte) {
                            tx.write_all(&packed(&self.answer(&request))?).await?;
                        }
                    }
                    continue;
                }
                frame = self.due(), if playing => match frame {
                    None => return Ok(Some(Outcome::Finished)),
                    Some(Err(error)) => return Ok(Some(Outcome::Failed(error))),
                    Some(Ok(frame)) => Message::Frame(frame.masked(self.info.fields)),
                },
            };
            tx.write_all(&packed(&message)?).await?;
        }
    }

    /// Returns the next frame at its time. A dropped wait loses nothing.
    async fn due(&mut self) -> Option<Result<Frame, FileError>> {
        let frame = match self.next {
            Some(frame) => frame,
            None => match self.frames.next()? {
                Ok(frame) => *self.next.insert(frame),
                Err(error) => return Some(Err(error)),
            },
        };
        let (began, time) = *self.origin.get_or_insert((Instant::now(), frame.time.0));
        match frame.time.0.checked_sub(time) {
            Some(since) => sleep_until(began + Duration::from_micros(since)).await,
            // The recorded finger restarted here.
            None => self.origin = Some((Instant::now(), frame.time.0)),
        }
        self.next.take().map(Ok)
    }

    fn play(&mut self, on: bool) {
        self.info.streaming = on;
        let time = self.next.map_or(0, |frame| frame.time.0);
        self.origin = on.then(|| (Instant::now(), time));
    }

    fn answer(&mut self, request: &Request) -> Message {
        let tag = request.tag;
        let result = match &request.command {
            Command::Version => {
                return Message::Version { tag, protocol: PROTOCOL, firmware: [0; 3] };
            }
            Command::Info => Ok(Response::Info(self.info.clone())),
            Command::Health => Ok(Response::Health(BoardHealth::default())),
            Command::Stream(on) => {
                self.play(*on);
                Ok(Response::Done)
            }
            // The recorded rate is the nearest possible one.
            Command::SetRate { .. } => Ok(Response::Rate { millihertz: self.info.rate_millihertz }),
            Command::SetFields(fields) if self.frames.fields().contains(*fields) => {
                self.info.fields = *fields;
                Ok(Response::Done)
            }
            // A reconnecting client restores these settings.
            Command::SetFilter { hz } if *hz == self.info.filter_hz => Ok(Response::Done),
            Command::SetPointMethod(method) if *method == self.info.point_method => {
                Ok(Response::Done)
            }
            Command::ReadBias => match self.frames.header().bias() {
                Some(bias) => Ok(Response::Bias { bias, on_command: true, in_contact: false }),
                None => Err(Refusal::Unsupported),
            },
            Command::CalibrationRead { offset } => self.calibration(*offset),
            _ => Err(Refusal::Unsupported),
        };
        Message::Reply { tag, result }
    }

    fn calibration(&self, offset: u16) -> Result<Response, Refusal> {
        let record = self.frames.calibration.as_deref().ok_or(Refusal::Uncalibrated)?;
        let rest = record.get(usize::from(offset)..).unwrap_or_default();
        let data = rest.iter().copied().take(CHUNK).collect();
        Ok(Response::Calibration { offset, data })
    }
}

/// Identity and settings of the recorded finger.
fn info(path: &Path, frames: &Recorded) -> Info {
    let facts = &frames.header().facts;
    let fact = |name: &str| facts.get(name).map_or("", String::as_str);
    let rate: f64 = fact("rate_hz").parse().unwrap_or_default();
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let serial = if fact("serial").is_empty() { &*stem } else { fact("serial") };
    let date = humantime::parse_rfc3339(fact("calibration_date")).ok();
    let date = date.and_then(|date| date.duration_since(std::time::UNIX_EPOCH).ok());
    let crc = u32::from_str_radix(fact("calibration_crc"), 16).ok();
    let calibration = frames.calibration.as_ref().and(crc).zip(date).map(|(crc, date)| {
        CalibrationId { serial: short(fact("calibration_serial")), date: date.as_secs(), crc }
    });
    Info {
        identity: Identity {
            board: short(fact("board")),
            serial: short(serial),
            build: short(fact("build")),
            scan_hz: fact("scan_hz").parse().unwrap_or_default(),
            full_scale: FullScale::BITS_12,
            tick_hz: 1,
        },
        rate_millihertz: (rate * 1000.0) as u32,
        filter_hz: fact("filter_hz").parse().unwrap_or_default(),
        fields: frames.fields(),
        streaming: false,
        point_method: frames.header().point_method(),
        biased: fact("biased") == "true",
        calibration,
        counters: Counters::default(),
        cost: Cost::default(),
        estimators: Status::default(),
    }
}

/// Cuts a text to fit.
fn short<const N: usize>(text: &str) -> heapless::String<N> {
    let mut short = heapless::String::new();
    let _ = text.chars().try_for_each(|c| short.push(c));
    short
}

fn packed(message: &Message) -> io::Result<Vec<u8>> {
    let mut buffer = [0; MAX_PACKET];
    let packed = pack(message, &mut buffer).map(<[u8]>::to_vec);
    packed.map_err(|_| io::Error::other("a frame longer than any can be"))
}

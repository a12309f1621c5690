//! Requests and replies, frames and their losses.

mod printable;
mod reader;
mod upload;

use std::hash::{BuildHasher, Hasher};
use std::io::Write;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use taxel::condition::Bias;
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Frame};
use taxel::scan::ScanSettings;
use taxel::self_test::SelfTest;
use taxel::wire::message::{
    BoardHealth, Command, Info, Message, PROTOCOL, Refusal, Request, Response,
};
use taxel::wire::{MAX_PACKET, pack};

pub use reader::Counts;

use crate::error::{LinkError, Problem};
use crate::link::{Device, Link};
use crate::port::Port;
use printable::{printable, shown};
use reader::{NO_TAG, Reader, Shared};

/// Frames queued for the program; those beyond are dropped and counted.
const QUEUE: usize = 8192;
/// Time a finger has to reply before the request is repeated.
const PATIENCE: Duration = Duration::from_millis(500);
/// Attempts per request: with [`PATIENCE`], two seconds in all.
const TRIES: u32 = 4;
/// Time within which a finger may erase its flash again: it rests for a second of scans, of which
/// an erasure itself may have delayed the first.
const REST: Duration = Duration::from_millis(2500);
/// [`PATIENCE`] after a reconnect. It is shorter because a board that still starts loses requests.
const KNOWN_PATIENCE: Duration = Duration::from_millis(150);

/// Frame with the time this host received it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received {
    /// Frame as sent.
    pub frame: Frame,
    /// Host time. Device time is in the frame.
    pub at: Instant,
}

/// Reply to the version query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Version {
    /// Version of the protocol.
    pub protocol: u16,
    /// Firmware major, minor, patch.
    pub firmware: [u8; 3],
}

/// Active bias and how it was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActiveBias {
    /// Signals of the unloaded finger.
    pub bias: Bias,
    /// Whether the bias was taken on command; otherwise it is the calibration's own.
    pub on_command: bool,
    /// Whether the contact gate was open: the finger may have been loaded.
    pub in_contact: bool,
}

/// Connection to one finger. One thread may send requests while another takes frames.
pub struct Client {
    port: Port,
    version: Version,
    requests: Mutex<Requests>,
    frames: Mutex<Receiver<Received>>,
    shared: Arc<Shared>,
    device: Option<Box<dyn Device>>,
    thread: Option<JoinHandle<()>>,
}

/// Sending side: one request at a time.
struct Requests {
    writer: Box<dyn Write + Send>,
    replies: Receiver<Message>,
    /// Tag of the last request.
    tag: u8,
}

impl Client {
    /// Opens `port` and checks that a finger of this protocol answers.
    ///
    /// # Errors
    /// The port cannot be opened, nothing answers, or the finger speaks another protocol.
    pub fn open(port: &Port) -> Result<Self, LinkError> {
        Self::over(port, Link::open(port)?)
    }

    /// Checks that a finger of this protocol answers on `link`; `port` is its name in errors.
    ///
    /// # Errors
    /// Nothing answers, or the finger speaks another protocol.
    pub fn over(port: &Port, link: Link) -> Result<Self, LinkError> {
        Self::start(port, link, PATIENCE)
    }

    /// Like [`Self::over`], for a finger that was there before: see [`KNOWN_PATIENCE`].
    pub(crate) fn again(port: &Port, link: Link) -> Result<Self, LinkError> {
        Self::start(port, link, KNOWN_PATIENCE)
    }

    fn start(port: &Port, link: Link, patience: Duration) -> Result<Self, LinkError> {
        let shared = Arc::new(Shared::default());
        let (reply_in, replies) = channel();
        let (frame_in, frames) = sync_channel(QUEUE);
        let reader = Reader::new(link.reader, reply_in, frame_in, Arc::clone(&shared));
        let thread = std::thread::Builder::new()
            .name("taxel-reader".to_owned())
            .spawn(move || reader.run())
            .map_err(|error| Problem::Open(error.to_string()).at(port))?;
        let tag = link.first_tag.unwrap_or_else(random_tag).wrapping_sub(1);
        let mut client = Self {
            port: port.clone(),
            version: Version { protocol: 0, firmware: [0; 3] },
            requests: Mutex::new(Requests { writer: link.writer, replies, tag }),
            frames: Mutex::new(frames),
            shared,
            device: link.device,
            thread: Some(thread),
        };
        client.version = client.ask_version(patience)?;
        Ok(client)
    }

    /// Port of the finger.
    #[must_use]
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// Protocol and firmware version of the finger.
    #[must_use]
    pub fn version(&self) -> Version {
        self.version
    }

    /// Numbers of frames received and lost so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.shared.counts()
    }

    /// Returns the next frame, or `None` when none comes within `patience`.
    ///
    /// # Errors
    /// [`Problem::Unplugged`] when the link broke, [`Problem::Ended`] after the last frame of a
    /// playback. Every earlier frame has been returned by then.
    pub fn next(&self, patience: Duration) -> Result<Option<Received>, LinkError> {
        match lock(&self.frames).recv_timeout(patience) {
            Ok(received) => Ok(Some(received)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(self.gone()),
        }
    }

    /// Measures the round trip of a request and its reply.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn echo(&self) -> Result<Duration, LinkError> {
        let asked = Instant::now();
        // Sent once: a lost reply measures nothing.
        self.exchange(&Command::Version, PATIENCE, 1).map(|_| asked.elapsed())
    }

    /// Returns identity, settings and counters of the finger.
    ///
    /// # Errors
    /// No reply, an unexpected reply, a refusal, or a broken link, as for every request.
    pub fn info(&self) -> Result<Info, LinkError> {
        match self.request("info", Command::Info)? {
            Response::Info(info) => Ok(printable(info)),
            _ => Err(self.unexpected("info")),
        }
    }

    /// Starts or stops the stream. A start discards earlier frames and restarts the count of lost
    /// ones.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn stream(&self, on: bool) -> Result<(), LinkError> {
        self.done("stream", Command::Stream(on))
    }

    /// Sets the frame rate. Returns the actual rate, which is the scan rate over a whole number.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn set_rate(&self, hz: u16) -> Result<f64, LinkError> {
        match self.request("rate", Command::SetRate { hz })? {
            Response::Rate { millihertz } => Ok(f64::from(millihertz) / 1000.0),
            _ => Err(self.unexpected("rate")),
        }
    }

    /// Sets which fields frames carry.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn set_fields(&self, fields: Fields) -> Result<(), LinkError> {
        self.done("fields", Command::SetFields(fields))
    }

    /// Sets how the contact point is found.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn set_point_method(&self, method: PointMethod) -> Result<(), LinkError> {
        self.done("point", Command::SetPointMethod(method))
    }

    /// Takes a new bias as the mean of `scans` scans, and waits for it.
    ///
    /// # Errors
    /// As [`Self::info`]; refused when the finger was not still.
    pub fn take_bias(&self, scans: u16) -> Result<ActiveBias, LinkError> {
        let scan_hz = self.info()?.identity.scan_hz.max(1);
        let averaging = Duration::from_secs_f64(f64::from(scans) / f64::from(scan_hz));
        let command = Command::TakeBias { scans };
        // Sent once: a second attempt would be refused as busy.
        let response = self.ask("bias", command, averaging + 4 * PATIENCE, 1)?;
        self.bias(&response)
    }

    /// Returns the active bias.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn read_bias(&self) -> Result<ActiveBias, LinkError> {
        let response = self.request("bias", Command::ReadBias)?;
        self.bias(&response)
    }

    /// Returns to the calibration's own bias.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn clear_bias(&self) -> Result<(), LinkError> {
        self.done("bias", Command::ClearBias)
    }

    /// Stores scan, rate, filter, fields and contact point method in flash.
    ///
    /// # Errors
    /// As [`Self::info`]; refused when the finger's flash failed.
    pub fn save_settings(&self) -> Result<(), LinkError> {
        self.erase("save", &Command::SaveSettings, PATIENCE, TRIES)
    }

    /// Stores the active bias in flash.
    ///
    /// # Errors
    /// As [`Self::save_settings`].
    pub fn save_bias(&self) -> Result<(), LinkError> {
        self.erase("save", &Command::SaveBias, PATIENCE, TRIES)
    }

    /// Returns the state of the board itself.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn health(&self) -> Result<BoardHealth, LinkError> {
        match self.request("health", Command::Health)? {
            Response::Health(mut health) => {
                health.panic = health.panic.as_ref().map(shown);
                Ok(health)
            }
            _ => Err(self.unexpected("health")),
        }
    }

    /// Measures mean and noise of every channel over `scans` scans, and waits for it.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn self_test(&self, scans: u16) -> Result<SelfTest, LinkError> {
        let scan_hz = self.info()?.identity.scan_hz.max(1);
        let measuring = Duration::from_secs_f64(f64::from(scans) / f64::from(scan_hz));
        let command = Command::SelfTest { scans };
        match self.ask("self-test", command, measuring + 4 * PATIENCE, 1)? {
            Response::SelfTest(test) => Ok(test),
            _ => Err(self.unexpected("self-test")),
        }
    }

    /// Restarts the board in its bootloader. The link ends soon after.
    ///
    /// # Errors
    /// As [`Self::info`]; refused by a board without one.
    pub fn bootloader(&self) -> Result<(), LinkError> {
        match self.ask("dfu", Command::Bootloader, PATIENCE, 1)? {
            Response::Done => Ok(()),
            _ => Err(self.unexpected("dfu")),
        }
    }

    /// Sets the low-pass filter of the signals: −3 dB at `hz`, 0 for no filter.
    ///
    /// # Errors
    /// As [`Self::info`]; refused above a quarter of the scan rate.
    pub fn set_filter(&self, hz: u16) -> Result<(), LinkError> {
        self.done("filter", Command::SetFilter { hz })
    }

    /// Changes scan rate, oversampling and settling time.
    ///
    /// # Errors
    /// As [`Self::info`]; refused where the settings exclude each other.
    pub fn set_scan(&self, settings: ScanSettings) -> Result<(), LinkError> {
        // Sent once: each attempt would restart the scan.
        match self.ask("scan", Command::SetScan(settings), 4 * PATIENCE, 1)? {
            Response::Done => Ok(()),
            _ => Err(self.unexpected("scan")),
        }
    }

    /// Holds an LED row, 0 … 3, on in every step until this connection ends; `None` scans again.
    ///
    /// # Errors
    /// As [`Self::info`]; refused by a board that cannot, and while a bias is taken.
    pub fn hold_row(&self, row: Option<u8>) -> Result<(), LinkError> {
        self.done("hold row", Command::HoldRow { row })
    }

    fn bias(&self, response: &Response) -> Result<ActiveBias, LinkError> {
        match *response {
            Response::Bias { bias, on_command, in_contact } => {
                Ok(ActiveBias { bias, on_command, in_contact })
            }
            _ => Err(self.unexpected("bias")),
        }
    }

    fn ask_version(&self, patience: Duration) -> Result<Version, LinkError> {
        match self.exchange(&Command::Version, patience, TRIES)? {
            Message::Version { protocol, firmware, .. } if protocol == PROTOCOL => {
                Ok(Version { protocol, firmware })
            }
            Message::Version { protocol: theirs, firmware, .. } => {
                Err(self.error(Problem::Protocol { theirs, firmware }))
            }
            Message::Reply { result: Err(Refusal::Busy), .. } => Err(self.error(Problem::Busy)),
            _ => Err(self.unexpected("version")),
        }
    }

    fn done(&self, name: &'static str, command: Command) -> Result<(), LinkError> {
        match self.request(name, command)? {
            Response::Done => Ok(()),
            _ => Err(self.unexpected(name)),
        }
    }

    /// Sends a request that erases flash, which the finger does at most once a second.
    fn erase(
        &self,
        name: &'static str,
        command: &Command,
        patience: Duration,
        tries: u32,
    ) -> Result<(), LinkError> {
        let asked = Instant::now();
        loop {
            match self.ask(name, command.clone(), patience, tries) {
                Err(error) if busy(&error) && asked.elapsed() < REST => {
                    std::thread::sleep(REST / 50);
                }
                Ok(Response::Done) => return Ok(()),
                Ok(_) => return Err(self.unexpected(name)),
                Err(error) => return Err(error),
            }
        }
    }

    /// Sends a request that may be repeated without harm.
    fn request(&self, name: &'static str, command: Command) -> Result<Response, LinkError> {
        self.ask(name, command, PATIENCE, TRIES)
    }

    fn ask(
        &self,
        name: &'static str,
        command: Command,
        patience: Duration,
        tries: u32,
    ) -> Result<Response, LinkError> {
        match self.exchange(&command, patience, tries)? {
            Message::Reply { result: Ok(response), .. } => Ok(response),
            Message::Reply { result: Err(refusal), .. } => {
                Err(self.error(Problem::Refusal { command: name, refusal }))
            }
            _ => Err(self.unexpected(name)),
        }
    }

    /// Sends a command and waits for the reply with its tag.
    fn exchange(
        &self,
        command: &Command,
        patience: Duration,
        tries: u32,
    ) -> Result<Message, LinkError> {
        let mut requests = lock(&self.requests);
        requests.tag = requests.tag.wrapping_add(1);
        let tag = requests.tag;
        if *command == Command::Stream(true) {
            self.shared.start_tag.store(tag.into(), Ordering::Release);
        }
        let mut buffer = [0; MAX_PACKET + 1];
        // A leading zero ends half a packet that the finger may still hold.
        let (_, packet) = buffer.split_at_mut(1);
        let length = 1 + pack(&Request { tag, command: command.clone() }, packet)
            .map_err(|_| self.error(Problem::Open("request too long".to_owned())))?
            .len();
        for _ in 0..tries {
            let sent = requests.writer.write_all(&buffer[..length]);
            sent.and_then(|()| requests.writer.flush()).map_err(|error| {
                let end = self.shared.ended();
                self.error(end.unwrap_or_else(|| Problem::broken(&error)))
            })?;
            let deadline = Instant::now() + patience;
            loop {
                let left = deadline.saturating_duration_since(Instant::now());
                match requests.replies.recv_timeout(left) {
                    Ok(message) if answers(&message, tag, command) => return Ok(message),
                    // Late reply to a repeated request, or to another host's.
                    Ok(_) => {}
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return Err(self.gone()),
                }
            }
        }
        self.shared.start_tag.store(NO_TAG, Ordering::Release);
        Err(self.error(Problem::NoReply))
    }

    /// Returns the reason for the end of messages.
    fn gone(&self) -> LinkError {
        match self.device.as_ref().and_then(|device| device.outcome()) {
            Some(Ok(())) => self.error(Problem::Ended),
            Some(Err(error)) => error.into(),
            None => {
                let closed = || Problem::Unplugged("the link was closed".to_owned());
                self.error(self.shared.ended().unwrap_or_else(closed))
            }
        }
    }

    fn unexpected(&self, name: &'static str) -> LinkError {
        self.error(Problem::UnexpectedReply(name))
    }

    fn error(&self, problem: Problem) -> LinkError {
        problem.at(&self.port)
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        // A device in this process ends the read at once; others end with the next poll.
        drop(self.device.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the reader was reported when it happened.
            let _ = thread.join();
        }
    }
}

/// First tag, random because a serial link may still hold replies to an earlier program.
fn random_tag() -> u8 {
    std::hash::RandomState::new().build_hasher().finish() as u8
}

fn busy(error: &LinkError) -> bool {
    matches!(error.problem(), Some(Problem::Refusal { refusal: Refusal::Busy, .. }))
}

fn answers(message: &Message, tag: u8, command: &Command) -> bool {
    let fits = match message {
        Message::Version { .. } => *command == Command::Version,
        // A TCP port that serves another program answers so.
        Message::Reply { result: Err(Refusal::Busy), .. } => true,
        _ => *command != Command::Version,
    };
    fits && tag_of(message) == Some(tag)
}

fn tag_of(message: &Message) -> Option<u8> {
    match message {
        Message::Version { tag, .. } | Message::Reply { tag, .. } => Some(*tag),
        Message::Frame(_) => None,
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

//! The host's side of the conversation: requests and their answers, frames and their losses.

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
use taxel::wire::message::{BoardHealth, Command, Info, Message, PROTOCOL, Request, Response};
use taxel::wire::{MAX_PACKET, pack};

pub use reader::Counts;

use crate::error::{LinkError, Problem};
use crate::link::{Device, Link};
use crate::port::Port;
use reader::{NO_TAG, Reader, Shared};

/// Frames kept for a program that reads them late; those beyond it are dropped and counted.
const QUEUE: usize = 8192;
/// How long a finger may take to answer before it is asked again.
const PATIENCE: Duration = Duration::from_millis(500);
/// How often it is asked: with [`PATIENCE`], two seconds in all.
const TRIES: u32 = 4;
/// A finger that is waited for is asked whether it is there at shorter notice: it has answered before, and
/// what is said to a board that still starts is lost.
const KNOWN_PATIENCE: Duration = Duration::from_millis(150);

/// A frame, and when this host received it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Received {
    /// The frame.
    pub frame: Frame,
    /// Host time. Device time is in the frame.
    pub at: Instant,
}

/// Who answered the version query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Version {
    /// Version of the protocol.
    pub protocol: u16,
    /// Firmware major, minor, patch.
    pub firmware: [u8; 3],
}

/// A bias and the circumstances it was taken in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasInForce {
    /// What the unloaded finger reads.
    pub bias: Bias,
    /// Taken on command; else the calibration's own.
    pub on_command: bool,
    /// The gate was open meanwhile: the finger may have been under load.
    pub in_contact: bool,
}

/// A conversation with one finger. Requests may come from one thread while another takes the frames.
pub struct Client {
    port: Port,
    version: Version,
    requests: Mutex<Requests>,
    frames: Mutex<Receiver<Received>>,
    shared: Arc<Shared>,
    device: Option<Box<dyn Device>>,
    thread: Option<JoinHandle<()>>,
}

/// The sending side: one request at a time.
struct Requests {
    writer: Box<dyn Write + Send>,
    replies: Receiver<Message>,
    /// Of the last request.
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
        let mut client = Self {
            port: port.clone(),
            version: Version { protocol: 0, firmware: [0; 3] },
            requests: Mutex::new(Requests { writer: link.writer, replies, tag: first_tag() }),
            frames: Mutex::new(frames),
            shared,
            device: link.device,
            thread: Some(thread),
        };
        client.version = client.ask_version(patience)?;
        Ok(client)
    }

    /// Where the finger is.
    #[must_use]
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// What the finger said it speaks.
    #[must_use]
    pub fn version(&self) -> Version {
        self.version
    }

    /// Frames received and lost so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.shared.counts()
    }

    /// The next frame, or `None` when none comes within `patience`.
    ///
    /// # Errors
    /// [`Problem::Unplugged`] when the finger has gone, [`Problem::Ended`] when a playback is over: every
    /// frame that came before has been handed out by then.
    pub fn next(&self, patience: Duration) -> Result<Option<Received>, LinkError> {
        match lock(&self.frames).recv_timeout(patience) {
            Ok(received) => Ok(Some(received)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(self.gone()),
        }
    }

    /// How long a question and its answer take, there and back.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn echo(&self) -> Result<Duration, LinkError> {
        let asked = Instant::now();
        // Asked once: a lost answer is no measure of time.
        self.exchange(&Command::Version, PATIENCE, 1).map(|_| asked.elapsed())
    }

    /// Who the finger is and how it is doing.
    ///
    /// # Errors
    /// As for every request: no answer, another's answer, a refusal, a broken link.
    pub fn info(&self) -> Result<Info, LinkError> {
        match self.request("info", Command::Info)? {
            Response::Info(info) => Ok(info),
            _ => Err(self.confused("info")),
        }
    }

    /// Starts or stops the stream. Frames from before the start are not handed out, and the count of
    /// lost ones starts afresh with it.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn stream(&self, on: bool) -> Result<(), LinkError> {
        self.done("stream", Command::Stream(on))
    }

    /// Sets the frames a second. Returns the rate in force: the scan rate over a whole number.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn set_rate(&self, hz: u16) -> Result<f64, LinkError> {
        match self.request("rate", Command::SetRate { hz })? {
            Response::Rate { millihertz } => Ok(f64::from(millihertz) / 1000.0),
            _ => Err(self.confused("rate")),
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

    /// Averages so many scans into a new bias and waits for it.
    ///
    /// # Errors
    /// As [`Self::info`]; refused when the finger was not still.
    pub fn take_bias(&self, scans: u16) -> Result<BiasInForce, LinkError> {
        let scan_hz = self.info()?.identity.scan_hz.max(1);
        let averaging = Duration::from_secs_f64(f64::from(scans) / f64::from(scan_hz));
        let command = Command::TakeBias { scans };
        // Asked once: a second try would be refused as busy.
        let response = self.ask("bias", command, averaging + 4 * PATIENCE, 1)?;
        self.bias(&response)
    }

    /// The bias in force.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn read_bias(&self) -> Result<BiasInForce, LinkError> {
        let response = self.request("bias", Command::ReadBias)?;
        self.bias(&response)
    }

    /// Back to the calibration's own bias.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn clear_bias(&self) -> Result<(), LinkError> {
        self.done("bias", Command::ClearBias)
    }

    /// Scan, rate, filter, fields and contact point method shall survive power-off.
    ///
    /// # Errors
    /// As [`Self::info`]; refused when the finger's flash failed.
    pub fn save_settings(&self) -> Result<(), LinkError> {
        self.done("save", Command::SaveSettings)
    }

    /// The bias in force shall survive power-off.
    ///
    /// # Errors
    /// As [`Self::save_settings`].
    pub fn save_bias(&self) -> Result<(), LinkError> {
        self.done("save", Command::SaveBias)
    }

    /// How the board itself is doing.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn health(&self) -> Result<BoardHealth, LinkError> {
        match self.request("health", Command::Health)? {
            Response::Health(health) => Ok(health),
            _ => Err(self.confused("health")),
        }
    }

    /// Measures mean and noise of every channel over so many scans, and waits for it.
    ///
    /// # Errors
    /// As [`Self::info`].
    pub fn self_test(&self, scans: u16) -> Result<SelfTest, LinkError> {
        let scan_hz = self.info()?.identity.scan_hz.max(1);
        let measuring = Duration::from_secs_f64(f64::from(scans) / f64::from(scan_hz));
        let command = Command::SelfTest { scans };
        match self.ask("self-test", command, measuring + 4 * PATIENCE, 1)? {
            Response::SelfTest(test) => Ok(test),
            _ => Err(self.confused("self-test")),
        }
    }

    /// Sends the board to its chip's own bootloader. The link ends soon after.
    ///
    /// # Errors
    /// As [`Self::info`]; refused where there is none.
    pub fn bootloader(&self) -> Result<(), LinkError> {
        match self.ask("dfu", Command::Bootloader, PATIENCE, 1)? {
            Response::Done => Ok(()),
            _ => Err(self.confused("dfu")),
        }
    }

    /// Smooths the signals that forces and places come from: −3 dB at `hz`, 0 for no filter.
    ///
    /// # Errors
    /// As [`Self::info`]; refused above a quarter of the scans a second.
    pub fn set_filter(&self, hz: u16) -> Result<(), LinkError> {
        self.done("filter", Command::SetFilter { hz })
    }

    /// Scans differently from now on.
    ///
    /// # Errors
    /// As [`Self::info`]; refused where the settings cannot be had together.
    pub fn set_scan(&self, settings: ScanSettings) -> Result<(), LinkError> {
        // Asked once: the scan would begin anew with every try.
        match self.ask("scan", Command::SetScan(settings), 4 * PATIENCE, 1)? {
            Response::Done => Ok(()),
            _ => Err(self.confused("scan")),
        }
    }

    fn bias(&self, response: &Response) -> Result<BiasInForce, LinkError> {
        match *response {
            Response::Bias { bias, on_command, in_contact } => {
                Ok(BiasInForce { bias, on_command, in_contact })
            }
            _ => Err(self.confused("bias")),
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
            _ => Err(self.confused("version")),
        }
    }

    fn done(&self, name: &'static str, command: Command) -> Result<(), LinkError> {
        match self.request(name, command)? {
            Response::Done => Ok(()),
            _ => Err(self.confused(name)),
        }
    }

    /// A request that may be repeated without harm.
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
            _ => Err(self.confused(name)),
        }
    }

    /// Sends a command and waits for the message with its tag.
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
        // A zero first ends whatever half a packet the finger may still hold.
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
                    // The late answer to a request that was repeated, or that another host made.
                    Ok(_) => {}
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return Err(self.gone()),
                }
            }
        }
        self.shared.start_tag.store(NO_TAG, Ordering::Release);
        Err(self.error(Problem::Silent))
    }

    /// Why there is nothing more to come.
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

    fn confused(&self, name: &'static str) -> LinkError {
        self.error(Problem::Confused(name))
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
            // A reader that panicked has nothing more to say.
            let _ = thread.join();
        }
    }
}

/// Serial links keep what nobody has read: answers to the host before us must not look like ours.
fn first_tag() -> u8 {
    std::hash::RandomState::new().build_hasher().finish() as u8
}

fn answers(message: &Message, tag: u8, command: &Command) -> bool {
    let asked_version = *command == Command::Version;
    tag_of(message) == Some(tag) && matches!(message, Message::Version { .. }) == asked_version
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

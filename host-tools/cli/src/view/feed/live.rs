//! Feed of a finger that is connected or is waited for.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_client::{
    Client, DeviceClock, Event, LinkError, Received, ReconnectingClient, fields, self_test,
};
use taxel_files::frames::{Cell, cells, columns};
use taxel_files::point_method;

use taxel_files::recording::Existing;

use super::{Context, Feed, facts};
use crate::Files;
use crate::view::orders::{Envelope, Order, Outcome};

/// Interval at which a thread checks whether to stop.
const LOOK: Duration = Duration::from_millis(50);
/// Interval between measurements of the round trip.
const ECHO: Duration = Duration::from_secs(1);
/// Silence after which a finger counts as not streaming.
const DRY: Duration = Duration::from_secs(2);
/// Notice after a reconnect that lost the bias.
const BIAS_LOST: &str = "the finger lost its bias; take it again";
/// Scans averaged for a bias or a self-test. They take 0.25 s at 4 kHz, 1 s at 1 kHz.
const SCANS: u16 = 1000;

/// Starts the feed of a finger: one thread takes its frames, another executes the page's commands.
pub(super) fn start(steady: Arc<ReconnectingClient>, folder: PathBuf) -> Feed {
    let (mut feed, context, orders) = Feed::new(steady.port().to_string());
    let live = Arc::new(Live { steady, folder, context, now: Mutex::default() });
    let other = Arc::clone(&live);
    feed.spawn("view-frames", move || live.frames());
    feed.spawn("view-orders", move || other.orders(&orders));
    feed
}

/// Starts the feed of a finger whose frames come through [`Tap::take`].
pub(super) fn tapped(
    steady: &Arc<ReconnectingClient>,
    folder: PathBuf,
) -> Result<(Feed, Tap), LinkError> {
    let (mut feed, context, orders) = Feed::new(steady.port().to_string());
    let steady = Arc::clone(steady);
    let live = Arc::new(Live { steady, folder, context, now: Mutex::default() });
    if let Some(client) = live.steady.client() {
        live.there(&client)?;
    }
    let other = Arc::clone(&live);
    feed.spawn("view-orders", move || other.orders(&orders));
    Ok((feed, Tap(live)))
}

/// Input for frames that another part of the program streams.
pub struct Tap(Arc<Live>);

impl Tap {
    /// Takes one frame.
    pub fn take(&self, received: &Received) {
        self.0.take(received);
    }

    /// Reports a reconnect.
    pub fn again(&self, client: &Client) {
        self.0.trouble(self.0.there(client).err());
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.0.end_recording();
    }
}

/// State shared by both threads.
struct Live {
    steady: Arc<ReconnectingClient>,
    folder: PathBuf,
    context: Context,
    now: Mutex<Now>,
}

/// Mutable state.
#[derive(Default)]
struct Now {
    fields: Option<Fields>,
    row: Vec<Cell>,
    files: Option<(PathBuf, Files)>,
    /// Frames and losses of earlier connections.
    before: (u64, u64),
    clock: DeviceClock,
}

impl Now {
    fn echo(&mut self, echo: Duration) {
        self.clock.echo(echo);
        self.files.iter_mut().for_each(|(_, files)| files.echo(echo));
    }
}

impl Live {
    fn frames(&self) {
        let mut heard = Instant::now();
        while !self.context.stopped() {
            match self.steady.next(LOOK) {
                Event::Frame(received) => {
                    heard = received.at;
                    self.take(&received);
                }
                Event::Connected(client) => {
                    heard = Instant::now();
                    let there = self.there(&client);
                    self.trouble(there.err());
                }
                Event::Timeout if heard.elapsed() > DRY => {
                    let dry = DRY.as_secs();
                    self.context.scope.lock().trouble =
                        Some(format!("{}: no frame for {dry} s", self.steady.port()));
                }
                Event::Timeout => {}
                Event::Disconnected(error) => {
                    let counts = &mut self.now().before;
                    let link = self.context.scope.lock().link;
                    *counts = (link.frames, link.lost);
                    self.trouble(Some(error));
                }
                Event::Ended => {
                    self.context.scope.lock().trouble = Some("the playback is over".to_owned());
                    std::thread::sleep(LOOK);
                }
            }
        }
        self.end_recording();
    }

    /// Prepares a connected finger. Adds the taxels' signals to its fields, because the page draws
    /// them.
    fn there(&self, client: &Client) -> Result<(), LinkError> {
        {
            let mut now = self.now();
            now.clock = DeviceClock::default();
            now.files.iter_mut().for_each(|(_, files)| files.reconnected());
        }
        if self.steady.bias_lost() {
            self.context.scope.lock().mishap = Some(BIAS_LOST.to_owned());
        }
        let info = client.info()?;
        if !info.fields.contains(Fields::SIGNALS) {
            client.set_fields(info.fields | Fields::SIGNALS)?;
        }
        self.refresh(client)
    }

    /// Reads the finger's settings again and updates columns and facts.
    fn refresh(&self, client: &Client) -> Result<(), LinkError> {
        let info = self.steady.remember(client)?;
        let mut now = self.now();
        let mut scope = self.context.scope.lock();
        if now.fields != Some(info.fields) {
            now.fields = Some(info.fields);
            scope.set_columns(columns(info.fields));
        }
        scope.facts = facts(client, &info);
        Ok(())
    }

    fn trouble(&self, error: Option<LinkError>) {
        self.context.scope.lock().trouble = error.map(|error| error.to_string());
    }

    fn take(&self, received: &Received) {
        let mut now = self.now();
        let Some(fields) = now.fields else { return };
        now.clock.frame(received.frame.time, received.at);
        let clock =
            now.clock.host(received.frame.time).map(|host| (now.clock.drift_ppm(), host.error));
        let mut row = std::mem::take(&mut now.row);
        row.clear();
        cells(&received.frame, fields, &mut row);
        let written = now.files.as_mut().map(|(_, files)| files.write(received));
        let mut scope = self.context.scope.lock();
        if let Some(Err(error)) = written {
            // The file keeps the earlier frames; further writes would fail too.
            now.files = None;
            scope.recording = None;
            scope.mishap = Some(error.to_string());
        }
        scope.trouble = None;
        scope.push(&row, received.at);
        scope.link.clock = clock;
        now.row = row;
        if let Some(client) = self.steady.client() {
            let counts = client.counts();
            scope.link.frames = now.before.0 + counts.frames;
            scope.link.lost = now.before.1 + counts.lost + counts.overflow;
        }
    }

    fn orders(&self, orders: &Receiver<Envelope>) {
        let mut echoed = Instant::now();
        while !self.context.stopped() {
            match orders.recv_timeout(LOOK) {
                Ok(envelope) => envelope.answer(|order| self.carry_out(order)),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if echoed.elapsed() >= ECHO {
                echoed = Instant::now();
                let echo = self.steady.client().and_then(|client| client.echo().ok());
                echo.into_iter().for_each(|echo| self.now().echo(echo));
                self.context.scope.lock().link.echo = echo;
            }
        }
    }

    fn carry_out(&self, order: Order) -> Outcome {
        if let Order::Channel { name } = &order {
            self.context.scope.lock().set_channel(name);
            return Ok(String::new());
        }
        let client = self.steady.client().ok_or("the finger is not connected")?;
        let done = match order {
            Order::Bias => client.take_bias(SCANS).map(|bias| match bias.in_contact {
                false => "bias taken".to_owned(),
                true => "bias taken, but something touched the finger meanwhile".to_owned(),
            }),
            Order::ClearBias => {
                client.clear_bias().map(|()| "back to the calibration's bias".to_owned())
            }
            Order::Rate { hz } => client.set_rate(hz).map(|hz| format!("rate {hz} Hz")),
            Order::Filter { hz } => client.set_filter(hz).map(|()| match hz {
                0 => "no filter".to_owned(),
                hz => format!("filter {hz} Hz"),
            }),
            Order::Fields { list } => {
                if self.now().files.is_some() {
                    return Err("end the recording first: its columns are those fields".to_owned());
                }
                let fields = fields::parse(&list).map_err(|error| error.to_string())?;
                client
                    .set_fields(fields)
                    .map(|()| format!("fields {}", fields::list(fields).replace(',', ", ")))
            }
            Order::Method { name } => {
                let method = point_method::parse(&name).unwrap_or_default();
                client.set_point_method(method).map(|()| format!("contact point by {name}"))
            }
            Order::SelfTest => client.self_test(SCANS).map(|test| {
                let wrong = self_test::findings(&test);
                let channels = self_test::named(&test).len();
                match wrong.as_slice() {
                    [] => format!("self-test: all {channels} channels are as they should be"),
                    wrong => format!("self-test: {}", wrong.join("; ")),
                }
            }),
            Order::Record { on: true } => return self.begin_recording(&client),
            Order::Record { on: false } => {
                return self.end_recording().unwrap_or(Ok(String::new()));
            }
            Order::Play { .. } | Order::Seek { .. } => {
                return Err("this is a finger, not a recording".to_owned());
            }
            Order::Channel { .. } => return Ok(String::new()),
        };
        let done = done.and_then(|text| self.refresh(&client).map(|()| text));
        done.map_err(|error| error.to_string())
    }

    fn begin_recording(&self, client: &Client) -> Outcome {
        if let Some((path, _)) = &self.now().files {
            return Err(format!("already recording into {}", path.display()));
        }
        let info = client.info().map_err(|error| error.to_string())?;
        let path = self.folder.join(file_name(&info));
        let files = Files::create(client, std::slice::from_ref(&path), Existing::Keep);
        let files = files.map_err(|error| error.to_string())?;
        let name = path.display().to_string();
        self.now().files = Some((path, files));
        let mut scope = self.context.scope.lock();
        (scope.recording, scope.mishap) = (Some(name.clone()), None);
        Ok(format!("recording into {name}"))
    }

    fn end_recording(&self) -> Option<Outcome> {
        let (path, files) = self.now().files.take()?;
        self.context.scope.lock().recording = None;
        let finished = files.finish().map_err(|error| error.to_string());
        Some(finished.map(|()| format!("recorded {}", path.display())))
    }

    fn now(&self) -> MutexGuard<'_, Now> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns a file name such as `taxel-F-0042-1790000000.mcap`, which sorts by time. An existing
/// file is never overwritten.
fn file_name(info: &Info) -> PathBuf {
    let serial = info.identity.serial.chars();
    let serial: String = serial.map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Path::new(&format!("taxel-{serial}-{}.mcap", now.as_secs())).to_owned()
}

//! Feed of a finger that is connected or is waited for.

use std::path::{Path, PathBuf};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_client::{Client, DeviceClock, Event, LinkError, Received, ReconnectingClient, fields};
use taxel_files::frames::{Cell, cells, columns};
use taxel_files::point_method;

use taxel_files::recording::{EXTENSION, Existing};

use super::{Context, Feed, facts, self_test};
use crate::Files;
use crate::view::orders::{Order, Outcome, Queue};
use crate::view::scope::Recorded;

/// Interval at which a thread checks whether to stop.
const LOOK: Duration = Duration::from_millis(50);
/// Interval between measurements of the round trip.
const ECHO: Duration = Duration::from_secs(1);
/// Silence after which a finger counts as not streaming.
const DRY: Duration = Duration::from_secs(2);
/// Notice after a reconnect that lost the bias.
const BIAS_LOST: &str = "the finger lost its bias; take it again";
/// Scans averaged for a bias. They take 0.25 s at 4 kHz, 1 s at 1 kHz.
const SCANS: u16 = 1000;

/// Starts the feed of a finger: one thread takes its frames, another executes the page's commands.
pub(super) fn start(steady: Arc<ReconnectingClient>, folder: PathBuf) -> Feed {
    let (mut feed, context, orders) = Feed::new(steady.port().to_string());
    let live = Arc::new(Live { steady, folder, context, now: Mutex::default() });
    let other = Arc::clone(&live);
    feed.spawn("view-frames", move || live.frames());
    feed.spawn("view-orders", move || other.orders(orders));
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
    feed.spawn("view-orders", move || other.orders(orders));
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
    files: Option<Recording>,
    /// Frames and losses of earlier connections.
    before: (u64, u64),
    clock: DeviceClock,
}

/// Recording started from the page.
struct Recording {
    path: PathBuf,
    files: Files,
    /// Fields of the stream before it.
    fields: Fields,
}

impl Now {
    fn echo(&mut self, echo: Duration) {
        self.clock.echo(echo);
        self.files.iter_mut().for_each(|recording| recording.files.echo(echo));
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
                Event::Timeout | Event::Connecting => {}
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

    /// Prepares a connected finger. Adds to its fields those that the page draws: signals, standard
    /// deviations, and without a calibration the codes.
    fn there(&self, client: &Client) -> Result<(), LinkError> {
        {
            let mut now = self.now();
            now.clock = DeviceClock::default();
            now.files.iter_mut().for_each(|recording| recording.files.reconnected());
        }
        if self.steady.bias_lost() {
            self.context.scope.lock().mishap = Some(BIAS_LOST.to_owned());
        }
        let info = client.info()?;
        let mut drawn = Fields::SIGNALS | Fields::UNCERTAINTY;
        if info.calibration.is_none() {
            drawn |= Fields::CODES;
        }
        if !info.fields.contains(drawn) {
            client.set_fields(info.fields | drawn)?;
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
        let written = now.files.as_mut().map(|recording| recording.files.write(received));
        let mut scope = self.context.scope.lock();
        if let Some(Err(error)) = &written {
            // The file keeps the earlier frames; further writes would fail too.
            now.files = None;
            scope.recording = None;
            scope.mishap = Some(error.to_string());
        }
        if let (Some(recording), Some(Ok(()))) = (&mut scope.recording, &written) {
            recording.rows += 1;
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

    fn orders(&self, mut orders: Queue) {
        let mut echoed = Instant::now();
        while !self.context.stopped() {
            let answered = orders.answer(LOOK, |order| self.carry_out(order));
            if answered == Err(RecvTimeoutError::Disconnected) {
                return;
            }
            self.measure_recording();
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
            Order::SelfTest => self_test::run(&client).map(|test| {
                self.context.scope.lock().self_test = self_test::facts(&test);
                self_test::verdict(&test)
            }),
            Order::Record { on: true } => return self.begin_recording(&client),
            Order::Record { on: false } => {
                let fields = self.now().files.as_ref().map(|recording| recording.fields);
                let ended = self.end_recording().unwrap_or(Ok(String::new()));
                if let Some(fields) = fields {
                    let restored = client.set_fields(fields).and_then(|()| self.refresh(&client));
                    restored.map_err(|error| error.to_string())?;
                }
                return ended;
            }
            Order::Play { .. } | Order::Seek { .. } => {
                return Err("this is a finger, not a recording".to_owned());
            }
            Order::Channel { .. } => return Ok(String::new()),
        };
        let done = done.and_then(|text| self.refresh(&client).map(|()| text));
        done.map_err(|error| error.to_string())
    }

    /// Begins a recording. It always has the codes, so that it can be computed again.
    fn begin_recording(&self, client: &Client) -> Outcome {
        if let Some(Recording { path, .. }) = &self.now().files {
            return Err(format!("already recording into {}", path.display()));
        }
        let text = |error: LinkError| error.to_string();
        let info = client.info().map_err(text)?;
        let path = self.folder.join(file_name(&info));
        let fields = info.fields;
        if !fields.contains(Fields::CODES) {
            client.set_fields(fields | Fields::CODES).map_err(text)?;
            self.refresh(client).map_err(text)?;
        }
        let files = Files::create(client, std::slice::from_ref(&path), Existing::Keep);
        let files = files.map_err(text)?;
        let name = path.display().to_string();
        let mut now = self.now();
        now.files = Some(Recording { path, files, fields });
        let mut scope = self.context.scope.lock();
        let begun = Recorded { name: name.clone(), begun: Instant::now(), rows: 0, bytes: 0 };
        (scope.recording, scope.mishap) = (Some(begun), None);
        Ok(format!("recording into {name}"))
    }

    fn end_recording(&self) -> Option<Outcome> {
        let Recording { path, files, .. } = self.now().files.take()?;
        let recorded = self.context.scope.lock().recording.take();
        let finished = files.finish().map_err(|error| error.to_string());
        let (seconds, rows) = recorded
            .map_or((0.0, 0), |recorded| (recorded.begun.elapsed().as_secs_f64(), recorded.rows));
        let bytes = indicatif::HumanBytes(size(&path));
        let path = path.display();
        Some(finished.map(|()| format!("recorded {path}: {seconds:.1} s, {rows} rows, {bytes}")))
    }

    /// Updates the size of the recording's file.
    fn measure_recording(&self) {
        let path = self.now().files.as_ref().map(|recording| recording.path.clone());
        let bytes = path.as_deref().map(size);
        let mut scope = self.context.scope.lock();
        if let (Some(recording), Some(bytes)) = (&mut scope.recording, bytes) {
            recording.bytes = bytes;
        }
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
    Path::new(&format!("taxel-{serial}-{}.{EXTENSION}", now.as_secs())).to_owned()
}

/// Returns the bytes of a file; 0 if there is none.
fn size(path: &Path) -> u64 {
    path.metadata().map_or(0, |file| file.len())
}

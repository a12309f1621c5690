//! Client that opens a broken link again and restores the finger's settings.

use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use taxel::estimate::contact_point::PointMethod;
use taxel::frame::Fields;
use taxel::scan::ScanSettings;
use taxel::wire::message::Info;

use crate::client::{Client, Received};
use crate::error::{LinkError, Problem};
use crate::link::Link;
use crate::port::Port;

/// Interval between attempts to open a port.
const RETRY: Duration = Duration::from_millis(100);

/// Client of one finger over any number of connections.
pub struct ReconnectingClient {
    port: Port,
    open: Arc<Open>,
    state: Mutex<State>,
}

type Open = dyn Fn(&Port) -> Result<Link, LinkError> + Send + Sync;

#[derive(Default)]
struct State {
    client: Option<Arc<Client>>,
    /// Attempt to connect that goes on in its own thread.
    attempt: Option<Receiver<Result<Connected, LinkError>>>,
    settings: Option<Settings>,
    bias_lost: bool,
}

/// Finger that streams with its settings.
struct Connected {
    client: Client,
    settings: Settings,
    bias_lost: bool,
}

/// Settings that a finger loses with its power.
#[derive(Clone, Copy)]
pub struct Settings {
    millihertz: u32,
    filter_hz: u16,
    fields: Fields,
    method: PointMethod,
    /// Scan settings, where the board reports them.
    pub scan: Option<ScanSettings>,
    /// Whether a bias taken on command was active.
    biased: bool,
}

/// Result of waiting for a finger.
#[expect(clippy::large_enum_variant, reason = "a frame is handed on at once, thousands a second")]
pub enum Event {
    /// Frame received.
    Frame(Received),
    /// No frame within the time given.
    Timeout,
    /// An attempt to connect goes on.
    Connecting,
    /// The finger was connected, for the first time or again, and streams.
    Connected(Arc<Client>),
    /// The finger is not connected, with the reason. The next call tries again.
    Disconnected(LinkError),
    /// End of a playback; no more frames come.
    Ended,
}

impl ReconnectingClient {
    /// Creates a client for `port`, which need not be connected yet.
    #[must_use]
    pub fn new(port: Port) -> Self {
        Self::opened_by(port, Link::open)
    }

    /// Creates a client whose port is opened by `open` each time.
    #[must_use]
    pub fn opened_by(
        port: Port,
        open: impl Fn(&Port) -> Result<Link, LinkError> + Send + Sync + 'static,
    ) -> Self {
        Self { port, open: Arc::new(open), state: Mutex::default() }
    }

    /// Wraps a client that is connected and streams.
    #[must_use]
    pub fn of(client: Arc<Client>) -> Self {
        let steady = Self::new(client.port().clone());
        steady.state().client = Some(client);
        steady
    }

    /// Port of the finger.
    #[must_use]
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// Current connection, if there is one.
    #[must_use]
    pub fn client(&self) -> Option<Arc<Client>> {
        self.state().client.clone()
    }

    /// Waits for the next event, in one thread at a time. The finger streams from the first call
    /// on.
    ///
    /// A connection is made in a thread of its own, because a finger may be silent for seconds: no
    /// call takes longer than `patience` and the interval between attempts, 0.1 s.
    pub fn next(&self, patience: Duration) -> Event {
        let Some(client) = self.client() else {
            return self.connect(patience);
        };
        match client.next(patience) {
            Ok(Some(received)) => Event::Frame(received),
            Ok(None) => Event::Timeout,
            Err(error) if error.problem() == Some(&Problem::Ended) => Event::Ended,
            Err(error) => {
                self.state().client = None;
                Event::Disconnected(error)
            }
        }
    }

    /// Remembers the present settings of the finger, to restore them after a reconnect.
    ///
    /// # Errors
    /// The finger does not reply.
    pub fn remember(&self, client: &Client) -> Result<Info, LinkError> {
        let (settings, info) = Settings::of(client)?;
        self.state().settings = Some(settings);
        Ok(info)
    }

    /// Whether the finger lost a bias that was taken on command. Only the unloaded finger can take
    /// it again.
    #[must_use]
    pub fn bias_lost(&self) -> bool {
        self.state().bias_lost
    }

    /// Begins an attempt to connect, or waits for the one that goes on.
    fn connect(&self, patience: Duration) -> Event {
        let attempt = self.state().attempt.take();
        let attempt = attempt.unwrap_or_else(|| self.begin());
        match attempt.recv_timeout(patience) {
            Ok(Ok(Connected { client, settings, bias_lost })) => {
                let client = Arc::new(client);
                let mut state = self.state();
                (state.settings, state.bias_lost) = (Some(settings), bias_lost);
                state.client = Some(Arc::clone(&client));
                Event::Connected(client)
            }
            Ok(Err(error)) => {
                std::thread::sleep(RETRY);
                Event::Disconnected(error)
            }
            Err(RecvTimeoutError::Timeout) => {
                self.state().attempt = Some(attempt);
                Event::Connecting
            }
            Err(RecvTimeoutError::Disconnected) => {
                std::thread::sleep(RETRY);
                let failed = "the attempt to connect failed by a bug in this program".to_owned();
                Event::Disconnected(Problem::Open(failed).at(&self.port))
            }
        }
    }

    /// Starts the thread of an attempt. It ends by itself, even if nobody waits for it.
    fn begin(&self) -> Receiver<Result<Connected, LinkError>> {
        let (done, attempt) = channel();
        let (port, open, settings) =
            (self.port.clone(), Arc::clone(&self.open), self.state().settings);
        let connect = move || drop(done.send(connect(&port, &*open, settings)));
        // Without a thread the attempt counts as failed.
        let _ = std::thread::Builder::new().name("taxel-connect".to_owned()).spawn(connect);
        attempt
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Settings {
    /// Asks for the present settings of a finger.
    ///
    /// # Errors
    /// The finger does not reply.
    pub fn of(client: &Client) -> Result<(Self, Info), LinkError> {
        let info = client.info()?;
        let settings = Self {
            millihertz: info.rate_millihertz,
            filter_hz: info.filter_hz,
            fields: info.fields,
            method: info.point_method,
            scan: client.health()?.scan,
            biased: info.biased,
        };
        Ok((settings, info))
    }

    /// Restores the settings, the scan first, which may clear the bias. Returns whether it is lost.
    ///
    /// # Errors
    /// The finger does not reply.
    pub fn restore(self, client: &Client) -> Result<bool, LinkError> {
        // First, because the others depend on it. Only if it differs, because it clears the bias.
        if let Some(scan) = self.scan
            && client.health()?.scan != Some(scan)
        {
            client.set_scan(scan)?;
        }
        let bias_lost = self.biased && !client.info()?.biased;
        let hertz = self.millihertz.div_ceil(1000).clamp(1, u16::MAX.into());
        client.set_rate(hertz as u16)?;
        client.set_filter(self.filter_hz)?;
        client.set_fields(self.fields)?;
        client.set_point_method(self.method)?;
        Ok(bias_lost)
    }
}

/// Connects to a finger with these settings, or with its own for the first time.
fn connect(port: &Port, open: &Open, settings: Option<Settings>) -> Result<Connected, LinkError> {
    let link = open(port)?;
    let connected = if let Some(settings) = settings {
        let client = Client::again(port, link)?;
        let bias_lost = settings.restore(&client)?;
        Connected { client, settings, bias_lost }
    } else {
        let client = Client::over(port, link)?;
        let (settings, _) = Settings::of(&client)?;
        Connected { client, settings, bias_lost: false }
    };
    connected.client.stream(true)?;
    Ok(connected)
}

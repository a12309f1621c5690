//! Client that opens a broken link again and restores the finger's settings.

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
    open: Open,
    state: Mutex<State>,
}

type Open = Box<dyn Fn(&Port) -> Result<Link, LinkError> + Send + Sync>;

#[derive(Default)]
struct State {
    client: Option<Arc<Client>>,
    settings: Option<Settings>,
    bias_lost: bool,
}

/// Settings that a finger loses with its power.
#[derive(Clone, Copy)]
struct Settings {
    millihertz: u32,
    filter_hz: u16,
    fields: Fields,
    method: PointMethod,
    /// Scan settings, where the board reports them.
    scan: Option<ScanSettings>,
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
        Self { port, open: Box::new(open), state: Mutex::default() }
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

    /// Waits for the next event. The finger streams from the first call on.
    pub fn next(&self, patience: Duration) -> Event {
        let Some(client) = self.client() else {
            return match self.connect() {
                Ok(client) => Event::Connected(client),
                Err(error) => {
                    std::thread::sleep(RETRY);
                    Event::Disconnected(error)
                }
            };
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
        let info = client.info()?;
        self.state().settings = Some(Settings {
            millihertz: info.rate_millihertz,
            filter_hz: info.filter_hz,
            fields: info.fields,
            method: info.point_method,
            scan: client.health()?.scan,
            biased: info.biased,
        });
        Ok(info)
    }

    /// Whether the finger lost a bias that was taken on command. Only the unloaded finger can take
    /// it again.
    #[must_use]
    pub fn bias_lost(&self) -> bool {
        self.state().bias_lost
    }

    fn connect(&self) -> Result<Arc<Client>, LinkError> {
        let settings = self.state().settings;
        let link = (self.open)(&self.port)?;
        let client = match settings {
            None => Client::over(&self.port, link)?,
            Some(_) => Client::again(&self.port, link)?,
        };
        match settings {
            None => drop(self.remember(&client)?),
            Some(Settings { millihertz, filter_hz, fields, method, scan, biased }) => {
                // First, because the others depend on it. Only if it differs, because it clears the
                // bias.
                if let Some(scan) = scan
                    && client.health()?.scan != Some(scan)
                {
                    client.set_scan(scan)?;
                }
                self.state().bias_lost = biased && !client.info()?.biased;
                let hertz = millihertz.div_ceil(1000).clamp(1, u16::MAX.into());
                client.set_rate(hertz as u16)?;
                client.set_filter(filter_hz)?;
                client.set_fields(fields)?;
                client.set_point_method(method)?;
            }
        }
        client.stream(true)?;
        let client = Arc::new(client);
        self.state().client = Some(Arc::clone(&client));
        Ok(client)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

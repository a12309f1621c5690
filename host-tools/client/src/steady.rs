//! A finger that stays connected: when the link breaks it is opened again, and what the finger had been set
//! to is set again.

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

/// How often a port that has gone is tried.
const RETRY: Duration = Duration::from_millis(100);

/// One finger, through however many connections.
pub struct Steady {
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

/// What a finger forgets when it loses power.
#[derive(Clone, Copy)]
struct Settings {
    millihertz: u32,
    filter_hz: u16,
    fields: Fields,
    method: PointMethod,
    /// How it scans, where the board can tell.
    scan: Option<ScanSettings>,
    /// A bias taken on command was in force.
    biased: bool,
}

/// What came next.
#[expect(clippy::large_enum_variant, reason = "a frame is handed on at once, thousands a second")]
pub enum Event {
    /// A frame.
    Frame(Received),
    /// Nothing, for as long as the caller was patient.
    Quiet,
    /// The finger is there, for the first time or again, and streams.
    There(Arc<Client>),
    /// It is not there, and why. It is being looked for.
    Gone(LinkError),
    /// A playback is over: nothing more will come.
    Over,
}

impl Steady {
    /// A finger at `port`, which need not be there yet.
    #[must_use]
    pub fn new(port: Port) -> Self {
        Self::opened_by(port, Link::open)
    }

    /// A finger at `port`, which `open` opens each time.
    #[must_use]
    pub fn opened_by(
        port: Port,
        open: impl Fn(&Port) -> Result<Link, LinkError> + Send + Sync + 'static,
    ) -> Self {
        Self { port, open: Box::new(open), state: Mutex::default() }
    }

    /// A finger that is connected already, and streams.
    #[must_use]
    pub fn of(client: Arc<Client>) -> Self {
        let steady = Self::new(client.port().clone());
        steady.state().client = Some(client);
        steady
    }

    /// Where it is.
    #[must_use]
    pub fn port(&self) -> &Port {
        &self.port
    }

    /// The connection, while there is one.
    #[must_use]
    pub fn client(&self) -> Option<Arc<Client>> {
        self.state().client.clone()
    }

    /// The next thing that happens; streams from the first call on.
    pub fn next(&self, patience: Duration) -> Event {
        let Some(client) = self.client() else {
            return match self.connect() {
                Ok(client) => Event::There(client),
                Err(error) => {
                    std::thread::sleep(RETRY);
                    Event::Gone(error)
                }
            };
        };
        match client.next(patience) {
            Ok(Some(received)) => Event::Frame(received),
            Ok(None) => Event::Quiet,
            Err(error) if error.problem() == Some(&Problem::Ended) => Event::Over,
            Err(error) => {
                self.state().client = None;
                Event::Gone(error)
            }
        }
    }

    /// What the finger is set to now is what it shall be set to after a reconnect.
    ///
    /// # Errors
    /// It does not say.
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

    /// The finger had a bias taken on command, and came back without: a board without power forgets it, and
    /// nobody but the finger itself can take it again.
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
                // First, because the others depend on it. Not in vain, because the finger forgets its bias with it.
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

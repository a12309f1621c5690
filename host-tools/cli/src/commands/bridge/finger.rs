//! Stream of one finger in a bridge.

use std::sync::atomic::Ordering;
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Serialize;
use taxel::wire::message::Info;
use taxel_client::{
    Client, Event, LinkError, Port, Problem, Received, ReconnectingClient, RoundTrips, Timestamps,
};

use super::{LOOK, Shared, ros};
use crate::output;

/// Destination of a finger's frames.
pub trait Outlet: Send {
    /// Announces a connected finger, perhaps another than before, and returns its name.
    fn there(&mut self, port: &Port, info: &Info) -> anyhow::Result<String>;
    /// Publishes a frame of the connected finger. `stamps` includes this frame already.
    fn frame(&mut self, received: &Received, stamps: &Timestamps) -> anyhow::Result<()>;
}

/// Summary of a finger's frames.
#[derive(Default, Serialize)]
pub struct Report {
    pub port: String,
    /// Names of the finger; several if another finger was plugged in.
    pub names: Vec<String>,
    pub frames: u64,
    /// Frames lost on the way to this program, or dropped by its full queue.
    pub lost: u64,
    /// Frames without a wrench, because their force or contact point has no value.
    pub withheld: u64,
}

/// Finger of a bridge, in its own thread.
pub struct Finger {
    steady: Arc<ReconnectingClient>,
    shared: Arc<Shared>,
    outlets: Vec<Box<dyn Outlet>>,
    stamps: Timestamps,
    report: Report,
}

impl Finger {
    pub fn new(
        steady: Arc<ReconnectingClient>,
        shared: Arc<Shared>,
        outlets: Vec<Box<dyn Outlet>>,
    ) -> Self {
        let report = Report { port: steady.port().to_string(), ..Report::default() };
        Self { steady, shared, outlets, stamps: Timestamps::default(), report }
    }

    /// Publishes until the bridge or a playback ends.
    pub fn serve(mut self) -> anyhow::Result<Report> {
        let served = self.run();
        if served.is_err() {
            self.shared.stop.store(true, Ordering::Relaxed);
        }
        served.map(|()| self.report)
    }

    fn run(&mut self) -> anyhow::Result<()> {
        let echoes = RoundTrips::of(&self.steady);
        let mut client: Option<Arc<Client>> = None;
        let mut missed = false;
        while !self.shared.stop.load(Ordering::Relaxed) {
            match self.steady.next(LOOK) {
                Event::Frame(received) => {
                    echoes.try_iter().for_each(|echo| self.stamps.echo(echo));
                    self.publish(&received)?;
                }
                Event::Timeout | Event::Connecting => {}
                Event::Connected(there) => {
                    (client, missed) = (Some(Arc::clone(&there)), false);
                    self.stamps.reconnected();
                    if self.steady.bias_lost() {
                        let port = self.steady.port();
                        output::note(format_args!(
                            "{port}: the finger lost its bias; take it again"
                        ));
                    }
                    match self.set(&there) {
                        Ok(info) => self.there(&info)?,
                        // The finger was unplugged again, which the next event reports too.
                        Err(error) if matches!(error.problem(), Some(Problem::Unplugged(_))) => {}
                        Err(error) => return Err(error.into()),
                    }
                }
                // A recording or scene that fails does so each time.
                Event::Disconnected(error) if error.problem().is_none() => return Err(error.into()),
                Event::Disconnected(error) => {
                    client.take().iter().for_each(|client| self.count(client));
                    if !std::mem::replace(&mut missed, true) {
                        output::note(format_args!("{error}; waiting for it"));
                    }
                }
                Event::Ended => break,
            }
        }
        client.iter().for_each(|client| self.count(client));
        Ok(())
    }

    fn set(&self, client: &Client) -> Result<Info, LinkError> {
        if let Some(hz) = self.shared.rate {
            client.set_rate(hz)?;
        }
        if let Some(fields) = self.shared.fields {
            client.set_fields(fields)?;
        }
        // Earlier frames may have other fields than requested.
        while client.next(Duration::ZERO)?.is_some() {}
        self.steady.remember(client)
    }

    fn there(&mut self, info: &Info) -> anyhow::Result<()> {
        for outlet in &mut self.outlets {
            let name = outlet.there(self.steady.port(), info)?;
            if !self.report.names.contains(&name) {
                self.report.names.push(name);
            }
        }
        Ok(())
    }

    fn publish(&mut self, received: &Received) -> anyhow::Result<()> {
        self.stamps.frame(received);
        if self.report.names.is_empty() {
            return Ok(());
        }
        self.report.frames += 1;
        self.report.withheld += u64::from(ros::wrench(&received.frame).is_none());
        self.outlets.iter_mut().try_for_each(|outlet| outlet.frame(received, &self.stamps))
    }

    fn count(&mut self, client: &Client) {
        let counts = client.counts();
        self.report.lost += counts.lost + counts.overflow;
    }
}

/// Locks a mutex; a panic in another thread leaves its data usable.
pub fn lock<T>(mutex: &std::sync::Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

//! Stream of one finger in a bridge.

use std::sync::atomic::Ordering;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use taxel::frame::{Fields, Status};
use taxel::wire::message::Info;
use taxel_client::{
    Client, Counts, Event, LinkError, Port, Problem, Received, ReconnectingClient, RoundTrips,
    Timestamps,
};

use super::{LOOK, Shared, ros};
use crate::output;

/// Destination of a finger's frames.
pub trait Outlet: Send {
    /// Returns the fields that its messages need.
    fn needs(&self) -> Fields;
    /// Announces a connected finger, perhaps another than before, and returns its name.
    fn there(&mut self, port: &Port, info: &Info) -> anyhow::Result<String>;
    /// Announces the connected finger with other settings.
    fn changed(&mut self, _port: &Port, _: &Info) -> anyhow::Result<()> {
        Ok(())
    }
    /// Publishes a frame of the connected finger. `stamps` includes this frame already.
    fn frame(&mut self, received: &Received, stamps: &Timestamps) -> anyhow::Result<()>;
    /// Publishes the condition of the finger at `at`, about once a second.
    fn health(&mut self, _: &Health, _at: Duration) -> anyhow::Result<()> {
        Ok(())
    }
}

/// Interval of [`Outlet::health`].
const PULSE: Duration = Duration::from_secs(1);

/// Condition of a finger and its link.
#[derive(Clone, Copy, Default)]
pub struct Health<'p> {
    /// Reason why the finger is not connected.
    pub problem: Option<&'p str>,
    /// Flags of any frame of the last second.
    pub status: Status,
    /// Frames a second, over the last second.
    pub rate_hz: f64,
    /// Frames so far.
    pub frames: u64,
    /// Frames lost on the way to this program so far, and in the last second.
    pub lost: u64,
    pub newly_lost: u64,
    /// Frames dropped by this program's full queue so far.
    pub overflow: u64,
    /// Damaged packets so far.
    pub bad_packets: u64,
    /// Times that the finger was connected.
    pub connections: u64,
}

/// State of a second of [`Health`].
struct Pulse {
    began: Instant,
    frames: u64,
    status: Status,
    /// Counts of earlier connections.
    before: Counts,
    lost: u64,
    connections: u64,
    problem: Option<String>,
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
    /// Frames without a wrench, because their force, contact point or torsion has no value.
    pub withheld: u64,
}

/// Finger of a bridge, in its own thread.
pub struct Finger {
    steady: Arc<ReconnectingClient>,
    shared: Arc<Shared>,
    outlets: Vec<Box<dyn Outlet>>,
    /// State of the finger after each change by an outlet's service.
    changed: Receiver<Info>,
    stamps: Timestamps,
    pulse: Pulse,
    report: Report,
}

impl Finger {
    pub fn new(
        steady: Arc<ReconnectingClient>,
        shared: Arc<Shared>,
        outlets: Vec<Box<dyn Outlet>>,
        changed: Receiver<Info>,
    ) -> Self {
        let report = Report { port: steady.port().to_string(), ..Report::default() };
        let pulse = Pulse {
            began: Instant::now(),
            frames: 0,
            status: Status::empty(),
            before: Counts::default(),
            lost: 0,
            connections: 0,
            problem: None,
        };
        Self { steady, shared, outlets, changed, stamps: Timestamps::default(), pulse, report }
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
            while let Ok(info) = self.changed.try_recv() {
                let port = self.steady.port();
                self.outlets.iter_mut().try_for_each(|outlet| outlet.changed(port, &info))?;
            }
            self.beat(client.as_deref())?;
            match self.steady.next(LOOK) {
                Event::Frame(received) => {
                    echoes.try_iter().for_each(|echo| self.stamps.echo(echo));
                    self.publish(&received)?;
                }
                Event::Timeout | Event::Connecting => {}
                Event::Connected(there) => {
                    (client, missed) = (Some(Arc::clone(&there)), false);
                    self.stamps.reconnected();
                    self.pulse.connections += 1;
                    self.pulse.problem = None;
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
                    self.pulse.problem = Some(error.to_string());
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

    /// Applies the options of the command, once: later connections restore what was set since.
    /// Without --fields the finger's own and those that the outlets need are streamed.
    fn set(&self, client: &Client) -> Result<Info, LinkError> {
        let first = self.report.names.is_empty();
        if let Some(hz) = self.shared.rate.filter(|_| first) {
            client.set_rate(hz)?;
        }
        if first {
            let own = client.info()?.fields;
            let needed = self.outlets.iter().fold(own, |fields, outlet| fields | outlet.needs());
            match self.shared.fields {
                Some(fields) => client.set_fields(fields)?,
                None if needed == own => {}
                None => match client.set_fields(needed) {
                    // A recording without codes is played as it is.
                    Err(error) if matches!(error.problem(), Some(Problem::Refusal { .. })) => {}
                    set => set?,
                },
            }
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
        self.pulse.frames += 1;
        self.pulse.status |= received.frame.status;
        if self.report.names.is_empty() {
            return Ok(());
        }
        self.report.frames += 1;
        self.report.withheld += u64::from(ros::wrench(&received.frame).is_none());
        self.outlets.iter_mut().try_for_each(|outlet| outlet.frame(received, &self.stamps))
    }

    /// Publishes the condition of the finger if a second has passed.
    fn beat(&mut self, client: Option<&Client>) -> anyhow::Result<()> {
        let passed = self.pulse.began.elapsed();
        if passed < PULSE {
            return Ok(());
        }
        let counts = add(self.pulse.before, client.map_or_else(Counts::default, Client::counts));
        let health = Health {
            problem: self.pulse.problem.as_deref(),
            status: self.pulse.status,
            rate_hz: self.pulse.frames as f64 / passed.as_secs_f64(),
            frames: counts.frames,
            lost: counts.lost,
            newly_lost: counts.lost - self.pulse.lost,
            overflow: counts.overflow,
            bad_packets: counts.bad_packets,
            connections: self.pulse.connections,
        };
        let at = self.stamps.unix(Instant::now());
        self.outlets.iter_mut().try_for_each(|outlet| outlet.health(&health, at))?;
        self.pulse.began = Instant::now();
        self.pulse.lost = counts.lost;
        (self.pulse.frames, self.pulse.status) = (0, Status::empty());
        Ok(())
    }

    fn count(&mut self, client: &Client) {
        let counts = client.counts();
        self.pulse.before = add(self.pulse.before, counts);
        self.report.lost += counts.lost + counts.overflow;
    }
}

fn add(a: Counts, b: Counts) -> Counts {
    Counts {
        frames: a.frames + b.frames,
        lost: a.lost + b.lost,
        bad_packets: a.bad_packets + b.bad_packets,
        overflow: a.overflow + b.overflow,
    }
}

/// Locks a mutex; a panic in another thread leaves its data usable.
pub fn lock<T>(mutex: &std::sync::Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

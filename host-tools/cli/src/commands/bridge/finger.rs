//! One finger of a bridge.

use std::sync::atomic::Ordering;
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::bail;
use serde::Serialize;
use taxel::wire::message::Info;
use taxel_link::{Client, Echoes, Event, LinkError, Problem, Received, Stamps, Steady};

use super::graph::{Publisher, name};
use super::pipe::Order;
use super::{LOOK, Shared, ros};
use crate::output;

/// What became of a finger's frames.
#[derive(Default, Serialize)]
pub struct Report {
    pub port: String,
    /// What it was called. More than one where another finger was plugged in meanwhile.
    pub names: Vec<String>,
    pub frames: u64,
    /// Frames that never came: lost on the way to this program, or by it.
    pub lost: u64,
    /// Frames without a wrench: their force was withheld.
    pub withheld: u64,
}

/// A finger as a node.
struct Node {
    name: String,
    wrench: Topic,
    frames: Topic,
}

/// A publisher and how often it has published.
struct Topic {
    /// Its number on the other side of the pipe.
    number: u32,
    publisher: Publisher,
    samples: u64,
}

/// One finger, in its own thread.
pub struct Finger {
    steady: Arc<Steady>,
    shared: Arc<Shared>,
    /// The last is the one that is there.
    nodes: Vec<Node>,
    stamps: Stamps,
    report: Report,
}

impl Finger {
    pub fn new(steady: Arc<Steady>, shared: Arc<Shared>) -> Self {
        let report = Report { port: steady.port().to_string(), ..Report::default() };
        Self { steady, shared, nodes: Vec::new(), stamps: Stamps::default(), report }
    }

    /// Publishes until the bridge ends, or a playback does.
    pub fn serve(mut self) -> anyhow::Result<Report> {
        let served = self.run();
        if served.is_err() {
            self.shared.stop.store(true, Ordering::Relaxed);
        }
        served.map(|()| self.report)
    }

    fn run(&mut self) -> anyhow::Result<()> {
        let echoes = Echoes::of(&self.steady);
        let mut client: Option<Arc<Client>> = None;
        let mut missed = false;
        while !self.shared.stop.load(Ordering::Relaxed) {
            match self.steady.next(LOOK) {
                Event::Frame(received) => {
                    echoes.try_iter().for_each(|echo| self.stamps.echo(echo));
                    self.publish(&received)?;
                }
                Event::Quiet => {}
                Event::There(there) => {
                    (client, missed) = (Some(Arc::clone(&there)), false);
                    self.stamps.reconnected();
                    if self.steady.bias_lost() {
                        let port = self.steady.port();
                        output::note(format_args!("{port}: its bias is gone; take it again"));
                    }
                    match self.set(&there) {
                        Ok(info) => self.there(&info.identity.serial)?,
                        // It has gone again, which the next event says too.
                        Err(error) if matches!(error.problem(), Some(Problem::Unplugged(_))) => {}
                        Err(error) => return Err(error.into()),
                    }
                }
                Event::Gone(error) => {
                    client.take().iter().for_each(|client| self.count(client));
                    if !std::mem::replace(&mut missed, true) {
                        output::note(format_args!("{error}; waiting for it"));
                    }
                }
                Event::Over => break,
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
        // Frames from before have other fields than were asked for.
        while client.next(Duration::ZERO)?.is_some() {}
        self.steady.remember(client)
    }

    /// A finger of this serial number is there: a node, unless it was one before.
    fn there(&mut self, serial: &str) -> anyhow::Result<()> {
        let name = name(serial);
        if let Some(known) = self.nodes.iter().position(|node| node.name == name) {
            let node = self.nodes.remove(known);
            self.nodes.push(node);
            return Ok(());
        }
        let shared = Arc::clone(&self.shared);
        let mut names = lock(&shared.names);
        if names.contains(&name) {
            bail!(
                "{}: another finger is called {name} already; give each its own serial number",
                self.steady.port()
            );
        }
        names.push(name.clone());
        let mut numbers = lock(&shared.publishers);
        let context = &shared.context;
        // Three entities a finger, numbered over the whole session.
        let node = *numbers / 2 * 3;
        let topic = |i: u32, topic: &str, kind| Topic {
            number: *numbers + i,
            publisher: context.publisher(
                (node, &name),
                node + 1 + i,
                &context.namespace.topic(topic),
                kind,
            ),
            samples: 0,
        };
        let wrench = topic(0, &format!("{name}/wrench"), &ros::WRENCH);
        let frames = topic(1, "frames", &ros::FRAME);
        shared.pipe.send(&[
            Order::Token(&context.node(node, &name)),
            Order::Publisher(&wrench.publisher.key),
            Order::Token(&wrench.publisher.token),
            Order::Publisher(&frames.publisher.key),
            Order::Token(&frames.publisher.token),
        ])?;
        *numbers += 2;
        output::note(format_args!(
            "{}: node {}, topics {} and {}",
            self.steady.port(),
            context.namespace.topic(&name),
            context.namespace.topic(&format!("{name}/wrench")),
            context.namespace.topic("frames")
        ));
        self.report.names.push(name.clone());
        self.nodes.push(Node { name, wrench, frames });
        Ok(())
    }

    fn publish(&mut self, received: &Received) -> anyhow::Result<()> {
        self.stamps.frame(received);
        let Some(node) = self.nodes.last_mut() else { return Ok(()) };
        let scanned = self.stamps.scanned(received.frame.time);
        // Until the finger's clock is known, when it came is the best there is.
        let at = scanned.map_or(self.stamps.unix(received.at), |(at, _)| at);
        let now = self.stamps.unix(Instant::now());
        let wrench = ros::wrench(&received.frame, at, &node.name);
        let frame = ros::frame(&received.frame, at, &node.name);
        self.report.frames += 1;
        self.report.withheld += u64::from(wrench.is_none());
        let wrench = wrench.map(|payload| (node.wrench.next(now), payload));
        let attachment = node.frames.next(now);
        let mut orders = vec![node.frames.put(&attachment, &frame)];
        orders.extend(wrench.iter().map(|(a, payload)| node.wrench.put(a, payload)));
        Ok(self.shared.pipe.send(&orders)?)
    }

    fn count(&mut self, client: &Client) {
        let counts = client.counts();
        self.report.lost += counts.lost + counts.overflow;
    }
}

impl Topic {
    /// What goes with the next sample. They count from 1.
    fn next(&mut self, now: Duration) -> [u8; 33] {
        self.samples += 1;
        self.publisher.attachment(self.samples, now)
    }

    fn put<'o>(&self, attachment: &'o [u8], payload: &'o [u8]) -> Order<'o> {
        Order::Put { publisher: self.number, attachment, payload }
    }
}

fn lock<T>(mutex: &std::sync::Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

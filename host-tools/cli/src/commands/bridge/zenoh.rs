//! Fingers as nodes of a ROS 2 system, over Zenoh.

use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::bail;
use serde_json::json;
use taxel::wire::message::Info;
use taxel_client::{Port, Received, Timestamps};

use super::finger::{Outlet, lock};
use super::graph::{Context, Namespace, Publisher, name};
use super::peer::{Peer, Token, Writer};
use super::ros;
use crate::output;

/// The session that all fingers of a bridge share.
pub struct Session {
    context: Context,
    peer: Peer,
    /// Names of all fingers so far: no two may share one.
    names: Mutex<Vec<String>>,
}

impl Session {
    /// Opens it.
    ///
    /// # Errors
    /// Zenoh is not built in, or takes no such endpoints.
    pub fn open(
        domain: u32,
        namespace: Namespace,
        connect: &[String],
        listen: &[String],
    ) -> anyhow::Result<Arc<Self>> {
        let session = identity();
        let config = config(&session, connect, listen);
        let peer = Peer::open(&config)?;
        let context = Context { domain, session, namespace };
        Ok(Arc::new(Self { context, peer, names: Mutex::default() }))
    }
}

/// Nodes of one finger.
pub struct Nodes {
    session: Arc<Session>,
    /// The last is the one that is there.
    nodes: Vec<Node>,
}

/// A finger as a node.
struct Node {
    name: String,
    wrench: Topic,
    frames: Topic,
    _token: Token,
}

/// A publisher and how often it has published.
struct Topic {
    publisher: Publisher,
    writer: Writer,
    samples: u64,
    _token: Token,
}

impl Nodes {
    pub fn new(session: Arc<Session>) -> Self {
        Self { session, nodes: Vec::new() }
    }
}

impl Outlet for Nodes {
    /// A finger of this serial number is there: a node, unless it was one before.
    fn there(&mut self, port: &Port, info: &Info) -> anyhow::Result<String> {
        let name = name(&info.identity.serial);
        if let Some(known) = self.nodes.iter().position(|node| node.name == name) {
            self.nodes[known..].rotate_left(1);
            return Ok(name);
        }
        let Session { context, peer, names } = &*self.session;
        let mut names = lock(names);
        if names.contains(&name) {
            bail!(
                "{port}: another finger is called {name} already; give each its own serial number"
            );
        }
        // Three entities a finger, numbered over the whole session.
        let node = names.len() as u32 * 3;
        names.push(name.clone());
        let token = peer.token(&context.node(node, &name))?;
        let topic = |i: u32, topic: &str, kind| {
            let topic = context.namespace.topic(topic);
            let publisher = context.publisher((node, &name), node + 1 + i, &topic, kind);
            let writer = peer.writer(&publisher.key)?;
            let token = peer.token(&publisher.token)?;
            anyhow::Ok(Topic { publisher, writer, samples: 0, _token: token })
        };
        let wrench = topic(0, &format!("{name}/wrench"), &ros::WRENCH)?;
        let frames = topic(1, "frames", &ros::FRAME)?;
        output::note(format_args!(
            "{port}: node {}, topics {} and {}",
            context.namespace.topic(&name),
            context.namespace.topic(&format!("{name}/wrench")),
            context.namespace.topic("frames")
        ));
        self.nodes.push(Node { name: name.clone(), wrench, frames, _token: token });
        Ok(name)
    }

    fn frame(&mut self, received: &Received, stamps: &Timestamps) -> anyhow::Result<()> {
        let Some(node) = self.nodes.last_mut() else { return Ok(()) };
        let scanned = stamps.scanned(received.frame.time);
        // Until the finger's clock is known, when it came is the best there is.
        let at = scanned.map_or(stamps.unix(received.at), |(at, _)| at);
        let now = stamps.unix(Instant::now());
        let wrench = ros::wrench(&received.frame, at, &node.name);
        let frame = ros::frame(&received.frame, at, &node.name);
        node.frames.put(&frame, now)?;
        wrench.map_or(Ok(()), |wrench| node.wrench.put(&wrench, now))
    }
}

impl Topic {
    /// Publishes the next sample. Samples are numbered from 1.
    fn put(&mut self, payload: &[u8], now: Duration) -> anyhow::Result<()> {
        self.samples += 1;
        let attachment = self.publisher.attachment(self.samples, now);
        self.writer.put(payload, &attachment)
    }
}

/// A session's identity: 128 bits, the first of its digits not zero.
fn identity() -> String {
    let random = || RandomState::new().hash_one(std::process::id());
    format!("{:016x}{:016x}", random() | 1 << 63, random())
}

/// Session configuration of rmw_zenoh: peers that find each other through a router, without multicast.
fn config(session: &str, connect: &[String], listen: &[String]) -> String {
    json!({
        "id": session,
        "mode": "peer",
        "connect": {
            "endpoints": connect,
            "exit_on_failure": false,
            "timeout_ms": -1,
            // A router that is started later, or again, is found within a second.
            "retry": { "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 },
        },
        "listen": { "endpoints": listen },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": true } },
        // A millisecond, the default, is less than a reader may be held up by its operating system.
        "transport": { "link": { "tx": { "queue": { "congestion_control": {
            "drop": { "wait_before_drop": 50_000 }
        } } } } },
    })
    .to_string()
}

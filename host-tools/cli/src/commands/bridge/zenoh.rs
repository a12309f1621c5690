//! Publishes fingers as nodes of a ROS 2 system, over Zenoh.

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

/// Session shared by all fingers of a bridge.
pub struct Session {
    context: Context,
    peer: Peer,
    /// Names of all fingers so far. Each name belongs to one finger.
    names: Mutex<Vec<String>>,
}

impl Session {
    /// Opens the session.
    ///
    /// Zenoh is not built in, or an endpoint is invalid.
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
    /// Nodes so far; the last one is that of the connected finger.
    nodes: Vec<Node>,
}

/// ROS 2 node of a finger.
struct Node {
    name: String,
    wrench: Topic,
    frames: Topic,
    _token: Token,
}

/// Publisher with its count of samples.
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
    /// Adds a node for a new serial number; selects the existing one otherwise.
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
        // Time of reception until the finger's clock is known.
        let at = scanned.map_or(stamps.unix(received.at), |(at, _)| at);
        let now = stamps.unix(Instant::now());
        node.frames.put(&ros::frame(&received.frame, at, &node.name), now)?;
        let Some(wrench) = ros::wrench(&received.frame) else { return Ok(()) };
        node.wrench.put(&ros::wrench_stamped(wrench, at, &node.name), now)
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

/// Returns a random session id: 128 bits, first hexadecimal digit not zero.
fn identity() -> String {
    let random = || RandomState::new().hash_one(std::process::id());
    format!("{:016x}{:016x}", random() | 1 << 63, random())
}

/// Builds the session configuration of rmw_zenoh. Peers find each other through a router, without
/// multicast.
fn config(session: &str, connect: &[String], listen: &[String]) -> String {
    json!({
        "id": session,
        "mode": "peer",
        "connect": {
            "endpoints": connect,
            "exit_on_failure": false,
            "timeout_ms": -1,
            // A router that starts late or again is found within 1 s.
            "retry": { "period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5 },
        },
        "listen": { "endpoints": listen },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": true } },
        // The default of 1 ms is too short: the operating system may delay a reader longer.
        "transport": { "link": { "tx": { "queue": { "congestion_control": {
            "drop": { "wait_before_drop": 50_000 }
        } } } } },
    })
    .to_string()
}

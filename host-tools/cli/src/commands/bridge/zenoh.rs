//! Publishes fingers as nodes of a ROS 2 system, over Zenoh.

mod node;

use std::hash::{BuildHasher, RandomState};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::json;
use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_client::{Port, Received, Timestamps, fields};

use super::finger::{Health, Outlet};
use super::graph::{Context, Namespace, Qos, name};
use super::peer::Peer;
use super::ros;
use super::services::Services;
use super::tool::Tool;
use crate::output;
use node::Node;

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
        qos: Qos,
        connect: &[String],
        listen: &[String],
    ) -> anyhow::Result<Arc<Self>> {
        let session = identity();
        let config = config(&session, connect, listen);
        let peer = Peer::open(&config)?;
        let context = Context { domain, session, namespace, qos };
        Ok(Arc::new(Self { context, peer, names: Mutex::default() }))
    }
}

/// Nodes of one port's fingers.
pub struct Nodes {
    session: Arc<Session>,
    services: Services,
    tool: Option<Tool>,
    /// Nodes so far; the last one is that of the connected finger.
    nodes: Vec<Node>,
}

impl Nodes {
    pub fn new(session: Arc<Session>, services: Services, tool: Option<Tool>) -> Self {
        Self { session, services, tool, nodes: Vec::new() }
    }
}

impl Outlet for Nodes {
    fn needs(&self) -> Fields {
        ros::WRENCH_FIELDS
    }

    /// Adds a node for a new serial number; selects the existing one otherwise.
    fn there(&mut self, port: &Port, info: &Info) -> anyhow::Result<String> {
        let name: Arc<str> = name(&info.identity.serial).into();
        if let Some(known) = self.nodes.iter().position(|node| node.name == name) {
            self.nodes[known..].rotate_left(1);
        } else {
            let node = Node::announce(&self.session, &self.services, port, &name, info)?;
            let namespace = &self.session.context.namespace;
            output::note(format_args!(
                "{port}: node {}, topics {} and {}; `ros2 node info` lists all",
                namespace.topic(&name),
                namespace.topic(&format!("{name}/wrench")),
                namespace.topic("frames")
            ));
            self.nodes.push(node);
        }
        self.services.connected(Arc::clone(&name));
        self.changed(port, info)?;
        Ok(name.to_string())
    }

    fn changed(&mut self, port: &Port, info: &Info) -> anyhow::Result<()> {
        if !info.fields.contains(ros::WRENCH_FIELDS) {
            output::note(format_args!(
                "{port}: no wrench: the stream has the fields {}; it needs {}",
                fields::list(info.fields),
                fields::list(ros::WRENCH_FIELDS)
            ));
        }
        Ok(())
    }

    fn frame(&mut self, received: &Received, stamps: &Timestamps) -> anyhow::Result<()> {
        let Some(node) = self.nodes.last_mut() else { return Ok(()) };
        let scanned = stamps.scanned(received.frame.time);
        // Time of reception until the finger's clock is known.
        let at = scanned.map_or(stamps.unix(received.at), |(at, _)| at);
        node.frame(&received.frame, self.tool.as_ref(), at, stamps.unix(Instant::now()))
    }

    fn health(&mut self, health: &Health, at: Duration) -> anyhow::Result<()> {
        self.nodes.last_mut().map_or(Ok(()), |node| node.health(health, at))
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

//! ROS 2 node of one finger: its topics and services.

use std::sync::Arc;
use std::time::Duration;

use anyhow::bail;
use taxel::frame::Frame;
use taxel::wire::message::Info;
use taxel_client::Port;

use super::Session;
use crate::commands::bridge::finger::{Health, lock};
use crate::commands::bridge::graph::Publisher;
use crate::commands::bridge::peer::{Server, Token, Writer};
use crate::commands::bridge::ros::contact;
use crate::commands::bridge::ros::diagnostics::{DIAGNOSTICS, diagnostic_array};
use crate::commands::bridge::ros::services::Service;
use crate::commands::bridge::ros::{self, Type};
use crate::commands::bridge::services::{Services, Waiting};
use crate::commands::bridge::tool::Tool;
use crate::output;
use taxel_files::recording::Contact;

/// Entities of a node, itself included, numbered over the whole session.
const ENTITIES: u32 = 16;
/// Interval of markers and transforms, which people look at.
const DRAW: Duration = Duration::from_millis(20);

/// ROS 2 node of a finger.
pub(super) struct Node {
    pub name: Arc<str>,
    /// Name with its namespace.
    path: String,
    serial: String,
    wrench: Topic,
    frames: Topic,
    point: Topic,
    marker: Topic,
    tf: Topic,
    diagnostics: Topic,
    /// Time of the last marker.
    drawn: Duration,
    /// Whether the last marker was an arrow.
    arrow: bool,
    /// Whether the user was told that the finger measures no torsion.
    told: bool,
    _services: Vec<(Server, Token)>,
    _token: Token,
}

/// Publisher with its count of samples.
struct Topic {
    publisher: Publisher,
    writer: Writer,
    samples: u64,
    _token: Token,
}

impl Node {
    /// Announces the node of a finger.
    ///
    /// Another finger has this name, or the network fails.
    pub fn announce(
        session: &Session,
        services: &Services,
        port: &Port,
        name: &Arc<str>,
        info: &Info,
    ) -> anyhow::Result<Self> {
        let Session { context, peer, names } = session;
        let mut names = lock(names);
        if names.iter().any(|taken| **taken == **name) {
            bail!(
                "{port}: another finger is called {name} already; give each its own serial number"
            );
        }
        let node = names.len() as u32 * ENTITIES;
        names.push(name.to_string());
        let mut entities = node + 1..node + ENTITIES;
        let mut next = || entities.next().unwrap_or(node);
        let token = peer.token(&context.node(node, name))?;
        let mut topic = |topic: &str, kind: &Type| {
            let publisher = context.publisher((node, name), next(), topic, kind);
            let writer = peer.writer(&publisher.key)?;
            let token = peer.token(&publisher.token)?;
            anyhow::Ok(Topic { publisher, writer, samples: 0, _token: token })
        };
        let own = |part: &str| context.namespace.topic(&format!("{name}/{part}"));
        let wrench = topic(&own("wrench"), &ros::WRENCH)?;
        let frames = topic(&context.namespace.topic("frames"), &ros::FRAME)?;
        let point = topic(&own("contact_point"), &contact::POINT)?;
        let marker = topic(&own("marker"), &contact::MARKER)?;
        let tf = topic("/tf", &contact::TF)?;
        let diagnostics = topic("/diagnostics", &DIAGNOSTICS)?;
        let mut server = |service: Service| {
            let entry = context.server((node, name), next(), &own(service.name()), service.kind());
            let (calls, node) = (services.calls.clone(), Arc::clone(name));
            let server = peer.server(&entry.key, move |call| {
                // A caller beyond the queue gets no reply.
                let _ = calls.try_send(Waiting { node: Arc::clone(&node), service, call });
            })?;
            anyhow::Ok((server, peer.token(&entry.token)?))
        };
        let services = Service::ALL.into_iter().map(&mut server).collect::<Result<_, _>>()?;
        Ok(Self {
            name: Arc::clone(name),
            path: context.namespace.topic(name),
            serial: info.identity.serial.to_string(),
            wrench,
            frames,
            point,
            marker,
            tf,
            diagnostics,
            drawn: Duration::ZERO,
            arrow: false,
            told: false,
            _services: services,
            _token: token,
        })
    }

    /// Publishes what a frame has. `at` is the time of its scan.
    pub fn frame(
        &mut self,
        frame: &Frame,
        tool: Option<&Tool>,
        at: Duration,
        now: Duration,
    ) -> anyhow::Result<()> {
        let name = &*self.name;
        self.frames.put(&ros::frame(frame, at, name), now)?;
        if let Some(wrench) = ros::wrench(frame) {
            let stamped = match tool {
                None => ros::wrench_stamped(wrench, at, name),
                Some(tool) => {
                    ros::wrench_stamped(tool.wrench(wrench), at, &contact::tool_frame(name))
                }
            };
            self.wrench.put(&stamped, now)?;
            if ros::never_torsion(frame) && !std::mem::replace(&mut self.told, true) {
                output::note(format_args!(
                    "{name}: measures no torsion, because it has no array of force sensors that was \
                     calibrated with places or moments: its torque is r × F alone"
                ));
            }
        }
        let touched = Contact::of(frame);
        if let Some(touched) = &touched {
            self.point.put(&contact::point_stamped(touched, at, name), now)?;
        }
        if at.abs_diff(self.drawn) < DRAW {
            return Ok(());
        }
        self.drawn = at;
        if let Some(transforms) = contact::tf(touched.as_ref(), tool, at, name) {
            self.tf.put(&transforms, now)?;
        }
        let arrow = touched.as_ref().and_then(Contact::arrow).is_some();
        // The arrow of a contact that has ended is removed once.
        if arrow || std::mem::replace(&mut self.arrow, arrow) {
            self.arrow = arrow;
            self.marker.put(&contact::marker(touched.as_ref(), at, name), now)?;
        }
        Ok(())
    }

    /// Publishes the condition of the finger.
    pub fn health(&mut self, health: &Health, at: Duration) -> anyhow::Result<()> {
        let message = diagnostic_array(health, at, &self.path, &self.serial);
        self.diagnostics.put(&message, at)
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

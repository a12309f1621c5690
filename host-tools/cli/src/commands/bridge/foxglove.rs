//! Live fingers in Foxglove. A finger's frames have the topic and the messages of an MCAP
//! recording, so that a layout's plots serve both; a scene and a log have Foxglove's own schemas.

pub mod scene;

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_client::{Port, Received, Timestamps};
use taxel_files::frames::Cell;
use taxel_files::recording::schema;

use super::finger::Outlet;
use super::websocket::{self, Live, Standard};
use crate::files::{row, row_columns};
use crate::output;

/// Starts the server shared by all fingers of a bridge.
///
/// # Errors
/// The feature is not built in, or the address is taken.
pub fn start(address: &str) -> anyhow::Result<Arc<Live>> {
    let (server, address) = Live::start(address)?;
    output::note(format_args!("Foxglove: open connection, ws://{address}"));
    Ok(Arc::new(server))
}

/// Interval of scenes: 60 a second.
const DRAW: Duration = Duration::from_micros(16_666);

/// Topics of one finger.
pub struct Topics {
    server: Arc<Live>,
    channel: Option<Channel>,
    connection: u64,
    row: Vec<Cell>,
    message: Vec<u8>,
}

/// Topic of the finger that is connected.
struct Channel {
    topic: websocket::Channel,
    standard: Standard,
    serial: String,
    fields: Fields,
    flags: scene::Flags,
    /// Time of the last scene.
    drawn: Duration,
}

impl Topics {
    pub fn new(server: Arc<Live>) -> Self {
        Self { server, channel: None, connection: 0, row: Vec::new(), message: Vec::new() }
    }
}

impl Outlet for Topics {
    /// The scene's taxels are coloured by their signals.
    fn needs(&self) -> Fields {
        Fields::SIGNALS
    }

    fn there(&mut self, port: &Port, info: &Info) -> anyhow::Result<String> {
        self.connection += 1;
        self.changed(port, info)?;
        Ok(info.identity.serial.to_string())
    }

    /// Opens the topics again if the finger or its fields are other ones.
    fn changed(&mut self, port: &Port, info: &Info) -> anyhow::Result<()> {
        let serial = info.identity.serial.as_str();
        let same = |c: &Channel| c.serial == serial && c.fields == info.fields;
        if self.channel.as_ref().is_some_and(same) {
            return Ok(());
        }
        let topic = schema::topic(serial);
        let descriptor = schema::descriptor(&row_columns(info.fields));
        // Foxglove needs the old topic closed before one of the same name opens.
        drop(self.channel.take());
        let channel = self.server.channel(&topic, schema::NAME, descriptor).context("foxglove")?;
        output::note(format_args!("{port}: topics {topic}, {topic}/scene and {topic}/log"));
        self.channel = Some(Channel {
            topic: channel,
            standard: self.server.standard(&topic, serial),
            serial: serial.to_owned(),
            fields: info.fields,
            flags: scene::Flags::default(),
            drawn: Duration::ZERO,
        });
        Ok(())
    }

    fn frame(&mut self, received: &Received, stamps: &Timestamps) -> anyhow::Result<()> {
        let Some(channel) = &mut self.channel else { return Ok(()) };
        row(received, channel.fields, stamps, self.connection, &mut self.row);
        schema::encode(&self.row, &mut self.message);
        // Time of reception, as in a recording.
        let at = stamps.unix(received.at);
        let nanos = at.as_micros() as u64 * 1000;
        channel.topic.log(&self.message, nanos);
        for line in channel.flags.raised(&received.frame) {
            channel.standard.tell(&line, nanos);
        }
        if at.abs_diff(channel.drawn) >= DRAW {
            channel.drawn = at;
            let frame = &received.frame;
            channel.standard.draw(&scene::plates(frame), scene::arrow(frame), nanos);
        }
        Ok(())
    }
}

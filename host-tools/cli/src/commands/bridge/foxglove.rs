//! Live fingers in Foxglove, one topic each. Topics and messages are those of an MCAP recording, so
//! that one layout serves both.

use std::sync::Arc;

use anyhow::Context;
use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_client::{Port, Received, Timestamps};
use taxel_files::frames::Cell;
use taxel_files::recording::schema;

use super::finger::Outlet;
use super::websocket::{self, Live};
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
    serial: String,
    fields: Fields,
}

impl Topics {
    pub fn new(server: Arc<Live>) -> Self {
        Self { server, channel: None, connection: 0, row: Vec::new(), message: Vec::new() }
    }
}

impl Outlet for Topics {
    fn there(&mut self, port: &Port, info: &Info) -> anyhow::Result<String> {
        self.connection += 1;
        let serial = info.identity.serial.as_str();
        let same = |c: &Channel| c.serial == serial && c.fields == info.fields;
        if self.channel.as_ref().is_some_and(same) {
            return Ok(serial.to_owned());
        }
        let topic = schema::topic(serial);
        let descriptor = schema::descriptor(&row_columns(info.fields));
        // Foxglove needs the old topic closed before one of the same name opens.
        drop(self.channel.take());
        let channel = self.server.channel(&topic, schema::NAME, descriptor).context("foxglove")?;
        output::note(format_args!("{port}: topic {topic}"));
        let serial = serial.to_owned();
        self.channel =
            Some(Channel { topic: channel, serial: serial.clone(), fields: info.fields });
        Ok(serial)
    }

    fn frame(&mut self, received: &Received, stamps: &Timestamps) -> anyhow::Result<()> {
        let Some(channel) = &self.channel else { return Ok(()) };
        row(received, channel.fields, stamps, self.connection, &mut self.row);
        schema::encode(&self.row, &mut self.message);
        // Time of reception, as in a recording.
        let micros = stamps.unix(received.at).as_micros() as u64;
        channel.topic.log(&self.message, micros * 1000);
        Ok(())
    }
}

//! Live fingers in Foxglove, with the topics and the messages of an MCAP recording, so that a layout
//! serves both.

use std::sync::Arc;

use anyhow::Context;
use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_client::{Port, Received, Timestamps};
use taxel_files::frames::Cell;
use taxel_files::recording::foxglove::{self, Standard, TOPICS};
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
    standard: Standard,
    /// Channels of [`TOPICS`].
    standards: Vec<websocket::Channel>,
    serial: String,
    fields: Fields,
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
        let open = |topic: &str, name, descriptor| {
            self.server.channel(topic, name, descriptor).context("foxglove")
        };
        let channel = open(&topic, schema::NAME, descriptor)?;
        let standards = TOPICS.iter().enumerate().map(|(at, (end, name))| {
            open(&format!("{topic}{end}"), name, foxglove::descriptor(at))
        });
        let standards = standards.collect::<anyhow::Result<_>>()?;
        let ends = TOPICS.map(|(end, _)| end).join(", ");
        output::note(format_args!("{port}: topic {topic}, and below it {ends}"));
        self.channel = Some(Channel {
            topic: channel,
            standard: Standard::new(serial),
            standards,
            serial: serial.to_owned(),
            fields: info.fields,
        });
        Ok(())
    }

    fn frame(&mut self, received: &Received, stamps: &Timestamps) -> anyhow::Result<()> {
        let Some(channel) = &mut self.channel else { return Ok(()) };
        row(received, channel.fields, stamps, self.connection, &mut self.row);
        schema::encode(&self.row, &mut self.message);
        // Time of reception, as in a recording.
        let nanos = stamps.unix(received.at).as_micros() as u64 * 1000;
        channel.topic.log(&self.message, nanos);
        let standards = &channel.standards;
        channel.standard.messages(&received.frame, nanos, |topic, message| {
            standards[topic].log(message, nanos);
            Ok(())
        })
    }
}

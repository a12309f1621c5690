//! Fingers live in Foxglove: a topic each, of the messages that a recording in MCAP has, so that one layout
//! serves both.

use std::sync::{Arc, Mutex};

use taxel::frame::Fields;
use taxel::wire::message::Info;
use taxel_client::{Port, Received, Stamps};
use taxel_files::frames::Cell;
use taxel_files::recording::schema;

use super::finger::{Outlet, lock};
use super::pipe::{Order, Pipe};
use crate::files::{row, row_columns};
use crate::output;

/// The server that all fingers of a bridge share.
pub struct Server {
    pipe: Pipe,
    channels: Mutex<u32>,
}

impl Server {
    /// Starts it.
    ///
    /// # Errors
    /// It cannot be had, or the address is another program's.
    pub fn start(address: &str) -> anyhow::Result<Arc<Self>> {
        let hint = "is another program there? --foxglove HOST:PORT names another address";
        let (pipe, address) = Pipe::open(["foxglove", address], hint)?;
        output::note(format_args!("Foxglove: open connection, ws://{address}"));
        Ok(Arc::new(Self { pipe, channels: Mutex::default() }))
    }
}

/// One finger on it.
pub struct Topics {
    server: Arc<Server>,
    channel: Option<Channel>,
    connection: u64,
    row: Vec<Cell>,
    message: Vec<u8>,
}

/// What the finger that is there streams into.
struct Channel {
    number: u32,
    serial: String,
    fields: Fields,
}

impl Topics {
    pub fn new(server: Arc<Server>) -> Self {
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
        let mut channels = lock(&self.server.channels);
        self.server.pipe.send(&[Order::Channel {
            topic: &topic,
            schema: schema::NAME,
            descriptor: &descriptor,
        }])?;
        let (number, fields) = (*channels, info.fields);
        *channels += 1;
        output::note(format_args!("{port}: topic {topic}"));
        self.channel = Some(Channel { number, serial: serial.to_owned(), fields });
        Ok(serial.to_owned())
    }

    fn frame(&mut self, received: &Received, stamps: &Stamps) -> anyhow::Result<()> {
        let Some(channel) = &self.channel else { return Ok(()) };
        row(received, channel.fields, stamps, self.connection, &mut self.row);
        schema::encode(&self.row, &mut self.message);
        // As in the recording: when it came.
        let micros = stamps.unix(received.at).as_micros() as u64;
        let message = Order::Message {
            channel: channel.number,
            nanos: micros * 1000,
            payload: &self.message,
        };
        self.server.pipe.send(&[message])
    }
}

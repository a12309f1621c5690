//! Orders as channels and messages of a server that Foxglove connects to.

use std::sync::Arc;

use foxglove::{ChannelBuilder, PartialMetadata, RawChannel, Schema, WebSocketServer};

use crate::order::{self, Order};
use crate::{Failure, ready};

/// What a viewer may be behind before it loses the oldest: four seconds of the fastest finger.
const BACKLOG: usize = 1 << 14;

/// Serves until the pipe closes.
pub fn run(address: &str) -> Result<(), Failure> {
    let (host, port) = address.rsplit_once(':').ok_or("expected HOST:PORT")?;
    let server = WebSocketServer::new()
        .name("taxel")
        .bind(host.trim_matches(['[', ']']), port.parse()?)
        .message_backlog_size(BACKLOG)
        .start_blocking()?;
    let mut pipe = ready(&format!("{host}:{}", server.port()))?;
    let mut buffer = Vec::new();
    let mut channels: Vec<Arc<RawChannel>> = Vec::new();
    while let Some(order) = order::next(&mut pipe, &mut buffer)? {
        match order {
            Order::Channel { topic, schema, descriptor } => {
                let replaced = channels.iter().filter(|channel| channel.topic() == topic);
                replaced.for_each(|channel| channel.close());
                let channel = ChannelBuilder::new(topic)
                    .message_encoding("protobuf")
                    .schema(Schema::new(schema, "protobuf", descriptor.to_vec()));
                channels.push(channel.build_raw()?);
            }
            Order::Message { channel, nanos, payload } => {
                let channel = channels.get(channel as usize).ok_or("no such channel")?;
                channel.log_with_meta(payload, PartialMetadata::with_log_time(nanos));
            }
            Order::Token(_) | Order::Publisher(_) | Order::Put { .. } => {
                return Err("Foxglove has no publishers".into());
            }
        }
    }
    server.stop().wait_blocking();
    Ok(())
}

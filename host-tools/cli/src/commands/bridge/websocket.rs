//! Server that Foxglove connects to. Without the feature `foxglove`, starting a server is an error.

pub use server::{Channel, Live};

#[cfg(feature = "foxglove")]
mod server {
    use std::sync::Arc;

    use anyhow::{Context, Result, anyhow};
    use foxglove::{
        ChannelBuilder, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle,
    };

    /// Queued messages per viewer before the oldest is lost: 4 s at 4 kHz.
    const BACKLOG: usize = 1 << 14;

    /// Running server. Dropping it disconnects the viewers.
    pub struct Live(Option<WebSocketServerHandle>);

    /// Topic that is open until dropped.
    pub struct Channel(Arc<RawChannel>);

    impl Live {
        pub fn start(address: &str) -> Result<(Self, String)> {
            let (host, port) = address.rsplit_once(':').context("expected HOST:PORT")?;
            let server = WebSocketServer::new()
                .name("taxel")
                .bind(host.trim_matches(['[', ']']), port.parse()?)
                .message_backlog_size(BACKLOG)
                .start_blocking()
                .map_err(|error| {
                    let hint =
                        "is another program there? --foxglove HOST:PORT names another address";
                    anyhow!("foxglove: {error}; {hint}")
                })?;
            let address = format!("{host}:{}", server.port());
            Ok((Self(Some(server)), address))
        }

        /// Opens a topic of protobuf messages of one type.
        pub fn channel(&self, topic: &str, schema: &str, descriptor: Vec<u8>) -> Result<Channel> {
            let schema = Schema::new(schema, "protobuf", descriptor);
            let channel = ChannelBuilder::new(topic).message_encoding("protobuf").schema(schema);
            Ok(Channel(channel.build_raw()?))
        }
    }

    impl Drop for Live {
        fn drop(&mut self) {
            if let Some(server) = self.0.take() {
                server.stop().wait_blocking();
            }
        }
    }

    impl Channel {
        /// Sends one message with its time in nanoseconds since 1970.
        pub fn log(&self, message: &[u8], nanos: u64) {
            self.0.log_with_meta(message, PartialMetadata::with_log_time(nanos));
        }
    }

    impl Drop for Channel {
        fn drop(&mut self) {
            self.0.close();
        }
    }
}

#[cfg(not(feature = "foxglove"))]
mod server {
    use anyhow::Result;

    use crate::commands::bridge::not_built_in;

    pub enum Live {}
    pub enum Channel {}

    impl Live {
        pub fn start(_address: &str) -> Result<(Self, String)> {
            Err(not_built_in("foxglove"))
        }

        pub fn channel(
            &self,
            _topic: &str,
            _schema: &str,
            _descriptor: Vec<u8>,
        ) -> Result<Channel> {
            match *self {}
        }
    }

    impl Channel {
        pub fn log(&self, _message: &[u8], _nanos: u64) {
            match *self {}
        }
    }
}

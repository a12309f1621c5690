//! Server that Foxglove connects to. Without the feature `foxglove`, starting a server is an error.

pub use server::{Channel, Live, Standard};

#[cfg(feature = "foxglove")]
mod server {
    use std::sync::Arc;

    use anyhow::{Context, Result, anyhow};
    use foxglove::messages::{
        ArrowPrimitive, Color, CubePrimitive, Log, Pose, Quaternion, SceneEntity, SceneUpdate,
        Timestamp, Vector3, log,
    };
    use foxglove::{
        ChannelBuilder, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle,
    };

    use crate::commands::bridge::foxglove::scene::{Arrow, Line, Plate};

    /// Queued messages per viewer before the oldest is lost: 4 s at 4 kHz.
    const BACKLOG: usize = 1 << 14;

    /// Running server. Dropping it disconnects the viewers.
    pub struct Live(Option<WebSocketServerHandle>);

    /// Topic that is open until dropped.
    pub struct Channel(Arc<RawChannel>);

    /// Topics of one finger with Foxglove's own schemas, open until dropped.
    pub struct Standard {
        serial: String,
        scene: foxglove::Channel<SceneUpdate>,
        log: foxglove::Channel<Log>,
    }

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

        /// Opens the topics `<topic>/scene` and `<topic>/log`.
        pub fn standard(&self, topic: &str, serial: &str) -> Standard {
            Standard {
                serial: serial.to_owned(),
                scene: ChannelBuilder::new(format!("{topic}/scene")).build(),
                log: ChannelBuilder::new(format!("{topic}/log")).build(),
            }
        }
    }

    impl Standard {
        /// Draws the finger; what was drawn before disappears.
        pub fn draw(&self, plates: &[Plate], arrow: Option<Arrow>, nanos: u64) {
            let entity = SceneEntity {
                timestamp: Some(stamp(nanos)),
                frame_id: self.serial.clone(),
                id: "finger".to_owned(),
                frame_locked: true,
                cubes: plates.iter().map(cube).collect(),
                arrows: arrow.into_iter().map(primitive).collect(),
                ..SceneEntity::default()
            };
            let update = SceneUpdate { deletions: Vec::new(), entities: vec![entity] };
            self.scene.log_with_meta(&update, PartialMetadata::with_log_time(nanos));
        }

        /// Writes a line of the log.
        pub fn tell(&self, line: &Line, nanos: u64) {
            let level = if line.fault { log::Level::Error } else { log::Level::Warning };
            let line = Log {
                timestamp: Some(stamp(nanos)),
                level: level.into(),
                message: line.text.clone(),
                name: self.serial.clone(),
                ..Log::default()
            };
            self.log.log_with_meta(&line, PartialMetadata::with_log_time(nanos));
        }
    }

    impl Drop for Standard {
        fn drop(&mut self) {
            self.scene.close();
            self.log.close();
        }
    }

    fn stamp(nanos: u64) -> Timestamp {
        const SECOND: u64 = 1_000_000_000;
        Timestamp::new(u32::try_from(nanos / SECOND).unwrap_or(u32::MAX), (nanos % SECOND) as u32)
    }

    fn vector([x, y, z]: [f64; 3]) -> Option<Vector3> {
        Some(Vector3 { x, y, z })
    }

    fn pose(place: [f64; 3], [x, y, z, w]: [f64; 4]) -> Option<Pose> {
        Some(Pose { position: vector(place), orientation: Some(Quaternion { x, y, z, w }) })
    }

    fn cube(plate: &Plate) -> CubePrimitive {
        let [r, g, b, a] = plate.colour;
        CubePrimitive {
            pose: pose(plate.middle, [0.0, 0.0, 0.0, 1.0]),
            size: vector(plate.size),
            color: Some(Color { r, g, b, a }),
        }
    }

    /// Draws an arrow whose head takes at most a third of it.
    fn primitive(Arrow { tail, turn, length }: Arrow) -> ArrowPrimitive {
        let head_length = (length / 3.0).min(0.003);
        ArrowPrimitive {
            pose: pose(tail, turn),
            shaft_length: length - head_length,
            shaft_diameter: 0.001,
            head_length,
            head_diameter: 0.002,
            color: Some(Color { r: 0.1, g: 0.75, b: 0.3, a: 1.0 }),
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

    use crate::commands::bridge::foxglove::scene::{Arrow, Line, Plate};
    use crate::commands::bridge::not_built_in;

    pub enum Live {}
    pub enum Channel {}
    pub enum Standard {}

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

        pub fn standard(&self, _topic: &str, _serial: &str) -> Standard {
            match *self {}
        }
    }

    impl Standard {
        pub fn draw(&self, _plates: &[Plate], _arrow: Option<Arrow>, _nanos: u64) {
            match *self {}
        }

        pub fn tell(&self, _line: &Line, _nanos: u64) {
            match *self {}
        }
    }

    impl Channel {
        pub fn log(&self, _message: &[u8], _nanos: u64) {
            match *self {}
        }
    }
}

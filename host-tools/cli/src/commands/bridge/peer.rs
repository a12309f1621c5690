//! Session of a Zenoh network. Without the feature `zenoh`, opening a session is an error.

pub use session::{Peer, Token, Writer};

#[cfg(feature = "zenoh")]
mod session {
    use anyhow::{Error, Result, anyhow};
    use zenoh::liveliness::LivelinessToken;
    use zenoh::pubsub::Publisher;
    use zenoh::qos::CongestionControl;
    use zenoh::{Config, Session, Wait};

    /// Open session. Drop tokens and writers first, so that the network hears that they are gone.
    pub struct Peer(Session);

    /// Liveliness token; other peers see its key until it is dropped.
    pub struct Token(#[expect(dead_code, reason = "held for its drop")] LivelinessToken);

    /// Publisher on one key.
    pub struct Writer(Publisher<'static>);

    impl Peer {
        pub fn open(config: &str) -> Result<Self> {
            let session = Config::from_json5(config).and_then(|config| zenoh::open(config).wait());
            let failed = |error| anyhow!("zenoh: {error}; check --connect and --listen");
            session.map(Self).map_err(failed)
        }

        pub fn token(&self, key: &str) -> Result<Token> {
            let token = self.0.liveliness().declare_token(key.to_owned()).wait();
            token.map(Token).map_err(Error::from_boxed)
        }

        pub fn writer(&self, key: &str) -> Result<Writer> {
            // Congestion drops samples, so that a slow reader delays nobody else; sample numbers
            // show the loss.
            let publisher = self.0.declare_publisher(key.to_owned());
            let publisher = publisher.congestion_control(CongestionControl::Drop).wait();
            publisher.map(Writer).map_err(Error::from_boxed)
        }
    }

    impl Writer {
        pub fn put(&self, payload: &[u8], attachment: &[u8]) -> Result<()> {
            self.0.put(payload).attachment(attachment).wait().map_err(Error::from_boxed)
        }
    }
}

#[cfg(not(feature = "zenoh"))]
mod session {
    use anyhow::Result;

    use crate::commands::bridge::not_built_in;

    pub enum Peer {}
    pub enum Token {}
    pub enum Writer {}

    impl Peer {
        pub fn open(_config: &str) -> Result<Self> {
            Err(not_built_in("zenoh"))
        }

        pub fn token(&self, _key: &str) -> Result<Token> {
            match *self {}
        }

        pub fn writer(&self, _key: &str) -> Result<Writer> {
            match *self {}
        }
    }

    impl Writer {
        pub fn put(&self, _payload: &[u8], _attachment: &[u8]) -> Result<()> {
            match *self {}
        }
    }
}

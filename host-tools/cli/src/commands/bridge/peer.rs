//! Session of a Zenoh network. Without the feature `zenoh`, opening a session is an error.

pub use session::{Call, Peer, Server, Token, Writer};

#[cfg(feature = "zenoh")]
mod session {
    use std::time::Duration;

    use anyhow::{Error, Result, anyhow};
    use zenoh::liveliness::LivelinessToken;
    use zenoh::pubsub::Publisher;
    use zenoh::qos::CongestionControl;
    use zenoh::query::{Query, Queryable};
    use zenoh::{Config, Session, Wait};

    use crate::commands::bridge::graph::reply_attachment;

    /// Open session. Drop tokens and writers first, so that the network hears that they are gone.
    pub struct Peer(Session);

    /// Liveliness token; other peers see its key until it is dropped.
    pub struct Token(#[expect(dead_code, reason = "held for its drop")] LivelinessToken);

    /// Publisher on one key.
    pub struct Writer(Publisher<'static>);

    /// Server of the requests on one key.
    pub struct Server(#[expect(dead_code, reason = "held for its drop")] Queryable<()>);

    /// Request that waits for its reply.
    pub struct Call(Query);

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

        /// Hands requests to `take`, which must not wait.
        pub fn server(
            &self,
            key: &str,
            take: impl Fn(Call) + Send + Sync + 'static,
        ) -> Result<Server> {
            let server = self.0.declare_queryable(key.to_owned()).complete(true);
            let server = server.callback(move |query| take(Call(query))).wait();
            server.map(Server).map_err(Error::from_boxed)
        }
    }

    impl Call {
        /// Returns the request; empty if it has no payload.
        pub fn payload(&self) -> Vec<u8> {
            self.0.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default()
        }

        /// Sends the reply. A caller that is gone does not receive it.
        pub fn reply(&self, payload: &[u8], at: Duration) {
            let attachment = self.0.attachment().map(|attachment| attachment.to_bytes());
            let attachment = attachment.and_then(|request| reply_attachment(&request, at));
            let reply = self.0.reply(self.0.key_expr(), payload);
            let _ = match attachment {
                Some(attachment) => reply.attachment(attachment).wait(),
                None => reply.wait(),
            };
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
    use std::time::Duration;

    use anyhow::Result;

    use crate::commands::bridge::not_built_in;

    pub enum Peer {}
    pub enum Token {}
    pub enum Writer {}
    pub enum Server {}
    pub enum Call {}

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

        pub fn server(
            &self,
            _key: &str,
            _take: impl Fn(Call) + Send + Sync + 'static,
        ) -> Result<Server> {
            match *self {}
        }
    }

    impl Call {
        pub fn payload(&self) -> Vec<u8> {
            match *self {}
        }

        pub fn reply(&self, _payload: &[u8], _at: Duration) {
            match *self {}
        }
    }

    impl Writer {
        pub fn put(&self, _payload: &[u8], _attachment: &[u8]) -> Result<()> {
            match *self {}
        }
    }
}

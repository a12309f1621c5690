//! Hosts at a TCP port: one is served, the others are told so.
//!
//! The first packet of a host must ask for the version, as that of every client does. A browser
//! sends HTTP to any port that a web page names, and its body could hold requests; but it begins
//! with a line of text, which is no packet.

use std::convert::Infallible;
use std::io;
use std::time::Duration;

use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Command, Message, Refusal, Request};
use taxel::wire::{MAX_PACKET, pack};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

/// Longest time from connection to the end of the first packet.
const PATIENCE: Duration = Duration::from_secs(2);
/// Most hosts that may owe their first packet at a time.
const MOST: usize = 32;
/// Time in which a host that leaves makes room for the next one.
const HANDOVER: Duration = Duration::from_millis(200);

/// Connected host that has asked for the version.
pub(super) struct Host {
    pub stream: TcpStream,
    /// Bytes of the request, which is still to be answered.
    pub request: Vec<u8>,
    tag: u8,
}

/// Port with the hosts that have come.
pub(super) struct Hosts {
    listener: TcpListener,
    arriving: JoinSet<Option<Host>>,
    waiting: Option<Host>,
}

impl Hosts {
    pub(super) fn new(listener: std::net::TcpListener) -> io::Result<Self> {
        let listener = TcpListener::from_std(listener)?;
        Ok(Self { listener, arriving: JoinSet::new(), waiting: None })
    }

    /// Waits for the next host.
    pub(super) async fn next(&mut self) -> io::Result<Host> {
        match self.waiting.take() {
            Some(host) => Ok(host),
            None => self.arrival().await,
        }
    }

    /// Answers every host that another one is connected, as long as it is polled.
    pub(super) async fn refuse(&mut self) -> Infallible {
        loop {
            if let Ok(host) = self.arrival().await {
                self.waiting = Some(host);
            }
            sleep(HANDOVER).await;
            if let Some(host) = self.waiting.take() {
                host.refuse().await;
            }
        }
    }

    async fn arrival(&mut self) -> io::Result<Host> {
        loop {
            tokio::select! {
                accepted = self.listener.accept(), if self.arriving.len() < MOST => {
                    let first = Host::first_packet(accepted?.0);
                    self.arriving.spawn(async { timeout(PATIENCE, first).await.ok()? });
                }
                arrived = self.arriving.join_next(), if !self.arriving.is_empty() => {
                    if let Some(Ok(Some(host))) = arrived {
                        return Ok(host);
                    }
                }
            }
        }
    }
}

impl Host {
    /// Reads the first packet; `None` unless it asks for the version.
    async fn first_packet(mut stream: TcpStream) -> Option<Self> {
        stream.set_nodelay(true).ok()?;
        taxel_client::keep_alive(&stream).ok()?;
        let mut deframer = Deframer::<MAX_PACKET>::default();
        let mut request = Vec::new();
        while request.len() <= MAX_PACKET {
            let byte = stream.read_u8().await.ok()?;
            request.push(byte);
            if let Some(packet) = deframer.push::<Request>(byte) {
                let Request { tag, command } = packet.ok()?;
                return (command == Command::Version).then_some(Self { stream, request, tag });
            }
        }
        None
    }

    async fn refuse(mut self) {
        let mut buffer = [0; MAX_PACKET];
        let busy = Message::Reply { tag: self.tag, result: Err(Refusal::Busy) };
        if let Ok(packet) = pack(&busy, &mut buffer) {
            // A host that has left needs no answer.
            let _ = self.stream.write_all(packet).await;
            let _ = self.stream.shutdown().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn served_host_is_probed_when_silent() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let _client = std::net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (host, _) = listener.accept().unwrap();
        let same = host.try_clone().unwrap();
        host.set_nonblocking(true).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let host = Host::first_packet(TcpStream::from_std(host).unwrap());
            assert!(timeout(Duration::from_millis(50), host).await.is_err(), "it says nothing");
        });
        let probes = socket2::SockRef::from(&same);
        assert!(probes.keepalive().unwrap());
        assert_eq!(probes.tcp_keepalive_time().unwrap(), Duration::from_secs(10));
        assert_eq!(probes.tcp_keepalive_interval().unwrap(), Duration::from_secs(5));
        assert_eq!(probes.tcp_keepalive_retries().unwrap(), 3);
        #[cfg(target_os = "linux")]
        assert_eq!(probes.tcp_user_timeout().unwrap(), Some(Duration::from_secs(25)));
    }
}

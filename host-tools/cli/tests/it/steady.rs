//! Tests of reconnecting to a finger that is unplugged and plugged in again.

use std::io::Read;
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use taxel_cli::VirtualFinger;
use taxel_client::{Event, Port, ReconnectingClient};

use crate::fingers::*;

/// Time limit from plugging in to the first frame.
const RECONNECT: Duration = Duration::from_secs(1);

/// Waits for a frame.
fn streams(steady: &ReconnectingClient) {
    let deadline = Instant::now() + PATIENCE;
    while !matches!(steady.next(Duration::from_millis(50)), Event::Frame(_)) {
        assert!(Instant::now() < deadline, "no frame");
    }
}

/// Waits until the finger counts as disconnected.
fn gone(steady: &ReconnectingClient) {
    let deadline = Instant::now() + PATIENCE;
    while !matches!(steady.next(Duration::from_millis(50)), Event::Disconnected(_)) {
        assert!(Instant::now() < deadline, "still there");
    }
}

#[test]
fn power_loss_restores_settings_within_1_s() {
    let mut finger = on_tcp(still());
    let (host, number) = address(finger.port());
    let address = (host.to_owned(), number);
    let steady = ReconnectingClient::new(finger.port().clone());
    streams(&steady);
    let client = steady.client().unwrap();
    client.take_bias(50).unwrap();
    client.set_rate(500).unwrap();
    client.set_filter(20).unwrap();
    assert!(steady.remember(&client).unwrap().biased && !steady.bias_lost());
    drop(client);
    // Three trials, because a busy machine may delay one of them.
    let took = (0..3).map(|_| {
        drop(std::mem::replace(&mut finger, on_tcp(still())));
        gone(&steady);
        finger = VirtualFinger::on_tcp((address.0.as_str(), address.1), still(), None).unwrap();
        let ready = Instant::now();
        streams(&steady);
        ready.elapsed()
    });
    let quickest = took.min().unwrap();
    assert!(quickest < RECONNECT, "{quickest:?}");
    let info = steady.client().unwrap().info().unwrap();
    assert_eq!((info.rate_millihertz, info.filter_hz, info.biased), (500_000, 20, false));
    assert!(steady.bias_lost());
}

#[test]
fn bias_survives_reconnect_without_power_loss() {
    let finger = on_tcp(still());
    let client = connect(&finger);
    client.take_bias(50).unwrap();
    drop(client);
    let steady = ReconnectingClient::new(finger.port().clone());
    streams(&steady);
    assert!(steady.client().unwrap().info().unwrap().biased && !steady.bias_lost());
}

/// Reconnects to a board that accepts connections but does not answer while it starts.
#[test]
fn silent_port_is_retried_within_1_s() {
    let finger = on_tcp(still());
    let (host, number) = address(finger.port());
    let upstream = (host.to_owned(), number);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port =
        Port::Tcp { host: "127.0.0.1".to_owned(), port: listener.local_addr().unwrap().port() };
    let (accepted, connections) = channel();
    std::thread::spawn(move || {
        for (number, host) in listener.incoming().map(Result::unwrap).enumerate() {
            accepted.send((Instant::now(), host.try_clone().unwrap())).unwrap();
            if (1..4).contains(&number) {
                // Does not answer until the host has given up.
                let _ = (&host).read_to_end(&mut Vec::new());
                continue;
            }
            let finger = TcpStream::connect((upstream.0.as_str(), upstream.1)).unwrap();
            let (mut from_host, mut to_finger) =
                (host.try_clone().unwrap(), finger.try_clone().unwrap());
            std::thread::spawn(move || std::io::copy(&mut from_host, &mut to_finger));
            std::thread::spawn(move || std::io::copy(&mut &finger, &mut &host));
        }
    });
    let steady = ReconnectingClient::new(port);
    streams(&steady);
    let (_, first) = connections.recv().unwrap();
    first.shutdown(std::net::Shutdown::Both).unwrap();
    gone(&steady);
    streams(&steady);
    let tried: Vec<_> = connections.try_iter().map(|(at, _)| at).collect();
    assert!(tried.len() >= 4, "three deaf, and one that answers: {}", tried.len());
    let quickest = tried.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap();
    assert!(quickest < RECONNECT, "{quickest:?}");
}

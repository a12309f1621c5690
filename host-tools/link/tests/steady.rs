//! A finger that goes and comes back, in the eyes of whoever waits for it.

mod support;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use support::*;
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Status};
use taxel::units::FullScale;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{
    BoardHealth, Command, Cost, Counters, Identity, Info, Message, PROTOCOL, Request, Response,
    ScanSettings,
};
use taxel::wire::{MAX_PACKET, pack};
use taxel_link::{Event, Port, Steady, VirtualFinger};

/// How long a finger that is there again may take to its first frame.
const RECONNECT: Duration = Duration::from_secs(1);

/// Until there is a frame.
fn streams(steady: &Steady) {
    let deadline = Instant::now() + PATIENCE;
    while !matches!(steady.next(Duration::from_millis(50)), Event::Frame(_)) {
        assert!(Instant::now() < deadline, "no frame");
    }
}

/// Until it is noticed that there will be none.
fn gone(steady: &Steady) {
    let deadline = Instant::now() + PATIENCE;
    while !matches!(steady.next(Duration::from_millis(50)), Event::Gone(_)) {
        assert!(Instant::now() < deadline, "still there");
    }
}

#[test]
fn a_finger_that_lost_its_power_streams_again_within_a_second_as_it_was_set_but_for_its_bias() {
    let mut finger = on_tcp(still());
    let (host, number) = address(finger.port());
    let address = (host.to_owned(), number);
    let steady = Steady::new(finger.port().clone(), None);
    streams(&steady);
    let client = steady.client().unwrap();
    client.take_bias(50).unwrap();
    client.set_rate(500).unwrap();
    client.set_filter(20).unwrap();
    assert!(steady.remember(&client).unwrap().biased && !steady.bias_lost());
    drop(client);
    // A machine that was busy with something else is busy once, not every time.
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
fn a_finger_that_kept_its_power_kept_its_bias() {
    let finger = on_tcp(still());
    let client = connect(&finger);
    client.take_bias(50).unwrap();
    drop(client);
    let steady = Steady::new(finger.port().clone(), None);
    streams(&steady);
    assert!(steady.client().unwrap().info().unwrap().biased && !steady.bias_lost());
}

/// A board that is there already, and hears nothing while it starts.
#[test]
fn a_port_that_opens_and_says_nothing_is_tried_again_within_a_second() {
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
                // Deaf until the host has given up.
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
    let steady = Steady::new(port, None);
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

/// What a board does with requests, without its firmware: it scans as it is told until its power goes, which
/// `ClearBias` stands for here.
fn board(listener: &TcpListener, asked: &Sender<Command>) {
    for mut host in listener.incoming().map(Result::unwrap) {
        let mut scan = ScanSettings { scan_hz: 4000, oversampling: 1, settle_ns: 5000 };
        let mut deframer = Deframer::<MAX_PACKET>::default();
        let mut byte = [0];
        while host.read_exact(&mut byte).is_ok() {
            let Some(Ok(Request { tag, command })) = deframer.push::<Request>(byte[0]) else {
                continue;
            };
            asked.send(command.clone()).unwrap();
            let result = Ok(match command {
                Command::ClearBias => break,
                Command::Info => Response::Info(info(scan.scan_hz)),
                Command::Health => {
                    Response::Health(BoardHealth { scan: Some(scan), ..BoardHealth::default() })
                }
                Command::SetRate { .. } => Response::Rate { millihertz: 500_000 },
                Command::SetScan(settings) => {
                    scan = settings;
                    Response::Done
                }
                _ => Response::Done,
            });
            let answer = match command {
                Command::Version => Message::Version { tag, protocol: PROTOCOL, firmware: [0; 3] },
                _ => Message::Reply { tag, result },
            };
            host.write_all(pack(&answer, &mut [0; MAX_PACKET]).unwrap()).unwrap();
        }
    }
}

fn info(scan_hz: u16) -> Info {
    Info {
        identity: Identity {
            board: Default::default(),
            serial: Default::default(),
            build: Default::default(),
            scan_hz,
            full_scale: FullScale::BITS_12,
            tick_hz: 1,
        },
        rate_millihertz: 500_000,
        fields: Fields::ESTIMATES,
        streaming: false,
        point_method: PointMethod::default(),
        biased: false,
        calibration: None,
        counters: Counters::default(),
        cost: Cost::default(),
        estimators: Status::default(),
        filter_hz: 0,
    }
}

#[test]
fn a_board_that_lost_its_power_scans_as_it_did_before_its_rate_is_set() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port =
        Port::Tcp { host: "127.0.0.1".to_owned(), port: listener.local_addr().unwrap().port() };
    let (asked, commands) = channel();
    std::thread::spawn(move || board(&listener, &asked));
    let steady = Steady::new(port, None);
    let there = || {
        let deadline = Instant::now() + PATIENCE;
        loop {
            assert!(Instant::now() < deadline, "not there");
            if let Event::There(client) = steady.next(Duration::from_millis(50)) {
                break client;
            }
        }
    };
    let client = there();
    let slow = ScanSettings { scan_hz: 500, oversampling: 16, settle_ns: 20_000 };
    client.set_scan(slow).unwrap();
    steady.remember(&client).unwrap();
    commands.try_iter().for_each(drop);
    assert!(client.clear_bias().is_err());
    gone(&steady);
    let client = there();
    assert_eq!(client.health().unwrap().scan, Some(slow));
    let asked: Vec<_> = commands.try_iter().collect();
    let place = |wanted: &Command| asked.iter().position(|command| command == wanted).unwrap();
    assert!(place(&Command::SetScan(slow)) < place(&Command::SetRate { hz: 500 }), "{asked:?}");
}

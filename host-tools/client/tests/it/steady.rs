//! Tests of a finger that is unplugged and plugged in again, played by a script.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Status};
use taxel::scan::ScanSettings;
use taxel::units::FullScale;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{
    BoardHealth, Command, Cost, Counters, Identity, Info, Message, PROTOCOL, Request, Response,
};
use taxel::wire::{MAX_PACKET, pack};
use taxel_client::{Event, Port, ReconnectingClient};

/// Time limit of a wait. Only a failing test reaches it.
const PATIENCE: Duration = Duration::from_secs(20);

/// Waits until the finger counts as disconnected.
fn gone(steady: &ReconnectingClient) {
    let deadline = Instant::now() + PATIENCE;
    while !matches!(steady.next(Duration::from_millis(50)), Event::Disconnected(_)) {
        assert!(Instant::now() < deadline, "still there");
    }
}

/// Answers requests as a board does, without its firmware. `ClearBias` stands for a loss of power.
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
fn scan_settings_are_restored_before_rate() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port =
        Port::Tcp { host: "127.0.0.1".to_owned(), port: listener.local_addr().unwrap().port() };
    let (asked, commands) = channel();
    std::thread::spawn(move || board(&listener, &asked));
    let steady = ReconnectingClient::new(port);
    let there = || {
        let deadline = Instant::now() + PATIENCE;
        loop {
            assert!(Instant::now() < deadline, "not there");
            if let Event::Connected(client) = steady.next(Duration::from_millis(50)) {
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

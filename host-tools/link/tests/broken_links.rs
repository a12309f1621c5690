//! What a client makes of links that are not as they should be.

mod support;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Instant;

use support::*;
use taxel::frame::Fields;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Command, Message, PROTOCOL, Request};
use taxel::wire::{MAX_PACKET, pack};
use taxel_link::{Client, LinkError, Port, Problem};

/// A server that does as `behave` says with its first connection.
fn server(behave: impl FnOnce(TcpStream) + Send + 'static) -> Port {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || behave(listener.accept().unwrap().0));
    Port::Tcp { host: "127.0.0.1".to_owned(), port }
}

/// The tag of the next request.
fn tag(host: &mut TcpStream) -> u8 {
    let mut deframer = Deframer::<MAX_PACKET>::default();
    let mut byte = [0];
    loop {
        host.read_exact(&mut byte).unwrap();
        if let Some(Ok(request)) = deframer.push::<Request>(byte[0]) {
            return request.tag;
        }
    }
}

fn open_error(port: &Port) -> LinkError {
    let error = Client::open(port, None).err().unwrap();
    assert!(!error.to_string().contains('\n'), "{error}");
    error
}

fn packed(message: &impl serde::Serialize) -> Vec<u8> {
    pack(message, &mut [0; MAX_PACKET]).unwrap().to_vec()
}

#[test]
fn a_pulled_cable_is_an_error_of_its_own_and_no_hang() {
    for finger in on_every_link() {
        let client = connect(&finger);
        client.stream(true).unwrap();
        frames(&client, 100);
        drop(finger);
        let deadline = Instant::now() + PATIENCE;
        let end = std::iter::repeat_with(|| client.next(PATIENCE)).find_map(Result::err).unwrap();
        assert!(Instant::now() < deadline);
        assert!(matches!(end.problem(), Some(Problem::Unplugged(_))), "{end}");
        let asked = client.info().unwrap_err();
        assert!(matches!(asked.problem(), Some(Problem::Unplugged(_))), "{asked}");
    }
}

#[test]
fn garbage_before_the_first_packet_and_half_a_packet_do_no_harm() {
    let finger = on_tcp(still());
    let upstream = TcpStream::connect(address(finger.port())).unwrap();
    let port = server(move |mut host| {
        host.write_all(b"Booting...\r\n\x00\x07\x01half a packet").unwrap();
        let (mut from_host, mut to_finger) = (host.try_clone().unwrap(), upstream);
        let mut from_finger = to_finger.try_clone().unwrap();
        to_finger.write_all(b"AT+GMI\r\n").unwrap();
        std::thread::spawn(move || std::io::copy(&mut from_host, &mut to_finger));
        let _ = std::io::copy(&mut from_finger, &mut host);
    });
    let client = Client::open(&port, None).unwrap();
    client.stream(true).unwrap();
    frames(&client, 100);
    assert_eq!(client.counts().lost, 0);
    // The finger counts what it could not read of the host's garbage.
    assert_eq!(client.info().unwrap().counters.bad_packets, 1);
}

#[test]
fn whoever_does_not_answer_is_no_finger() {
    let port = server(|mut host| {
        let _ = host.read_to_end(&mut Vec::new());
    });
    let error = open_error(&port);
    assert_eq!(error.problem(), Some(&Problem::Silent));
    assert!(error.to_string().contains("is it a taxel finger"), "{error}");
}

#[test]
fn another_protocol_is_named_and_not_guessed_at() {
    let port = server(|mut host| {
        let tag = tag(&mut host);
        let answer = Message::Version { tag, protocol: 7, firmware: [3, 2, 1] };
        let _ = host.write_all(&packed(&answer));
        let _ = host.read_to_end(&mut Vec::new());
    });
    let error = open_error(&port);
    assert_eq!(error.problem(), Some(&Problem::Protocol { theirs: 7, firmware: [3, 2, 1] }));
    assert!(error.to_string().contains("firmware 3.2.1"), "{error}");
    assert!(error.to_string().contains("update this program"), "{error}");
}

#[test]
fn an_answer_lost_on_the_way_is_asked_for_again() {
    let port = server(|mut host| {
        let lost = tag(&mut host);
        let tag = tag(&mut host);
        assert_eq!(tag, lost);
        let answer = Message::Version { tag, protocol: PROTOCOL, firmware: [0, 1, 0] };
        let _ = host.write_all(&packed(&answer));
        let _ = host.read_to_end(&mut Vec::new());
    });
    assert_eq!(Client::open(&port, None).unwrap().version().firmware, [0, 1, 0]);
}

#[test]
fn nobody_at_the_address_no_such_device_and_a_file_are_told_apart() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let nobody = Port::Tcp { host: "127.0.0.1".to_owned(), port };
    assert_eq!(open_error(&nobody).problem(), Some(&Problem::Refused));

    let missing = open_error(&"/dev/no-such-finger".parse().unwrap());
    assert!(matches!(missing.problem(), Some(Problem::Missing(_))), "{missing}");
    assert!(missing.to_string().starts_with("/dev/no-such-finger: no such device; there "));

    let file = tempfile::NamedTempFile::new().unwrap();
    let error = open_error(&Port::Serial(file.path().display().to_string()));
    assert_eq!(error.problem(), Some(&Problem::NotADevice));

    let error = open_error(&Port::File("no-such-trace.csv".into()));
    assert!(error.to_string().starts_with("no-such-trace.csv: "), "{error}");
}

#[cfg(unix)]
#[test]
fn a_second_program_finds_the_device_busy() {
    let finger = taxel_link::VirtualFinger::on_pty(still(), None).unwrap();
    let _first = connect(&finger);
    assert_eq!(open_error(finger.port()).problem(), Some(&Problem::Busy));
}

#[cfg(unix)]
#[test]
fn a_host_that_does_not_read_loses_frames_which_are_counted_while_the_scan_goes_on() {
    let finger = taxel_link::VirtualFinger::on_pty(still(), None).unwrap();
    let name = finger.port().to_string();
    let mut deaf = std::fs::File::options().write(true).open(name).unwrap();
    let commands = [
        Command::SetFields(Fields::ALL),
        Command::SetRate { hz: SCAN_HZ as u16 },
        Command::Stream(true),
    ];
    for (tag, command) in (0..).zip(commands) {
        deaf.write_all(&packed(&Request { tag, command })).unwrap();
    }
    // Some hundred kilobytes a second: sooner or later no buffer on the way holds them.
    let mut pause = std::time::Duration::from_secs(1);
    let client = loop {
        std::thread::sleep(pause);
        let client = connect(&finger);
        if client.info().unwrap().counters.lost > 0 {
            break client;
        }
        pause *= 2;
    };
    let before = client.info().unwrap().counters;
    assert!(before.lost <= before.frames && before.frames <= before.scans);
    // Whoever reads again, and asks for no more than the link carries, loses nothing.
    client.set_fields(Fields::ESTIMATES).unwrap();
    client.set_rate(1000).unwrap();
    client.stream(true).unwrap();
    frames(&client, 500);
    assert_eq!(client.counts().lost, 0);
    assert!(client.info().unwrap().counters.scans > before.scans);
}

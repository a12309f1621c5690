//! Tests of a virtual finger behind a link that is cut, noisy, busy or unread.

use std::io::Write;
use std::net::TcpListener;
use std::time::Instant;

use taxel::frame::Fields;
use taxel::wire::message::{Command, Request};
use taxel::wire::{MAX_PACKET, pack};
use taxel_cli::VirtualFinger;
use taxel_client::{Client, Port, Problem};

use crate::fingers::*;

fn packed(message: &impl serde::Serialize) -> Vec<u8> {
    pack(message, &mut [0; MAX_PACKET]).unwrap().to_vec()
}

#[test]
fn pulled_cable_is_reported_as_unplugged() {
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

/// A serial server in front of the finger, behind a program that spoke to both first.
#[cfg(unix)]
#[test]
fn leading_garbage_loses_no_frame() {
    let finger = VirtualFinger::on_pty(still(), None).unwrap();
    let mut options = std::fs::File::options();
    let upstream = options.read(true).write(true).open(finger.port().to_string()).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let number = listener.local_addr().unwrap().port();
    let port = Port::Tcp { host: "127.0.0.1".to_owned(), port: number };
    std::thread::spawn(move || {
        let mut host = listener.accept().unwrap().0;
        host.write_all(b"Booting...\r\n\x00\x07\x01half a packet").unwrap();
        let (mut from_host, mut to_finger) = (host.try_clone().unwrap(), upstream);
        let mut from_finger = to_finger.try_clone().unwrap();
        to_finger.write_all(b"AT+GMI\r\n").unwrap();
        std::thread::spawn(move || std::io::copy(&mut from_host, &mut to_finger));
        let _ = std::io::copy(&mut from_finger, &mut host);
    });
    let client = Client::open(&port).unwrap();
    client.stream(true).unwrap();
    frames(&client, 100);
    assert_eq!(client.counts().lost, 0);
    // The finger counts the host's garbage as bad packets.
    assert_eq!(client.info().unwrap().counters.bad_packets, 1);
}

#[cfg(unix)]
#[test]
fn second_program_finds_device_busy() {
    let finger = VirtualFinger::on_pty(still(), None).unwrap();
    let _first = connect(&finger);
    let busy = Client::open(finger.port()).err().unwrap();
    assert_eq!(busy.problem(), Some(&Problem::Busy));
}

#[cfg(unix)]
#[test]
fn unread_frames_are_counted_as_lost() {
    let finger = VirtualFinger::on_pty(still(), None).unwrap();
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
    // At some 100 kB/s every buffer on the way overflows at last.
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
    // A host that reads again, within the link's capacity, loses nothing.
    client.set_fields(Fields::ESTIMATES).unwrap();
    client.set_rate(1000).unwrap();
    client.stream(true).unwrap();
    frames(&client, 500);
    assert_eq!(client.counts().lost, 0);
    assert!(client.info().unwrap().counters.scans > before.scans);
}

//! Tests of the served board whose virtual time waits for its client.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::mpsc::channel;
use std::time::Duration;

use taxel::scan::ScanSettings;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Command, Message, Request};
use taxel::wire::{MAX_PACKET, pack};

use taxel_emulator::board::cpu::Board;
use taxel_emulator::board::finger::{Finger, Pace};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::model::Model;
use taxel_emulator::board::server::Server;

use crate::support::{image, scene};

/// Number of bytes compared: some hundred frames.
const BYTES: usize = 10_000;

/// Serves a replaying board and returns its port's number.
fn served() -> u16 {
    let (says, said) = channel();
    std::thread::spawn(move || {
        let finger = Finger::new(scene(), Pace::Replay);
        let board = Board::new(Model::G431, &image(Model::G431), finger, Host::new(false)).unwrap();
        let mut server = Server::new(board, "127.0.0.1:0").unwrap();
        says.send(server.greeting().unwrap()).unwrap();
        server.replay().unwrap();
    });
    let greeting = said.recv().unwrap();
    greeting.split([':', ' ']).nth(2).unwrap().parse().unwrap()
}

/// Starts a stream on a connection to `port`; pauses before each request and sends it `times`
/// times. Returns all bytes, replies and frames.
fn streamed(port: u16, pause: Duration, times: usize) -> Vec<u8> {
    let mut link = TcpStream::connect(("127.0.0.1", port)).unwrap();
    let settings = ScanSettings { scan_hz: 1_000, oversampling: 4, settle_ns: 20_000 };
    let commands = [
        Command::Version,
        Command::Stream(true),
        Command::Info,
        Command::SetScan(settings),
        Command::Health,
    ];
    let mut bytes = Vec::new();
    for (tag, command) in (1..).zip(commands) {
        std::thread::sleep(pause);
        let mut buffer = [0; MAX_PACKET];
        let packet = pack(&Request { tag, command }, &mut buffer).unwrap();
        for _ in 0..times {
            link.write_all(&[&[0], packet].concat()).unwrap();
        }
        let mut messages = Deframer::<MAX_PACKET>::default();
        loop {
            let mut byte = [0];
            link.read_exact(&mut byte).unwrap();
            bytes.extend(byte);
            match messages.push::<Message>(byte[0]) {
                None | Some(Ok(Message::Frame(_))) => {}
                Some(Ok(Message::Reply { result: Err(refusal), .. })) => panic!("{refusal:?}"),
                Some(Ok(_)) => break,
                Some(Err(error)) => panic!("{error:?}"),
            }
        }
    }
    link.shutdown(Shutdown::Write).unwrap();
    let begun = bytes.len();
    bytes.resize(begun + BYTES, 0);
    link.read_exact(&mut bytes[begun..]).unwrap();
    bytes
}

#[test]
fn replay_is_the_same_however_slow_its_client() {
    let quick = streamed(served(), Duration::ZERO, 1);
    let slow = streamed(served(), Duration::from_millis(37), 3);
    assert!(quick == slow);
}

#[test]
fn replaying_board_serves_one_client_after_the_other() {
    let port = served();
    for _ in 0..2 {
        streamed(port, Duration::ZERO, 1);
    }
}

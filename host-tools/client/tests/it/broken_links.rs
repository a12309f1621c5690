//! Tests of the client on faulty links.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};

use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Message, PROTOCOL, Refusal, Request, Response};
use taxel::wire::{MAX_PACKET, pack};
use taxel_client::{Client, LinkError, Port, Problem};

/// Starts a server that handles its first connection by `behave`.
fn server(behave: impl FnOnce(TcpStream) + Send + 'static) -> Port {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || behave(listener.accept().unwrap().0));
    Port::Tcp { host: "127.0.0.1".to_owned(), port }
}

/// Reads the tag of the next request.
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
    let error = Client::open(port).err().unwrap();
    assert!(!error.to_string().contains('\n'), "{error}");
    error
}

fn packed(message: &impl serde::Serialize) -> Vec<u8> {
    pack(message, &mut [0; MAX_PACKET]).unwrap().to_vec()
}

#[test]
fn silent_server_is_reported_as_no_reply() {
    let port = server(|mut host| {
        let _ = host.read_to_end(&mut Vec::new());
    });
    let error = open_error(&port);
    assert_eq!(error.problem(), Some(&Problem::NoReply));
    assert!(error.to_string().contains("is it a taxel finger"), "{error}");
}

#[test]
fn other_protocol_version_is_refused() {
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
fn lost_reply_is_requested_again() {
    let port = server(|mut host| {
        let lost = tag(&mut host);
        let tag = tag(&mut host);
        assert_eq!(tag, lost);
        let answer = Message::Version { tag, protocol: PROTOCOL, firmware: [0, 1, 0] };
        let _ = host.write_all(&packed(&answer));
        let _ = host.read_to_end(&mut Vec::new());
    });
    assert_eq!(Client::open(&port).unwrap().version().firmware, [0, 1, 0]);
}

#[test]
fn open_errors_name_their_cause() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let nobody = Port::Tcp { host: "127.0.0.1".to_owned(), port };
    assert_eq!(open_error(&nobody).problem(), Some(&Problem::Refused));

    let missing = open_error(&"/dev/no-such-finger".parse().unwrap());
    assert!(matches!(missing.problem(), Some(Problem::NoSuchDevice(_))), "{missing}");
    assert!(missing.to_string().starts_with("/dev/no-such-finger: no such device; there "));

    let file = tempfile::NamedTempFile::new().unwrap();
    let error = open_error(&Port::Serial(file.path().display().to_string()));
    assert_eq!(error.problem(), Some(&Problem::NotADevice));

    let error = open_error(&Port::File("press.csv".into()));
    assert!(
        error.to_string().starts_with("file:press.csv: played by the `taxel` command"),
        "{error}"
    );
}

#[test]
fn programs_begin_with_different_tags() {
    let first = || {
        let (told, tags) = std::sync::mpsc::channel();
        let port = server(move |mut host| {
            let tag = tag(&mut host);
            told.send(tag).unwrap();
            let answer = Message::Version { tag, protocol: PROTOCOL, firmware: [0, 1, 0] };
            let _ = host.write_all(&packed(&answer));
        });
        drop(Client::open(&port).unwrap());
        tags.recv().unwrap()
    };
    // Equal by chance once in 256^9 runs.
    let tags: Vec<u8> = (0..10).map(|_| first()).collect();
    assert!(tags.iter().any(|tag| *tag != tags[0]), "{tags:?}");
}

#[test]
fn late_reply_to_an_earlier_program_is_dropped() {
    let port = server(|mut host| {
        let tag = tag(&mut host);
        let late = |tag| packed(&Message::Reply { tag, result: Err(Refusal::NotStill) });
        // An earlier program had any other tag, and asked for a bias.
        for other in (0..=u8::MAX).filter(|other| *other != tag) {
            host.write_all(&late(other)).unwrap();
        }
        let answer = Message::Version { tag, protocol: PROTOCOL, firmware: [0, 1, 0] };
        host.write_all(&packed(&answer)).unwrap();
        let tag = self::tag(&mut host);
        host.write_all(&late(tag.wrapping_sub(1))).unwrap();
        host.write_all(&packed(&Message::Reply { tag, result: Ok(Response::Done) })).unwrap();
        let _ = host.read_to_end(&mut Vec::new());
    });
    let client = Client::open(&port).unwrap();
    assert_eq!(client.version().firmware, [0, 1, 0]);
    client.clear_bias().unwrap();
}

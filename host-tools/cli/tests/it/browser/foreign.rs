//! Pages of another origin: nothing that a browser lets them try changes a finger.

use std::io::{Read, Write};
use std::net::TcpListener;

use serde_json::{Value, json};
use taxel::frame::Fields;
use taxel::wire::message::{Command, Info, Request};
use taxel::wire::{MAX_PACKET, pack};
use taxel_client::{Client, Port};

use super::stream::tapped;
use super::{Browser, finger};

/// Rate that the attacks ask for, in hertz.
const ASKED: u16 = 80;

/// Attempts of a page: requests, a socket that gives orders, and a frame.
///
/// Returns the addresses whose sockets opened.
const ATTACK: &str = "async (addresses, packet, order) => {
    const opened = [];
    const wait = (ms) => new Promise((done) => setTimeout(done, ms));
    const bodies = [new Uint8Array(packet), new URLSearchParams({ order }), order];
    for (const address of addresses) {
        for (const body of bodies) {
            const request = { method: 'POST', mode: 'no-cors', body, signal: AbortSignal.timeout(300) };
            await fetch('http://' + address, request).catch(() => {});
        }
        for (const protocol of [[], ['foxglove.sdk.v1']]) {
            const socket = new WebSocket('ws://' + address, protocol);
            socket.onopen = () => {
                opened.push(address);
                socket.send(order);
                socket.send(new Uint8Array(packet));
            };
            await Promise.race([new Promise((done) => { socket.onerror = done }), wait(500)]);
            socket.close();
        }
        const frame = document.createElement('iframe');
        frame.src = 'http://' + address;
        document.body.append(frame);
    }
    await wait(500);
    return [...new Set(opened)];
}";

/// Serves an empty page; returns its address.
fn foreign_page() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let _ = stream.read(&mut [0; 4096]);
            let page = "<!doctype html><title>foreign</title>";
            let _ = write!(
                stream,
                "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: {}\r\n\r\n{page}",
                page.len()
            );
        }
    });
    address
}

/// Order of the page for a rate, and the finger's own packet for it between zeros.
fn order_and_packet() -> (String, Vec<u8>) {
    let order = json!({ "order": "rate", "hz": ASKED }).to_string();
    let mut buffer = [0; MAX_PACKET];
    let request = Request { tag: 1, command: Command::SetRate { hz: ASKED } };
    let packet = pack(&request, &mut buffer).unwrap();
    (order, [&[0], packet, &[0]].concat())
}

/// Attacks these addresses from the page that is open; returns those whose sockets opened.
fn attack(browser: &mut Browser, addresses: &[String]) -> Value {
    let (order, packet) = order_and_packet();
    browser.value(&format!("({ATTACK})({}, {}, {})", json!(addresses), json!(packet), json!(order)))
}

/// Settings in a finger's answer; whether it streams depends on the moment.
fn settings(info: Info) -> impl PartialEq + std::fmt::Debug {
    let Info { rate_millihertz, fields, point_method, biased, filter_hz, calibration, .. } = info;
    (rate_millihertz, fields, point_method, biased, filter_hz, calibration)
}

fn address(port: &Port) -> String {
    let Port::Tcp { host, port } = port else { panic!("{port} is not TCP") };
    format!("{host}:{port}")
}

/// Opens a page of another origin.
fn visit(page: &str) -> Browser {
    let mut browser = Browser::blank(600, 400);
    browser.go(&format!("http://{page}/"));
    browser.wait_for("document.title === 'foreign'");
    browser
}

#[test]
fn foreign_page_changes_nothing_through_view() {
    let folder = tempfile::tempdir().unwrap();
    let finger = finger("idle");
    let tapped = tapped(&finger, 1000, Fields::ESTIMATES, folder.path());
    let before = settings(tapped.client.info().unwrap());
    let url = tapped.server.url();
    let own = url.trim_start_matches("http://").trim_end_matches('/');
    let page = foreign_page();

    let mut browser = visit(&page);
    let addresses = ["", "/finger/0", "/fingers"].map(|path| format!("{own}{path}"));
    assert_eq!(
        attack(&mut browser, &[addresses.as_slice(), std::slice::from_ref(&page)].concat()),
        json!([])
    );
    // Another page can be framed, this one cannot.
    let framed = browser.frames();
    assert!(framed.iter().any(|url| url.contains(&page)), "{framed:?}");
    assert!(!framed.iter().any(|url| url.contains(own)), "{framed:?}");

    // A foreign name that leads to this machine.
    let port = own.rsplit(':').next().unwrap();
    browser.go(&format!("http://rebound.test:{port}/"));
    browser.wait_for("document.body?.textContent.includes('give it to --listen')");
    let rebound = ["", "/finger/0"].map(|path| format!("rebound.test:{port}{path}"));
    assert_eq!(attack(&mut browser, &rebound), json!([]));
    assert_eq!(settings(tapped.client.info().unwrap()), before);

    // An order like that from the page that is served there.
    browser.show(&url);
    let stream = format!("{own}/finger/0");
    assert_eq!(attack(&mut browser, std::slice::from_ref(&stream)), json!([stream]));
    assert_ne!(settings(tapped.client.info().unwrap()), before);
    tapped.end();
}

#[test]
fn foreign_page_changes_nothing_through_serve() {
    let finger = finger("idle");
    let own = address(finger.port());
    let before = settings(Client::open(finger.port()).unwrap().info().unwrap());
    let mut browser = visit(&foreign_page());
    assert_eq!(attack(&mut browser, &[own]), json!([]));
    drop(browser);
    let client = Client::open(finger.port()).unwrap();
    assert_eq!(settings(client.info().unwrap()), before);
    // The packet is a valid one.
    client.set_rate(ASKED).unwrap();
    assert_ne!(settings(client.info().unwrap()), before);
}

#[cfg(feature = "foxglove")]
#[test]
fn foreign_page_changes_nothing_through_bridge() {
    use std::io::{BufRead, BufReader};

    let folder = tempfile::tempdir().unwrap();
    let finger = finger("idle");
    let port = finger.port().to_string();
    let args = ["bridge", "--foxglove", "127.0.0.1:0", "--port", &port];
    // The bridge adds signals to the fields, sooner or later than it is killed.
    let fields = Fields::ESTIMATES | Fields::SIGNALS;
    Client::open(finger.port()).unwrap().set_fields(fields).unwrap();
    let run = |attacked: bool| {
        let mut bridge = crate::common::In(folder.path()).command(&args).spawn().unwrap();
        let mut said = BufReader::new(bridge.stderr.take().unwrap()).lines().map_while(Result::ok);
        let own = said.find_map(|line| Some(line.split_once("ws://")?.1.to_owned())).unwrap();
        if attacked {
            let mut browser = visit(&foreign_page());
            // Every page may read the stream.
            assert_eq!(attack(&mut browser, std::slice::from_ref(&own)), json!([own]));
        }
        bridge.kill().unwrap();
        bridge.wait().unwrap();
        settings(Client::open(finger.port()).unwrap().info().unwrap())
    };
    assert_eq!(run(false), run(true));
}

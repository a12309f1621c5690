//! Attacks on the page server: its memory stays bounded, and other pages are answered.
//!
//! `TAXEL_LONG=1` runs the long form: a thousand pages and slow clients, a million orders.

use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::process::Stdio;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use serde_json::Value;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket, connect};

use crate::common::{In, Running, long_form};

/// Largest resident memory of the command, in kB.
const MEMORY: u64 = 64 << 10;
/// Longest time to an answer for another page.
const ANSWER: Duration = Duration::from_secs(1);
/// Orders of a page after which its flood has begun: more than wait in the server.
const UNDER_WAY: usize = 500;
/// Pages that the server serves at once.
const PAGES: usize = 32;

/// Clients of each kind, and orders of each page of the flood.
fn scale() -> (usize, usize) {
    if long_form() { (1000, 1_000_000 / 16) } else { (300, 2_000) }
}

/// `taxel view` of a virtual finger.
struct Command {
    process: Running,
    address: String,
    _folder: tempfile::TempDir,
}

impl Command {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = concat!("sim:", env!("CARGO_MANIFEST_DIR"), "/tests/scenes/idle.toml");
        let args = ["view", "--port", scene, "--listen", "127.0.0.1:0", "--no-browser"];
        let mut process =
            In(folder.path()).command(&args).stderr(Stdio::inherit()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut url).unwrap();
        let address = url.trim().trim_start_matches("http://").trim_end_matches('/').to_owned();
        Self { process: Running(process), address, _folder: folder }
    }

    fn page(&self) -> Page {
        let (socket, _) = connect(format!("ws://{}/finger/0", self.address)).unwrap();
        Page(socket)
    }

    /// Largest resident memory so far, in kB.
    fn memory(&self) -> u64 {
        let status =
            std::fs::read_to_string(format!("/proc/{}/status", self.process.0.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }

    /// Takes a file of the page; returns the time that it took.
    fn opens(&self) -> Duration {
        let begun = Instant::now();
        let mut stream = TcpStream::connect(&self.address).unwrap();
        let host = &self.address;
        write!(stream, "GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        begun.elapsed()
    }
}

struct Page(WebSocket<MaybeTlsStream<TcpStream>>);

impl Page {
    fn send(&mut self, order: &str) -> tungstenite::Result<()> {
        self.0.send(Message::text(order))
    }

    fn read(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.0.read().unwrap() {
                return serde_json::from_str(text.as_str()).unwrap();
            }
        }
    }

    /// Gives an order; returns the time to its outcome.
    fn order(&mut self, order: &str) -> Duration {
        let begun = Instant::now();
        self.send(order).unwrap();
        loop {
            let message = self.read();
            assert_eq!(message["failed"], Value::Null);
            if message["done"].is_string() {
                return begun.elapsed();
            }
        }
    }

    /// Waits until frames arrive; returns their losses.
    fn lost(&mut self) -> u64 {
        self.lost_of(100)
    }

    /// Waits until more frames than these have arrived; returns the losses.
    fn lost_of(&mut self, most: u64) -> u64 {
        loop {
            let message = self.read();
            assert_eq!(message["trouble"], Value::Null);
            if message["frames"].as_u64().is_some_and(|frames| frames > most) {
                return message["lost"].as_u64().unwrap();
            }
        }
    }
}

#[test]
fn slow_headers_keep_nobody_out() {
    let (clients, _) = scale();
    let command = Command::start();
    let mut page = command.page();
    page.lost();
    let slow: Vec<_> = (0..clients)
        .map(|_| {
            let mut stream = TcpStream::connect(&command.address).unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ").unwrap();
            stream
        })
        .collect();
    let opened = command.opens();
    let answered = page.order(r#"{"order":"rate","hz":900}"#);
    // A header that is never finished ends its connection in five seconds.
    let mut last = slow.last().unwrap();
    last.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let begun = Instant::now();
    let mut rest = Vec::new();
    let ended = last.read_to_end(&mut rest);
    let closed = begun.elapsed();
    assert!(
        !ended.is_err_and(|error| matches!(
            error.kind(),
            ErrorKind::WouldBlock | ErrorKind::TimedOut
        )),
        "a slow header is still waited for"
    );
    println!(
        "{clients} slow headers: opened in {opened:?}, answered in {answered:?}, closed after \
         {closed:?}, {} kB, {} lost",
        command.memory(),
        page.lost()
    );
    assert!(opened < ANSWER && answered < ANSWER, "{opened:?}, {answered:?}");
    assert!(closed < Duration::from_secs(8), "{closed:?}");
    assert!(command.memory() < MEMORY);
    assert_eq!(page.lost(), 0);
}

#[test]
fn many_idle_pages_leave_memory_bounded() {
    let (clients, _) = scale();
    let command = Command::start();
    let mut page = command.page();
    page.lost();
    // They never read. Those beyond the limit are told so and closed.
    let mut idle: Vec<_> = (0..clients).map(|_| command.page()).collect();
    // Unfinished frames that announce 16 MiB, and some that announce nothing unusual.
    for (i, page) in idle.iter_mut().enumerate() {
        let MaybeTlsStream::Plain(stream) = page.0.get_mut() else { unreachable!() };
        let length = if i % 2 == 0 { [0, 0, 0, 0, 1, 0, 0, 0] } else { [0, 0, 0, 0, 0, 0, 15, 0] };
        let _ = stream.write_all(&[0x81, 0xff]);
        let _ = stream.write_all(&length).and_then(|()| stream.write_all(&[0; 2000]));
    }
    let opened = command.opens();
    let answered = page.order(r#"{"order":"rate","hz":900}"#);
    let lost = page.lost_of(3000);
    println!(
        "{clients} idle pages: opened in {opened:?}, answered in {answered:?}, {} kB, {lost} lost",
        command.memory()
    );
    assert!(opened < ANSWER && answered < ANSWER, "{opened:?}, {answered:?}");
    assert!(command.memory() < MEMORY, "{} kB", command.memory());
    assert_eq!(lost, 0);
    let full = idle.last_mut().unwrap();
    let reason = loop {
        match full.0.read() {
            Ok(Message::Close(Some(close))) => break close.reason.to_string(),
            Ok(_) => {}
            Err(error) => panic!("no reason: {error}"),
        }
    };
    assert!(reason.contains(&format!("{PAGES} pages are open already")), "{reason}");
}

#[test]
fn flood_of_orders_delays_no_other_page() {
    let (_, orders) = scale();
    let command = Command::start();
    let mut page = command.page();
    page.lost();
    let address = command.address.clone();
    let (begin, begun) = channel::<()>();
    let floods: Vec<_> = (0..16)
        .map(|_| {
            let (address, begun) = (address.clone(), begin.clone());
            std::thread::spawn(move || {
                let (mut socket, _) = connect(format!("ws://{address}/finger/0")).unwrap();
                let MaybeTlsStream::Plain(stream) = socket.get_mut() else { unreachable!() };
                stream.set_write_timeout(Some(Duration::from_secs(3))).unwrap();
                // Sends until the server takes no more; its answers are not read.
                let text = r#"{"order":"self-test"}"#;
                let mut begun = Some(begun);
                let order = |n: &usize| {
                    if *n == UNDER_WAY {
                        drop(begun.take());
                    }
                    socket.send(Message::text(text)).is_ok()
                };
                let sent = (0..orders).take_while(order).count();
                (sent, socket)
            })
        })
        .collect();
    // A flood that ended before has begun as well.
    drop(begin);
    begun.iter().for_each(drop);
    let mut slowest = Duration::ZERO;
    for hz in [800, 900, 1000] {
        slowest = slowest.max(page.order(&format!(r#"{{"order":"rate","hz":{hz}}}"#)));
    }
    // The pages stay open, so that their orders still wait.
    let floods: Vec<_> = floods.into_iter().map(|flood| flood.join().unwrap()).collect();
    let taken: usize = floods.iter().map(|(sent, _)| sent).sum();
    assert!(floods.iter().all(|(sent, _)| *sent > 0), "a page that takes no order is not flooded");
    let after = page.order(r#"{"order":"rate","hz":700}"#);
    let lost = page.lost();
    println!(
        "{} orders tried, {taken} sent: answered in {slowest:?} meanwhile, {after:?} after, {} kB, {lost} lost",
        16 * orders,
        command.memory()
    );
    // A self-test takes half a second; an order waits for the one in work.
    assert!(slowest < ANSWER && after < ANSWER, "{slowest:?}, {after:?}");
    assert!(command.memory() < MEMORY, "{} kB", command.memory());
    assert_eq!(lost, 0);
}

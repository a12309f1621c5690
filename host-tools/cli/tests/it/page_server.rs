//! Tests of the page server's access rules: only the served page commands the finger.

use std::io::{Read, Write};
use std::net::TcpStream;

use taxel_cli::view::Server;

use crate::common::In;

/// Sends a request with these headers; returns status and whole answer.
fn get(address: &str, path: &str, headers: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n{headers}\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    (answer[9..12].parse().unwrap(), answer)
}

#[test]
fn requests_for_other_host_names_are_refused() {
    let server = Server::start("127.0.0.1:0", Vec::new()).unwrap();
    let url = server.url();
    let address = url.trim_start_matches("http://").trim_end_matches('/');
    let port = address.rsplit(':').next().unwrap();
    for path in ["/", "/page.js", "/fingers"] {
        for own in [address, &format!("localhost:{port}"), &format!("[::1]:{port}")] {
            assert_eq!(get(address, path, &format!("Host: {own}\r\n")).0, 200, "{path} of {own}");
        }
        let (status, said) = get(address, path, &format!("Host: evil.example:{port}\r\n"));
        assert_eq!(status, 403, "{path}");
        assert!(said.contains("give it to --listen"), "{said}");
    }
}

#[test]
fn stream_is_refused_to_foreign_pages() {
    let server = Server::start("127.0.0.1:0", Vec::new()).unwrap();
    let url = server.url();
    let address = url.trim_start_matches("http://").trim_end_matches('/');
    let upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let open = |host: &str, origin: &str| {
        let headers = format!("Host: {host}\r\nOrigin: http://{origin}\r\n{upgrade}");
        // Without `Connection: close`: a refusal closes the connection, and any other answer is "no
        // such finger".
        let mut stream = TcpStream::connect(address).unwrap();
        let request = format!("GET /finger/0 HTTP/1.1\r\n{headers}\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut status = [0; 12];
        stream.read_exact(&mut status).unwrap();
        String::from_utf8(status[9..].to_vec()).unwrap()
    };
    assert_eq!(open(address, address), "404");
    assert_eq!(open(address, "evil.example"), "403");
    // A foreign page's name that leads to this machine.
    assert_eq!(open("evil.example:8173", "evil.example:8173"), "403");
}

#[test]
fn no_answer_lets_another_page_frame_it() {
    let server = Server::start("127.0.0.1:0", Vec::new()).unwrap();
    let url = server.url();
    let address = url.trim_start_matches("http://").trim_end_matches('/');
    let host = |name: &str| format!("Host: {name}\r\n");
    for (path, headers) in [
        ("/", host(address)),
        ("/page.js", host(address)),
        ("/fingers", host(address)),
        ("/no-such-file", host(address)),
        ("/", host("evil.example")),
    ] {
        let (_, said) = get(address, path, &headers);
        let header = |name: &str| {
            let line = said.lines().find_map(|line| line.strip_prefix(name));
            line.unwrap_or_else(|| panic!("{path} without {name}: {said}")).to_owned()
        };
        let policy = header("content-security-policy: ");
        for rule in ["default-src 'none'", "script-src 'self'", "frame-ancestors 'none'"] {
            assert!(policy.contains(rule), "{policy}");
        }
        assert!(!policy.contains("unsafe"), "{policy}");
        assert_eq!(header("x-frame-options: "), "DENY");
        assert_eq!(header("x-content-type-options: "), "nosniff");
    }
}

#[test]
fn page_beyond_this_machine_needs_its_token() {
    let server = Server::start("0.0.0.0:0", Vec::new()).unwrap();
    let url = server.url();
    let (base, token) = url.split_once("/?token=").unwrap();
    let port = base.rsplit(':').next().unwrap();
    let address = format!("127.0.0.1:{port}");
    let upgrade = "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let asks =
        |path: &str, headers: &str| get(&address, path, &format!("Host: {address}\r\n{headers}"));
    let other = format!("{:032x}", !u128::from_str_radix(token, 16).unwrap());
    assert_eq!(token.len(), 32);
    for path in ["/", "/page.js", "/fingers", "/finger/0"] {
        for query in ["", "?token", "?token=", &format!("?token={other}"), &format!("?x={token}")] {
            let (status, said) = asks(&format!("{path}{query}"), upgrade);
            assert_eq!(status, 403, "{path}{query}");
            assert!(said.contains("with its token") && !said.contains(token), "{said}");
        }
        let wrong = format!("Cookie: taxel-{port}={other}\r\n");
        assert_eq!(asks(path, &wrong).0, 403, "{path}");
    }
    let (status, said) = asks(&format!("/?token={token}"), "");
    assert_eq!(status, 200);
    let cookie = format!("taxel-{port}={token}");
    assert!(
        said.contains(&format!("set-cookie: {cookie}; Path=/; HttpOnly; SameSite=Strict")),
        "{said}"
    );
    let cookie = format!("Cookie: a=b; {cookie}\r\n");
    for path in ["/", "/page.js", "/fingers"] {
        assert_eq!(asks(path, &cookie).0, 200, "{path}");
    }
    // Two servers have two tokens; one for this machine alone has none.
    assert_ne!(
        Server::start("0.0.0.0:0", Vec::new()).unwrap().url().split_once('?').unwrap().1,
        url
    );
    let here = Server::start("127.0.0.1:0", Vec::new()).unwrap();
    assert!(!here.url().contains("token"), "{}", here.url());
}

#[test]
fn address_of_the_network_needs_open() {
    let taxel = In(std::path::Path::new("."));
    let serve = ["serve", "--port", "sim:press", "--tcp", "0.0.0.0:0"];
    let demo = ["demo", "--headless", "--duration", "0.2", "--tcp", "0.0.0.0:0"];
    let bridge = ["bridge", "--port", "sim:press", "--foxglove", "0.0.0.0:0", "--duration", "0.2"];
    for typed in [&serve[..], &demo, &bridge] {
        let said = taxel.fails(1, typed);
        assert!(said.contains("0.0.0.0:0: every machine") && said.contains("add --open"), "{said}");
    }
    taxel.succeeds(&[&demo[..], &["--open"]].concat());
    // Without an address there is nothing to open.
    taxel.fails(2, &["demo", "--headless", "--duration", "0.2", "--open"]);
}

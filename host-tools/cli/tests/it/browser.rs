//! Tests of the page in a real browser: it shows the stream, and its buttons work.
//!
//! `TAXEL_SCREENSHOTS=docs/images cargo test -p taxel-cli --test it browser::` saves the pictures.

mod chromium;
mod foreign;
mod instrument;
mod playback;
mod raw;
mod spectrum;
mod stream;

use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::until;
use chromium::Browser;
use serde_json::Value;
use taxel_cli::view::{Feed, Server, Source};
use taxel_cli::{VirtualFinger, virtual_finger};
use taxel_client::{Port, ReconnectingClient};
use taxel_files::calibration;
use taxel_files::recording::Recording;

/// Opens a scene of these tests, or a built-in one.
fn source(scene: &str) -> virtual_finger::Source {
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/scenes/{scene}.toml"));
    let own = own.exists().then(|| own.display().to_string());
    virtual_finger::Source::scene(own.as_deref().unwrap_or(scene)).unwrap()
}

fn finger(scene: &str) -> VirtualFinger {
    let text = include_str!("../../assets/virtual-finger.cal.toml");
    let calibration = calibration::parse(Path::new("virtual-finger"), text).unwrap();
    let source = source(scene);
    VirtualFinger::on_tcp("127.0.0.1:0", source, Some(&calibration)).unwrap()
}

fn serve(feeds: Vec<Feed>) -> Server {
    Server::start("127.0.0.1:0", feeds).unwrap()
}

fn show(port: &Port, folder: &Path) -> Server {
    let steady = ReconnectingClient::new(port.clone());
    serve(vec![Feed::start(Source::Finger(Box::new(steady), folder.to_owned())).unwrap()])
}

#[test]
fn page_renders_every_state_and_phone_width() {
    let folder = tempfile::tempdir().unwrap();
    for (scene, name, until) in [
        ("idle", "view-idle", "taxel.times.length > 1200 && taxel.spectrumShown?.lines"),
        (
            "shear",
            "view-press",
            "Math.hypot(taxel.latest[taxel.at.fx_n], taxel.latest[taxel.at.fy_n]) > .6",
        ),
        // The tour slides from 9 s on.
        (
            "tour",
            "view-slip",
            "/It slides/.test(flags()) && taxel.latest[taxel.at.slip_margin] < .1",
        ),
        (
            "two-contacts",
            "view-two-contacts",
            "taxel.latest[taxel.at.contact2_fz_n] > .5 && /Not a single contact/.test(flags())",
        ),
        (
            "faulty",
            "view-fault",
            "document.getElementById('flags').querySelectorAll('.bad').length === 2
                && taxel.times.length > 400",
        ),
    ] {
        let finger = finger(scene);
        let server = show(finger.port(), folder.path());
        let mut browser = Browser::open(&server.url(), 1280, 860);
        browser.value("void (window.flags = () => ['verdict', 'flags'].map((id) => document.getElementById(id).innerText).join())");
        if scene == "two-contacts" {
            browser.wait_for("document.querySelector('#fields [value=contacts]')");
            browser.value("document.querySelector('#fields [value=contacts]').click()");
        }
        browser.wait_for("taxel.times.length > 60");
        browser.wait_for(until);
        if scene == "idle" {
            browser.wait_for(
                "document.getElementById('verdict').innerText.includes('Nothing touches the finger')",
            );
        }
        if scene == "two-contacts" {
            let crosses = "[...document.querySelectorAll('#map .point')]
                .filter((made) => made.getAttribute('visibility') === 'visible').length === 2";
            browser.wait_for(crosses);
        }
        browser.picture(name);
        if scene == "shear" {
            browser.dark(true);
            browser.redrawn(10);
            browser.picture("view-dark");
            browser.dark(false);
            browser.resize(390, 844);
            browser.redrawn(10);
            let wide = "document.documentElement.scrollWidth";
            assert_eq!(browser.value(wide), 390, "a phone must not scroll sideways");
            browser.wait_for(until);
            browser.picture("view-phone");
        }
    }
}

#[test]
fn page_without_finger_shows_reason() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("notes.txt");
    std::fs::write(&file, "no device").unwrap();
    for (port, why) in [
        (Port::Usb(Some("NOBODY-HAS-THIS".into())), "USB"),
        (Port::Serial("/dev/no-such-device".into()), "no such device"),
        (Port::Serial(file.display().to_string()), "a file, not a device"),
    ] {
        let server = show(&port, folder.path());
        let mut browser = Browser::open(&server.url(), 1280, 900);
        browser
            .wait_for(&format!("document.getElementById('trouble').innerText.includes('{why}')"));
        assert!(browser.text("trouble").starts_with(&port.to_string()));
        assert!(browser.text("verdict").contains("No word from the finger"));
        assert_eq!(browser.value("document.getElementById('bias').offsetParent"), Value::Null);
    }
}

#[test]
fn unknown_finger_in_address_shows_first() {
    let folder = tempfile::tempdir().unwrap();
    let (one, other) = (finger("idle"), finger("press"));
    let feed = |finger: &VirtualFinger| {
        let steady = ReconnectingClient::new(finger.port().clone());
        Feed::start(Source::Finger(Box::new(steady), folder.path().to_owned())).unwrap()
    };
    let server = serve(vec![feed(&one), feed(&other)]);
    for (query, serial) in [("?finger=abc", "idle"), ("?finger=2", "idle"), ("?finger=1", "press")]
    {
        let mut browser = Browser::open(&format!("{}{query}", server.url()), 1280, 900);
        browser.wait_for(&format!("taxel.facts.serial === '{serial}' && taxel.times.length > 5"));
        assert_eq!(browser.value("document.getElementById('finger').options.length"), 2);
    }
}

#[test]
fn every_control_works_by_keyboard() {
    let folder = tempfile::tempdir().unwrap();
    let finger = finger("idle");
    let server = show(finger.port(), folder.path());
    let mut browser = Browser::open(&server.url(), 1280, 900);
    browser.wait_for("taxel.times.length > 10");
    let mut press = |key: &str, said: &str| {
        browser.key(key);
        browser
            .wait_for(&format!("document.getElementById('said').textContent.includes('{said}')"));
    };
    press("b", "bias taken");
    press("t", "channels are as they should be");
    press("r", "recording into");
    browser.wait_for("taxel.recording");
    // A thousand frames by their sequence numbers, whatever time this machine needs.
    browser.value("void (window.from = taxel.latest[taxel.at.seq])");
    browser.wait_for("taxel.latest[taxel.at.seq] > from + 1000");
    browser.wait_for(
        "/^[0-9.]+ s · [0-9,]+ rows · [0-9.]+ [kM]B · with codes/.test(document.getElementById('recording').innerText)",
    );
    browser.key("r");
    browser.wait_for("!taxel.recording");
    let files: Vec<_> = std::fs::read_dir(folder.path()).unwrap().flatten().collect();
    assert_eq!(files.len(), 1);
    let recording = Recording::open(&files[0].path()).unwrap();
    assert!(recording.position("lit_r0c0").is_some(), "a recording without codes");
    let rows = recording.map(Result::unwrap).count();
    assert!(rows > 1000, "{rows}");
    let said = browser.text("said");
    assert!(said.contains(&format!("{rows} rows")) && said.contains("iB"), "{said}");
    // The stream is again what it was.
    browser.wait_for("!('lit_r0c0' in taxel.at)");

    // Tab alone reaches every control.
    let mut reached = std::collections::BTreeSet::new();
    for _ in 0..30 {
        browser.key("Tab");
        let at = browser.value("document.activeElement.id || document.activeElement.value");
        reached.insert(at.as_str().unwrap_or_default().to_owned());
    }
    for id in [
        "bias",
        "clear-bias",
        "self-test",
        "record",
        "rate-input",
        "filter",
        "method",
        "force",
        "channel",
    ] {
        assert!(reached.contains(id), "{id} is not among {reached:?}");
    }

    // Ticking a field keeps the focus: the next field is one Tab further.
    let at = |browser: &mut Browser| browser.value("document.activeElement.value");
    browser.value("document.querySelector('#fields [value=point]').focus()");
    for (field, column) in [("point", "x_mm"), ("slip", "slip_margin")] {
        assert_eq!(at(&mut browser), field);
        browser.wait_for(&format!("document.activeElement.checked && '{column}' in taxel.at"));
        browser.key(" ");
        browser.wait_for(&format!("!document.activeElement.checked && !('{column}' in taxel.at)"));
        browser.key("Tab");
    }
    assert_eq!(at(&mut browser), "torsion");

    browser.value("document.getElementById('rate-input').focus(), document.getElementById('rate-input').value = 250");
    browser.key("Enter");
    browser.wait_for("document.getElementById('said').textContent === 'rate 250 Hz'");
    browser.wait_for("Math.abs(taxel.rate - 250) < 5");
    browser.value("(document.getElementById('filter').value = 20, document.getElementById('filter').onchange())");
    browser.wait_for("document.getElementById('said').textContent === 'filter 20 Hz'");
    browser.wait_for("taxel.facts.filter_hz === 20");
    browser.value("document.querySelector('#fields [value=codes]').click()");
    browser.wait_for("'lit_r0c0' in taxel.at");
    browser.value("(document.getElementById('channel').value = 'lit_r0c0', document.getElementById('channel').onchange())");
    browser.wait_for("taxel.spectrumShown?.channel === 'lit_r0c0' && taxel.spectrumShown.lines");
}

#[test]
fn page_reconnects_and_restores_settings() {
    let folder = tempfile::tempdir().unwrap();
    let first = finger("idle");
    let port = first.port().clone();
    let Port::Tcp { host, port: number } = &port else { panic!("{port}") };
    let address = format!("{host}:{number}");
    drop(first);
    let server = show(&port, folder.path());
    let mut browser = Browser::open(&server.url(), 1280, 900);
    browser
        .wait_for("document.getElementById('trouble').textContent.includes('connection refused')");

    let again = || {
        let mut finger = None;
        // The address may stay busy briefly after the previous server.
        until("the address", || {
            finger = VirtualFinger::on_tcp(&address, source("idle"), None).ok();
            finger.is_some()
        });
        finger.unwrap()
    };
    let finger = again();
    browser.wait_for("!taxel.trouble && taxel.times.length > 5");
    assert_eq!(browser.value("document.getElementById('bias').disabled"), false);
    browser.value("(document.getElementById('rate-input').value = 500, document.querySelector('#rate-form button').click())");
    browser.wait_for("Math.abs(taxel.rate - 500) < 10");
    browser.value("(document.getElementById('filter').value = 50, document.getElementById('filter').onchange())");
    browser.wait_for("taxel.facts.filter_hz === 50");
    let mut finger = Some(finger);
    let mut soonest = Duration::MAX;
    // The fastest of several reconnects, because other load may delay some.
    for _ in 0..5 {
        drop(finger.take());
        // First "gone", then "connection refused".
        browser.wait_for("/the finger is gone|connection refused/.test(document.getElementById('trouble').textContent)");
        finger = Some(again());
        let back = Instant::now();
        browser.wait_for("!taxel.trouble && taxel.rate");
        soonest = soonest.min(back.elapsed());
        browser.wait_for("Math.abs(taxel.rate - 500) < 10");
        browser.wait_for("taxel.facts.filter_hz === 50");
        browser.wait_for("!document.getElementById('bias').disabled");
        if soonest < Duration::from_secs(2) {
            break;
        }
    }
    // 1 s for the program, and the browser's own delay.
    assert!(soonest < Duration::from_secs(2), "{soonest:?}");
}

//! Tests that what cannot be done is refused at once, in one line with the mend, and changes
//! nothing.

use std::path::Path;

use crate::common::{In, json};
use taxel::calibration::Calibration;
use taxel::estimate::quantised::Net;
use taxel_cli::VirtualFinger;
use taxel_cli::virtual_finger::Source;
use taxel_files::calibration;

/// Calibration of the virtual finger with net and sensors only.
const VIRTUAL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");

/// Runs a command that must fail in the current folder, which these tests do not depend on.
fn fails(args: &[&str]) -> String {
    In(Path::new(".")).fails(1, args)
}

fn succeeds(args: &[&str]) -> String {
    In(Path::new(".")).succeeds(args)
}

#[test]
fn refused_setting_changes_no_other() {
    let finger = VirtualFinger::on_tcp("127.0.0.1:0", Source::scene("press").unwrap(), None);
    let finger = finger.unwrap();
    let port = finger.port().to_string();
    let info = || {
        let mut info = json(&succeeds(&["info", "--port", &port, "--json"]));
        info.as_object_mut().unwrap().retain(|key, _| {
            ["rate_hz", "filter_hz", "fields", "point", "scan_hz"].contains(&key.as_str())
        });
        info
    };
    let before = ["set", "--port", &port, "--rate", "250", "--point", "argmin"];
    succeeds(&before);
    let before = info();
    let others = ["--rate", "500", "--fields", "force", "--point", "centroid"];
    for refused in [["--filter", "60000"], ["--oversampling", "2"]] {
        let set = [&["set", "--port", port.as_str()], &others[..], &refused[..]].concat();
        let error = fails(&set);
        assert!(error.ends_with("; all settings are as before\n"), "{error}");
        assert_eq!(info(), before, "{refused:?}");
    }
}

#[test]
fn refused_number_is_told_its_true_range() {
    let set = |option: &str| fails(&["set", "--port", "sim:press", option]);
    for (option, range) in [
        ("--rate=-5", "rate: must lie in 1…1000"),
        ("--rate=70000", "rate: must lie in 1…1000"),
        ("--filter=-1", "filter: must lie in 0…250"),
    ] {
        let error = set(option);
        assert!(error.starts_with(&format!("taxel: sim:press: {range};")), "{option}: {error}");
    }
    let usage = |args: &[&str]| In(Path::new(".")).fails(2, args);
    let word = usage(&["set", "--port", "sim:press", "--rate=fast"]);
    assert!(word.contains("'--rate <HZ>': expected a whole number;"), "{word}");
    let domain = usage(&["bridge", "--zenoh", "--port", "sim:press", "--domain=-1"]);
    assert!(domain.contains("expected a whole number in 0…232"), "{domain}");
    let seed = usage(&["simulate", "--scene", "press", "--out", "no.csv", "--seed=-1"]);
    assert!(seed.contains("expected a whole number in 0…18446744073709551615"), "{seed}");
}

#[test]
fn taken_address_is_named_with_mend() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for command in [["serve", "--port", "sim:press"], ["demo", "--headless", "--json"]] {
        let error = fails(&[&command[..], &["--tcp", &address]].concat());
        let told = format!("taxel: tcp:{address}: cannot be served: Address already in use; ");
        assert!(error.starts_with(&told), "{error}");
        assert!(error.contains("--tcp") && error.contains("127.0.0.1:0"), "{error}");
    }
}

#[test]
fn missing_scene_or_file_is_not_waited_for() {
    for command in [
        ["view", "--no-browser", "--listen", "127.0.0.1:0"],
        ["bridge", "--foxglove", "127.0.0.1:0", "--json"],
    ] {
        let error = fails(&[&command[..], &["--port", "sim:nosuch"]].concat());
        assert!(error.starts_with("taxel: nosuch: "), "{error}");
        assert!(error.contains("a name that `taxel simulate --list` shows"), "{error}");
        let error = fails(&[&command[..], &["--port", "file:nosuch.csv"]].concat());
        assert!(error.starts_with("taxel: nosuch.csv: "), "{error}");
    }
}

#[test]
fn hopeless_recording_is_not_sent_to_export_again() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let record = ["record", "--port", "sim:press", "--duration", "1", "--fields", "estimates"];
    folder.succeeds(&[record.as_slice(), &["--out", "a.mcap"]].concat());
    let whole = std::fs::read(directory.path().join("a.mcap")).unwrap();
    for bytes in [&whole[..20], &whole[..whole.len() / 20], b"no recording"] {
        std::fs::write(directory.path().join("b.mcap"), bytes).unwrap();
        let error = folder.fails(1, &["export", "b.mcap", "--out", "c.mcap"]);
        assert!(error.starts_with("taxel: b.mcap: "), "{error}");
        assert!(!error.contains("`taxel export` saves"), "{error}");
        assert!(!directory.path().join("c.mcap").exists());
    }
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 0x55;
    std::fs::write(directory.path().join("b.mcap"), damaged).unwrap();
    let error = folder.fails(1, &["export", "b.mcap", "--out", "c.mcap"]);
    assert!(error.contains("; c.mcap has the ") && !error.contains("`taxel export`"), "{error}");
}

#[test]
fn record_that_a_finger_refuses_is_an_error_everywhere() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let mut record = calibration::read(VIRTUAL).unwrap();
    let text = std::fs::read_to_string(VIRTUAL).unwrap();
    let Some(Net::Float(net)) = &mut record.net else { panic!("no net in f32") };
    let force = net.output_bias[2];
    net.output_bias[2] = 90.0;
    let crc = |record: &Calibration| calibration::record_crc(record).unwrap();
    let old = crc(&calibration::read(VIRTUAL).unwrap());
    let text = text.replace(&format!("{old:08x}"), &format!("{:08x}", crc(&record)));
    let text = text.replace(&format!("{force}]"), "90.0]");
    std::fs::write(directory.path().join("cal.toml"), text).unwrap();
    let told = "taxel: cal.toml: a finger refuses it: the net gives 1 N or more without a contact; fit it again\n";
    for command in [
        "serve --port sim:tour --tcp 127.0.0.1:0 --calibration cal.toml",
        "demo --headless --duration 1 --calibration cal.toml",
        "calibrate upload --port sim:tour --calibration cal.toml",
        "calibrate compare cal.toml cal.toml",
    ] {
        assert_eq!(folder.fails(1, &command.split(' ').collect::<Vec<_>>()), told, "{command}");
    }
    let error = calibration::write(directory.path().join("new.toml"), &record).unwrap_err();
    assert!(error.to_string().contains("new.toml: not written: the net gives 1 N"), "{error}");
    assert!(!directory.path().join("new.toml").exists());
    // A finger that another part of a program starts says so as well.
    let source = Source::scene("tour").unwrap();
    let error = VirtualFinger::on_tcp("127.0.0.1:0", source, Some(&record)).err();
    let error = error.unwrap().to_string();
    assert!(error.contains("calibration: refused, the net gives 1 N or more"), "{error}");
}

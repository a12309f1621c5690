//! What is broken off leaves something whole: a fit by Ctrl-C, an upload by a pulled cable.
#![cfg(target_os = "linux")]

mod common;

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::Child;
use std::thread;
use std::time::Duration;

use common::In;
use taxel_formats::calibration;
use taxel_link::{Source, VirtualFinger};

/// The virtual finger with the net and the sensors alone.
const VIRTUAL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");

/// Ten channels and a force that no line follows: more than a minute of fitting.
fn write_table(folder: &Path) {
    let names: Vec<String> = (0..10).map(|k| format!("m{k}")).collect();
    let mut text = format!("t_s,{},force_n\n", names.join(","));
    for i in 0..4000 {
        let t = 0.02 * f64::from(i);
        let x = |k: i32| 40.0 * ((0.21 + 0.13 * f64::from(k)) * t).sin();
        let channels: Vec<String> = (0..10).map(|k| format!("{:.4}", x(k))).collect();
        let force = 0.1 * x(0) + (x(1) * x(2) / 500.0).sin() + (x(3) / 9.0).tanh();
        writeln!(text, "{t:.2},{},{force:.5}", channels.join(",")).unwrap();
    }
    std::fs::write(folder.join("long.csv"), text).unwrap();
}

/// Processor time that a child has had, which unlike the clock tells how far it has come.
fn worked(child: &Child) -> Duration {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    // utime and stime, fields 14 and 15 of proc(5), in hundredths of a second.
    let fields = after_name.split_whitespace().skip(11).take(2);
    Duration::from_millis(10 * fields.filter_map(|field| field.parse::<u64>().ok()).sum::<u64>())
}

#[test]
fn ctrl_c_in_a_fit_keeps_the_best_so_far() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    write_table(folder.0);
    let judge = ["calibrate", "evaluate", "--data", "long.csv", "--json", "--calibration"];
    let rmse = |calibration: &str| {
        let judged = folder.succeeds(&[&judge[..], &[calibration]].concat());
        let judged: serde_json::Value = serde_json::from_str(&judged).unwrap();
        judged["force_n"]["rmse"].as_f64().unwrap()
    };
    let fit = ["calibrate", "fit", "--data", "long.csv", "--inputs", "m*", "--targets", "force_n"];
    folder.succeeds(&[&fit[..], &["--model", "ridge", "--out", "line.toml"]].concat());
    let line = rmse("line.toml");
    for (model, out) in [("mlp", "net.toml"), ("auto", "auto.toml")] {
        let typed = [&fit[..], &["--model", model, "--out", out]].concat();
        let mut child = folder.command(&typed).spawn().unwrap();
        while worked(&child) < Duration::from_secs(3) {
            assert_eq!(child.try_wait().unwrap(), None, "{model}: it ended before Ctrl-C");
            thread::sleep(Duration::from_millis(20));
        }
        let id = nix::unistd::Pid::from_raw(i32::try_from(child.id()).unwrap());
        nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGINT).unwrap();
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(0), "{model}: {said}");
        assert!(said.contains("stopped early: the best net so far was kept"), "{model}: {said}");
        // A net that was just begun need not beat the line, but it is no nonsense; the line is what `auto` keeps.
        assert!(rmse(out) < 1.001 * line, "{model}: {} {line}", rmse(out));
    }
}

/// A cable to a finger that is pulled once so many bytes have gone to it. How many had, and the port to use.
fn cable(finger: &str, pulled_after: usize) -> (thread::JoinHandle<usize>, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp:{}", listener.local_addr().unwrap());
    let finger = finger.strip_prefix("tcp:").unwrap().to_owned();
    let carry = move || {
        let (mut host, _) = listener.accept().unwrap();
        // Nobody can plug it in again.
        drop(listener);
        let mut finger = TcpStream::connect(finger).unwrap();
        let (mut answers, mut to_host) = (finger.try_clone().unwrap(), host.try_clone().unwrap());
        let back = thread::spawn(move || std::io::copy(&mut answers, &mut to_host));
        let (mut sent, mut buffer) = (0, [0; 64]);
        while sent < pulled_after {
            let most = buffer.len().min(pulled_after - sent);
            match host.read(&mut buffer[..most]) {
                Ok(count) if count > 0 => {
                    finger.write_all(&buffer[..count]).unwrap();
                    sent += count;
                }
                _ => break,
            }
        }
        // Either may be closed already.
        let _ = (finger.shutdown(Shutdown::Both), host.shutdown(Shutdown::Both));
        let _ = back.join();
        sent
    };
    (thread::spawn(carry), port)
}

#[test]
fn a_cable_pulled_at_any_chunk_of_an_upload_leaves_the_old_calibration_whole() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let old = calibration::read(VIRTUAL).unwrap();
    let mut new = old.clone();
    new.date += 86_400;
    calibration::write(folder.0.join("new.toml"), &new).unwrap();
    let mut buffer = [0; taxel::calibration::MAX_BYTES];
    let length = new.to_bytes(&mut buffer).unwrap().len();

    let source = Source::scene("press").unwrap();
    let finger = VirtualFinger::on_tcp("127.0.0.1:0", source, Some(&old)).unwrap();
    let port = finger.port().to_string();
    let in_force = || {
        folder.succeeds(&["calibrate", "download", "--port", &port, "--out", "read.toml"]);
        calibration::read(folder.0.join("read.toml")).unwrap()
    };
    let upload = |port: &str| {
        folder.taxel(&["calibrate", "upload", "--port", port, "--calibration", "new.toml"])
    };
    // A message is a chunk and some bytes around it: no chunk is stepped over.
    for pulled_after in (100..length).step_by(taxel::wire::message::CHUNK) {
        let (cable, pulled) = cable(&port, pulled_after);
        let ran = upload(&pulled);
        assert_eq!(ran.code, Some(1), "{pulled_after}: {}{}", ran.out, ran.err);
        assert!(ran.err.starts_with("taxel: tcp:127.0.0.1:"), "{}", ran.err);
        assert_eq!(cable.join().unwrap(), pulled_after);
        assert_eq!(in_force(), old, "pulled after {pulled_after} bytes of {length}");
    }
    let ran = upload(&port);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert_eq!(in_force(), new);
}

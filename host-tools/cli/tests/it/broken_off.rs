//! Tests that interrupted commands leave whole files. Fits are interrupted by Ctrl-C, uploads by a
//! pulled cable.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{Read, copy};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::Child;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::Duration;

use crate::common::{In, Ran, SHORT_PRESSES, json, until, worked};
use taxel::calibration::Calibration;
use taxel_cli::VirtualFinger;
use taxel_cli::virtual_finger::Source;
use taxel_files::calibration;

/// Calibration of the virtual finger with net and sensors only.
const VIRTUAL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");

/// Writes ten channels of scattered rows and a nonlinear force: three seconds of fitting a net.
fn write_table(folder: &Path) {
    let names: Vec<String> = (0..10).map(|k| format!("m{k}")).collect();
    let mut text = format!("t_s,{},force_n\n", names.join(","));
    for i in 0..4000 {
        let x = |k: i32| 40.0 * (12.9898 * f64::from(10 * i + k).powi(2)).sin();
        let channels: Vec<String> = (0..10).map(|k| format!("{:.4}", x(k))).collect();
        let force = 0.1 * x(0) + (x(1) * x(2) / 500.0).sin() + (x(3) / 9.0).tanh();
        writeln!(text, "{:.2},{},{force:.5}", 0.02 * f64::from(i), channels.join(",")).unwrap();
    }
    std::fs::write(folder.join("long.csv"), text).unwrap();
}

fn interrupt(child: &Child) {
    let id = nix::unistd::Pid::from_raw(i32::try_from(child.id()).unwrap());
    nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGINT).unwrap();
}

/// Interrupts the child after this much processor time.
fn interrupted_after(worked_for: Duration, mut child: Child) -> Ran {
    until("the processor time", || {
        assert_eq!(child.try_wait().unwrap(), None, "it ended before Ctrl-C");
        worked(&child) >= worked_for
    });
    interrupt(&child);
    Ran::of(child.wait_with_output().unwrap())
}

#[test]
fn ctrl_c_in_fit_keeps_best_net() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    write_table(folder.0);
    let judge = ["calibrate", "evaluate", "--data", "long.csv@60..", "--json", "--calibration"];
    let rmse = |calibration: &str| {
        let judged = json(&folder.succeeds(&[&judge[..], &[calibration]].concat()));
        judged["force_n"]["rmse"].as_f64().unwrap()
    };
    let fit = ["calibrate", "fit", "--data", "long.csv@0..60", "--json"];
    let fit = [&fit[..], &["--inputs", "m*", "--targets", "force_n"]].concat();
    let whole = folder.succeeds(&[&fit[..], &["--model", "ridge", "--out", "line.toml"]].concat());
    assert_eq!(json(&whole)["interrupted"], false);
    let line = rmse("line.toml");
    // A net is nonlinear from its first steps on; `auto` has only the straight line by then.
    for (model, chosen, out, share) in [
        ("mlp", "16 hidden units as usual, not chosen by recordings left out", "net.toml", 0.5),
        (
            "auto",
            "chosen by stretches of the recordings, not by whole ones left out",
            "auto.toml",
            1.02,
        ),
    ] {
        std::fs::write(folder.0.join(out), "what was there before").unwrap();
        let typed = [&fit[..], &["--model", model, "--force", "--out", out]].concat();
        let ran =
            interrupted_after(Duration::from_secs(1), folder.command(&typed).spawn().unwrap());
        assert_eq!(ran.code, Some(0), "{model}: {}", ran.err);
        // With one recording it also warns how little the choice rests on.
        assert!(ran.err.starts_with(&format!("taxel: warning: {model}: {chosen}")), "{}", ran.err);
        let said: Vec<_> = ran.err.lines().skip(1).collect();
        assert_eq!(said, ["taxel: stopped early: the best net so far was kept"], "{model}");
        let told = json(&ran.out);
        assert_eq!((&told["interrupted"], &told["calibration"]), (&true.into(), &out.into()));
        // Its own residual equals the error of the written record on the same rows.
        let own = ["calibrate", "evaluate", "--data", "long.csv@0..60", "--json", "--calibration"];
        let own = json(&folder.succeeds(&[&own[..], &[out]].concat()));
        let (own, said) = (&own["force_n"]["rmse"], &told["parts"][0]["residual"][0]);
        let (own, said) = (own.as_f64().unwrap(), said.as_f64().unwrap());
        assert!((own / said - 1.0).abs() < 1e-3, "{model}: {own}, and it says {said}");
        eprintln!("{model}: {own:.4} on its rows, {:.4} on others; line {line:.4}", rmse(out));
        assert!(rmse(out) < share * line, "{model}: {} {line}", rmse(out));
    }
}

/// Fits presses with shear, which a net of 32 units takes many seconds to learn.
#[test]
fn ctrl_c_in_finger_fit_leaves_usable_record() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    std::fs::write(folder.0.join("mine.toml"), SHORT_PRESSES).unwrap();
    for (seed, out) in [("1", "presses.csv"), ("2", "unseen.csv")] {
        folder.succeeds(&["simulate", "--scene", "mine.toml", "--seed", seed, "--out", out]);
    }
    let fit = ["calibrate", "fit", "--data", "presses.csv", "--net-only", "--hidden", "32"];
    let fit = [&fit[..], &["--model", "mlp", "--json", "--out", "cal.toml"]].concat();
    let ran = interrupted_after(Duration::from_secs(4), folder.command(&fit).spawn().unwrap());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let line = "taxel: stopped early: the best net so far was kept";
    assert!(ran.err.lines().any(|said| said == line), "{}", ran.err);
    assert_eq!(json(&ran.out)["interrupted"], true);
    let judge = ["calibrate", "evaluate", "--data", "unseen.csv", "--calibration", "cal.toml"];
    let judged = json(&folder.succeeds(&[&judge[..], &["--json"]].concat()));
    eprintln!("{}", judged["fz_n"]);
    // RMS of the force itself is 0.75 N.
    assert!(judged["fz_n"]["rmse"].as_f64().unwrap() < 0.25, "{judged}");
}

/// Interrupts a reader that blocks on a recording's next row.
#[test]
fn ctrl_c_while_reading_changes_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let pipe = folder.0.join("growing.csv");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    std::fs::copy(VIRTUAL, folder.0.join("cal.toml")).unwrap();
    std::fs::write(folder.0.join("out"), "what was there before").unwrap();
    let before = folder.files();
    let commands: [&[&str]; 4] = [
        &["evaluate", "--calibration", "cal.toml"],
        &["report", "--calibration", "cal.toml", "--force", "--out", "out"],
        &["adjust", "--calibration", "cal.toml", "--force", "--out", "out"],
        &["compare", "cal.toml", "cal.toml"],
    ];
    for args in commands {
        let typed = [&["calibrate"], args, &["--data", "growing.csv"]].concat();
        let child = folder.command(&typed).spawn().unwrap();
        // Opens when the command does.
        let writer = std::fs::File::options().write(true).open(&pipe).unwrap();
        interrupt(&child);
        let ran = Ran::of(child.wait_with_output().unwrap());
        drop(writer);
        // Ended by the signal, as a shell expects.
        assert_eq!((ran.code, ran.out.as_str(), ran.err.as_str()), (None, "", ""), "{args:?}");
        assert_eq!(folder.files(), before, "{args:?}");
    }
}

/// Fate of a cable after its last byte.
#[derive(Clone, Copy)]
enum Then {
    Pulled,
    /// Passes nothing more until the host disconnects.
    Stuck,
}

/// Cable to a finger.
struct Cable {
    /// Bytes carried: to the finger, to the host.
    carried: thread::JoinHandle<[u64; 2]>,
    /// Port of the cable's near end.
    port: String,
    /// Receives when the way to the finger has ended.
    ended: Receiver<()>,
}

/// Creates a cable that passes so many bytes to the finger and to the host.
fn cable(finger: &str, most: [u64; 2], then: Then) -> Cable {
    let (tell, ended) = channel();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp:{}", listener.local_addr().unwrap());
    let finger = finger.strip_prefix("tcp:").unwrap().to_owned();
    let carry = move || {
        let (host, _) = listener.accept().unwrap();
        // Makes a second connection impossible.
        drop(listener);
        let finger = TcpStream::connect(finger).unwrap();
        let through =
            move |from: &TcpStream, to: &TcpStream, most: u64, tell: Option<Sender<()>>| {
                let sent = copy(&mut from.take(most), &mut &*to).unwrap_or_default();
                if let Some(tell) = tell {
                    // The receiver may be gone.
                    let _ = tell.send(());
                }
                if matches!(then, Then::Stuck) {
                    // Discards the rest.
                    let _ = copy(&mut &*from, &mut std::io::sink());
                }
                // Either may be closed already.
                let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
                sent
            };
        let back = [&finger, &host].map(|end| end.try_clone().unwrap());
        let back = thread::spawn(move || through(&back[0], &back[1], most[1], None));
        [through(&host, &finger, most[0], Some(tell)), back.join().unwrap()]
    };
    Cable { carried: thread::spawn(carry), port, ended }
}

/// Finger with a calibration, a new one in `new.toml`, and the bytes of a whole upload.
struct Upload<'f> {
    folder: In<'f>,
    old: Calibration,
    new: Calibration,
    finger: VirtualFinger,
    total: [u64; 2],
    /// Bytes of these to the host for reading the record back, after a hello.
    read_back: u64,
}

impl<'f> Upload<'f> {
    fn begin(directory: &'f Path) -> Self {
        let folder = In(directory);
        let old = calibration::read(VIRTUAL).unwrap();
        let new = Calibration { date: old.date + 86_400, ..old.clone() };
        calibration::write(directory.join("old.toml"), &old).unwrap();
        calibration::write(directory.join("new.toml"), &new).unwrap();
        let source = Source::scene("press").unwrap();
        let finger = VirtualFinger::on_tcp("127.0.0.1:0", source, Some(&old)).unwrap();
        let mut upload = Self { folder, old, new, finger, total: [0; 2], read_back: 0 };
        let cable = self::cable(&upload.port(), [u64::MAX; 2], Then::Pulled);
        assert_eq!(upload.run(&cable.port).code, Some(0));
        upload.total = cable.carried.join().unwrap();
        assert_eq!(upload.in_force(), upload.new);
        let cable = self::cable(&upload.port(), [u64::MAX; 2], Then::Pulled);
        let download = ["calibrate", "download", "--force", "--out", "read.toml"];
        let download = [&download[..], &["--port", &cable.port]].concat();
        upload.folder.succeeds(&download);
        upload.read_back = cable.carried.join().unwrap()[1];
        upload.put_back();
        upload
    }

    fn port(&self) -> String {
        self.finger.port().to_string()
    }

    fn typed<'t>(&self, port: &'t str, file: &'t str) -> [&'t str; 6] {
        ["calibrate", "upload", "--port", port, "--calibration", file]
    }

    fn run(&self, port: &str) -> Ran {
        self.folder.taxel(&self.typed(port, "new.toml"))
    }

    fn put_back(&self) {
        self.folder.succeeds(&self.typed(&self.port(), "old.toml"));
    }

    fn in_force(&self) -> Calibration {
        let port = self.port();
        let download = ["calibrate", "download", "--port", &port, "--out", "read.toml", "--force"];
        self.folder.succeeds(&download);
        calibration::read(self.folder.0.join("read.toml")).unwrap()
    }
}

#[test]
fn ctrl_c_in_transfer_leaves_calibrations_whole() {
    let directory = tempfile::tempdir().unwrap();
    let upload = Upload::begin(directory.path());
    let stuck_after = |bytes: u64, typed: &dyn Fn(&str) -> Vec<String>| {
        let cable = cable(&upload.port(), [bytes, u64::MAX], Then::Stuck);
        let typed = typed(&cable.port);
        let typed: Vec<&str> = typed.iter().map(String::as_str).collect();
        let child = upload.folder.command(&typed).spawn().unwrap();
        // From here on the command waits for answers that do not come.
        cable.ended.recv().unwrap();
        interrupt(&child);
        let ran = Ran::of(child.wait_with_output().unwrap());
        cable.carried.join().unwrap();
        ran
    };
    let [half, _] = upload.total.map(|bytes| bytes / 2);
    let ran = stuck_after(half, &|port| upload.typed(port, "new.toml").map(str::to_owned).to_vec());
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""), "{}", ran.err);
    assert!(
        ran.err.ends_with(": stopped; the previous calibration stays active; upload again\n"),
        "{}",
        ran.err
    );
    assert_eq!(upload.in_force(), upload.old);

    std::fs::write(upload.folder.0.join("mine.toml"), "what was there before").unwrap();
    let before = upload.folder.files();
    let download = |port: &str| {
        let download = ["calibrate", "download", "--force", "--port", port, "--out", "mine.toml"];
        download.map(str::to_owned).to_vec()
    };
    let ran = stuck_after(60, &download);
    assert_eq!((ran.code, ran.out.as_str(), ran.err.as_str()), (None, "", ""));
    assert_eq!(upload.folder.files(), before);
    assert_eq!(upload.in_force(), upload.old);
}

/// Ends the writer in mid-write by a limit on file size.
#[test]
fn crash_while_writing_keeps_previous_file() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    let finger = VirtualFinger::on_tcp(
        "127.0.0.1:0",
        Source::scene("press").unwrap(),
        Some(&calibration::read(VIRTUAL).unwrap()),
    );
    let finger = finger.unwrap();
    let former = "what was there before\n";
    std::fs::write(folder.0.join("cal.toml"), former).unwrap();
    let limited = |first: &str| {
        let command = "exec \"$0\" calibrate download --force --out cal.toml --port \"$1\"";
        let output = std::process::Command::new("bash")
            .args(["-c", &format!("{first}; ulimit -f 1; {command}")])
            .args([env!("CARGO_BIN_EXE_taxel"), &finger.port().to_string()])
            .current_dir(folder.0)
            .output();
        Ran::of(output.unwrap())
    };
    let crashed = limited("ulimit -c 0");
    assert_eq!((crashed.code, crashed.out.as_str()), (None, ""), "{}", crashed.err);
    assert_eq!(std::fs::read_to_string(folder.0.join("cal.toml")).unwrap(), former);
    let parts = std::fs::read_dir(folder.0).unwrap().count();
    // If the signal is ignored, the write fails: the command reports it and removes the file.
    let told = limited("trap '' XFSZ");
    assert_eq!((told.code, told.out.as_str()), (Some(1), ""));
    assert!(told.err.starts_with("taxel: cal.toml: File too large"), "{}", told.err);
    assert_eq!(std::fs::read_to_string(folder.0.join("cal.toml")).unwrap(), former);
    assert_eq!(std::fs::read_dir(folder.0).unwrap().count(), parts);
}

/// Tests with an erasure of flash a second.
mod endurance {
    use super::*;

    #[test]
    fn pulled_cable_in_upload_leaves_one_calibration() {
        let directory = tempfile::tempdir().unwrap();
        let upload = Upload::begin(directory.path());
        let ([to_finger, to_host], chunk) = (upload.total, taxel::wire::message::CHUNK as u64);
        // The step is below one message (a chunk and its frame), so that no chunk is skipped.
        let length = to_finger - to_finger / 8;
        let chunks = (100..length).step_by(chunk as usize).map(|bytes| [bytes, u64::MAX]);
        // Near the answer that reports the new record as active; after a hello the record is read back.
        let committed = to_host - upload.read_back;
        let answers = (committed - 12..committed + 36).step_by(3).map(|bytes| [u64::MAX, bytes]);
        let read_back = [[u64::MAX, to_host - 1], [to_finger - 1, u64::MAX]];
        let mut said = BTreeMap::new();
        for most in chunks.chain(answers).chain(read_back) {
            // Within a second of an erasure of flash, Busy and its repetition would move the cut.
            thread::sleep(Duration::from_millis(1_100));
            let cable = cable(&upload.port(), most, Then::Pulled);
            let ran = upload.run(&cable.port);
            cable.carried.join().unwrap();
            assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""), "{most:?}: {}", ran.err);
            assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
            let found = upload.in_force();
            assert!(found == upload.old || found == upload.new, "{most:?}");
            let of = |is: &str, then: &str| ran.err.contains(is) && ran.err.contains(then);
            let state = if of("the previous calibration stays active", "upload again") {
                assert_eq!(found, upload.old, "{most:?}");
                "old"
            } else if of("the new calibration is active", "`taxel calibrate download`") {
                assert_eq!(found, upload.new, "{most:?}");
                "new"
            } else {
                assert!(
                    of("the previous or the new calibration is active", "`taxel info`"),
                    "{}",
                    ran.err
                );
                "either"
            };
            assert!(ran.err.starts_with("taxel: tcp:127.0.0.1:"), "{}", ran.err);
            *said.entry(state).or_insert(0) += 1;
            if found != upload.old {
                upload.put_back();
            }
        }
        eprintln!("{:?}: {said:?}", upload.total);
        assert!(
            said["old"] as u64 >= length / chunk - 1 && said["new"] >= 2 && said["either"] >= 1,
            "{said:?}"
        );
        let ran = upload.run(&upload.port());
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        assert_eq!(upload.in_force(), upload.new);
    }
}

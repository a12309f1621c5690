//! Tests of the command as users and scripts run it.

use std::io::Read;
use std::path::Path;
use std::process::Command;

use crate::common::{In, Ran, rows_so_far, until};
use taxel_cli::VirtualFinger;
use taxel_cli::virtual_finger::Source;

/// Runs the command in the current folder, which these tests do not depend on.
fn here() -> In<'static> {
    In(Path::new("."))
}

fn command(args: &[&str]) -> Command {
    here().command(args)
}

fn fails(code: i32, args: &[&str]) -> String {
    here().fails(code, args)
}

fn succeeds(args: &[&str]) -> String {
    here().succeeds(args)
}

fn json(text: &str) -> serde_json::Value {
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(text).unwrap()
}

#[test]
fn list_prints_one_line_per_scene() {
    let list = succeeds(&["simulate", "--list"]);
    for (name, _) in taxel_sim::scene::built_in() {
        let line = list.lines().find(|line| line.split_whitespace().next() == Some(name)).unwrap();
        assert!(line.len() > name.len() + 10, "{line}");
    }
    assert_eq!(list.lines().count(), taxel_sim::scene::built_in().count());
}

#[test]
fn chart_writes_all_three_files_or_none() {
    let directory = tempfile::tempdir().unwrap();
    let charts = directory.path().join("charts");
    let said = succeeds(&["chart", "--only", "peers", "--out", charts.to_str().unwrap()]);
    assert!(said.contains("peers.csv"), "{said}");
    let read = |name: &str| std::fs::read_to_string(charts.join(name)).unwrap();
    let table = read("peers.csv");
    assert!(
        table.starts_with("name,net,max_error,cycles_low,cycles_high,instructions,cycles_least,"),
        "{table}"
    );
    let first = table.lines().nth(1).unwrap().split(',').nth(3).unwrap();
    assert!(first.parse::<f64>().unwrap() > 0.0);
    assert!(read("peers.svg").contains("16-16-3") && read("peers.html").contains("16-16-3"));
    let mut names: Vec<_> =
        std::fs::read_dir(&charts).unwrap().map(|f| f.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["peers.csv", "peers.html", "peers.svg"]);
    let file = charts.join("peers.csv");
    let told = fails(1, &["chart", "--only", "peers", "--out", file.to_str().unwrap()]);
    assert!(told.contains("peers.csv") && told.contains("cannot be made"), "{told}");
}

/// Starts a virtual finger in this process and returns its port.
fn finger() -> (VirtualFinger, String) {
    let source = Source::scene("press").unwrap();
    let finger = VirtualFinger::on_tcp("127.0.0.1:0", source, None).unwrap();
    let port = finger.port().to_string();
    (finger, port)
}

/// Writes a trace of so many scans at 1 kHz.
fn trace(directory: &Path, scans: u64) -> String {
    let mut text = String::from("t_us,bridge_s0_a,bridge_s0_b,bridge_s0_c,bridge_s0_d\n");
    for i in 0..scans {
        text += &format!("{},2000,2001,2002,{}\n", i * 1000, 2000 + i % 5);
    }
    let path = directory.join("trace.csv");
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// Reads the lines after the header, and checks that each has as many cells as the header.
fn lines(path: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.ends_with('\n'));
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let cells = lines.next().unwrap().split(',').count();
    lines
        .map(|line| {
            assert_eq!(line.split(',').count(), cells, "{line}");
            line.to_owned()
        })
        .collect()
}

#[test]
fn help_names_commands_and_port_forms() {
    let help = succeeds(&["--help"]);
    for word in ["demo", "record", "info", "bias", "set", "tcp:HOST:PORT", "sim:SCENE"] {
        assert!(help.contains(word), "{word}");
    }
    assert!(succeeds(&["--version"]).starts_with("taxel "));
}

#[test]
fn every_command_has_a_manual_page_with_its_options_and_examples() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("man1");
    succeeds(&["man", "--out", out.to_str().unwrap()]);
    let page = |name: &str| std::fs::read_to_string(out.join(format!("{name}.1"))).unwrap();
    let help = succeeds(&["--help"]);
    let (_, commands) = help.split_once("Commands:\n").unwrap();
    let names =
        commands.lines().map_while(|line| line.strip_prefix("  ")?.split_whitespace().next());
    let names: Vec<_> = names.filter(|name| *name != "help").collect();
    assert!(names.len() > 15, "{names:?}");
    for name in names {
        let (text, title) = (page(&format!("taxel-{name}")), format!("\n.TH taxel-{name} 1 "));
        assert!(text.contains(&title), "{name}");
        for section in ["NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXTRA"] {
            assert!(text.contains(&format!("\n.SH {section}\n")), "{name} has no {section}");
        }
        // A line that begins with a dot or a quote is a roff request: only these are intended.
        let meant = [".ie", ".el", ".TH", ".SH", ".TP", ".IP", ".PP", ".RS", ".RE", ".br"];
        let orders = text.lines().filter(|line| line.starts_with(['.', '\'']));
        orders.for_each(|line| assert!(meant.contains(&&line[..3]), "{name}: {line}"));
    }
    // Examples stay on one line.
    assert!(page("taxel-record").contains("\n  taxel record \\-\\-port sim:tour "));
    assert!(page("taxel-calibrate-upload").contains(".SH NAME\ntaxel\\-calibrate\\-upload"));
}

#[test]
fn incomplete_command_prints_help() {
    for (args, word) in [(&[][..], "\n  demo "), (&["calibrate"], "\n  upload ")] {
        let ran = here().taxel(args);
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""));
        assert!(ran.err.contains("Usage: taxel ") && ran.err.contains(word), "{}", ran.err);
    }
}

#[test]
fn bad_usage_is_one_line_and_exit_code_2() {
    let port = "--port sim:press";
    for (args, line) in [
        (
            "info --port udp:here",
            "invalid value 'udp:here' for '--port <PORT>': unknown kind of port `udp:`; write usb, a serial \
             device, tcp:HOST:PORT, file:PATH or sim:SCENE; see --help",
        ),
        (
            "info --port tcp:here",
            "invalid value 'tcp:here' for '--port <PORT>': `here` is not HOST:PORT; write for example \
             tcp:192.168.1.20:5000 or tcp:[::1]:5000; see --help",
        ),
        (
            "calibrate download",
            "the following required arguments were not provided: --out <CAL.toml>; see --help",
        ),
        ("infp", "unrecognized subcommand 'infp'; a similar subcommand exists: 'info'; see --help"),
        (
            &format!("set {port}"),
            "the following required arguments were not provided: <--rate <HZ>|--filter <HZ>|--fields <LIST>|\
             --point <METHOD>|--scan <HZ>|--oversampling <SAMPLES>|--settle <US>|--save>; see --help",
        ),
        (
            &format!("set {port} --fields force,colour"),
            &format!(
                "invalid value 'force,colour' for '--fields <LIST>': unknown field `colour`; choose from \
                 {}; see --help",
                taxel::frame::schema::FIELD_NAMES
            ),
        ),
        (
            "demo --duration 0",
            "invalid value '0' for '--duration <SEC>': expected seconds above 0; see --help",
        ),
        (
            &format!("bias {port} take --scans 1"),
            "invalid value '1' for '--scans <SCANS>': 1 is not in 2..=65535; see --help",
        ),
    ] {
        let args: Vec<_> = args.split(' ').collect();
        assert_eq!(fails(2, &args), format!("taxel: {line}\n"));
    }
}

#[test]
fn failure_is_one_line_and_exit_code_1() {
    let trace = fails(1, &["info", "--port", "file:no-such-trace.csv"]);
    assert!(trace.starts_with("taxel: no-such-trace.csv: "), "{trace}");
    let file = fails(1, &["info", "--port", "Cargo.toml"]);
    let line = "a file, not a device; write `file:` in front of it to play it back";
    assert_eq!(file, format!("taxel: Cargo.toml: {line}\n"));
    let rate = fails(1, &["set", "--port", "sim:press", "--rate", "0"]);
    let line = ": rate: must lie in 1…1000; all settings are as before\n";
    assert!(rate.ends_with(line), "{rate}");
    let missing = fails(1, &["info", "--port", "/dev/no-such-finger"]);
    assert!(missing.starts_with("taxel: /dev/no-such-finger: no such device; there "), "{missing}");
    let scene = fails(1, &["demo", "--scene", "no-such-scene"]);
    assert!(scene.starts_with("taxel: no-such-scene"), "{scene}");
    let out = "no-such-directory/frames.csv";
    let file = fails(1, &["record", "--port", "sim:press", "--out", out]);
    assert!(file.starts_with("taxel: no-such-directory/frames.csv: "), "{file}");
    let calibration = fails(1, &["demo", "--calibration", "no-such.cal.toml"]);
    assert!(calibration.starts_with("taxel: no-such.cal.toml: "), "{calibration}");
}

#[test]
fn demo_json_is_one_object() {
    let report =
        json(&succeeds(&["demo", "--headless", "--json", "--duration", "1", "--scene", "press"]));
    assert_eq!(report["frames"], 1000);
    assert_eq!(report["lost"], 0);
    assert!(report["rate_hz"].as_f64().unwrap() > 0.0);
    assert!((report["duration_s"].as_f64().unwrap() - 1.0).abs() < 0.01);
    for target in ["fx_n", "fy_n", "fz_n", "x_mm", "y_mm"] {
        assert!(report["rmse"].as_object().unwrap().contains_key(target));
        assert!(report["compared"][target].is_u64());
    }
}

#[test]
fn demo_runs_behind_tcp() {
    let args = ["demo", "--headless", "--json", "--duration", "0.2", "--tcp", "127.0.0.1:0"];
    assert_eq!(json(&succeeds(&args))["frames"], 200);
}

#[test]
fn info_shows_settings_changed_by_set() {
    let (_finger, port) = finger();
    let before = json(&succeeds(&["info", "--port", &port, "--json"]));
    assert_eq!(before["board"], "virtual");
    assert_eq!(before["rate_hz"], 1000.0);
    assert_eq!(before["calibration"], serde_json::Value::Null);

    let set = ["--rate", "250", "--fields", "force,point", "--point", "argmin"];
    let said = succeeds(&[&["set", "--port", port.as_str()], set.as_slice()].concat());
    assert_eq!(said, "rate 250 Hz\nfields force,point\npoint argmin\n");
    let after = json(&succeeds(&["info", "--port", &port, "--json"]));
    assert_eq!((&after["rate_hz"], &after["point"]), (&250.0.into(), &"argmin".into()));
    assert_eq!(after["fields"], "force,point");
    let text = succeeds(&["info", "--port", &port]);
    assert!(text.contains("stream       250 Hz, off, fields force,point"), "{text}");
}

#[test]
fn self_test_lists_every_channel() {
    let (_finger, port) = finger();
    let test = json(&succeeds(&["self-test", "--port", &port, "--scans", "200", "--json"]));
    assert_eq!(test["scans"], 200);
    assert_eq!(test["wrong"], serde_json::json!([]));
    let mean = |channel: &str| test["channels"][channel]["mean"].as_f64().unwrap();
    let ratio = test["lit_over_dark"][3][2].as_f64().unwrap();
    assert!(ratio > 2.0 && (ratio - mean("lit_r3c2") / mean("dark_c2")).abs() < 1e-3, "{ratio}");
    let text = succeeds(&["info", "--port", &port]);
    assert!(text.contains("started      after a reset that it cannot tell"), "{text}");
    let error = fails(1, &["dfu", "--port", &port]);
    assert!(error.contains("this board cannot do that"), "{error}");
    let error = fails(1, &["set", "--port", &port, "--settle", "30"]);
    assert!(error.contains("cannot scan in another way"), "{error}");
}

/// Runs the example of the help; the scene has known faults.
#[test]
fn self_test_example_finds_faults() {
    let help = succeeds(&["self-test", "--help"]);
    let example = help.lines().find(|line| line.contains("taxel self-test --port sim:")).unwrap();
    let words: Vec<_> = example.split('#').next().unwrap().split_whitespace().skip(1).collect();
    let ran = here().taxel(&words);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    let led = "taxel: self-test: lit_r1c2 is hardly brighter than its column in the dark";
    assert!(ran.err.starts_with(led) && ran.err.contains("; bridge_s1_a rests at "), "{}", ran.err);
    assert!(!ran.err.contains("noisy") && ran.out.contains("lit_r3c3 "), "{}{}", ran.err, ran.out);
}

#[test]
fn bias_is_taken_read_and_cleared() {
    let directory = tempfile::tempdir().unwrap();
    let trace = trace(directory.path(), 60_000);
    let source = Source::trace(Path::new(&trace)).unwrap();
    let finger = VirtualFinger::on_tcp("127.0.0.1:0", source, None).unwrap();
    let port = finger.port().to_string();
    let bias = |action: &str| {
        json(&succeeds(&["bias", "--port", &port, action, "--scans", "50", "--json"]))
    };
    let taken = bias("take");
    assert_eq!(taken["on_command"], true);
    assert!(taken["sensors"][0]["noise"].as_f64().unwrap() > 0.0);
    assert_eq!(bias("read"), taken);
    assert_eq!(bias("clear")["on_command"], false);
    let text = succeeds(&["bias", "take", "--port", &port, "--scans", "50"]);
    assert!(text.starts_with("bias taken on command\nsensor 0 "), "{text}");
}

#[test]
fn recording_has_reported_number_of_rows() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("frames.csv");
    let path = out.to_str().unwrap();
    let said = succeeds(&[
        "record",
        "--port",
        "sim:press",
        "--out",
        path,
        "--duration",
        "0.5",
        "--fields",
        "all",
        "--rate",
        "500",
    ]);
    assert!(said.contains("frames.csv: 250 frames, 0 lost"), "{said}");
    let lines = lines(&out);
    assert_eq!(lines.len(), 250);
    let seqs = lines.iter().map(|line| line.split(',').nth(1).unwrap());
    assert!(seqs.clone().map(|seq| seq.parse::<u64>().unwrap()).eq(0..250));
}

#[test]
fn playback_is_recorded_to_its_end() {
    let directory = tempfile::tempdir().unwrap();
    let port = format!("file:{}", trace(directory.path(), 1500));
    let out = directory.path().join("frames.csv");
    let summary =
        json(&succeeds(&["record", "--port", &port, "--out", out.to_str().unwrap(), "--json"]));
    assert_eq!(summary["frames"], lines(&out).len());
    assert_eq!(summary["lost"], 0);
    // The first scans pass during the client's handshake.
    assert!(lines(&out).len() > 100);
}

#[test]
fn lasting_disconnect_keeps_recording() {
    let (finger, port) = finger();
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("frames.csv");
    let path = out.to_str().unwrap();
    let child = command(&["record", "--port", &port, "--out", path, "--duration", "5"]);
    let child = recording(child, &out);
    drop(finger);
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stderr).unwrap();
    let frames = lines(&out).len();
    assert!(said.contains("the finger is gone") && said.contains("waiting for it"), "{said}");
    assert!(said.lines().last().unwrap().starts_with("taxel: tcp:127.0.0.1:"), "{said}");
    assert!(said.ends_with(&format!("frames.csv has the {frames} frames until then\n")), "{said}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_recording_cleanly() {
    let (_finger, port) = finger();
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("frames.csv");
    let child = command(&["record", "--port", &port, "--out", out.to_str().unwrap()]);
    let child = recording(child, &out);
    let id = nix::unistd::Pid::from_raw(child.id() as i32);
    nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGINT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains(&format!(": {} frames, 0 lost", lines(&out).len())), "{said}");
}

/// Starts the command and waits until frames reach the disk.
fn recording(mut command: Command, out: &Path) -> std::process::Child {
    let mut child = command.spawn().unwrap();
    until("a hundred frames", || {
        assert_eq!(child.try_wait().unwrap(), None, "it ended before it recorded");
        rows_so_far(out) > 100
    });
    child
}

#[test]
fn closed_output_is_no_failure() {
    let mut child = command(&["info", "--port", "sim:press"]).spawn().unwrap();
    drop(child.stdout.take());
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!((child.wait().unwrap().code(), said.as_str()), (Some(0), ""));
}

#[test]
fn serve_refuses_hardware_ports() {
    let error = fails(1, &["serve", "--port", "tcp:127.0.0.1:5000"]);
    assert_eq!(
        error,
        "taxel: tcp:127.0.0.1:5000: already a port of its own; serve takes sim:SCENE or file:TRACE.csv\n"
    );
}

#[test]
fn missing_emulator_names_the_command_that_builds_it() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["simulate", "--scene", "press", "--out", "press.csv"]);
    let replay = ["replay", "press.csv", "--out", "frames.csv", "--on", "stm32f411"];
    for args in [&replay[..], &["demo", "--emulated", "--headless"]] {
        let ran = taxel.command(args).env("TAXEL_EMULATOR", "nowhere").output().unwrap();
        let ran = Ran::of(ran);
        assert_eq!((ran.code, ran.err.lines().count()), (Some(1), 1), "{}", ran.err);
        let named =
            ran.err.starts_with("taxel: nowhere") && ran.err.contains("`cargo xtask emulator`");
        assert!(named, "{}", ran.err);
    }
}

//! Tests that Ctrl-C on a terminal ends every command within a second, and leaves whole files.
//!
//! `ports`, `udev`, `completions` and `man` print and end, so they have no row here.

use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::signal::{Signal, kill};
use nix::sys::stat::Mode;
use nix::unistd::{Pid, mkfifo};

use crate::common::{In, Running, rows_so_far, until};
use taxel_files::recording::{Recording, Scans};

/// Longest time from Ctrl-C to the end of a command.
const LIMIT: Duration = Duration::from_secs(1);
/// Number of the signal that Ctrl-C sends.
const SIGINT: i32 = Signal::SIGINT as i32;
/// Time for a command without output to begin its work.
const UNDER_WAY: Duration = Duration::from_millis(300);
/// Time for a command to start on a busy machine. Only a failing test reaches it.
const PATIENCE: Duration = Duration::from_secs(20);

/// End of an interrupted command.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    /// Exit code 130, or death by the signal, which a shell reports as 130.
    Interrupted,
    /// Exit code 0, after the files were finished.
    Finished,
    /// Exit code 1, with a line on what there is now.
    Failed,
}

impl End {
    fn of(status: ExitStatus) -> Option<Self> {
        match (status.code(), status.signal()) {
            (Some(130), _) | (None, Some(SIGINT)) => Some(Self::Interrupted),
            (Some(0), _) => Some(Self::Finished),
            (Some(1), _) => Some(Self::Failed),
            _ => None,
        }
    }
}

/// Command on a terminal of its own.
struct OnTerminal {
    child: Running,
    keyboard: File,
    said: Receiver<Vec<u8>>,
}

impl OnTerminal {
    fn start(folder: &Path, args: &[&str]) -> Self {
        let terminal = nix::pty::openpty(None, None).unwrap();
        let mut command = Command::new("setsid");
        command.args(["--ctty", env!("CARGO_BIN_EXE_taxel")]).args(args).current_dir(folder);
        command.stdin(terminal.slave.try_clone().unwrap());
        command.stdout(terminal.slave.try_clone().unwrap());
        let child = Running(command.stderr(terminal.slave).spawn().unwrap());
        let keyboard = File::from(terminal.master);
        let mut screen = keyboard.try_clone().unwrap();
        let (say, said) = channel();
        thread::spawn(move || {
            let mut bytes = [0; 4096];
            // Linux reports the closed other end as an error.
            while let Ok(read @ 1..) = screen.read(&mut bytes) {
                if say.send(bytes[..read].to_vec()).is_err() {
                    return;
                }
            }
        });
        Self { child, keyboard, said }
    }

    /// Waits until the command has said something, or has run for a while.
    fn under_way(&mut self) -> Vec<u8> {
        let program = format!("/proc/{}/exe", self.child.0.id());
        let own = Path::new(env!("CARGO_BIN_EXE_taxel")).canonicalize().unwrap();
        // Until then it is `setsid`, whose terminal may not be its own yet.
        until("the command", || {
            std::fs::read_link(&program).map_or(true, |running| running == own)
        });
        self.said.recv_timeout(UNDER_WAY).unwrap_or_default()
    }

    /// Waits until the command handles Ctrl-C, which would otherwise end it at once.
    fn handles_ctrl_c(&self) {
        const SIGINT: u64 = 1 << 1;
        let status = format!("/proc/{}/status", self.child.0.id());
        until("the handler of Ctrl-C", || {
            let status = std::fs::read_to_string(&status).unwrap_or_default();
            let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
            let caught = caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
            caught.is_none_or(|mask| mask & SIGINT != 0)
        });
    }

    /// Waits until the command has said this.
    fn until(&mut self, words: &str) -> Vec<u8> {
        let mut said = self.under_way();
        let deadline = Instant::now() + PATIENCE;
        while !String::from_utf8_lossy(&said).contains(words) {
            said.extend(self.said.recv_timeout(UNDER_WAY).unwrap_or_default());
            assert!(Instant::now() < deadline, "{}", String::from_utf8_lossy(&said));
        }
        said
    }

    /// Presses Ctrl-C. Returns the end, the time until then and the output.
    fn ctrl_c(mut self, mut said: Vec<u8>) -> (ExitStatus, Duration, String) {
        let pressed = Instant::now();
        self.keyboard.write_all(b"\x03").unwrap();
        until("the end", || {
            if pressed.elapsed() > PATIENCE {
                self.child.0.kill().unwrap();
            }
            self.child.0.try_wait().unwrap().is_some()
        });
        let took = pressed.elapsed();
        let status = self.child.0.wait().unwrap();
        drop(self.keyboard);
        said.extend(self.said.iter().flatten());
        (status, took, String::from_utf8_lossy(&said).into_owned())
    }
}

/// Interrupts a command and checks its end, its time and that it leaves no temporary file.
fn interrupt(folder: &Path, line: &str, end: End) -> String {
    let args: Vec<&str> = line.split_whitespace().collect();
    let mut command = OnTerminal::start(folder, &args);
    let said = command.under_way();
    if end == End::Finished {
        command.handles_ctrl_c();
    }
    interrupted(folder, line, command, said, end)
}

fn interrupted(folder: &Path, line: &str, command: OnTerminal, said: Vec<u8>, end: End) -> String {
    let (status, took, said) = command.ctrl_c(said);
    eprintln!("{:6} ms  {status}  taxel {line}", took.as_millis());
    assert_eq!(End::of(status), Some(end), "{line}: {status}: {said}");
    assert!(took < LIMIT, "{line}: {took:?}: {said}");
    let names: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    let temporary = names.iter().find(|name| name.to_string_lossy().starts_with('.'));
    assert_eq!(temporary, None, "{line}");
    said
}

/// Asserts that a recording is whole, and returns its number of frames.
fn whole(path: &Path) -> usize {
    let recording = Recording::open(path).unwrap();
    assert!(recording.whole, "{}", path.display());
    recording.map(Result::unwrap).count()
}

#[test]
fn endless_work_ends_within_a_second() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    for (line, end) in [
        ("demo --headless", End::Finished),
        ("simulate --scene tour --set scan.duration_s=80000 --out trace.csv", End::Finished),
        ("serve --port sim:tour", End::Finished),
        ("serve --port sim:tour --tcp 127.0.0.1:0", End::Finished),
        ("view --port sim:tour --no-browser --listen 127.0.0.1:0", End::Finished),
        (
            "record --port sim:tour --fields all --out frames.mcap --out frames.csv --out frames.parquet",
            End::Finished,
        ),
        ("bias --port sim:tour take --scans 65535", End::Interrupted),
        ("self-test --port sim:tour --scans 4096", End::Interrupted),
        ("chart --out charts", End::Interrupted),
    ] {
        interrupt(folder, line, end);
    }
    #[cfg(feature = "foxglove")]
    interrupt(folder, "bridge --foxglove 127.0.0.1:0 --port sim:tour", End::Finished);
    #[cfg(feature = "zenoh")]
    interrupt(folder, "bridge --zenoh --port sim:tour", End::Finished);
    let scans = Scans::open(&folder.join("trace.csv")).unwrap();
    assert!(scans.samples.map(Result::unwrap).count() > 0);
    let frames =
        ["frames.mcap", "frames.csv", "frames.parquet"].map(|name| whole(&folder.join(name)));
    assert!(frames.iter().all(|count| *count == frames[0]), "{frames:?}");
}

#[test]
fn guided_recording_shows_its_map_and_is_whole_after_ctrl_c() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    let line = "calibrate record --port sim:presses --out presses.mcap --out presses.csv";
    let args: Vec<&str> = line.split_whitespace().collect();
    let mut command = OnTerminal::start(folder, &args);
    let said = command.until("press the middle 3 times");
    let said = interrupted(folder, line, command, said, End::Finished);
    assert!(said.contains("touch nothing for a second") && said.contains("  r3 [···"), "{said}");
    assert!(said.contains("ended early; next: press"), "{said}");
    let frames = ["presses.mcap", "presses.csv"].map(|name| whole(&folder.join(name)));
    assert!(frames[0] > 100 && frames[0] == frames[1], "{frames:?}");
}

#[test]
fn report_shows_progress_and_writes_nothing_after_ctrl_c() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    let calibration = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");
    std::fs::copy(calibration, folder.join("cal.toml")).unwrap();
    In(folder).succeeds(&["simulate", "--scene", "tour", "--out", "tour.csv"]);
    let judged = "--data tour.csv ".repeat(20);
    let line = format!("calibrate report {judged}--calibration cal.toml --out report.html");
    let args: Vec<&str> = line.split_whitespace().collect();
    let mut command = OnTerminal::start(folder, &args);
    let mut said = command.until("reading the recordings");
    said.extend(command.until("tour.csv "));
    let said = interrupted(folder, &line, command, said, End::Failed);
    assert!(said.contains("stopped early; nothing was written"), "{said}");
    assert!(!folder.join("report.html").exists());
}

#[test]
fn adjustment_keeps_what_helped_before_ctrl_c() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    std::fs::write(folder.join("cal.toml"), CALIBRATION).unwrap();
    // A dimmer light needs a new zero, and then gains. The load cell tells no contact point.
    let dimmed = "simulate --scene press-grid --set electronics.load_ohm=930 --out dimmed.csv --cell cell.csv";
    In(folder).succeeds(&dimmed.split_whitespace().collect::<Vec<_>>());
    let data = "--data dimmed.csv --reference cell.csv ".repeat(6);
    let line = format!("calibrate adjust {data}--calibration cal.toml --force --out today.toml");
    let args: Vec<&str> = line.split_whitespace().collect();
    for (stage, end, told) in [
        ("as it is: ", End::Failed, "stopped early; nothing was written"),
        (
            "light of the taxels: ",
            End::Finished,
            "stopped early: the parts kept so far were written",
        ),
    ] {
        std::fs::write(folder.join("today.toml"), "").unwrap();
        let mut command = OnTerminal::start(folder, &args);
        let said = command.until(stage);
        let said = interrupted(folder, &line, command, said, end);
        assert!(said.contains(told), "{said}");
        let written = std::fs::read_to_string(folder.join("today.toml")).unwrap();
        assert_eq!(written.is_empty(), end == End::Failed, "{stage}");
    }
    let zero = |name| taxel_files::calibration::read(folder.join(name)).unwrap().bias().taxels;
    assert_ne!(zero("today.toml"), zero("cal.toml"));
}

/// Opens a serial device that nobody answers on.
fn silent_serial() -> (PtyMaster, String) {
    let master = posix_openpt(nix::fcntl::OFlag::O_RDWR | nix::fcntl::OFlag::O_NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname_r(&master).unwrap();
    (master, name)
}

/// Calibration of the virtual finger with net and sensors only.
const CALIBRATION: &str = include_str!("../../../emulator/data/finger.cal.toml");

/// Starts `taxel serve`, and returns it with its port.
fn served(folder: &Path) -> (Child, String) {
    let mut serve = In(folder).command(&["serve", "--port", "sim:tour", "--tcp", "127.0.0.1:0"]);
    let mut child = serve.stderr(Stdio::null()).spawn().unwrap();
    let mut port = String::new();
    let mut out = std::io::BufReader::new(child.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut out, &mut port).unwrap();
    (child, port.trim().to_owned())
}

#[test]
fn recording_is_whole_when_finger_fell_silent() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    let (mut serve, port) = served(folder);
    let stop = |signal| kill(Pid::from_raw(serve.id().try_into().unwrap()), signal).unwrap();
    let names = ["frames.mcap", "frames.csv", "frames.parquet"];
    for page in ["", " --page 127.0.0.1:0"] {
        let outs = names.map(|name| format!("--out {name}")).join(" ");
        let line = format!("record --port {port} --fields all --force {outs}{page}");
        let args: Vec<&str> = line.split_whitespace().collect();
        let mut command = OnTerminal::start(folder, &args);
        let mut said = command.under_way();
        let deadline = Instant::now() + PATIENCE;
        while !String::from_utf8_lossy(&said).contains("Ctrl-C ends it") {
            said.extend(command.said.recv_timeout(UNDER_WAY).unwrap_or_default());
            assert!(Instant::now() < deadline, "{}", String::from_utf8_lossy(&said));
        }
        // The second recording replaces the first, at its end.
        let rows = if page.is_empty() { "frames.csv" } else { "frames.csv.part.csv" };
        until("a hundred frames", || rows_so_far(&folder.join(rows)) > 100);
        stop(Signal::SIGSTOP);
        thread::sleep(UNDER_WAY);
        interrupted(folder, &line, command, said, End::Finished);
        stop(Signal::SIGCONT);
        let frames = names.map(|name| whole(&folder.join(name)));
        assert!(frames[0] > 100 && frames.iter().all(|count| *count == frames[0]), "{frames:?}");
    }
    serve.kill().unwrap();
    serve.wait().unwrap();
}

#[test]
fn recording_is_whole_while_finger_is_waited_for() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    let (mut serve, port) = served(folder);
    let line = format!("record --port {port} --out frames.mcap");
    let args: Vec<&str> = line.split_whitespace().collect();
    let mut command = OnTerminal::start(folder, &args);
    let mut said = command.under_way();
    until("a frame", || rows_so_far(&folder.join("frames.mcap")) > 0);
    serve.kill().unwrap();
    serve.wait().unwrap();
    // A program takes the port that accepts the connection and says nothing.
    let address = port.strip_prefix("tcp:").unwrap();
    let mut silent = None;
    until("the port", || {
        silent = TcpListener::bind(address).ok();
        silent.is_some()
    });
    let silent = silent.unwrap();
    let (_host, _) = silent.accept().unwrap();
    said.extend(command.said.try_iter().flatten());
    let said = interrupted(folder, &line, command, said, End::Failed);
    assert!(said.contains("waiting for it"), "{said}");
    assert!(whole(&folder.join("frames.mcap")) > 0);
}

#[test]
fn export_of_stalled_pipe_leaves_no_half_file() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    let record = ["record", "--port", "sim:tour", "--duration", "0.5", "--out", "frames.csv"];
    In(folder).succeeds(&record);
    let pipe = folder.join("stalls.csv");
    mkfifo(&pipe, Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
    let line = "export stalls.csv --out copy.csv";
    let args: Vec<&str> = line.split_whitespace().collect();
    let mut command = OnTerminal::start(folder, &args);
    let mut held = File::options().read(true).write(true).open(&pipe).unwrap();
    // A pipe holds 64 KiB.
    let text = std::fs::read(folder.join("frames.csv")).unwrap();
    held.write_all(&text[..text.len().min(60_000)]).unwrap();
    let said = command.under_way();
    let begun = || {
        let mut entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
        entries.any(|entry| entry.file_name().to_string_lossy().ends_with(".part.csv"))
    };
    until("its file", begun);
    // It reads what there is, and waits for the rest.
    thread::sleep(UNDER_WAY);
    interrupted(folder, line, command, said, End::Interrupted);
    assert!(!folder.join("copy.csv").exists());
}

/// Interrupts of every command.
mod endurance {
    use super::*;

    #[test]
    fn wait_for_silent_finger_ends_within_a_second() {
        let directory = tempfile::tempdir().unwrap();
        let folder = directory.path();
        std::fs::write(folder.join("cal.toml"), CALIBRATION).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let tcp = format!("tcp:{}", listener.local_addr().unwrap());
        let (_master, serial) = silent_serial();
        for port in [tcp.as_str(), serial.as_str()] {
            for (line, end) in [
                ("info --port PORT", End::Interrupted),
                ("set --port PORT --rate 500", End::Interrupted),
                ("bias --port PORT take", End::Interrupted),
                ("self-test --port PORT", End::Interrupted),
                ("dfu --port PORT", End::Interrupted),
                ("record --port PORT --out frames.mcap", End::Interrupted),
                ("view --port PORT --no-browser --listen 127.0.0.1:0", End::Finished),
                ("calibrate download --port PORT --out own.toml", End::Interrupted),
            ] {
                interrupt(folder, &line.replace("PORT", port), end);
            }
            let upload = format!("calibrate upload --port {port} --calibration cal.toml");
            let said = interrupt(folder, &upload, End::Interrupted);
            assert!(
                said.contains("taxel: interrupted; the previous calibration stays active"),
                "{said}"
            );
            #[cfg(feature = "foxglove")]
            interrupt(
                folder,
                &format!("bridge --foxglove 127.0.0.1:0 --port {port}"),
                End::Finished,
            );
            #[cfg(feature = "zenoh")]
            interrupt(folder, &format!("bridge --zenoh --port {port}"), End::Finished);
        }
        assert_eq!(In(folder).files().into_keys().collect::<Vec<_>>(), ["cal.toml"]);
    }

    #[test]
    fn read_of_silent_pipe_ends_within_a_second() {
        let directory = tempfile::tempdir().unwrap();
        let folder = directory.path();
        std::fs::write(folder.join("cal.toml"), CALIBRATION).unwrap();
        let make = |name: &str| mkfifo(&folder.join(name), Mode::S_IRUSR | Mode::S_IWUSR).unwrap();
        let hold =
            |name: &str| File::options().read(true).write(true).open(folder.join(name)).unwrap();
        // Nobody opens the first, nobody writes into the second.
        ["unopened.csv", "silent.csv", "unopened.toml", "silent.toml"].into_iter().for_each(make);
        let _held = ["silent.csv", "silent.toml"].map(hold);
        for pipe in ["unopened", "silent"] {
            for line in [
                "export PIPE.csv --out copy.mcap",
                "replay PIPE.csv --out frames.mcap",
                "view --port file:PIPE.csv --no-browser --listen 127.0.0.1:0",
                "serve --port file:PIPE.csv",
                "record --port file:PIPE.csv --out frames.mcap",
                "info --port file:PIPE.csv",
                "simulate --scene PIPE.toml --out trace.csv",
                "calibrate fit --data PIPE.csv --out own.toml",
                "calibrate fit --data PIPE.csv --inputs m* --targets f --out own.toml",
                "calibrate evaluate --data PIPE.csv --calibration cal.toml",
                "calibrate report --data PIPE.csv --calibration cal.toml --out report.html",
                "calibrate adjust --data PIPE.csv --calibration cal.toml --out own.toml",
                "calibrate compare PIPE.toml cal.toml",
                "calibrate upload --port sim:tour --calibration PIPE.toml",
            ] {
                // A fit keeps what it has, and says so if that is nothing.
                let finger_fit = line.contains("fit") && !line.contains("--inputs");
                let end = if finger_fit { End::Failed } else { End::Interrupted };
                interrupt(folder, &line.replace("PIPE", pipe), end);
            }
        }
        let kept = ["cal.toml", "silent.csv", "silent.toml", "unopened.csv", "unopened.toml"];
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = entries.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        assert_eq!(names, kept);
    }
}

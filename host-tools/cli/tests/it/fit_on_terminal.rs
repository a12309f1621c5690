//! Tests of a fit on a terminal: progress from the start, Ctrl-C at every stage.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Child, Command};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeVal;

use crate::common::{In, SHORT_PRESSES, long_form, read_terminal, until, worked};
use taxel_files::calibration;

/// Processor time until the first line of progress; on an idle machine that is the time itself.
const FIRST_LINE: Duration = Duration::from_millis(500);
/// Processor time of two cores in the second after Ctrl-C.
const TWO_CORES: Duration = Duration::from_secs(2);
const FIT: [&str; 7] =
    ["calibrate", "fit", "--data", "presses.csv", "--out", "cal.toml", "--force"];

/// Processor time of all ended children.
fn spent() -> Duration {
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN).unwrap();
    let time = |value: TimeVal| {
        let [seconds, micros] =
            [value.tv_sec(), value.tv_usec()].map(|n| u64::try_from(n).unwrap());
        Duration::from_secs(seconds) + Duration::from_micros(micros)
    };
    time(usage.user_time()) + time(usage.system_time())
}

/// Starts the fit on a terminal of its own and waits for its first output.
fn start(folder: &Path) -> (Child, File) {
    let terminal = nix::pty::openpty(None, None).unwrap();
    let mut fit = Command::new("setsid");
    fit.args(["--ctty", env!("CARGO_BIN_EXE_taxel")]).args(FIT).current_dir(folder);
    fit.stdin(terminal.slave.try_clone().unwrap()).stdout(terminal.slave.try_clone().unwrap());
    let child = fit.stderr(terminal.slave).spawn().unwrap();
    drop(fit);
    let mut master = File::from(terminal.master);
    let read = master.read(&mut [0; 1024]).unwrap();
    assert!(read > 0);
    (child, master)
}

/// Starts the fit and waits for so many tenths of its processor time. Returns its keyboard, and
/// what it will have said.
///
/// The time of a fit is that of the last one that ran to its end, and differs by more than a tenth
/// on a busy machine.
fn at_tenth(tenths: u32, folder: &Path, whole: &mut Duration) -> (Child, File, JoinHandle<String>) {
    for _ in 0..3 {
        let _ = std::fs::remove_file(folder.join("cal.toml"));
        let before = spent();
        let (mut child, master) = start(folder);
        let keyboard = master.try_clone().unwrap();
        let said = thread::spawn(move || read_terminal(master));
        let mut ended = None;
        until("the share of the fit", || {
            ended = child.try_wait().unwrap();
            ended.is_some() || worked(&child) >= *whole * tenths / 10
        });
        let Some(status) = ended else { return (child, keyboard, said) };
        let said = said.join().unwrap();
        assert!(status.success(), "{tenths} tenths: {said}");
        *whole = spent() - before;
    }
    panic!("{tenths} tenths: it ended before Ctrl-C");
}

/// Fits are interrupted.
mod endurance {
    use super::*;

    #[test]
    fn fit_shows_progress_and_ends_at_ctrl_c() {
        let directory = tempfile::tempdir().unwrap();
        let folder = In(directory.path());
        std::fs::write(folder.0.join("mine.toml"), SHORT_PRESSES).unwrap();
        folder.succeeds(&["simulate", "--scene", "mine.toml", "--out", "presses.csv"]);

        let before = spent();
        let (mut child, master) = start(folder.0);
        assert!(worked(&child) < FIRST_LINE, "{:?}", worked(&child));
        let said = thread::spawn(move || read_terminal(master));
        assert!(child.wait().unwrap().success());
        let (mut whole, said) = (spent() - before, said.join().unwrap());
        for stage in ["reading the recordings", "model of the skin", "net"] {
            assert!(said.contains(stage), "{stage}: {said}");
        }

        // The long form interrupts at every tenth.
        let every = if long_form() { 1 } else { 3 };
        let (mut kept, mut ended) = (0, 0);
        for share in (0..10).step_by(every) {
            let (mut child, mut keyboard, said) = at_tenth(share, folder.0, &mut whole);
            let (before, until, since) = (spent(), worked(&child), Instant::now());
            keyboard.write_all(b"\x03").unwrap();
            drop(keyboard);
            let status = child.wait().unwrap();
            let (wall, more) = (since.elapsed(), spent() - before - until);
            let said = said.join().unwrap();
            eprintln!("{share} tenths: ended after {wall:?}, {more:?} of processor time");
            assert!(more < TWO_CORES, "{share}: {more:?}\n{said}");
            let record = calibration::read(folder.0.join("cal.toml"));
            match status.code() {
                Some(0) => assert!(record.is_ok() && said.contains("stopped early"), "{said}"),
                // 130 if the stage did not end within Ctrl-C's second, as on a busy machine.
                Some(1 | 130) => assert!(record.is_err() && said.contains("nothing was"), "{said}"),
                other => panic!("{share}: {other:?} {said}"),
            }
            kept += usize::from(status.code() == Some(0));
            ended += 1;
        }
        assert!(2 * kept >= ended, "{kept} of {ended}");
    }
}

/// Fits as long as a user's.
mod nightly {
    use super::*;

    /// Most processor time of a default fit: that of two cores in 20 s.
    const FIT_TAKES: Duration = Duration::from_secs(40);

    #[test]
    fn fit_of_23_000_rows_takes_20_s_of_two_cores() {
        let directory = tempfile::tempdir().unwrap();
        let folder = In(directory.path());
        for scene in ["presses", "shear"] {
            let out = format!("{scene}.csv");
            let simulate = ["simulate", "--finger", "reference", "--scene", scene, "--out", &out];
            folder.succeeds(&simulate);
        }
        // 500 rows a second.
        let data = ["--data", "presses.csv@0..20", "--data", "shear.csv@0..26"];
        let before = spent();
        folder.succeeds(&[&["calibrate", "fit", "--out", "cal.toml"], &data[..]].concat());
        let took = spent() - before;
        eprintln!("{took:?} of processor time");
        assert!(took < FIT_TAKES, "{took:?}");
    }
}

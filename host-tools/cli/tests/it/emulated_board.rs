//! Tests of the boards' own firmware under `taxel replay --on` and `taxel demo --emulated`. They
//! need the files of `cargo xtask emulator`.

use std::path::Path;

use taxel::frame::Status;
use taxel::scan::{Codes, Scan};
use taxel_files::frames::Cell;
use taxel_files::recording::{Recording, Scans};

use crate::common::{self, In, json};

/// Largest error of a code, in steps: 0.5 for the trace's rounding, 1 for incomplete settling.
const OFF_STEPS: f32 = 1.5;

/// Record of a default fit, which the board and this machine read whole.
const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/virtual-finger.cal.toml");

/// Returns a recording's rows, and the index of their status.
fn rows(path: &Path) -> (Vec<Vec<Cell>>, usize) {
    let recording = Recording::open(path).unwrap();
    let status = recording.position("status").unwrap();
    (recording.map(Result::unwrap).collect(), status)
}

fn scans(path: &Path) -> Vec<Scan> {
    Scans::open(path).unwrap().samples.map(|sample| sample.unwrap().scan).collect()
}

/// Largest error of the board's codes from the trace's, in steps of 12 bits.
fn off(read: &Scan, shown: &Scan) -> f32 {
    let steps = |codes: &Codes| {
        let step = f32::from(codes.full_scale.top().0) / 4095.0;
        let taxels = codes.taxels.unwrap();
        let bridges = codes.bridges.into_iter().flatten().flat_map(|m| [m.a, m.b, m.c, m.d]);
        let codes = taxels.lit.into_iter().flatten().chain(taxels.dark).chain(bridges);
        codes.map(move |code| f32::from(code.0) / step).collect::<Vec<_>>()
    };
    let (read, shown) = (steps(&read.codes), steps(&shown.codes));
    read.iter().zip(&shown).map(|(read, shown)| (read - shown).abs()).fold(0.0, f32::max)
}

/// Replays a stretch of `trace` on a board's pins. The codes must be the trace's. The frames must
/// equal, to the bit, those of this machine from the same codes. Returns the status of each.
fn replayed(folder: &Path, board: &str, trace: &str, stretch: &str) -> Vec<Status> {
    let taxel = In(folder);
    let replay = |trace: &str, on: &str, out: &str| {
        let args = ["replay", trace, "--calibration", SHIPPED, "--fields", "all"];
        taxel.succeeds(&[args.as_slice(), &["--on", on, "--out", out]].concat())
    };
    let stretch = format!("{trace}@{stretch}");
    let said = replay(&stretch, board, "board.mcap");
    replay("board.mcap", "host", "host.mcap");

    let heard = scans(&folder.join("board.mcap"));
    let all = scans(&folder.join(trace));
    let from = all.iter().position(|scan| scan.time >= heard[0].time).unwrap();
    let shown = &all[from..from + heard.len()];
    // A stretch includes both ends.
    assert!(said.starts_with(&format!("board.mcap: {} frames, ", heard.len())), "{said}");
    for (heard, shown) in heard.iter().zip(shown) {
        assert!(off(heard, shown) <= OFF_STEPS, "{:?}: {}", shown.time, off(heard, shown));
        let late = heard.time.0.abs_diff(shown.time.0);
        assert!(late <= 5, "{:?} for {:?}", heard.time, shown.time);
    }
    let ((board, status), (host, _)) =
        (rows(&folder.join("board.mcap")), rows(&folder.join("host.mcap")));
    assert_eq!(board.len(), heard.len());
    for (board, host) in board.iter().zip(&host) {
        assert_eq!(board, host);
    }
    let status = |row: &Vec<Cell>| match row[status] {
        Cell::Whole(bits) => Status(bits as u32),
        other => panic!("{other:?}"),
    };
    board.iter().map(status).collect()
}

fn seen(statuses: &[Status], wanted: Status) -> bool {
    statuses.iter().any(|status| status.contains(wanted))
}

fn replay_equals_this_machine(board: &str) {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["simulate", "--scene", "press", "--seed", "3", "--out", "press.csv"]);
    let statuses = replayed(folder.path(), board, "press.csv", "0.5..0.9");
    // Frames at 1 kHz, the one at 0.9 s no longer.
    assert_eq!(statuses.len(), 400);
    assert!(seen(&statuses, Status::CONTACT) && !seen(&statuses, Status::OVERRUN));
    assert!(seen(&statuses, Status::RAN_MODEL));
}

#[test]
fn emulated_g431_replay_equals_this_machine() {
    replay_equals_this_machine("stm32g431");
}

#[test]
fn emulated_f411_replay_equals_this_machine() {
    replay_equals_this_machine("stm32f411");
}

/// Replays a trace on this machine and on both boards, and compares the files byte for byte.
fn files_are_equal(folder: &Path, trace: &str, record: &str) {
    let file = |on: &str| {
        let out = format!("{on}.csv");
        let args = ["replay", trace, "--calibration", record, "--bits", "12", "--fields", "all"];
        In(folder).succeeds(&[args.as_slice(), &["--on", on, "--out", &out]].concat());
        std::fs::read_to_string(folder.join(out)).unwrap()
    };
    let host = file("host");
    for board in ["stm32g431", "stm32f411"] {
        let board_file = file(board);
        // The first line that differs says more than two whole files.
        for (host, board) in host.lines().zip(board_file.lines()) {
            assert_eq!(host, board);
        }
        assert_eq!(host.len(), board_file.len(), "{board}");
    }
}

/// At 500 scans a second, in codes of 16 bits.
#[test]
fn files_of_host_and_boards_are_equal_to_the_byte() {
    let folder = tempfile::tempdir().unwrap();
    let scene = "effects = ['noise', 'gain-spread', 'bridge-mismatch', 'temperature']\n\
                 [scan]\nrate_hz = 500\nduration_s = 1.2\n[device]\nseed = 1\nbits = 16\n\
                 [indenter]\nradius_mm = 6\n\
                 [[press]]\nat_s = 0.2\nx_mm = 0.6\ny_mm = -0.4\nfz_n = 1.2\nfx_n = 0.3\n\
                 rise_s = 0.1\nhold_s = 0.4\nfall_s = 0.1\n";
    std::fs::write(folder.path().join("press.toml"), scene).unwrap();
    In(folder.path()).succeeds(&["simulate", "--scene", "press.toml", "--out", "press.csv"]);
    files_are_equal(folder.path(), "press.csv", SHIPPED);
}

/// Replays a finger that another program made, with the record of a default fit to it.
#[test]
fn files_of_a_foreign_finger_are_equal_to_the_byte() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/independent");
    let path = |name: &str| data.join(name).to_str().unwrap().to_owned();
    if !data.is_dir() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (presses, shear) = (path("d21_presses.csv"), path("d21_shear.csv"));
    let fit = ["calibrate", "fit", "--data", &presses, "--data", &shear, "--out", "d21.toml"];
    In(folder.path()).succeeds(&fit);
    files_are_equal(folder.path(), &path("d21_trial.csv"), "d21.toml");
}

/// Replays faults at 500 Hz: at 1 kHz the first frame of a touch with every field takes longer than
/// a scan, so one is lost.
#[test]
fn emulated_faults_are_flagged_as_on_this_machine() {
    let folder = tempfile::tempdir().unwrap();
    let scene = "effects = ['noise', 'gain-spread', 'bridge-mismatch']\n\
                 [scan]\nrate_hz = 500\nduration_s = 0.5\n[device]\nseed = 1\nbits = 12\n\
                 [indenter]\nradius_mm = 6\n\
                 [[press]]\nat_s = 0.05\nx_mm = 0.6\ny_mm = -0.4\nfz_n = 1.2\n\
                 rise_s = 0.05\nhold_s = 0.35\nfall_s = 0.05\n\
                 [[fault]]\nat_s = 0.15\nuntil_s = 0.25\nkind = 'saturated-adc'\nchannel = 'c2'\n\
                 [[fault]]\nat_s = 0.3\nkind = 'broken-arm'\nchannel = 's0_r3'\n\
                 [[fault]]\nat_s = 0.35\nkind = 'dead-led'\nchannel = 'r1c2'\n";
    std::fs::write(folder.path().join("faults.toml"), scene).unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["simulate", "--scene", "faults.toml", "--seed", "1", "--out", "faults.csv"]);
    let statuses = replayed(folder.path(), "stm32g431", "faults.csv", "0..");
    for wanted in [Status::SATURATED, Status::BRIDGE_FAULT, Status::DEAD_TAXEL] {
        assert!(seen(&statuses, wanted), "{wanted:?}");
    }
}

/// Replays a trace slower than the board's minimum of 260 Hz. The board reads each scan several
/// times.
#[test]
fn emulated_slow_trace_takes_as_long_as_it_lasts() {
    let folder = tempfile::tempdir().unwrap();
    let scene =
        "effects = ['noise']\n[scan]\nrate_hz = 250\nduration_s = 0.4\n[device]\nbits = 12\n";
    std::fs::write(folder.path().join("slow.toml"), scene).unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["simulate", "--scene", "slow.toml", "--out", "slow.csv"]);
    let replay = ["replay", "slow.csv", "--on", "stm32g431", "--fields", "codes"];
    taxel.succeeds(&[replay.as_slice(), &["--out", "slow.mcap"]].concat());
    let (heard, shown) =
        (scans(&folder.path().join("slow.mcap")), scans(&folder.path().join("slow.csv")));
    assert_eq!((heard.len(), shown.len()), (100, 100));
    for (heard, shown) in heard.iter().zip(&shown) {
        assert!(off(heard, shown) <= OFF_STEPS, "{:?}: {}", shown.time, off(heard, shown));
        let late = heard.time.0.abs_diff(shown.time.0);
        assert!(late < 500, "{:?} for {:?}", heard.time, shown.time);
    }
}

#[test]
fn emulated_demo_sums_up_what_the_board_streamed() {
    let folder = tempfile::tempdir().unwrap();
    let demo = ["demo", "--emulated", "--scene", "press", "--duration", "1.5"];
    let said = In(folder.path()).succeeds(&[demo.as_slice(), &["--headless", "--json"]].concat());
    let said = json(&said);
    // On a busy machine the board runs slower than real time.
    assert!(said["frames"].as_u64().unwrap() > 100, "{said}");
    assert_eq!(said["lost"], 0);
    assert!(said["rate_hz"].as_f64().unwrap() > 50.0, "{said}");
    assert!(said["rmse"].as_object().unwrap().contains_key("fz_n"), "{said}");
}

/// Finds the `/proc` folder of a process that `parent` has started.
#[cfg(target_os = "linux")]
fn child_of(parent: u32) -> Option<std::path::PathBuf> {
    let folders = std::fs::read_dir("/proc").unwrap().map(|entry| entry.unwrap().path());
    folders.into_iter().find(|folder| {
        // The second field after the bracketed name is the parent (proc(5)).
        let stat = std::fs::read_to_string(folder.join("stat")).unwrap_or_default();
        let fields = stat.rsplit(')').next().unwrap_or_default();
        fields.split_whitespace().nth(1) == Some(&parent.to_string())
    })
}

/// Kills the command; a surviving emulator would keep a processor core busy.
#[cfg(target_os = "linux")]
#[test]
fn emulated_board_ends_when_the_command_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    let demo = ["demo", "--emulated", "--scene", "press", "--headless"];
    let mut child = In(folder.path()).command(&demo).spawn().unwrap();
    let mut emulator = None;
    common::until("the emulator", || {
        assert_eq!(child.try_wait().unwrap(), None, "it ended by itself");
        emulator = child_of(child.id());
        emulator.is_some()
    });
    let emulator = emulator.unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    common::until("the emulator's end", || !emulator.exists());
}

#[cfg(unix)]
#[test]
fn emulated_replay_keeps_its_frames_when_interrupted() {
    use nix::sys::signal::{Signal, kill};

    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["simulate", "--scene", "tour", "--out", "tour.csv"]);
    let replay = ["replay", "tour.csv", "--on", "stm32g431", "--out", "out.csv"];
    let mut child = taxel.command(&replay).spawn().unwrap();
    let out = folder.path().join("out.csv");
    // Until it is whole the file has another name in the same folder.
    let written = || {
        let files = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap());
        let part = files.filter(|file| file.file_name().to_string_lossy().contains(".part"));
        part.map(|file| file.metadata().map_or(0, |file| file.len())).sum::<u64>()
    };
    common::until("10 kB of frames", || {
        assert_eq!(child.try_wait().unwrap(), None, "it ended before Ctrl-C");
        written() >= 10_000
    });
    kill(nix::unistd::Pid::from_raw(child.id().try_into().unwrap()), Signal::SIGINT).unwrap();
    let ran = common::Ran::of(child.wait_with_output().unwrap());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(ran.out.ends_with("; stopped early\n"), "{}", ran.out);
    let frames = ran.out.split(' ').nth(1).unwrap().parse::<usize>().unwrap();
    let rows = std::fs::read_to_string(&out).unwrap();
    let rows = rows.lines().filter(|line| !line.starts_with('#')).count();
    assert_eq!(rows, frames + 1);
}

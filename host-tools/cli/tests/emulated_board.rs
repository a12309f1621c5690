//! `taxel replay --on` the boards with hardware, as a user would run it. Needs what `host-tools/emulator` builds with
//! and the boards' firmware: `cargo xtask test` sees to both.

#[path = "it/common.rs"]
#[allow(dead_code, reason = "the other tests use the rest")]
mod common;

use std::path::Path;

use common::In;

/// The virtual finger with the net and the sensors alone, which every image has room for.
const VIRTUAL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");

/// The lines of a recording behind its facts, without its first frame, which says that the board has just begun.
fn frames(folder: &Path, name: &str) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.skip(2).map(str::to_owned).collect()
}

/// A press on the pins; what the board says of it, and what this machine says of the codes that the board read.
fn emulated_press(board: &str) {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["simulate", "--scene", "press", "--seed", "3", "--out", "press.csv"]);
    let replay = |trace: &str, on: &str, out: &str| {
        let args = ["replay", trace, "--calibration", VIRTUAL, "--fields", "all"];
        taxel.succeeds(&[args.as_slice(), &["--on", on, "--out", out]].concat())
    };
    let said = replay("press.csv@0..0.4", board, "board.csv");
    // A stretch has both its ends.
    assert!(said.starts_with("board.csv: 401 frames, "), "{said}");
    replay("board.csv", "host", "host.csv");
    let (board, host) = (frames(folder.path(), "board.csv"), frames(folder.path(), "host.csv"));
    assert_eq!(board.len(), 400);
    assert_eq!(board, host);
}

#[test]
fn emulated_g431_says_of_a_trace_on_its_pins_what_this_machine_says_of_its_codes() {
    emulated_press("stm32g431");
}

#[test]
fn emulated_f411_says_of_a_trace_on_its_pins_what_this_machine_says_of_its_codes() {
    emulated_press("stm32f411");
}

//! Table of output files against what may befall them: none is lost or half written.

use std::path::Path;
use std::process::Command;

use crate::common::{In, Ran};

/// Commands with their output file as `OUT`, all of which need seconds at most.
const COMMANDS: [(&str, &str); 6] = [
    ("fit", "calibrate fit --data bench.csv --sensor 0 --out OUT.toml"),
    ("adjust", "calibrate adjust --data weights.csv --calibration finger.toml --out OUT.toml"),
    ("download", "calibrate download --port sim:tour --out OUT.toml"),
    ("report", "calibrate report --data bench.csv --calibration s0.toml --out OUT.html"),
    ("simulate", "simulate --scene bench-s0 --out OUT.csv"),
    ("replay", "replay bench.csv --out OUT.csv"),
];
const BEFORE: &str = "a quarter of an hour on a bench";

/// Makes the inputs of all commands.
fn inputs(folder: &In<'_>) {
    for typed in [
        "simulate --scene bench-s0 --seed 11 --out bench.csv",
        "simulate --scene press-grid --seed 4 --out weights.csv",
        "calibrate fit --data bench.csv --sensor 0 --out s0.toml",
    ] {
        folder.succeeds(&words(typed));
    }
    let finger = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");
    std::fs::copy(finger, folder.0.join("finger.toml")).unwrap();
}

fn words(typed: &str) -> Vec<&str> {
    typed.split(' ').collect()
}

fn file(typed: &str, out: &str) -> (String, String) {
    let typed = typed.replace("OUT", out);
    let name = typed.rsplit(' ').next().unwrap().to_owned();
    (typed, name)
}

fn text(folder: &In<'_>, name: &str) -> String {
    std::fs::read_to_string(folder.0.join(name)).unwrap()
}

fn no_part_is_left(folder: &In<'_>, at: &str) {
    let left = folder.files().into_keys().find(|name| name.contains(".part"));
    assert_eq!(left, None, "{at}");
}

/// Runs the command on a full disk, as far as this process is concerned.
fn on_full_disk(folder: &In<'_>, typed: &str) -> Ran {
    let script = format!("trap '' XFSZ; ulimit -f 0; exec \"$TAXEL\" {typed}");
    let mut bash = Command::new("bash");
    bash.args(["-c", &script]).env("TAXEL", env!("CARGO_BIN_EXE_taxel")).current_dir(folder.0);
    Ran::of(bash.output().unwrap())
}

#[cfg(unix)]
#[test]
fn no_output_file_is_lost_or_half_written() {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    inputs(&folder);
    for (name, typed) in COMMANDS {
        let (kept, out) = file(typed, name);
        std::fs::write(folder.0.join(&out), BEFORE).unwrap();
        // 1: a file of that name exists.
        let error = folder.fails(1, &words(&kept));
        assert!(error.contains("add --force to overwrite it"), "{name}: {error}");
        assert_eq!(text(&folder, &out), BEFORE, "{name}");
        // 2: the disk is full.
        let ran = on_full_disk(&folder, &format!("{kept} --force"));
        assert_eq!(ran.code, Some(1), "{name}: {}{}", ran.out, ran.err);
        let line = ran.err.lines().last().unwrap_or_default();
        assert!(line.contains(&out) && !line.contains(".part"), "{name}: {line}");
        assert_eq!(text(&folder, &out), BEFORE, "{name}");
        no_part_is_left(&folder, name);
        // 3: the file is write-protected.
        let path = folder.0.join(&out);
        let mut rights = path.metadata().unwrap().permissions();
        rights.set_readonly(true);
        std::fs::set_permissions(&path, rights.clone()).unwrap();
        let error = folder.fails(1, &words(&format!("{kept} --force")));
        assert!(error.contains("write-protected"), "{name}: {error}");
        assert_eq!(text(&folder, &out), BEFORE, "{name}");
        #[expect(clippy::permissions_set_readonly_false, reason = "the test's own file")]
        rights.set_readonly(false);
        std::fs::set_permissions(&path, rights).unwrap();
        // 4: it is to be overwritten.
        folder.succeeds(&words(&format!("{kept} --force")));
        assert_ne!(text(&folder, &out), BEFORE, "{name}");
        no_part_is_left(&folder, name);
        // 5: its folder is missing.
        let (nowhere, _) = file(typed, "no/such");
        let error = folder.fails(1, &words(&nowhere));
        assert!(error.contains("there is no folder no"), "{name}: {error}");
        assert!(!Path::new(&folder.0.join("no")).exists());
    }
}

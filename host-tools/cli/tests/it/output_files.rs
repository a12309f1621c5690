//! Table of output files against what may befall them: none is lost or half written.

use std::path::Path;
use std::process::Command;

use crate::common::{In, Ran};

/// Commands with their output file as `OUT`, all of which need seconds at most.
const COMMANDS: [(&str, &str); 7] = [
    ("fit", "calibrate fit --data bench.csv --sensor 0 --out OUT.toml"),
    ("adjust", "calibrate adjust --data weights.csv --calibration finger.toml --out OUT.toml"),
    ("download", "calibrate download --port sim:tour --out OUT.toml"),
    ("report", "calibrate report --data bench.csv --calibration s0.toml --out OUT.html"),
    ("bench-report", "bench-report form.csv --out OUT.html"),
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
    let form = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/bench-stm32g431.csv");
    std::fs::copy(form, folder.0.join("form.csv")).unwrap();
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

/// Size of a block of the disk, bytes: less than the shortest of the files.
const BLOCK: u64 = 512;

/// Runs the command on a disk with so many blocks left, as far as this process is concerned.
fn on_disk_of(blocks: u64, folder: &In<'_>, typed: &str) -> Ran {
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$TAXEL\" {typed}");
    let mut bash = Command::new("bash");
    bash.args(["--posix", "-c", &script])
        .env("TAXEL", env!("CARGO_BIN_EXE_taxel"))
        .current_dir(folder.0);
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
        // 2: the disk is full, before the file or in the middle of it.
        for blocks in [0, 1] {
            let ran = on_disk_of(blocks, &folder, &format!("{kept} --force"));
            assert_eq!(ran.code, Some(1), "{name}, {blocks}: {}{}", ran.out, ran.err);
            let line = ran.err.lines().last().unwrap_or_default();
            assert!(line.contains(&out) && !line.contains(".part"), "{name}, {blocks}: {line}");
            assert_eq!(text(&folder, &out), BEFORE, "{name}, {blocks}");
            no_part_is_left(&folder, name);
        }
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
        assert!(path.metadata().unwrap().len() > BLOCK, "{name}: row 2 cuts no file");
        no_part_is_left(&folder, name);
        // 5: its folder is missing.
        let (nowhere, _) = file(typed, "no/such");
        let error = folder.fails(1, &words(&nowhere));
        assert!(error.contains("there is no folder no"), "{name}: {error}");
        assert!(!Path::new(&folder.0.join("no")).exists());
    }
}

/// Ctrl-C in the middle of the work.
#[cfg(target_os = "linux")]
mod interrupted {
    use super::*;

    use std::net::TcpListener;
    use std::process::{Child, ExitStatus};
    use std::time::Duration;

    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    use crate::common::{until, worked};

    /// Processor time after which a command works at its many inputs, and is far from their end.
    const AT_WORK: Duration = Duration::from_millis(200);
    const INPUTS: usize = 30;

    /// Runs the command over an old file, and sends the signal of Ctrl-C once `begun` returns.
    fn interrupt(folder: &In<'_>, typed: &str, begun: impl FnOnce(&Child)) -> ExitStatus {
        let out = typed.rsplit(' ').next().unwrap();
        std::fs::write(folder.0.join(out), BEFORE).unwrap();
        let mut command = folder.command(&words(&format!("{typed} --force"))).spawn().unwrap();
        begun(&command);
        kill(Pid::from_raw(command.id().try_into().unwrap()), Signal::SIGINT).unwrap();
        let ended = command.wait().unwrap();
        no_part_is_left(folder, typed);
        ended
    }

    #[test]
    fn interrupted_command_leaves_the_old_file() {
        let directory = tempfile::tempdir().unwrap();
        let folder = In(directory.path());
        inputs(&folder);
        for (name, typed) in COMMANDS {
            let (typed, out) = file(typed, name);
            let ended = match name {
                "fit" | "adjust" | "report" => {
                    let data = typed.split(' ').nth(3).unwrap();
                    let many = format!(" --data {data}").repeat(INPUTS);
                    let typed = typed.replace(&format!(" --data {data}"), &many);
                    let at_work = |command: &Child| worked(command) >= AT_WORK;
                    interrupt(&folder, &typed, |command| until("work", || at_work(command)))
                }
                "download" => {
                    // The port accepts the connection and says nothing.
                    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
                    let port = format!("tcp:{}", silent.local_addr().unwrap());
                    let (typed, mut host) = (typed.replace("sim:tour", &port), None);
                    interrupt(&folder, &typed, |_| host = Some(silent.accept().unwrap()))
                }
                // They write row by row: the next test.
                _ => continue,
            };
            assert!(!ended.success(), "{name}: {ended}");
            assert_eq!(text(&folder, &out), BEFORE, "{name}: {ended}");
        }
    }

    #[test]
    fn interrupted_simulation_replaces_the_old_file_by_a_whole_one() {
        let directory = tempfile::tempdir().unwrap();
        let folder = In(directory.path());
        let begun = || {
            let entries = std::fs::read_dir(folder.0).unwrap().map(|entry| entry.unwrap());
            let mut parts = entries.filter(|e| e.file_name().to_string_lossy().contains(".part"));
            parts.any(|part| part.metadata().is_ok_and(|file| file.len() > BLOCK))
        };
        let endless = "simulate --scene bench-s0 --set scan.duration_s=80000 --out trace.csv";
        let ended = interrupt(&folder, endless, |_| until("rows", begun));
        assert!(ended.success(), "{ended}");
        assert_ne!(text(&folder, "trace.csv"), BEFORE);
        folder.succeeds(&words("replay trace.csv --out frames.csv"));
    }
}

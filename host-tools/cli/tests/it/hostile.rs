//! Tests of malformed files given to `taxel calibrate`, from spreadsheets, editors, crashes and
//! typing slips. Each ends in one line that names the place and the fix, and no file is written.

mod places;
mod records;
mod references;
mod tables;
mod traces;

use crate::common::{In, write_trace};
use taxel_sim::{Scene, Simulator};

/// Calibration of the virtual finger with net and sensors only.
const VIRTUAL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");

/// Rows of a sensor with two channels and a force, as text.
fn rows(count: u32) -> String {
    let row = |i: u32| {
        let t = 0.02 * f64::from(i);
        let force = (0.9 * t).sin() + 0.4 * (2.3 * t).sin();
        format!("{t:.2},{:.4},{:.4},{force:.4}\n", 7.0 - 2.0 * force, 0.3 * force + (1.7 * t).cos())
    };
    (0..count).map(row).collect()
}

const HEADER: &str = "t_s,m0,m1,force_n\n";

fn table() -> String {
    HEADER.to_owned() + &rows(300)
}

/// Creates a folder with a valid table, a model of it, a valid trace and a record for it.
fn folder() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let folder = In(directory.path());
    write(&folder, "good.csv", table());
    folder.succeeds(&fit_table("good.csv", "model.toml"));
    let samples: Vec<_> = Simulator::new(&Scene::load("press").unwrap(), 1).take(500).collect();
    write_trace(folder.0, "trace.csv", &samples, true);
    std::fs::copy(VIRTUAL, folder.0.join("finger.toml")).unwrap();
    directory
}

fn fit_table<'t>(data: &'t str, out: &'t str) -> Vec<&'t str> {
    let columns = ["--inputs", "m*", "--targets", "force_n", "--model", "ridge"];
    [&["calibrate", "fit", "--data", data, "--out", out], &columns[..]].concat()
}

fn write(folder: &In<'_>, name: &str, bytes: impl AsRef<[u8]>) {
    std::fs::write(folder.0.join(name), bytes).unwrap();
}

/// Every command that reads recordings, for a table or a finger's trace; none may leave a file.
fn readers<'t>(data: &'t str, record: &'t str) -> Vec<Vec<&'t str>> {
    let judge = ["--calibration", record, "--data", data];
    let mut commands = vec![
        [&["calibrate", "evaluate"][..], &judge].concat(),
        [&["calibrate", "report", "--out", "page.html"][..], &judge].concat(),
        vec!["calibrate", "compare", record, record, "--data", data],
    ];
    if record == "model.toml" {
        commands.push(fit_table(data, "new.toml"));
    } else {
        commands.push([&["calibrate", "adjust", "--out", "new.toml"][..], &judge].concat());
        commands.push(vec!["calibrate", "fit", "--data", data, "--out", "new.toml"]);
    }
    commands
}

/// Asserts that each command fails with `line` and leaves the folder unchanged.
fn all_say(folder: &In<'_>, commands: &[Vec<&str>], line: &str) {
    let before = folder.files();
    for typed in commands {
        assert_eq!(folder.fails(1, typed), format!("taxel: {line}\n"), "{typed:?}");
    }
    assert_eq!(folder.files(), before, "{line}");
}

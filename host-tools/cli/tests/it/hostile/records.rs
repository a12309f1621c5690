//! Tests of malformed calibrations of a finger.

use std::path::Path;

use super::{all_say, folder, readers, table, write};
use crate::common::In;

/// Every command that reads a finger's record.
fn users(record: &str) -> Vec<Vec<&str>> {
    let mut commands = readers("trace.csv", record);
    // The fit reads no record.
    commands.pop();
    commands.extend([
        vec!["calibrate", "compare", "finger.toml", record],
        // The record is read before a finger is searched.
        vec!["calibrate", "upload", "--port", "tcp:127.0.0.1:1", "--calibration", record],
        vec!["replay", "trace.csv", "--calibration", record, "--out", "frames.csv"],
    ]);
    commands
}

#[test]
fn invalid_record_is_refused_by_line_and_key() {
    let directory = folder();
    let folder = In(directory.path());
    let good = std::fs::read_to_string(folder.0.join("finger.toml")).unwrap();
    let line_of =
        |text: &str, key: &str| 1 + text.lines().position(|line| line.starts_with(key)).unwrap();
    let with = |from: &str, to: &str| {
        assert!(good.contains(from));
        good.replacen(from, to, 1)
    };
    let later = with("T11:", "T12:");
    let crc = |text: &str| {
        let error = folder_error(text);
        error.split("the contents give ").nth(1).unwrap()[..8].to_owned()
    };
    let said =
        good.lines().find_map(|line| line.strip_prefix("crc32 = ")).unwrap().trim_matches('"');
    let half = &good[..good.len() / 2];
    let fits = "`taxel calibrate fit --out CAL.toml` writes a calibration that fits";
    for (name, text, line) in [
        (
            "newer.toml",
            with("taxel_calibration = 2", "taxel_calibration = 9"),
            "newer.toml:1: `taxel_calibration`: version 9 where this build reads 2; fit it again with this build, or \
             use the build it was made with"
                .to_owned(),
        ),
        (
            "unit.toml",
            with("units = \"N, mm", "units = \"mN, mm"),
            "unit.toml:6: `units`: `mN, mm, N*mm; signals as fractions of full scale` where this build knows `N, mm, \
             N*mm; signals as fractions of full scale`; fit the calibration again"
                .into(),
        ),
        (
            "edited.toml",
            later.clone(),
            format!(
                "edited.toml:3: `crc32`: says {said}, the contents give {}; the file was damaged or edited: restore \
                 it or fit again",
                crc(&later)
            ),
        ),
        (
            "date.toml",
            with("date = \"2026", "date = \"yesterday 2026"),
            format!(
                "date.toml:5: `date`: `yesterday {}` is not a date like 2026-11-21T09:30:00Z; fit the calibration again",
                good.lines().nth(4).unwrap().trim_start_matches("date = ").trim_matches('"')
            ),
        ),
        (
            "nan.toml",
            with("noise = ", "noise = nan # "),
            format!(
                "nan.toml:{}: `noise`: noise of taxels is out of range; fit the calibration again",
                line_of(&good, "noise")
            ),
        ),
        (
            "empty.toml",
            String::new(),
            "empty.toml: the file is empty: expected a calibration in TOML; `taxel calibrate fit --out CAL.toml` \
             writes one"
                .into(),
        ),
        (
            "csv.toml",
            table(),
            format!("csv.toml:1: key with no value, expected `=`; {fits}"),
        ),
        (
            "without.toml",
            with("serial = ", "# serial = "),
            format!("without.toml:1: missing field `serial`; {fits}"),
        ),
    ] {
        write(&folder, name, text);
        all_say(&folder, &users(name), &line);
    }
    // The position of the cut depends on the record's length; the refusal does not.
    write(&folder, "half.toml", half);
    for typed in users("half.toml") {
        let error = folder.fails(1, &typed);
        assert!(error.starts_with("taxel: half.toml:") && error.contains("; "), "{error}");
    }
    write(&folder, "binary.toml", [0xff, 0xfe, 0x00, 0x80]);
    let line = "binary.toml: not text: expected a calibration in TOML; `taxel calibrate fit --out CAL.toml` writes one";
    all_say(&folder, &users("binary.toml"), line);
    std::fs::create_dir(folder.0.join("folder.toml")).unwrap();
    all_say(&folder, &users("folder.toml"), "folder.toml: Is a directory; give a file");
    all_say(&folder, &users("no.toml"), "no.toml: No such file or directory; check the path");
    // A table's model cannot be uploaded to a finger.
    let upload =
        ["calibrate", "upload", "--port", "tcp:127.0.0.1:1", "--calibration", "model.toml"];
    let line = "model.toml:2: `kind`: a table calibration where a finger one is needed; give the other file";
    all_say(&folder, &[upload.to_vec()], line);
}

fn folder_error(text: &str) -> String {
    taxel_files::calibration::parse(Path::new("x"), text).unwrap_err().to_string()
}

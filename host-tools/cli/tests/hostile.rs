//! Files that a hurried user gives to `taxel calibrate`, as spreadsheets, editors, crashes and typing slips make
//! them: each ends in one line that names the place and the mend, and with no file written.

mod common;

use std::path::Path;

use common::{In, write_trace};
use taxel_sim::{Scene, Simulator};

/// The virtual finger with the net and the sensors alone.
const VIRTUAL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../emulator/data/finger.cal.toml");

/// Rows of a sensor with two channels and a force, numbers as they are written here.
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

/// A scratch folder with a good table, a model of it, a good trace and a record for it.
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

/// Each command of them fails with `line` and leaves the folder as it was.
fn all_say(folder: &In<'_>, commands: &[Vec<&str>], line: &str) {
    let before = folder.files();
    for typed in commands {
        assert_eq!(folder.fails(1, typed), format!("taxel: {line}\n"), "{typed:?}");
    }
    assert_eq!(folder.files(), before, "{line}");
}

#[test]
fn a_table_that_is_no_table_is_refused_by_its_line_and_column() {
    let directory = folder();
    let folder = In(directory.path());
    let good = table();
    let with = |from: &str, to: &str| good.replacen(from, to, 1).into_bytes();
    let third = good.lines().nth(2).unwrap().split(',').nth(1).unwrap().to_owned();
    let cell = |to: &str| with(&third, to);
    let mut latin = with("m0", "gr\u{f6}\u{df}e");
    latin.retain(|byte| *byte != 0xc3);
    let utf16: Vec<u8> = good.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mend = "mend the cell, remove the line, or leave the column out";
    let cases: Vec<(&str, Vec<u8>, String)> = vec![
        (
            "empty.csv",
            vec![],
            "empty.csv: no header: the file is empty; the first line names the columns".into(),
        ),
        (
            "blank.csv",
            b"\n\n \n# nothing here\n".to_vec(),
            "blank.csv: no header: the file is empty; the first line names the columns".into(),
        ),
        (
            "header.csv",
            HEADER.into(),
            "header.csv: no rows after the line of column names; give a recording that has some".into(),
        ),
        (
            "semicolons.csv",
            good.replace(',', ";").replace('.', ",").into(),
            "semicolons.csv:1: columns are separated by ';': expected commas; export it with commas, and points in \
             the numbers"
                .into(),
        ),
        (
            "tabs.csv",
            good.replace(',', "\t").into(),
            "tabs.csv:1: columns are separated by '\\t': expected commas; export it with commas, and points in the \
             numbers"
                .into(),
        ),
        (
            "commas.csv",
            cell("\"6,98\""),
            format!("commas.csv:3: `m0`: expected a number with a decimal point, found `6,98`; {mend}"),
        ),
        ("nan.csv", cell("NaN"), format!("nan.csv:3: `m0`: expected a finite number, found `NaN`; {mend}")),
        ("inf.csv", cell("-inf"), format!("inf.csv:3: `m0`: expected a finite number, found `-inf`; {mend}")),
        (
            "huge.csv",
            cell("1e300"),
            format!("huge.csv:3: `m0`: expected a number up to 1e12, found `1e300`; {mend}"),
        ),
        ("gap.csv", cell(""), format!("gap.csv:3: `m0`: expected a finite number, found nothing; {mend}")),
        (
            "latin.csv",
            latin,
            "latin.csv:1: not text: expected a CSV file in UTF-8; export it as CSV, UTF-8".into(),
        ),
        (
            "utf16.csv",
            [&[0xff, 0xfe], &utf16[..]].concat(),
            "utf16.csv:1: not text: expected a CSV file in UTF-8; export it as CSV, UTF-8".into(),
        ),
        (
            "twice.csv",
            with("m1", "m0"),
            "twice.csv:1: `m0`: the column stands twice; remove one of them".into(),
        ),
        (
            "growing.csv",
            good.as_bytes()[..good.len() - 9].to_vec(),
            "growing.csv:301: 3 fields where the header has 4; complete or remove the line; a recording cut short \
             often ends in one"
                .into(),
        ),
        (
            "renamed.csv",
            with("force_n", "load_n"),
            "renamed.csv:1: `force_n`: no column matches; this file has t_s, m0, m1, load_n".into(),
        ),
    ];
    for (name, bytes, line) in &cases {
        write(&folder, name, bytes);
        all_say(&folder, &readers(name, "model.toml"), line);
    }
    std::fs::create_dir(folder.0.join("folder.csv")).unwrap();
    let line = "folder.csv: Is a directory; give a file";
    all_say(&folder, &readers("folder.csv", "model.toml"), line);
    let line = "no-*.csv: No such file or directory; check the path";
    all_say(&folder, &readers("no-*.csv", "model.toml"), line);
    let line = "good.csv: no rows from 90 s to 95 s: those of the recording lie between 0 and 5.98 s; check the \
                stretch FILE@FROM..TO";
    all_say(&folder, &readers("good.csv@90..95", "model.toml"), line);
    let unnamed =
        [&["calibrate", "fit", "--data", "good.csv", "--out", "new.toml"][..], &["--inputs", "q*"]];
    let unnamed = [&unnamed.concat()[..], &["--targets", "force_n"]].concat();
    all_say(
        &folder,
        &[unnamed],
        "good.csv:1: `q*`: no column matches; this file has t_s, m0, m1, force_n",
    );
}

#[test]
fn what_spreadsheets_do_to_a_good_table_is_no_harm() {
    let directory = folder();
    let folder = In(directory.path());
    let wide = |rows_of: String| {
        let more = |i: usize, k: usize| {
            if i == 0 { format!(",x{k}") } else { format!(",{}", (i * (k + 3)) % 211) }
        };
        let line = |(i, line): (usize, &str)| {
            format!("{line}{}\n", (0..200).map(|k| more(i, k)).collect::<String>())
        };
        rows_of.lines().enumerate().map(line).collect::<String>()
    };
    let evaluate = |record: &str, data: &str| {
        folder.succeeds(&[
            "calibrate",
            "evaluate",
            "--calibration",
            record,
            "--data",
            data,
            "--json",
        ])
    };
    let good = evaluate("model.toml", "good.csv");
    for (name, text) in [
        ("bom.csv", format!("\u{feff}{}", table())),
        ("crlf.csv", table().replace('\n', "\r\n")),
        ("quoted.csv", table().replace("m0", "\"m0\"").replace(",m1", ", m1 ")),
        ("comments.csv", format!("# by hand\n\n{}\n\n", table())),
        ("unfinished.csv", table().trim_end().to_owned()),
        ("wide.csv", wide(table())),
    ] {
        write(&folder, name, text);
        assert_eq!(evaluate("model.toml", name), good, "{name}");
        folder.succeeds(&fit_table(name, "again.toml"));
        assert_eq!(evaluate("again.toml", "good.csv"), good, "{name}");
    }
    // All 202 channels at once.
    let all =
        ["--inputs", "m*,x*", "--targets", "force_n", "--model", "ridge", "--out", "all.toml"];
    write(&folder, "long.csv", wide(HEADER.to_owned() + &rows(1000)));
    folder.succeeds(&[&["calibrate", "fit", "--data", "long.csv"], &all[..]].concat());
    evaluate("all.toml", "long.csv");
}

#[test]
fn a_trace_that_is_no_trace_is_refused_by_its_line_and_column() {
    let directory = folder();
    let folder = In(directory.path());
    let good = std::fs::read_to_string(folder.0.join("trace.csv")).unwrap();
    let names: Vec<&str> = good.lines().nth(1).unwrap().split(',').collect();
    assert_eq!((names[0], good.lines().next().unwrap()), ("t_us", "# full_scale=65535"));
    let at = |name: &str| names.iter().position(|other| *other == name).unwrap();
    let spoiled = |name: &str, to: &str| {
        let line = |(i, line): (usize, &str)| {
            let mut cells: Vec<&str> = line.split(',').collect();
            if i == 9 {
                cells[at(name)] = to;
            }
            cells.join(",") + "\n"
        };
        good.lines().enumerate().map(line).collect::<String>()
    };
    let head: String = good.lines().take(2).map(|line| line.to_owned() + "\n").collect();
    let unknown = "leave the cell empty where the value is not known";
    let codes = "codes are what the ADC read; a sensor that is absent has no column";
    for (name, text, line) in [
        (
            "empty.csv",
            String::new(),
            "empty.csv: no header: the file is empty; a trace starts with a line of column names, `t_us,lit_r0c0,…`"
                .to_owned(),
        ),
        (
            "header.csv",
            head,
            "header.csv: no rows after the line of column names; give a recording that has some".into(),
        ),
        (
            "semicolons.csv",
            good.replace(',', ";"),
            "semicolons.csv:2: columns are separated by ';': expected commas; export it with commas, and points in \
             the numbers"
                .into(),
        ),
        (
            "nan.csv",
            spoiled("fz_n", "nan"),
            format!("nan.csv:10: `fz_n`: expected a finite number, found `nan`; {unknown}"),
        ),
        (
            "huge.csv",
            spoiled("fz_n", "1e300"),
            format!("huge.csv:10: `fz_n`: expected a number up to 1e12, found `1e300`; {unknown}"),
        ),
        (
            "point.csv",
            spoiled("lit_r1c2", "25000.5"),
            format!("point.csv:10: `lit_r1c2`: expected a whole code 0…65535, found `25000.5`; {codes}"),
        ),
        (
            "beyond.csv",
            spoiled("lit_r1c2", "70000"),
            "beyond.csv:10: `lit_r1c2`: code 70000 is above full scale 65535; if the codes are scaled to 16 bits, \
             make `# full_scale=65535` the first line"
                .into(),
        ),
        (
            "back.csv",
            spoiled("t_us", "0"),
            "back.csv:10: `t_us`: time 0 does not come after 6000; sort the lines by t_us".into(),
        ),
        (
            "missing.csv",
            good.replacen("lit_r1c2", "lit_r1cX", 1),
            "missing.csv:2: `lit_r1c2`: the column is missing; add it, or leave out all of lit_r0c0 … dark_c3".into(),
        ),
        (
            "timeless.csv",
            good.replacen("t_us", "time", 1),
            "timeless.csv:1: not a taxel trace; name the columns of other files with --inputs and --targets".into(),
        ),
    ] {
        write(&folder, name, text);
        all_say(&folder, &readers(name, "finger.toml"), &line);
    }
    let line = "trace.csv: no rows from 90 s: those of the recording lie between 0 and 0.499 s; check the stretch \
                FILE@FROM..TO";
    all_say(&folder, &readers("trace.csv@90..", "finger.toml"), line);
    let typed =
        ["calibrate", "evaluate", "--calibration", "finger.toml", "--data", "trace.csv@2..1"];
    let error = folder.fails(2, &typed);
    assert!(error.contains("the stretch 2..1 is empty: FROM must be less than TO"), "{error}");
}

/// Every command that reads a finger's record.
fn users(record: &str) -> Vec<Vec<&str>> {
    let mut commands = readers("trace.csv", record);
    // The fit reads none.
    commands.pop();
    commands.extend([
        vec!["calibrate", "compare", "finger.toml", record],
        // Before it looks for a finger.
        vec!["calibrate", "upload", "--port", "tcp:127.0.0.1:1", "--calibration", record],
        vec!["replay", "trace.csv", "--calibration", record, "--out", "frames.csv"],
    ]);
    commands
}

#[test]
fn a_record_that_is_damaged_edited_or_newer_is_refused_by_its_line_and_key() {
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
                "date.toml:5: `date`: `yesterday {}` is no date like 2026-11-21T09:30:00Z; fit the calibration again",
                good.lines().nth(4).unwrap().trim_start_matches("date = ").trim_matches('"')
            ),
        ),
        (
            "nan.toml",
            with("noise = ", "noise = nan # "),
            format!(
                "nan.toml:{}: `noise`: noise of taxels makes no sense; fit the calibration again",
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
    // Where a crash cut it off depends on its length; that it is refused does not.
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
    // The model of a table goes onto no finger.
    let upload =
        ["calibrate", "upload", "--port", "tcp:127.0.0.1:1", "--calibration", "model.toml"];
    let line = "model.toml:2: `kind`: a table calibration where a finger one is needed; give the other file";
    all_say(&folder, &[upload.to_vec()], line);
}

fn folder_error(text: &str) -> String {
    taxel_formats::calibration::parse(Path::new("x"), text).unwrap_err().to_string()
}

/// Where `--out` cannot be what it says: known before the work, which may take minutes.
#[test]
fn a_place_that_cannot_be_written_to_is_named_before_the_work() {
    let directory = folder();
    let folder = In(directory.path());
    std::fs::create_dir(folder.0.join("cal")).unwrap();
    write(&folder, "kept.toml", "kept");
    let mut kept = folder.0.join("kept.toml").metadata().unwrap().permissions();
    kept.set_readonly(true);
    std::fs::set_permissions(folder.0.join("kept.toml"), kept).unwrap();
    let writers = |out: &'static str| {
        let judge = ["--calibration", "finger.toml", "--data", "trace.csv", "--out", out];
        vec![
            // There is nothing to fit to in so short a press: the place is looked at first.
            vec!["calibrate", "fit", "--data", "trace.csv", "--out", out],
            [&["calibrate", "adjust"][..], &judge].concat(),
            [&["calibrate", "report"][..], &judge].concat(),
            vec!["calibrate", "download", "--port", "tcp:127.0.0.1:1", "--out", out],
        ]
    };
    all_say(&folder, &writers("cal"), "cal: is a folder; name a file in it");
    let line = "kept.toml: is write-protected; choose another name, or take the protection off";
    all_say(&folder, &writers("kept.toml"), line);
    let line = "no/such/a.toml: there is no folder no/such; make it, or choose another";
    all_say(&folder, &writers("no/such/a.toml"), line);
    if cfg!(target_os = "linux") {
        // Nobody, not even root, can make a file there.
        for typed in writers("/proc/a.toml") {
            let error = folder.fails(1, &typed);
            assert!(
                error.starts_with("taxel: /proc/a.toml: nothing can be written in /proc ("),
                "{error}"
            );
        }
        let full = folder.fails(1, &fit_table("good.csv", "/dev/full"));
        assert_eq!(full, "taxel: /dev/full: No space left on device; free some space\n");
        folder.succeeds(&fit_table("good.csv", "/dev/null"));
        assert!(!Path::new("/dev/null").metadata().unwrap().is_file());
    }
    for typed in writers("trace.csv").iter().take(3).chain(&writers("finger.toml")[1..3]) {
        let error = folder.fails(1, typed);
        assert!(error.contains("--out would overwrite what is read from"), "{error}");
    }
}

/// What says which file, row or column is meant where two files belong together.
#[test]
fn a_reference_that_does_not_belong_to_its_recording_is_told_with_both_times() {
    let directory = folder();
    let folder = In(directory.path());
    write(&folder, "skin.csv", table());
    let cell = |from: f64, load: &dyn Fn(f64) -> f64| {
        let row = |i: i32| {
            let t = from + 0.0125 * f64::from(i);
            format!("{t:.4},{:.4}\n", load(t - from))
        };
        "t_s,force_n\n".to_owned() + &(0..480).map(row).collect::<String>()
    };
    write(&folder, "other.csv", cell(100.0, &|t| (31.0 * t * t).sin()));
    write(&folder, "still.csv", cell(0.0, &|_| 2.5));
    write(&folder, "short.csv", "t_s,force_n\n0,1\n1,2\n");
    write(&folder, "timeless.csv", cell(0.0, &|t| t.sin()).replace("t_s", "time"));
    write(
        &folder,
        "back.csv",
        cell(0.0, &|t| t.sin()).replacen("0.0250,", "0.0150,", 1).replacen("0.0125,", "0.0200,", 1),
    );
    let fit = |data: &'static str, reference: &'static str| {
        [&fit_table(data, "new.toml")[..], &["--reference", reference]].concat()
    };
    let error = folder.fails(1, &fit("skin.csv", "other.csv"));
    assert!(error.starts_with("taxel: other.csv: sensor and reference correlate by 0."), "{error}");
    assert!(
        error.ends_with(
            " at best (the sensor's times run from 0.0 to 6.0 s, the reference's from 100.0 to 106.0 s); check that \
             both saw the same presses\n"
        ),
        "{error}"
    );
    for (data, reference, line) in [
        ("skin.csv", "still.csv", "still.csv: it never changes; record presses with both"),
        (
            "skin.csv",
            "short.csv",
            "short.csv: 2 rows with a time where 32 are needed; name the time column t_s or t_us, and record for longer",
        ),
        (
            "skin.csv",
            "timeless.csv",
            "timeless.csv: 0 rows with a time where 32 are needed; name the time column t_s or t_us, and record for \
             longer",
        ),
        (
            "skin.csv",
            "back.csv",
            "back.csv: after 0.02 s comes 0.015 s; sort the rows by their time",
        ),
        (
            "skin.csv@50..60",
            "other.csv",
            "skin.csv: no rows from 50 s to 60 s: those of the recording lie between 0 and 5.98 s; check the stretch \
             FILE@FROM..TO",
        ),
    ] {
        all_say(&folder, &[fit(data, reference)], line);
    }
    // A channel that repeats another: the file and both columns.
    let twins: String = table()
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let cells: Vec<&str> = line.split(',').collect();
            let twin = if i == 0 { "m2" } else { cells[1] };
            format!("{},{},{},{twin},{}\n", cells[0], cells[1], cells[2], cells[3])
        })
        .collect();
    write(&folder, "twins.csv", twins);
    let mut typed = fit_table("twins.csv", "new.toml");
    *typed.last_mut().unwrap() = "least-squares";
    let line = "twins.csv: least-squares: m0, m2 say together what fewer of them would; leave some of them out, or \
                choose ridge";
    all_say(&folder, &[typed], line);
    write(&folder, "few.csv", HEADER.to_owned() + &rows(12));
    let mut typed = fit_table("few.csv", "new.toml");
    *typed.last_mut().unwrap() = "mlp";
    let few = folder.fails(1, &typed);
    assert!(few.starts_with("taxel: few.csv: mlp: 12 usable rows where at least "), "{few}");
}

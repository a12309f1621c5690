//! Tests of malformed tables of other sensors.

use super::{HEADER, all_say, fit_table, folder, readers, rows, table, write};
use crate::common::In;

#[test]
fn invalid_table_is_refused_by_line_and_column() {
    let directory = folder();
    let folder = In(directory.path());
    let good = table();
    let with = |from: &str, to: &str| good.replacen(from, to, 1).into_bytes();
    let third = good.lines().nth(2).unwrap().split(',').nth(1).unwrap().to_owned();
    let cell = |to: &str| with(&third, to);
    let mut latin = with("m0", "gr\u{f6}\u{df}e");
    latin.retain(|byte| *byte != 0xc3);
    let utf16: Vec<u8> = good.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mend = "correct the cell, remove the line, or leave the column out";
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
            "header.csv: no rows after the line of column names; give a recording with rows".into(),
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
            "twice.csv:1: `m0`: duplicate column; remove one of them".into(),
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
fn spreadsheet_formats_of_tables_are_read() {
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
        folder.succeeds(&[&fit_table(name, "again.toml")[..], &["--force"]].concat());
        assert_eq!(evaluate("again.toml", "good.csv"), good, "{name}");
    }
    // All 202 channels at once.
    let all =
        ["--inputs", "m*,x*", "--targets", "force_n", "--model", "ridge", "--out", "all.toml"];
    write(&folder, "long.csv", wide(HEADER.to_owned() + &rows(1000)));
    folder.succeeds(&[&["calibrate", "fit", "--data", "long.csv"], &all[..]].concat());
    evaluate("all.toml", "long.csv");
}

/// Refuses q15 for tables. A finger's firmware runs its net in 16 bits, but no firmware runs a
/// table's.
#[test]
fn q15_is_refused_for_tables_before_work() {
    let directory = folder();
    let folder = In(directory.path());
    let fit = |data| [&fit_table(data, "new.toml")[..], &["--form", "q15"]].concat();
    let line = "--form q15: 16 bits are for the 16 taxels of a finger, whose firmware runs them; a table's model \
                (--inputs) is kept in f32: leave --form out";
    all_say(&folder, &[fit("good.csv"), fit("no-such.csv")], line);
}

//! Tests of malformed recordings of a finger.

use super::{all_say, folder, readers, write};
use crate::common::In;

#[test]
fn invalid_trace_is_refused_by_line_and_column() {
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
            "header.csv: no rows after the line of column names; give a recording with rows".into(),
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

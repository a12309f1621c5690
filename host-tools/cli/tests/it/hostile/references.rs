//! Tests of files that do not belong together, and of duplicate channels.

use super::{HEADER, all_say, fit_table, folder, rows, table, write};
use crate::common::In;

/// Checks that errors between two files name the file, row or column.
#[test]
fn unrelated_reference_is_refused_with_both_times() {
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
            "back.csv:4: `t_s`: after 0.02 s comes 0.015 s; sort the rows by their time, or cut the file where its clock \
             began again",
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
    // For a repeated channel: the file and both columns.
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
    let line = "twins.csv: least-squares: m0, m2 are linearly dependent; leave some of them out, or \
                choose ridge";
    all_say(&folder, &[typed], line);
    write(&folder, "few.csv", HEADER.to_owned() + &rows(12));
    let mut typed = fit_table("few.csv", "new.toml");
    *typed.last_mut().unwrap() = "mlp";
    let few = folder.fails(1, &typed);
    assert!(few.starts_with("taxel: few.csv: mlp: 12 usable rows where at least "), "{few}");
}

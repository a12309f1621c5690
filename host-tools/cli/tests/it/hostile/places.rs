//! Tests of output paths that cannot be written to.

use std::path::Path;

use super::{all_say, fit_table, folder, write};
use crate::common::In;

/// Checks `--out` before the work, which may take minutes.
#[test]
fn unwritable_output_is_reported_before_work() {
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
            // So short a press cannot be fitted: the path is checked first.
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
        // Not even root can create a file there.
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

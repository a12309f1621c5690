//! Calibration files in TOML.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Err(error) = taxel_files::calibration::parse(Path::new("x"), text) {
        assert!(!error.to_string().contains('\n'), "an error is one line");
    }
});

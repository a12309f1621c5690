//! Tables of other sensors.
#![no_main]

use libfuzzer_sys::fuzz_target;
use taxel_files::stretch::Stretch;
use taxel_files::table::read_from;

fuzz_target!(|bytes: &[u8]| {
    if let Err(error) = read_from(bytes, &Stretch::whole("x"), &["m*", "force_n"]) {
        assert!(!error.to_string().contains('\n'), "an error is one line");
    }
});

//! Whole sessions: every reply is that of the tests' model of the finger.
#![no_main]

#[path = "../../core/common/mod.rs"]
mod common;
#[path = "../../core/model/mod.rs"]
mod model;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: &[u8]| {
    if let Err(wrong) = model::rig::replay(input) {
        panic!("{wrong}");
    }
});

//! Trace files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use taxel_files::trace::TraceReader;

fuzz_target!(|bytes: &[u8]| {
    let read = TraceReader::new(bytes, "x").and_then(|samples| {
        for sample in samples {
            sample?;
        }
        Ok(())
    });
    if let Err(error) = read {
        assert!(!error.to_string().contains('\n'), "an error is one line");
    }
});

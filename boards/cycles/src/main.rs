//! Bench image: calls every stage and announces to the machine what to measure.
#![no_std]
#![no_main]

use core::hint::black_box;
use core::panic::PanicInfo;
use core::ptr::with_exposed_provenance;
use core::slice;

// Printing needs its critical section.
use cortex_m as _;
use cortex_m_rt::entry;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::{heprintln, syscall};
use cycles::host::{COMPARE, Call, Compared, INPUTS, Inputs, MEASURE, REPORT, Span};
use cycles::{MAX_RESULT, Meter, result_bytes};
use serde::Serialize;

/// Passes the result of `name` in postcard to `tell`.
fn result<O: Serialize>(name: &str, out: &O, tell: impl FnOnce(Span)) {
    let mut buffer = [0; MAX_RESULT];
    match result_bytes(out, &mut buffer) {
        Some(result) => tell(Span::of(result)),
        None => panic!("a result of {name} does not fit"),
    }
}

/// Meter that lets the machine count.
struct Machine;

impl Meter for Machine {
    fn stage<M, I, O: Serialize>(
        &mut self,
        name: &str,
        memory: &mut M,
        inputs: impl Iterator<Item = I>,
        out: &mut O,
        stage: fn(&mut M, &I, &mut O),
    ) {
        // A pointer that the compiler cannot see through makes it a call.
        let stage = black_box(stage);
        for input in inputs {
            let call = Call { function: stage as usize, name: Span::of(name.as_bytes()) };
            // SAFETY: the operation reads the call and its name, both of which are alive.
            unsafe { syscall(MEASURE, &call) };
            stage(memory, &input, out);
            // SAFETY: the operation reads the span and the result, both of which are alive.
            result(name, out, |result| unsafe {
                syscall(REPORT, &result);
            });
        }
    }

    fn compare<M, I, O: Serialize>(
        &mut self,
        name: &str,
        memory: &mut M,
        inputs: impl Iterator<Item = I>,
        out: &mut O,
        stage: fn(&mut M, &I, &mut O),
    ) {
        for input in inputs {
            stage(memory, &input, out);
            result(name, out, |result| {
                let compared = Compared { name: Span::of(name.as_bytes()), result };
                // SAFETY: the operation reads the spans and their bytes, all of which are alive.
                unsafe { syscall(COMPARE, &compared) };
            });
        }
    }
}

#[entry]
fn main() -> ! {
    // SAFETY: the machine maps the range, fills it before reset and lets nothing write it.
    let bytes = unsafe {
        let length = *with_exposed_provenance::<u32>(INPUTS);
        slice::from_raw_parts(with_exposed_provenance(INPUTS + 4), length as usize)
    };
    match postcard::from_bytes::<Inputs>(bytes) {
        Ok(inputs) => cycles::all(&inputs, &mut Machine),
        Err(error) => panic!("inputs: {error}"),
    }
    loop {
        debug::exit(EXIT_SUCCESS);
    }
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    heprintln!("{}", info);
    loop {
        debug::exit(EXIT_FAILURE);
    }
}

//! Deepest stack of a firmware, from its machine code.
//!
//! It is the deepest path of calls, plus the deepest handler of each priority. A call through a
//! register goes to every function that [`POINTERS`] lists for it; a call without an entry is an
//! error. A panic ends in a reset and does not count.

use std::collections::{HashMap, HashSet};

use anyhow::{Result, bail};

use crate::image::{EXCEPTION_FRAME, Function, Image};
use crate::panics::is_panic;

/// Deepest stack of a firmware.
pub struct Stack {
    /// Bytes, with exception frames.
    pub bytes: u32,
    /// Deepest path of calls from the reset: each function and its own bytes.
    pub path: Vec<(String, u32)>,
}

/// Computes the deepest stack of an image.
pub fn deepest(image: &Image) -> Result<Stack> {
    let entry = image.functions.iter().find(|(_, function)| function.name == "Reset");
    let Some((reset, _)) = entry else { bail!("no function `Reset`") };
    let mut paths = Paths { image, known: HashMap::new(), open: HashSet::new() };
    let mut bytes = paths.below(*reset)?;
    let mut levels = HashMap::<usize, u32>::new();
    for (i, handler) in image.handlers.iter().enumerate() {
        let name = image.at(*handler).map_or("", |function| &function.name);
        if RESETS.contains(&name) {
            continue;
        }
        let level = LEVELS.iter().position(|level| level.contains(&name));
        let deepest = levels.entry(level.unwrap_or(LEVELS.len() + i)).or_default();
        *deepest = paths.below(*handler)?.max(*deepest);
    }
    bytes += levels.values().map(|level| level + EXCEPTION_FRAME).sum::<u32>();
    let mut path = vec![];
    let mut next = Some(*reset);
    while let Some(function) = next.and_then(|address| image.at(address)) {
        path.push((function.name.clone(), function.frame));
        next = next.and_then(|address| paths.known.get(&address)?.1);
    }
    Ok(Stack { bytes, path })
}

/// Handlers that share a priority and do not interrupt each other (`scan::start` of the boards).
///
/// Any other handler may interrupt all the rest.
const LEVELS: [&[&str]; 2] = [
    &["DMA1_CHANNEL2", "DMA1_CHANNEL3", "ADC1_2", "DMA2_STREAM0", "ADC"],
    &["USB_LP", "OTG_FS", "TIM2"],
];

/// Functions that the compiler makes of code that several others share.
const OUTLINED: &str = "OUTLINED_FUNCTION_";

/// Fault handlers, which end in a reset as a panic does.
const RESETS: [&str; 2] = ["HardFault", "HardFaultTrampoline"];

/// Calls through a register: parts of the callers' names and of their possible callees' names.
struct Pointer {
    callers: &'static [&'static str],
    callees: &'static [&'static str],
}

/// All calls through a register, except of functions whose address the caller loads as a constant.
const POINTERS: &[Pointer] = &[
    Pointer {
        callers: &["::Executor::run"],
        callees: &["embassy_executor::raw::TaskStorage<F>::poll"],
    },
    // Wakers.
    Pointer {
        callers: &[
            "embassy_sync::waitqueue::",
            "CriticalSectionRawMutex as ",
            "embassy_executor::raw::TaskStorage<F>::poll",
            "_embassy_time_schedule_wake",
            "taxel_board::time::",
            "embassy_usb::class::cdc_acm::",
            "embassy_stm32::usb::",
            "taxel_board::usb::",
            "as core::future::future::Future>::poll",
            "taxel_board::scanner::",
            "taxel_board::link::",
            "taxel::session::",
            "::scan::on_frame",
            "DMA2_STREAM0",
            "USB_LP",
            "OTG_FS",
        ],
        callees: &["embassy_executor::raw::waker::"],
    },
    // The USB device's tasks call the handlers of its events; one of these is the board's.
    Pointer {
        callers: &[
            "embassy_executor::raw::TaskStorage<F>::poll",
            "embassy_usb::UsbDevice",
            "embassy_usb::Inner",
        ],
        callees: &[" as embassy_usb::Handler>::"],
    },
    Pointer { callers: &["taxel_board::link::Suspend as"], callees: &["::scan::set_paused"] },
    // Flash operations of the store.
    Pointer {
        callers: &[
            "taxel::store::",
            "taxel::instrument::Instrument::",
            "embassy_executor::raw::TaskStorage<F>::poll",
            "as core::future::future::Future>::poll",
            "taxel_board::flash::",
        ],
        callees: &["::flash::place"],
    },
    // Sections of a calibration record, and the checks of their fields.
    Pointer {
        callers: &["taxel::calibration::Calibration::", "taxel::finger::Finger::recalibrate"],
        callees: &[
            " as taxel::calibration::section::Section>::",
            "core::ops::function::FnOnce::call_once",
        ],
    },
    Pointer {
        callers: &[" as taxel::calibration::section::Section>::wrong_field"],
        callees: &["core::ops::function::FnOnce::call_once"],
    },
    Pointer { callers: &["_defmt_"], callees: &["defmt_rtt::channel::Channel::"] },
    // The bootload jump does not return; a call in an outlined function is its callers'.
    Pointer { callers: &["cortex_m::asm::bootload", OUTLINED], callees: &[] },
];

struct Paths<'i> {
    image: &'i Image,
    /// Bytes of a function with its deepest callee, and that callee.
    known: HashMap<u32, (u32, Option<u32>)>,
    open: HashSet<u32>,
}

impl Paths<'_> {
    /// Returns the most bytes that the function at `address` and its callees take.
    fn below(&mut self, address: u32) -> Result<u32> {
        if let Some((bytes, _)) = self.known.get(&address) {
            return Ok(*bytes);
        }
        let Some(function) = self.image.at(address) else {
            bail!("a call to {address:#x}, which lies in no function");
        };
        if is_panic(&function.name) {
            return Ok(0);
        }
        if !self.open.insert(address) {
            bail!("{} calls itself", function.name);
        }
        let mut callees: Vec<_> = function.calls.iter().map(|(_, callee)| *callee).collect();
        let outlined = function.calls.iter().filter_map(|(_, callee)| self.image.at(*callee));
        let outlined = outlined.filter(|callee| callee.name.starts_with(OUTLINED));
        for part in outlined.chain([function]) {
            for (at, register) in &part.indirect {
                callees.extend(self.through_register(function, *at, *register)?);
            }
        }
        let mut deepest = (0, None);
        for callee in callees {
            deepest = deepest.max((self.below(callee)?, Some(callee)));
        }
        self.open.remove(&address);
        self.known.insert(address, (function.frame + deepest.0, deepest.1));
        Ok(function.frame + deepest.0)
    }

    /// Lists the functions that `caller` can call through `register` at address `at`.
    fn through_register(&self, caller: &Function, at: u32, register: u8) -> Result<Vec<u32>> {
        let constants = caller.constants.iter().filter(|(loaded, _)| *loaded == register);
        let constants = constants.map(|(_, word)| word & !1);
        let mut callees: Vec<_> =
            constants.filter(|at| self.image.functions.contains_key(at)).collect();
        let known =
            |pointer: &&Pointer| pointer.callers.iter().any(|part| caller.name.contains(part));
        let pointers: Vec<_> = POINTERS.iter().filter(known).collect();
        if pointers.is_empty() && callees.is_empty() {
            bail!(
                "{} calls an unknown function through a register at {at:#x}: add it to POINTERS in stack.rs",
                caller.name
            );
        }
        for Pointer { callees: parts, .. } in pointers {
            let is = |name: &str| parts.iter().any(|part| name.contains(part));
            let listed = self.image.functions.iter().filter(|(_, f)| is(&f.name));
            let before = callees.len();
            callees.extend(listed.map(|(at, _)| *at));
            if !parts.is_empty() && callees.len() == before {
                bail!(
                    "{}: no function is called {parts:?} any more: fix POINTERS in stack.rs",
                    caller.name
                );
            }
        }
        Ok(callees)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn function(name: &str, at: u32, frame: u32) -> (u32, Function) {
        let (calls, indirect, constants) = (vec![], vec![], vec![]);
        let name = name.to_owned();
        (at, Function { name, calls, indirect, constants, frame, end: at + 0x10 })
    }

    /// Image in which `Reset` calls `caller`, and `caller` calls through r3.
    fn image(caller: &str, constants: Vec<(u8, u32)>) -> Image {
        let (at, mut reset) = function("Reset", 0x100, 8);
        reset.calls.push((0x104, 0x200));
        let (of, mut caller) = function(caller, 0x200, 16);
        caller.indirect.push((0x204, 3));
        caller.constants = constants;
        let waker = function("embassy_executor::raw::waker::wake", 0x300, 32);
        let other = function("board::other", 0x400, 64);
        let functions = [(at, reset), (of, caller), waker, other].into_iter().collect();
        Image { functions, handlers: vec![] }
    }

    #[test]
    fn pointer_call_counts_its_callees() {
        let known = "embassy_sync::waitqueue::atomic_waker::AtomicWaker::wake";
        assert_eq!(deepest(&image(known, vec![])).unwrap().bytes, 8 + 16 + 32);
        // A loaded address has its lowest bit set. A constant in another register does not count.
        let constants = vec![(3, 0x401), (4, 0x301)];
        assert_eq!(deepest(&image("board::main", constants)).unwrap().bytes, 8 + 16 + 64);
    }

    #[test]
    fn unlisted_pointer_call_is_an_error() {
        let error = deepest(&image("board::main", vec![(4, 0x401)])).err().unwrap().to_string();
        assert!(error.contains("board::main") && error.contains("0x204"), "{error}");
    }
}

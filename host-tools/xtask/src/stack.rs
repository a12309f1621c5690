//! The most stack that a firmware can take, from its machine code: every path of calls, and on top
//! of it the deepest handler of each priority.
//!
//! A call through a register is followed to what may stand there ([`POINTERS`]); one of which nothing is said
//! is an error. A panic ends in a reset and is left out.

use std::collections::{HashMap, HashSet};

use anyhow::{Result, bail};

use crate::image::{EXCEPTION_FRAME, Function, Image};
use crate::panics::is_panic;

/// The most stack that a firmware can take.
pub struct Stack {
    /// Bytes, exceptions included.
    pub bytes: u32,
    /// The deepest path of calls from the reset: each function, and what it takes itself.
    pub path: Vec<(String, u32)>,
}

/// Finds it.
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

/// Handlers of one priority, which do not interrupt each other (`scan::start` of the boards). Any other may
/// interrupt all the rest.
const LEVELS: [&[&str]; 2] = [
    &["DMA1_CHANNEL2", "DMA1_CHANNEL3", "ADC1_2", "DMA2_STREAM0", "ADC"],
    &["USB_LP", "OTG_FS", "TIM2"],
];

/// A fault ends in a reset, as a panic does.
const RESETS: [&str; 2] = ["HardFault", "HardFaultTrampoline"];

/// Calls through a register: parts of the callers' names, and of the names of those whom they can mean.
struct Pointer {
    callers: &'static [&'static str],
    callees: &'static [&'static str],
}

/// All that there are, but for functions whose address a caller has loaded as a constant.
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
    // The USB device's tasks tell those who handle its events; one of them is the board's.
    Pointer {
        callers: &[
            "embassy_executor::raw::TaskStorage<F>::poll",
            "embassy_usb::UsbDevice",
            "embassy_usb::Inner",
        ],
        callees: &[" as embassy_usb::Handler>::"],
    },
    Pointer { callers: &["taxel_board::link::Suspend as"], callees: &["::scan::set_paused"] },
    // The store's flash.
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
    // A calibration's sections, and the checks of their fields.
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
    // It does not come back; the compiler's outlined functions come back by a register.
    Pointer { callers: &["cortex_m::asm::bootload", "OUTLINED_FUNCTION_"], callees: &[] },
];

struct Paths<'i> {
    image: &'i Image,
    /// Bytes below a function and its own, and the callee that takes most of them.
    known: HashMap<u32, (u32, Option<u32>)>,
    open: HashSet<u32>,
}

impl Paths<'_> {
    /// Bytes that the function at `address` and all that it calls take at most.
    fn below(&mut self, address: u32) -> Result<u32> {
        if let Some((bytes, _)) = self.known.get(&address) {
            return Ok(*bytes);
        }
        let Some(function) = self.image.at(address) else {
            bail!("a call to {address:#x}, where no function is");
        };
        if is_panic(&function.name) {
            return Ok(0);
        }
        if !self.open.insert(address) {
            bail!("{} calls itself", function.name);
        }
        let mut callees: Vec<_> = function.calls.iter().map(|(_, callee)| *callee).collect();
        for (at, register) in &function.indirect {
            callees.extend(self.through_register(function, *at, *register)?);
        }
        let mut deepest = (0, None);
        for callee in callees {
            deepest = deepest.max((self.below(callee)?, Some(callee)));
        }
        self.open.remove(&address);
        self.known.insert(address, (function.frame + deepest.0, deepest.1));
        Ok(function.frame + deepest.0)
    }

    /// Whom a function can call through `register`, which it does at `at`.
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
                "{} calls through a register at {at:#x}, and whom is not known: say so in stack.rs, POINTERS",
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
                    "{}: no function is called {parts:?} any more: stack.rs, POINTERS",
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

    /// `Reset` calls `caller`, which calls through r3.
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
    fn a_pointer_is_followed_to_whom_it_can_mean() {
        let known = "embassy_sync::waitqueue::atomic_waker::AtomicWaker::wake";
        assert_eq!(deepest(&image(known, vec![])).unwrap().bytes, 8 + 16 + 32);
        // The address of a function, with its lowest bit set; another register's constant is none of it.
        let constants = vec![(3, 0x401), (4, 0x301)];
        assert_eq!(deepest(&image("board::main", constants)).unwrap().bytes, 8 + 16 + 64);
    }

    #[test]
    fn a_call_by_a_pointer_that_nobody_has_explained_is_an_error() {
        let error = deepest(&image("board::main", vec![(4, 0x401)])).err().unwrap().to_string();
        assert!(error.contains("board::main") && error.contains("0x204"), "{error}");
    }
}

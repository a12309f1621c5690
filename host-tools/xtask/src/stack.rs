//! The most stack that a firmware can take, from its machine code: every path of calls, and on top
//! of it the deepest handler of each priority.
//!
//! A call through a register is followed to what may stand there ([`FOLLOWED`], [`POINTERS`]). A panic ends in a reset and
//! is left out.

use std::collections::{HashMap, HashSet};

use anyhow::{Result, bail};

use crate::image::{EXCEPTION_FRAME, Image};
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
const LEVELS: [&[&str]; 2] =
    [&["DMA1_CHANNEL2", "DMA1_CHANNEL3", "DMA2_STREAM0"], &["USB_LP", "OTG_FS", "TIM2"]];

/// A fault ends in a reset, as a panic does.
const RESETS: [&str; 2] = ["HardFault", "HardFaultTrampoline"];

/// Who is called through a register, by the caller's name: how it begins, then what the callees' contain.
const FOLLOWED: [(&str, &[&str]); 3] = [
    (
        "embassy_executor::platform::thread::Executor::run",
        &["embassy_executor::raw::TaskStorage<F>::poll"],
    ),
    ("_defmt_", &["defmt_rtt::channel::Channel::"]),
    // It does not come back.
    ("cortex_m::asm::bootload", &[]),
];

/// Whom all others can mean: wakers, and the functions that a board hands out.
const POINTERS: &[&str] =
    &["embassy_executor::raw::waker::", "::scan::set_paused", "::flash::place"];

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
        if !function.indirect.is_empty() {
            callees.extend(self.through_register(&function.name));
        }
        let mut deepest = (0, None);
        for callee in callees {
            deepest = deepest.max((self.below(callee)?, Some(callee)));
        }
        self.open.remove(&address);
        self.known.insert(address, (function.frame + deepest.0, deepest.1));
        Ok(function.frame + deepest.0)
    }

    fn through_register(&self, caller: &str) -> Vec<u32> {
        let followed = FOLLOWED.iter().find(|(start, _)| caller.starts_with(start));
        let callees = followed.map_or(POINTERS, |(_, callees)| *callees);
        let is = |name: &str| callees.iter().any(|part| name.contains(part));
        let functions = self.image.functions.iter();
        functions.filter(|(_, f)| is(&f.name)).map(|(address, _)| *address).collect()
    }
}

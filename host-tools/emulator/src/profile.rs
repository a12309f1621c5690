//! Profile of a stage: cycles by function, with inlined functions listed separately.

use std::collections::HashMap;
use std::path::Path;

use addr2line::Loader;
use anyhow::{Result, anyhow};

use crate::clock::Clock;
use crate::cost::Band;

/// Lookup of function names in an image.
pub struct Profiler {
    loader: Loader,
}

/// Share of one function in a stage, without the functions it calls.
pub struct Share {
    /// Name of the function; in brackets the innermost one inlined into it.
    pub name: String,
    /// Mean number of instructions per call of the stage.
    pub instructions: f64,
    /// Mean cycles per call of the stage: low and high.
    pub cycles: [f64; 2],
    /// Mean waits for the flash per call of the stage; a block's count for its first function.
    pub waits: f64,
}

impl Profiler {
    /// Reads the debug information of the image; fails if there is none.
    pub fn new(elf: &Path) -> Result<Self> {
        let loader = Loader::new(elf)
            .map_err(|error| anyhow!("{}: no debug information: {error}", elf.display()))?;
        Ok(Self { loader })
    }

    /// Shares of the counted blocks over `calls` calls, the greatest first.
    pub fn shares(&self, calls: usize, clock: &Clock) -> Vec<Share> {
        let mut sums = HashMap::<String, (u64, Band, u64)>::new();
        for (block, visits) in clock.blocks() {
            let runs = visits.taken + visits.fell_through;
            if runs == 0 {
                continue;
            }
            let mut address = block.start;
            let last = block.instructions.len() - 1;
            sums.entry(self.name(address)).or_default().2 += visits.waits;
            for (i, instruction) in block.instructions.iter().enumerate() {
                let taken = if i == last { visits.taken } else { 0 };
                let band = block.cost_of(i, true).times(taken)
                    + block.cost_of(i, false).times(runs - taken);
                let sum = sums.entry(self.name(address)).or_default();
                sum.0 += runs;
                sum.1 += band;
                address += u32::from(instruction.size);
            }
        }
        let calls = calls.max(1) as f64;
        let mut shares: Vec<_> = sums
            .into_iter()
            .map(|(name, (instructions, Band { low, high }, waits))| Share {
                name,
                instructions: instructions as f64 / calls,
                cycles: [low, high].map(|cycles| cycles as f64 / calls),
                waits: waits as f64 / calls,
            })
            .collect();
        shares.sort_by(|a, b| (b.cycles[1] + b.waits).total_cmp(&(a.cycles[1] + a.waits)));
        shares
    }

    /// Function of the project at `address`; in brackets the innermost one inlined there.
    fn name(&self, address: u32) -> String {
        let address = u64::from(address);
        let mut names = Vec::new();
        if let Ok(mut frames) = self.loader.find_frames(address) {
            while let Ok(Some(frame)) = frames.next() {
                let Some(name) = frame.function else { continue };
                if let Ok(name) = name.demangle() {
                    names.push(name.into_owned());
                }
            }
        }
        // Frames of the language's own library count for their caller.
        let own = names.iter().position(|name| !is_library(name)).unwrap_or(0);
        match (names.get(own), names.first()) {
            (Some(own), Some(first)) if own == first => own.clone(),
            (Some(own), Some(first)) => format!("{own} ({first})"),
            _ => self.loader.find_symbol(address).unwrap_or("?").to_owned(),
        }
    }
}

fn is_library(name: &str) -> bool {
    ["core::", "<core::", "<[", "alloc::"].iter().any(|prefix| name.starts_with(prefix))
}

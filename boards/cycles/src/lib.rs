//! Stages of the core, each called through a meter on every input that it has.
//!
//! The meter is the image (`main.rs`), for which the machine counts, or a host, which keeps the
//! results for comparison.
#![no_std]

pub mod host;
pub mod kinds;
mod stages;

use serde::Serialize;

pub use stages::{all, costliest, papers_net, papers_net_quantised};

/// Calls stages and keeps their results.
pub trait Meter {
    /// Calls `stage` once for each input.
    ///
    /// `memory` is the stage's state between calls. The result goes into `out`, because a finger
    /// has it there too.
    fn stage<M, I, O: Serialize>(
        &mut self,
        name: &str,
        memory: &mut M,
        inputs: impl Iterator<Item = I>,
        out: &mut O,
        stage: fn(&mut M, &I, &mut O),
    );

    /// Calls `stage` once for each input and compares results, without measurement.
    fn compare<M, I, O: Serialize>(
        &mut self,
        name: &str,
        memory: &mut M,
        inputs: impl Iterator<Item = I>,
        out: &mut O,
        stage: fn(&mut M, &I, &mut O),
    ) {
        self.stage(name, memory, inputs, out, stage);
    }
}

/// Longest result in postcard: the largest packet and its length.
pub const MAX_RESULT: usize = 1024;

/// Result in postcard, for a comparison of every bit.
pub fn result_bytes<'b, O: Serialize>(out: &O, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
    postcard::to_slice(out, buffer).ok().map(|bytes| &*bytes)
}

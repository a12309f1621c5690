//! The core's stages, each called on every input that it has, through whoever measures: the image
//! (`main.rs`), which has the machine count, or a host, which wants the results to compare with.
#![no_std]

pub mod host;
pub mod kinds;
mod stages;

use serde::Serialize;

pub use stages::{all, dearest, papers_net, papers_net_quantised};

/// Calls stages and keeps what came of it.
pub trait Meter {
    /// Calls `stage` once for each input. `memory` is what it keeps from call to call; the result goes
    /// into `out`, because that is where a finger would have it.
    fn stage<M, I, O: Serialize>(
        &mut self,
        name: &str,
        memory: &mut M,
        inputs: impl Iterator<Item = I>,
        out: &mut O,
        stage: fn(&mut M, &I, &mut O),
    );

    /// The same, only to compare what comes of it: nobody asks what it takes.
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

/// A result as it is compared: every bit of it.
pub fn result_bytes<'b, O: Serialize>(out: &O, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
    postcard::to_slice(out, buffer).ok().map(|bytes| &*bytes)
}

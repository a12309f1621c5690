//! Whole boards around a Cortex-M4F, and the costs of the core's stages on it.
//!
//! The machine is a crate of its own, [`m4_machine`]; [`board`] builds a whole board around it.

pub mod bench;
pub mod board;
pub mod faults;
pub mod peers;
pub mod report;

pub use m4_machine::{block, bounds, clock, cost, fetch, isa, machine, profile};

//! Whole boards around a Cortex-M4F, and the costs of the core's stages on it.
//!
//! The [`machine`] counts instructions exactly and models cycles from the core's manual. With its
//! decoder, costs, flash and profile it knows no chip; [`board`] builds a whole board around it.

// The machine.
pub mod block;
pub mod bounds;
pub mod clock;
pub mod cost;
pub mod fetch;
pub mod isa;
pub mod machine;
pub mod profile;

// The boards, and what is counted.
pub mod bench;
pub mod board;
pub mod faults;
pub mod peers;
pub mod report;

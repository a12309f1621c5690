//! Cortex-M4F machine that counts instructions exactly and models cycles from the core's manual.
//!
//! [`board`] builds a whole board around it.

pub mod bench;
pub mod block;
pub mod board;
pub mod bounds;
pub mod clock;
pub mod cost;
pub mod faults;
pub mod fetch;
pub mod isa;
pub mod machine;
pub mod peers;
pub mod profile;
pub mod report;

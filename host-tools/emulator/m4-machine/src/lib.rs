//! Cortex-M4F machine that counts instructions exactly and models cycles from the core's manual.
//!
//! It knows no chip: memories, the floating-point unit, blocks of instructions with their cost, a
//! flash with wait states, and a profile by function.

pub mod block;
pub mod bounds;
pub mod clock;
pub mod cost;
pub mod fetch;
pub mod isa;
pub mod machine;
pub mod profile;

//! The core among its tools: on the simulator's scenes, from files.

mod cascade;
#[path = "../core/common/mod.rs"]
mod common;
mod faults;

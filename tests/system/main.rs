//! The core among its tools: on the simulator's scenes, from files, and on the emulated board.

mod cascade;
#[path = "../core/common/mod.rs"]
mod common;
mod emulated_board;
mod faults;

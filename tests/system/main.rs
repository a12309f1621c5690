//! The core among its tools: on the simulator's scenes, from files.

mod cascade;
mod faults;

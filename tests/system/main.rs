//! Tests of the core with the host tools: on the simulator's scenes and on files.

mod cascade;
mod faults;

//! A Cortex-M4F machine that counts: instructions exactly, cycles as modelled from the core's manual; and
//! around it a whole board ([`board`]).

pub mod bench;
pub mod block;
pub mod board;
pub mod clock;
pub mod cost;
pub mod isa;
pub mod machine;
pub mod peers;
pub mod profile;
pub mod report;

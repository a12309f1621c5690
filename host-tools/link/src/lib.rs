//! A finger from the host's side: where it is ([`Port`]), how to talk to it ([`Client`]), and one that
//! needs no hardware ([`VirtualFinger`]).
//!
//! ```text
//!              ┌─ serial device ─┐
//! Port ──open──┼─ TCP ───────────┼──▶ Client ──requests──▶ writer
//!              └─ VirtualFinger ─┘          ◀──replies─── reader thread ──frames──▶ queue
//!                 (scene or trace, behind the very session that the firmware runs)
//! ```
//! Everything blocks; no runtime is needed to use it. Every error is one line that names the port, what
//! happened, and the mend.

pub mod client;
mod clock;
mod echoes;
pub mod emulated;
pub mod error;
pub mod fields;
mod files;
pub mod port;
mod recorded;
pub mod self_test;
mod stamps;
mod steady;
mod transport;
pub mod usb;
pub mod virtual_finger;

pub use client::{Client, Counts, Received};
pub use clock::{DeviceClock, HostTime};
pub use echoes::Echoes;
pub use error::{InForce, LinkError, Problem};
pub use files::{Files, row, row_columns};
pub use port::Port;
pub use stamps::Stamps;
pub use steady::{Event, Steady};
pub use virtual_finger::{Source, TruthLog, VirtualFinger};

#![doc = include_str!("../README.md")]
//!
//! ```text
//! Port ──open──▶ Link ──▶ Client ──requests──▶ writer
//!                            ◀──replies─── reader thread ──frames──▶ queue
//! ```
//! Every error is one line that names the port, what happened, and the fix.

pub mod client;
mod clock;
mod echoes;
pub mod error;
pub mod fields;
mod link;
pub mod port;
pub mod self_test;
mod stamps;
mod steady;
pub mod usb;

pub use client::{Client, Counts, Received};
pub use clock::{DeviceClock, HostTime};
pub use echoes::RoundTrips;
pub use error::{ActiveCalibration, LinkError, Problem};
pub use link::{Device, Link, keep_alive};
pub use port::Port;
pub use stamps::Timestamps;
pub use steady::{Event, ReconnectingClient, Settings};

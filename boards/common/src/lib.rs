//! What the boards with hardware share. A board adds its clocks, its pins, its scan and its flash.
//!
//! ```text
//! frame interrupt ──Scan──▶ queue ──▶ Scanner (watchdog) ──▶ session ──▶ link (USB CDC ACM)
//! ```
#![no_std]

pub mod boot;
mod copy;
pub mod flash;
pub mod identity;
pub mod link;
pub mod scanner;
pub mod stack;
pub mod status;
pub mod time;
pub mod usb;

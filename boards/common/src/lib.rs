//! Code that all firmware shares; a board adds its clocks, pins, scan and flash.
//!
//! ```text
//! frame interrupt ──Scan──▶ queue ──▶ Scanner (watchdog) ──▶ session ──▶ link (USB CDC ACM)
//! ```
#![no_std]

pub mod boot;
mod copy;
mod crc;
pub mod flash;
pub mod identity;
pub mod link;
pub mod scanner;
pub mod stack;
pub mod status;
#[cfg(feature = "tim2")]
pub mod time;
pub mod usb;

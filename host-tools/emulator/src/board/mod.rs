//! Whole board in virtual time, with a finger on its pins and a USB host on its port.
//!
//! The chip runs the image that is flashed. unicorn executes the instructions. [`cpu`] takes
//! exceptions and keeps time by the cost table. [`chip`] holds what the two chips share. [`g431`]
//! and [`f411`] are the chips: bus and wires between the peripherals, one file each. An access that
//! is not modelled stops the machine with the register's name, so that nothing is read as zero by
//! accident. `docs/emulator.md` lists what is modelled.

pub mod capture;
pub mod cells;
pub mod chip;
pub mod cpu;
pub mod crc;
pub mod diagram;
pub mod f411;
pub mod finger;
pub mod g431;
pub mod gpio;
pub mod host;
pub mod iwdg;
pub mod model;
pub mod oscillators;
pub mod registers;
pub mod script;
pub mod server;
pub mod stored;
pub mod system;
pub mod time;
pub mod timer;
pub mod timing;
pub mod usb;

/// Result of an operation, or the reason why the machine must stop.
pub type Outcome<T = ()> = Result<T, String>;

/// Error for an access that the model does not support.
pub const UNMODELLED: &str = "not modelled";

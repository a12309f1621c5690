//! The whole board: a chip that runs the very image that is flashed, with a finger on its pins and a USB host on
//! its port, in virtual time.
//!
//! unicorn executes instructions; [`cpu`] takes exceptions and keeps time by the cost table, [`chip`] is what the two
//! chips have in common, [`g431`] and [`f411`] are the chips: the bus and the wires between the peripherals, one file
//! each. What is not modelled stops the machine with the register's name: nothing is read as zero because nobody
//! thought of it. `docs/emulator.md` lists it.

pub mod capture;
pub mod cells;
pub mod chip;
pub mod cpu;
pub mod diagram;
pub mod f411;
pub mod finger;
pub mod g431;
pub mod gpio;
pub mod host;
pub mod iwdg;
pub mod model;
pub mod script;
pub mod server;
pub mod stored;
pub mod system;
pub mod time;
pub mod timer;
pub mod timing;
pub mod usb;

/// What came of it, or why the machine has to stop.
pub type Outcome<T = ()> = Result<T, String>;

/// Why, where there is nothing more to say.
pub const UNMODELLED: &str = "not modelled";

//! The whole board: an STM32G431CB that runs the very image that is flashed, with a finger on its pins and
//! a USB host on its port, in virtual time.
//!
//! unicorn executes instructions; [`cpu`] takes exceptions and keeps time by the cost table, [`chip`] is the
//! bus and the wires between the peripherals, one file each. What is not modelled stops the machine with
//! the register's name: nothing is read as zero because nobody thought of it.
//!
//! Not modelled: noise, the flash's wait states and cache, contention on the bus, the start-up time of
//! oscillators and of the PLL, the clock's deviation and its recovery from the USB's frames, MPU and faults,
//! the process stack, double-buffered and isochronous endpoints, every peripheral that the firmware does
//! not use.

pub mod adc;
pub mod capture;
pub mod chip;
pub mod cpu;
pub mod diagram;
pub mod dma;
pub mod finger;
pub mod flash;
pub mod gpio;
pub mod host;
pub mod iwdg;
pub mod names;
pub mod plain;
pub mod rcc;
pub mod script;
pub mod server;
pub mod system;
pub mod time;
pub mod timer;
pub mod timing;
pub mod usb;
pub mod wires;

/// What came of it, or why the machine has to stop.
pub type Outcome<T = ()> = Result<T, String>;

/// Why, where there is nothing more to say.
pub const UNMODELLED: &str = "not modelled";

//! Tables of the boards' pins, for the firmware's configuration and the boards' pages.

/// Configuration of a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Input of an ADC or an amplifier; no digital part, no pull.
    Analogue,
    /// Push-pull output, low at first.
    Output,
    /// Configured by another driver, or by the chip.
    Other,
}

/// Pin of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// Port: 0 is A.
    pub port: u8,
    /// Number in the port.
    pub number: u8,
    /// Configuration of the pin.
    pub mode: Mode,
    /// Name of the pin's function in the chip's manual.
    pub function: &'static str,
    /// Role of the pin in the finger.
    pub role: &'static str,
}

const A: u8 = 0;
const B: u8 = 1;
const C: u8 = 2;

const fn pin(port: u8, number: u8, mode: Mode, function: &'static str, role: &'static str) -> Pin {
    Pin { port, number, mode, function, role }
}

use Mode::{Analogue, Other, Output};

/// Pins of the STM32G431 board's LED rows, on port B.
pub const G431_ROWS: [u8; 4] = [9, 10, 11, 12];
/// Pins of the STM32G431 board's multiplexer address, on port B.
pub const G431_SELECT: [u8; 2] = [5, 7];
/// Pin of the STM32G431 board's status LED, on port A.
pub const G431_STATUS: u8 = 8;

/// Pins of the STM32G431CB (LQFP48).
pub const G431: [Pin; 22] = [
    pin(A, 0, Analogue, "ADC1_IN1", "column 0"),
    pin(A, 1, Analogue, "ADC1_IN2", "column 1"),
    pin(A, 2, Analogue, "ADC1_IN3", "column 2"),
    pin(A, 3, Analogue, "ADC1_IN4", "column 3"),
    pin(A, 7, Analogue, "OPAMP2_VINP0", "midpoint A"),
    pin(B, 14, Analogue, "OPAMP2_VINP1", "midpoint B"),
    pin(B, 0, Analogue, "OPAMP3_VINP0", "midpoint C"),
    pin(B, 13, Analogue, "OPAMP3_VINP1", "midpoint D"),
    pin(A, 5, Analogue, "OPAMP2_VINM0, ADC2_IN13", "bridge bias"),
    pin(B, 2, Analogue, "OPAMP3_VINM0", "bridge bias"),
    pin(B, 9, Output, "GPIO", "LED row 0"),
    pin(B, 10, Output, "GPIO", "LED row 1"),
    pin(B, 11, Output, "GPIO", "LED row 2"),
    pin(B, 12, Output, "GPIO", "LED row 3"),
    pin(B, 5, Output, "GPIO", "multiplexer address 0"),
    pin(B, 7, Output, "GPIO", "multiplexer address 1"),
    pin(A, 8, Output, "GPIO", "status LED"),
    pin(A, 11, Other, "USB_DM", "USB D−"),
    pin(A, 12, Other, "USB_DP", "USB D+"),
    pin(A, 13, Other, "SWDIO", "debug"),
    pin(A, 14, Other, "SWCLK", "debug"),
    pin(B, 8, Other, "BOOT0", "held high at reset: ROM bootloader"),
];

/// Pins of the STM32F411 board's LED rows, on port B.
pub const F411_ROWS: [u8; 4] = [12, 13, 14, 15];
/// Pins of the STM32F411 board's multiplexer address, on port B.
pub const F411_SELECT: [u8; 2] = [8, 9];
/// Pin of the Black Pill's own LED, on port C; lit when low.
pub const F411_STATUS: u8 = 13;

/// Pins of the STM32F411CE on a Black Pill, whose button is on PA0.
pub const F411: [Pin; 21] = [
    pin(A, 1, Analogue, "ADC1_IN1", "column 0"),
    pin(A, 2, Analogue, "ADC1_IN2", "column 1"),
    pin(A, 3, Analogue, "ADC1_IN3", "column 2"),
    pin(A, 4, Analogue, "ADC1_IN4", "column 3"),
    pin(A, 5, Analogue, "ADC1_IN5", "midpoint A"),
    pin(A, 6, Analogue, "ADC1_IN6", "midpoint B"),
    pin(A, 7, Analogue, "ADC1_IN7", "midpoint C"),
    pin(B, 0, Analogue, "ADC1_IN8", "midpoint D"),
    pin(B, 12, Output, "GPIO", "LED row 0"),
    pin(B, 13, Output, "GPIO", "LED row 1"),
    pin(B, 14, Output, "GPIO", "LED row 2"),
    pin(B, 15, Output, "GPIO", "LED row 3"),
    pin(B, 8, Output, "GPIO", "multiplexer address 0"),
    pin(B, 9, Output, "GPIO", "multiplexer address 1"),
    pin(C, 13, Output, "GPIO", "status LED, lit when low"),
    pin(A, 11, Other, "OTG_FS_DM", "USB D−"),
    pin(A, 12, Other, "OTG_FS_DP", "USB D+"),
    pin(A, 13, Other, "SWDIO", "debug"),
    pin(A, 14, Other, "SWCLK", "debug"),
    pin(A, 0, Other, "GPIO", "the board's button, unused"),
    pin(B, 2, Other, "BOOT1", "pulled down by the board"),
];

/// Value of `port`'s `MODER` for this table, from its value `before`: 0 input, 1 output, 3
/// analogue.
#[must_use]
pub const fn moder(pins: &[Pin], port: u8, before: u32) -> u32 {
    let mut moder = before;
    let mut i = 0;
    while i < pins.len() {
        let Pin { port: on, number, mode, .. } = pins[i];
        if on == port {
            let at = 2 * number as u32;
            moder = match mode {
                Analogue => moder | 3 << at,
                Output => moder & !(3 << at) | 1 << at,
                Other => moder,
            };
        }
        i += 1;
    }
    moder
}

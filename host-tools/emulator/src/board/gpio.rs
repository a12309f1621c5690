//! GPIO port (RM0440 §9).

use super::{Outcome, UNMODELLED};

/// GPIO port.
pub struct Gpio {
    moder: u32,
    odr: u32,
    /// Output type, speed, pulls, which have no effect, and alternate functions.
    other: [u32; 5],
}

impl Gpio {
    /// Port with this reset value of its mode register.
    pub fn new(moder: u32) -> Self {
        Self { moder, odr: 0, other: [0; 5] }
    }

    /// Pins that are outputs and high.
    pub fn high(&self) -> u32 {
        (0..16).filter(|pin| self.moder >> (2 * pin) & 3 == 1).map(|pin| 1 << pin).sum::<u32>()
            & self.odr
    }

    /// Whether a pin is in analogue mode.
    pub fn is_analogue(&self, pin: u32) -> bool {
        self.moder >> (2 * pin) & 3 == 3
    }

    /// Whether a pin has a pull-up or pull-down.
    pub fn is_pulled(&self, pin: u32) -> bool {
        self.other[2] >> (2 * pin) & 3 != 0
    }

    /// Whether a pin is an output that only pulls low.
    pub fn is_open_drain(&self, pin: u8) -> bool {
        self.moder >> (2 * pin) & 3 == 1 && self.other[0] >> pin & 1 == 1
    }

    /// Alternate function of a pin; `None` if the pin has another mode.
    pub fn alternate(&self, pin: u32) -> Option<u32> {
        let function = self.other[3 + pin as usize / 8] >> (4 * (pin % 8)) & 0xf;
        (self.moder >> (2 * pin) & 3 == 2).then_some(function)
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        Ok(match offset {
            0x00 => self.moder,
            0x04 => self.other[0],
            0x08 => self.other[1],
            0x0c => self.other[2],
            0x14 => self.odr,
            0x20 => self.other[3],
            0x24 => self.other[4],
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32) -> Outcome {
        match offset {
            0x00 => self.moder = value,
            0x04 => self.other[0] = value,
            0x08 => self.other[1] = value,
            0x0c => self.other[2] = value,
            0x14 => self.odr = value & 0xffff,
            // BSRR: setting takes precedence over resetting.
            0x18 => self.odr = self.odr & !(value >> 16) | value & 0xffff,
            0x20 => self.other[3] = value,
            0x24 => self.other[4] = value,
            0x28 => self.odr &= !value,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }
}

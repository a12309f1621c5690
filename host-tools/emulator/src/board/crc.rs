//! CRC unit with the polynomial of its reset (RM0440 §16, RM0383 §4): words, highest bit first.

use super::{Outcome, UNMODELLED};

const POLYNOMIAL: u32 = 0x04c1_1db7;

/// CRC unit.
pub struct Crc {
    register: u32,
}

impl Default for Crc {
    fn default() -> Self {
        Self { register: u32::MAX }
    }
}

impl Crc {
    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        match offset {
            0x00 => Ok(self.register),
            0x08 => Ok(0),
            _ => Err(UNMODELLED.into()),
        }
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32) -> Outcome {
        match (offset, value) {
            (0x00, word) => {
                self.register = (0..u32::BITS).fold(self.register ^ word, |register, _| {
                    register << 1 ^ if register >> 31 == 1 { POLYNOMIAL } else { 0 }
                });
            }
            (0x08, 1) => *self = Self::default(),
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }
}

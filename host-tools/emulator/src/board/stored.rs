//! Registers that store their values and have no other effect.

use std::collections::BTreeMap;

use super::{Outcome, UNMODELLED};

/// Registers of a peripheral that have values and no effect.
pub struct StoredRegisters {
    /// Values by offset.
    values: BTreeMap<u32, u32>,
}

impl StoredRegisters {
    /// Builds registers from offsets and reset values; all other offsets stop the machine.
    pub fn new(registers: &[(u32, u32)]) -> Self {
        Self { values: registers.iter().copied().collect() }
    }

    /// Reads the register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        self.values.get(&offset).copied().ok_or_else(|| UNMODELLED.into())
    }

    /// Writes the register at `offset`.
    pub fn write(&mut self, offset: u32, value: u32) -> Outcome {
        let place = self.values.get_mut(&offset).ok_or(UNMODELLED)?;
        *place = value;
        Ok(())
    }
}

//! Registers that keep what is written, and of which nothing else is modelled.

use std::collections::BTreeMap;

use super::{Outcome, UNMODELLED};

/// Registers of a peripheral that have a value and no effect.
pub struct StoredRegisters {
    /// By offset.
    values: BTreeMap<u32, u32>,
}

impl StoredRegisters {
    /// With these registers and reset values; all others stop the machine.
    pub fn new(registers: &[(u32, u32)]) -> Self {
        Self { values: registers.iter().copied().collect() }
    }

    /// The register at `offset`.
    pub fn read(&self, offset: u32) -> Outcome<u32> {
        self.values.get(&offset).copied().ok_or_else(|| UNMODELLED.into())
    }

    /// Writes it.
    pub fn write(&mut self, offset: u32, value: u32) -> Outcome {
        let place = self.values.get_mut(&offset).ok_or(UNMODELLED)?;
        *place = value;
        Ok(())
    }
}

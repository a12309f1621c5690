//! Flash of the chip, as the store uses it.
//!
//! The core stalls while flash is erased or programmed, because it fetches code from the same
//! flash. The scan continues by DMA, and frames that nobody reads meanwhile count as overrun.

use core::ops::Range;
use core::ptr::with_exposed_provenance;
use core::slice;

use embedded_storage::nor_flash::NorFlash;
use taxel::store::{Area, Flash, FlashError, Word};

/// Areas of the chip's flash.
pub struct ChipFlash<D> {
    driver: D,
    base: usize,
    place: fn(Area) -> Range<u32>,
}

impl<D: NorFlash> ChipFlash<D> {
    /// Builds the areas of flash that starts at address `base`.
    ///
    /// `place` returns the offsets of an area: whole sectors, of which the first [`Area::size`]
    /// bytes are used.
    ///
    /// # Safety
    /// All of these ranges are flash, and nothing else in the firmware reads or writes them.
    pub const unsafe fn new(driver: D, base: usize, place: fn(Area) -> Range<u32>) -> Self {
        Self { driver, base, place }
    }
}

impl<D: NorFlash> Flash for ChipFlash<D> {
    fn bytes(&self, area: Area) -> &[u8] {
        let start = self.base + (self.place)(area).start as usize;
        // SAFETY: `new` was promised that this is flash and that only this driver changes it; the
        // driver is borrowed for as long as the bytes are.
        unsafe { slice::from_raw_parts(with_exposed_provenance(start), area.size()) }
    }

    fn erase(&mut self, area: Area) -> Result<(), FlashError> {
        let Range { start, end } = (self.place)(area);
        self.driver.erase(start, end).map_err(|_| FlashError)
    }

    fn program(&mut self, area: Area, offset: usize, word: Word) -> Result<(), FlashError> {
        let start = (self.place)(area).start + offset as u32;
        self.driver.write(start, &word).map_err(|_| FlashError)
    }
}

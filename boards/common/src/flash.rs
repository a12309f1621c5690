//! The chip's flash as the store wants it.
//!
//! The chip stands still while it erases or programs: it fetches its code from the same flash. The scan
//! goes on by DMA, and the frames that nobody reads meanwhile are counted as overrun.

use core::ops::Range;
use core::ptr::with_exposed_provenance;
use core::slice;

use embedded_storage::nor_flash::NorFlash;
use taxel::store::{Area, Flash, FlashError, Word};

/// Parts of the chip's flash.
pub struct ChipFlash<D> {
    driver: D,
    base: usize,
    place: fn(Area) -> Range<u32>,
}

impl<D: NorFlash> ChipFlash<D> {
    /// Flash whose first byte the chip maps at `base`; `place` says where in it an area lies: whole
    /// sectors, of which the first [`Area::size`] bytes are used.
    ///
    /// # Safety
    /// All of these places are flash and nothing else in the firmware reads or writes them.
    pub const unsafe fn new(driver: D, base: usize, place: fn(Area) -> Range<u32>) -> Self {
        Self { driver, base, place }
    }
}

impl<D: NorFlash> Flash for ChipFlash<D> {
    fn bytes(&self, area: Area) -> &[u8] {
        let start = self.base + (self.place)(area).start as usize;
        // SAFETY: `new` was promised that flash is there and that it changes by this driver alone, which is
        // borrowed for as long as the bytes are.
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

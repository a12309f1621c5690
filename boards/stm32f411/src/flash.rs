//! Flash areas that survive power-off: the four sectors that `memory.x` leaves out.

use core::ops::Range;

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, Error, FLASH_BASE, Flash, WRITE_SIZE};
use embassy_stm32::pac;
use embassy_stm32::pac::flash::vals::Psize;
use embassy_stm32::peripherals::FLASH;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use taxel::store::Area;
use taxel_board::flash::ChipFlash;

/// Flash of the chip.
pub type Sectors = ChipFlash<ByWords>;

/// Sectors that survive power-off.
pub fn sectors(flash: Peri<'static, FLASH>) -> Sectors {
    // SAFETY: `memory.x` keeps the linker out of these ranges, and the peripheral is taken once.
    unsafe { ChipFlash::new(ByWords(Flash::new_blocking(flash)), FLASH_BASE, place) }
}

/// Sector of an area.
///
/// The largest takes longest to erase, so it holds a calibration, which is rarely written.
const fn place(area: Area) -> Range<u32> {
    match area {
        Area::PageA => 0x0_4000..0x0_8000,
        Area::PageB => 0x0_8000..0x0_C000,
        Area::SlotA => 0x0_C000..0x1_0000,
        Area::SlotB => 0x1_0000..0x2_0000,
    }
}

/// Driver of the HAL that erases 32 bits at once and keeps the data cache true.
///
/// embassy-stm32 0.6 leaves PSIZE at eight bits. The largest sector then takes up to 2.4 s instead
/// of 1.1 s (DS10314 table 47). It also leaves old contents in the data cache (RM0383 §3.4.2).
pub struct ByWords(Flash<'static, Blocking>);

impl ErrorType for ByWords {
    type Error = Error;
}

impl ReadNorFlash for ByWords {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        self.0.blocking_read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&self.0)
    }
}

impl NorFlash for ByWords {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = <Flash<'static, Blocking> as NorFlash>::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        // PSIZE cannot be written while CR is locked; the driver locks it again.
        if pac::FLASH.cr().read().lock() {
            for key in [0x4567_0123, 0xCDEF_89AB] {
                pac::FLASH.keyr().write_value(key);
            }
        }
        pac::FLASH.cr().modify(|cr| cr.set_psize(Psize::PSIZE32));
        let done = self.0.blocking_erase(from, to);
        forget_cached();
        done
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        let done = self.0.blocking_write(offset, bytes);
        forget_cached();
        done
    }
}

/// Empties the data cache, which can be reset only while it is off.
fn forget_cached() {
    let acr = pac::FLASH.acr();
    acr.modify(|w| w.set_dcen(false));
    acr.modify(|w| w.set_dcrst(true));
    acr.modify(|w| w.set_dcrst(false));
    acr.modify(|w| w.set_dcen(true));
}

//! Flash areas that survive power-off: the regions CALIBRATION and SETTINGS of `memory.x`.

use core::ops::Range;

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, FLASH_BASE, Flash};
use embassy_stm32::peripherals::FLASH;
use taxel::store::Area;
use taxel_board::flash::ChipFlash;

/// Flash of the chip.
pub type Pages = ChipFlash<Flash<'static, Blocking>>;

/// Pages that survive power-off.
pub fn pages(flash: Peri<'static, FLASH>) -> Pages {
    // SAFETY: `memory.x` keeps the linker out of these ranges, and the peripheral is taken once.
    unsafe { ChipFlash::new(Flash::new_blocking(flash), FLASH_BASE, place) }
}

unsafe extern "C" {
    /// Offset of the region CALIBRATION in the flash; SETTINGS follows it.
    static __stored: u8;
}

fn place(area: Area) -> Range<u32> {
    let (from, to) = match area {
        Area::SlotA => (0x0000, 0x1000),
        Area::SlotB => (0x1000, 0x2000),
        Area::PageA => (0x2000, 0x2800),
        Area::PageB => (0x2800, 0x3000),
    };
    let stored = (&raw const __stored).addr() as u32;
    stored + from..stored + to
}

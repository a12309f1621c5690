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

const fn place(area: Area) -> Range<u32> {
    match area {
        Area::SlotA => 0x1_D000..0x1_E000,
        Area::SlotB => 0x1_E000..0x1_F000,
        Area::PageA => 0x1_F000..0x1_F800,
        Area::PageB => 0x1_F800..0x2_0000,
    }
}

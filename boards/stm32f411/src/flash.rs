//! Where in the flash what survives power-off lies: the four small sectors that `memory.x` leaves out.

use core::ops::Range;

use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, FLASH_BASE, Flash};
use embassy_stm32::peripherals::FLASH;
use taxel::store::Area;
use taxel_board::flash::ChipFlash;

/// The chip's flash.
pub type Sectors = ChipFlash<Flash<'static, Blocking>>;

/// The sectors that survive power-off.
pub fn sectors(flash: Peri<'static, FLASH>) -> Sectors {
    // SAFETY: `memory.x` keeps the linker out of these places, and the peripheral is taken once.
    unsafe { ChipFlash::new(Flash::new_blocking(flash), FLASH_BASE, place) }
}

/// A sector each. The largest takes longest to erase: it holds a calibration, which is rarely written.
const fn place(area: Area) -> Range<u32> {
    match area {
        Area::PageA => 0x0_4000..0x0_8000,
        Area::PageB => 0x0_8000..0x0_C000,
        Area::SlotA => 0x0_C000..0x1_0000,
        Area::SlotB => 0x1_0000..0x2_0000,
    }
}

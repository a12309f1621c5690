//! Pin of the status LED, which is lit when the pin is low.

use embassy_stm32::pac::GPIOC;
use scan_plan::pins::F411_STATUS;

use crate::scan;

/// Shows the state of the scan without end.
#[embassy_executor::task]
pub async fn show() {
    taxel_board::status::show(&scan::FRAMES, set).await;
}

fn set(lit: bool) {
    let shift = if lit { 16 } else { 0 };
    GPIOC.bsrr().write(|bsrr| bsrr.0 = 1 << (u32::from(F411_STATUS) + shift));
}

//! The status LED's pin; the LED is lit when it is low.

use embassy_stm32::pac::GPIOC;
use scan_plan::pins::F411_STATUS;

use crate::scan;

/// Shows forever how the scan is doing.
#[embassy_executor::task]
pub async fn show() {
    taxel_board::status::show(&scan::FRAMES, set).await;
}

fn set(lit: bool) {
    let shift = if lit { 16 } else { 0 };
    GPIOC.bsrr().write(|bsrr| bsrr.0 = 1 << (u32::from(F411_STATUS) + shift));
}

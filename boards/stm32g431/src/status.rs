//! Pin of the status LED.

use embassy_stm32::pac::GPIOA;
use scan_plan::pins::G431_STATUS;

use crate::scan;

/// Shows the state of the scan without end.
#[embassy_executor::task]
pub async fn show() {
    taxel_board::status::show(&scan::FRAMES, set).await;
}

fn set(lit: bool) {
    let shift = if lit { 0 } else { 16 };
    GPIOA.bsrr().write(|bsrr| bsrr.0 = 1 << (u32::from(G431_STATUS) + shift));
}

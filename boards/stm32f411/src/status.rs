//! The status LED, lit when its pin is low: short blinks while scans come, steady while they do not.

use embassy_stm32::pac::GPIOC;
use embassy_time::{Duration, Timer};
use scan_plan::pins::F411_STATUS;

use crate::scan;

/// Shows for ever how the scan is doing.
#[embassy_executor::task]
pub async fn show() {
    let mut seen = 0;
    loop {
        let scans = scan::frames();
        set(true);
        Timer::after(Duration::from_millis(50)).await;
        set(scans == seen);
        seen = scans;
        Timer::after(Duration::from_millis(950)).await;
    }
}

fn set(lit: bool) {
    let shift = if lit { 16 } else { 0 };
    GPIOC.bsrr().write(|bsrr| bsrr.0 = 1 << (u32::from(F411_STATUS) + shift));
}

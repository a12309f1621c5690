//! The status LED: short blinks while scans come, steady while they do not.

use embassy_time::{Duration, Timer};

use crate::scanner::Frames;

/// Shows forever how the scan is doing; `set` lights the LED, or not.
pub async fn show(frames: &'static Frames, set: fn(bool)) -> ! {
    let mut seen = 0;
    loop {
        let scans = frames.count();
        set(true);
        Timer::after(Duration::from_millis(50)).await;
        set(scans == seen);
        seen = scans;
        Timer::after(Duration::from_millis(950)).await;
    }
}

//! Status LED: short blinks while scans arrive, steady light while they do not.

use embassy_time::{Duration, Timer};

use crate::scanner::Frames;

/// Shows the state of the scan without end; `set` switches the LED.
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

//! Register values with which a timer, the DMA and the ADCs scan the finger by themselves.
//!
//! A board crate writes these values unchanged.
//!
//! A frame is five steps: every LED off, then row 0 … row 3. One timer period is one step:
//!
//! ```text
//! count  0   A            C                          B                               top
//!        │   │ pattern    │ slow and unlit inputs    │ columns                        │
//!        │   └ DMA: LED row and multiplexer to GPIO  │                                │
//!        │                └ bridges, reference, temperature: they do not need light
//!        │                                           └ settled: the columns are sampled
//! ```
//! [`g431::plan`] and [`f411::plan`] turn [`taxel::scan::ScanSettings`] into a plan, or refuse them
//! with the range that fits. Both are `const`: a board's default is checked at compile time, and
//! the same code checks a host's settings at run time.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "drawing")]
extern crate std;

#[cfg(feature = "drawing")]
pub mod drawing;
pub mod f411;
pub mod finger;
pub mod g431;
pub mod pattern;
pub mod pins;
pub mod settle;

use taxel::scan::ScanSetting;
use taxel::wire::message::Refusal;

/// Steps of a frame: dark, then the four rows.
pub const STEPS: u32 = 5;
/// Number of columns read in every step.
pub const COLUMNS: u32 = 4;

/// Times of one timer period in ticks: `light` < `slow` < `columns` ≤ `done` ≤ `top`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Ticks per second.
    pub tick_hz: u32,
    /// Compare A: the DMA sets row and multiplexer.
    pub light: u32,
    /// Compare C: inputs that do not need light are converted.
    pub slow: u32,
    /// Compare B: the columns are converted.
    pub columns: u32,
    /// End of the last sample.
    pub done: u32,
    /// Last count of the period.
    pub top: u32,
}

impl Step {
    /// Ticks in a frame.
    #[must_use]
    pub const fn frame_ticks(&self) -> u32 {
        STEPS * (self.top + 1)
    }

    /// Microseconds in a frame, rounded down.
    #[must_use]
    pub const fn frame_us(&self) -> u32 {
        self.frame_ticks() / (self.tick_hz / 1_000_000)
    }

    /// Rate of frames by the timer, in millihertz.
    #[must_use]
    pub const fn scan_millihertz(&self) -> u32 {
        (self.tick_hz as u64 * 1000 / self.frame_ticks() as u64) as u32
    }

    /// Nanoseconds in `ticks`, rounded down.
    #[must_use]
    pub const fn ns(&self, ticks: u32) -> u32 {
        (ticks as u64 * 1_000_000_000 / self.tick_hz as u64) as u32
    }
}

/// Ticks of `tick_hz` in `ns`, rounded up, so that a settle time is never cut short.
///
/// The clock has whole megahertz, at most 200: a 64-bit division would take 1.2 KB of flash. More
/// than [`LONGEST_NS`] counts as that time, which no step can hold either.
#[must_use]
pub const fn ticks(ns: u32, tick_hz: u32) -> u32 {
    let ns = if ns > LONGEST_NS { LONGEST_NS } else { ns };
    (ns * (tick_hz / 1_000_000)).div_ceil(1_000)
}

/// Longest time in nanoseconds that [`ticks`] converts.
const LONGEST_NS: u32 = 20_000_000;

/// Ticks of a step at `hz` frames per second, rounded to the nearest.
const fn step_ticks(hz: u32, tick_hz: u32) -> u32 {
    let steps_hz = if hz == 0 { STEPS } else { STEPS * hz };
    (tick_hz + steps_hz / 2) / steps_hz
}

/// Builds the refusal of a setting; `low` to `high` is the range that fits the other two.
const fn refusal(setting: ScanSetting, low: u32, high: u32) -> Refusal {
    Refusal::Scan { setting, low, high }
}

/// Builds the refusal of a settle time, with the range that fits.
///
/// A step needs at least `least` ticks of settle time and `rest` other ticks. If the rate leaves no
/// room, the range is that of the slowest rate.
const fn settle_refusal(least: u32, rest: u32, scan_hz: u16, tick_hz: u32) -> Refusal {
    let step = step_ticks(scan_hz as u32, tick_hz);
    let fits = scan_hz > 0 && step <= LONGEST_STEP && step >= least + rest;
    let most = if fits { step } else { LONGEST_STEP } - rest;
    let mhz = tick_hz / 1_000_000;
    refusal(ScanSetting::SettleNs, (1_000 * least).div_ceil(mhz), 1_000 * most / mhz)
}

/// Most ticks of a step, because the timer counts to 65535.
const LONGEST_STEP: u32 = 1 << 16;
/// Divider of the timer's clock for slow scans.
///
/// More would leave an ADC of the STM32G431 idle for 1 ms, after which its next result may be wrong
/// (ES0430).
const DIVIDER: u32 = 2;

/// Returns the divider of the timer's clock with which it counts a step; 1 if none suffices.
const fn divider(scan_hz: u16, clock_hz: u32) -> u32 {
    let undivided = step_ticks(scan_hz as u32, clock_hz);
    let divided = step_ticks(scan_hz as u32, clock_hz / DIVIDER);
    if scan_hz > 0 && undivided > LONGEST_STEP && divided <= LONGEST_STEP { DIVIDER } else { 1 }
}

/// Returns the top count for the rate `scan_hz`, or a refusal with the range of rates.
///
/// A step needs `shortest` ticks of the clock over `divider`.
const fn fit(scan_hz: u16, shortest: u32, clock_hz: u32, divider: u32) -> Result<u32, Refusal> {
    let tick_hz = clock_hz / divider;
    let step = step_ticks(scan_hz as u32, tick_hz);
    if step < shortest || step > LONGEST_STEP || scan_hz == 0 {
        let lowest = (2 * (clock_hz / DIVIDER)).div_ceil(STEPS * (2 * LONGEST_STEP + 1));
        return Err(refusal(ScanSetting::ScanHz, lowest, fastest(shortest, tick_hz)));
    }
    Ok(step - 1)
}

/// Highest whole rate whose rounded step has at least `shortest` ticks.
const fn fastest(shortest: u32, tick_hz: u32) -> u32 {
    let mut hz = 2 * tick_hz / (STEPS * (2 * shortest - 1)) + 1;
    while hz > 1 && step_ticks(hz, tick_hz) < shortest {
        hz -= 1;
    }
    hz
}

//! Queue from the frame interrupt to the session.
//!
//! The interrupt puts each frame into a short queue. The queue fills while the session is busy for
//! longer than a frame: a calibration is checked, or a page of flash erased. Frames that do not fit
//! are lost, and the next queued scan reports their number. The instrument never stops.
//!
//! Only two things feed the watchdog: scans that reach the session, and a requested pause.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, Timer};
use heapless::String;
use taxel::scan::{Codes, Scan, ScanSettings};
use taxel::session::Board;
use taxel::store::{Flash, Store};
use taxel::units::{FullScale, Micros};
use taxel::wire::message::{BoardHealth, Cost, Refusal, Reset};

use crate::boot::{self, MESSAGE};
use crate::{crc, stack};

/// Capacity of the queue in frames: 1 ms at 4 kHz.
const QUEUE: usize = 4;
/// Longest delay of an interrupt by critical sections alone, microseconds.
const PROMPT: u32 = 8;

/// Interrupt side of the queue.
pub struct Frames {
    queue: Channel<CriticalSectionRawMutex, Scan, QUEUE>,
    /// Frames lost since the last queued one.
    lost: AtomicU32,
    /// Whether the scan is paused on request.
    paused: AtomicBool,
    /// Duration of a frame, microseconds.
    period: AtomicU32,
    /// Time of the last frame's interrupt, microseconds.
    last: AtomicU32,
    /// Frames read since power-up.
    count: AtomicU32,
    /// Cycles of the last interrupt, and the most so far.
    cost: AtomicU32,
    worst: AtomicU32,
}

impl Frames {
    /// Builds an empty queue.
    #[expect(clippy::new_without_default, reason = "made once, in a static")]
    #[must_use]
    pub const fn new() -> Self {
        Self {
            queue: Channel::new(),
            lost: AtomicU32::new(0),
            paused: AtomicBool::new(true),
            period: AtomicU32::new(0),
            last: AtomicU32::new(0),
            count: AtomicU32::new(0),
            cost: AtomicU32::new(0),
            worst: AtomicU32::new(0),
        }
    }

    /// Records that a scan starts, with frames of `period_us` microseconds.
    pub fn begin(&self, period_us: u32) {
        self.period.store(period_us, Ordering::Relaxed);
        self.last.store(now_us(), Ordering::Relaxed);
        self.paused.store(false, Ordering::Relaxed);
    }

    /// Records that the scan was stopped on request, in the middle of a frame.
    pub fn halt(&self) {
        self.paused.store(true, Ordering::Relaxed);
        self.lose(1);
    }

    /// Records a frame interrupt and returns its timestamp.
    ///
    /// Delayed interrupts merge into one. Their number follows from the time, and all of their
    /// frames but the last count as lost.
    pub fn tick(&self) -> Instant {
        let now = Instant::now();
        let us = now.as_micros() as u32;
        let since = us.wrapping_sub(self.last.load(Ordering::Relaxed));
        let period = self.period.load(Ordering::Relaxed).max(1);
        let frames = ((since + PROMPT) / period).max(1);
        // A delayed interrupt does not show when its frame was complete; the earlier ones do.
        let late = since.saturating_sub(frames * period);
        let complete = if late > PROMPT { us.wrapping_sub(late) } else { us };
        self.last.store(complete, Ordering::Relaxed);
        self.lose(frames - 1);
        now
    }

    /// Queues the codes of a frame that ended at `end`, or counts it as lost.
    pub fn push(&self, codes: Codes, end: Instant) {
        let period = u64::from(self.period.load(Ordering::Relaxed));
        let time = Micros(end.as_micros().saturating_sub(period));
        let lost = self.lost.load(Ordering::Relaxed);
        let queued = self.queue.try_send(Scan { time, lost, codes }).is_ok();
        self.lost.store(if queued { 0 } else { lost.saturating_add(1) }, Ordering::Relaxed);
        self.count.store(self.count().wrapping_add(1), Ordering::Relaxed);
    }

    /// Frames read since power-up, wrapping.
    #[must_use]
    pub fn count(&self) -> u32 {
        self.count.load(Ordering::Relaxed)
    }

    /// Counts frames that could not be read whole.
    pub fn lose(&self, frames: u32) {
        // Called from the frame's interrupt, and where that cannot interrupt.
        let lost = self.lost.load(Ordering::Relaxed);
        self.lost.store(lost.saturating_add(frames), Ordering::Relaxed);
    }

    /// Drops and counts queued frames, because they were read with other settings.
    fn forget(&self) {
        while self.queue.try_receive().is_ok() {
            cortex_m::interrupt::free(|_| self.lose(1));
        }
    }

    /// Records the cycles of reading a frame.
    pub fn note_cost(&self, cycles: u32) {
        self.cost.store(cycles, Ordering::Relaxed);
        self.worst.fetch_max(cycles, Ordering::Relaxed);
    }

    /// Cycles of reading the last frame, and the most so far.
    #[must_use]
    pub fn cost(&self) -> (u32, u32) {
        (self.cost.load(Ordering::Relaxed), self.worst.load(Ordering::Relaxed))
    }
}

fn now_us() -> u32 {
    Instant::now().as_micros() as u32
}

/// Chip functions that the scanner uses.
pub trait Chip {
    /// Feeds the watchdog.
    fn feed(&self);

    /// Present settings of the scan.
    fn scan_settings(&self) -> ScanSettings;

    /// Applies settings to the scan and returns the codes' new full scale.
    ///
    /// # Errors
    /// The setting that is out of range; the scan continues unchanged.
    fn set_scan(&self, settings: &ScanSettings) -> Result<FullScale, Refusal>;

    /// Holds an LED row on in every step, or scans again.
    fn hold_row(&self, row: Option<u8>);
}

/// Session side of the queue, which is the session's board.
pub struct Scanner<C, F> {
    frames: &'static Frames,
    chip: C,
    store: Store<F>,
    started: Started,
    /// Time to enter the bootloader, if requested.
    leave: Option<Instant>,
}

/// Cause of the board's start.
pub struct Started {
    /// Cause of the reset.
    pub reset: Reset,
    /// Panic before the reset, if there was one.
    pub panic: Option<String<MESSAGE>>,
}

impl<C: Chip, F> Scanner<C, F> {
    /// Interval at which a pause feeds the watchdog.
    const PAUSE: Duration = Duration::from_millis(100);
    /// Time for an answer to leave before the bootloader starts.
    const FAREWELL: Duration = Duration::from_millis(200);

    /// Builds a board that takes scans from `frames`; `store` survives power-off.
    pub const fn new(frames: &'static Frames, chip: C, store: Store<F>, started: Started) -> Self {
        Self { frames, chip, store, started, leave: None }
    }
}

impl<C: Chip, F: Flash> Board for Scanner<C, F> {
    type Flash = F;

    async fn scan(&mut self) -> Option<Scan> {
        loop {
            if self.leave.is_some_and(|at| Instant::now() >= at) {
                boot::enter_bootloader();
            }
            // Waits for readiness first: awaiting the value would copy the scan at each layer.
            match select(self.frames.queue.ready_to_receive(), Timer::after(Self::PAUSE)).await {
                Either::First(()) => {
                    self.chip.feed();
                    let scan = self.frames.queue.try_receive().ok();
                    if scan.is_some() {
                        return scan;
                    }
                }
                Either::Second(()) if self.frames.paused.load(Ordering::Relaxed) => {
                    self.chip.feed();
                }
                Either::Second(()) => {}
            }
        }
    }

    fn ticks(&self) -> u32 {
        cortex_m::peripheral::DWT::cycle_count()
    }

    fn crc32(&self, bytes: &[u8]) -> u32 {
        crc::crc32(bytes)
    }

    fn store(&mut self) -> &mut Store<F> {
        &mut self.store
    }

    fn health(&self) -> BoardHealth {
        let (last, worst) = self.frames.cost();
        BoardHealth {
            reset: self.started.reset,
            panic: self.started.panic.clone(),
            reading: Some(Cost { last, worst }),
            sending: None,
            stack: Some((stack::deepest() as u32, stack::size() as u32)),
            scan: Some(self.chip.scan_settings()),
            erasures: None,
        }
    }

    fn bootloader(&mut self) -> Result<(), Refusal> {
        self.leave = Some(Instant::now() + Self::FAREWELL);
        Ok(())
    }

    fn set_scan(&mut self, settings: &ScanSettings) -> Result<FullScale, Refusal> {
        let full_scale = self.chip.set_scan(settings)?;
        self.frames.forget();
        Ok(full_scale)
    }

    fn hold_row(&mut self, row: Option<u8>) -> Result<(), Refusal> {
        self.chip.hold_row(row);
        self.frames.forget();
        Ok(())
    }
}

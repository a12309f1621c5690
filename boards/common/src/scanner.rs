//! From the frame interrupt to the session.
//!
//! The interrupt puts each frame into a short queue and is done. While the session is busy for longer
//! than a frame (a calibration is checked, a page of flash erased) the queue fills; what does not fit is
//! lost, and the next scan that fits says so. It never stops the instrument.
//!
//! The watchdog is fed here and nowhere else: by scans that have come all the way, or by a pause that was
//! asked for.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Timer};
use taxel::scan::{Codes, Scan};
use taxel::session::Board;
use taxel::store::{Flash, Store};
use taxel::units::Micros;

/// Frames that may wait: 1 ms at 4 kHz.
const QUEUE: usize = 4;

/// The interrupt's end of the queue.
pub struct Frames {
    queue: Channel<CriticalSectionRawMutex, Scan, QUEUE>,
    /// Frames were lost since the last that was queued.
    lost: AtomicBool,
    /// The scan stands still on purpose.
    paused: AtomicBool,
    /// Cycles that the last interrupt took, and the most so far.
    cost: AtomicU32,
    worst: AtomicU32,
}

impl Frames {
    /// An empty queue.
    #[expect(clippy::new_without_default, reason = "made once, in a static")]
    #[must_use]
    pub const fn new() -> Self {
        Self {
            queue: Channel::new(),
            lost: AtomicBool::new(false),
            paused: AtomicBool::new(true),
            cost: AtomicU32::new(0),
            worst: AtomicU32::new(0),
        }
    }

    /// A frame has been read. `missed` is true where one before it was not.
    pub fn push(&self, time: Micros, codes: Codes, missed: bool) {
        let overrun = self.lost.load(Ordering::Relaxed) || missed;
        let scan = Scan { time, overrun, codes };
        self.lost.store(self.queue.try_send(scan).is_err(), Ordering::Relaxed);
    }

    /// A frame came and could not be read whole.
    pub fn drop_one(&self) {
        self.lost.store(true, Ordering::Relaxed);
    }

    /// Notes what reading a frame took.
    pub fn note_cost(&self, cycles: u32) {
        self.cost.store(cycles, Ordering::Relaxed);
        self.worst.fetch_max(cycles, Ordering::Relaxed);
    }

    /// Cycles that reading the last frame took, and the most so far.
    #[must_use]
    pub fn cost(&self) -> (u32, u32) {
        (self.cost.load(Ordering::Relaxed), self.worst.load(Ordering::Relaxed))
    }

    /// The scan stands still on purpose, or goes on.
    pub fn set_paused(&self, paused: bool) {
        self.paused.store(paused, Ordering::Relaxed);
        if paused {
            self.drop_one();
        }
    }
}

/// The session's end of the queue.
pub struct Scanner<F> {
    frames: &'static Frames,
    feed: fn(),
    store: Store<F>,
}

impl<F> Scanner<F> {
    /// How often a pause feeds the watchdog.
    const PAUSE: Duration = Duration::from_millis(100);

    /// Scans from `frames`; `feed` feeds the watchdog, `store` survives power-off.
    pub const fn new(frames: &'static Frames, feed: fn(), store: Store<F>) -> Self {
        Self { frames, feed, store }
    }
}

impl<F: Flash> Board for Scanner<F> {
    type Flash = F;

    async fn scan(&mut self) -> Option<Scan> {
        loop {
            // A receive that is dropped has taken nothing.
            match select(self.frames.queue.receive(), Timer::after(Self::PAUSE)).await {
                Either::First(scan) => {
                    (self.feed)();
                    return Some(scan);
                }
                Either::Second(()) if self.frames.paused.load(Ordering::Relaxed) => (self.feed)(),
                Either::Second(()) => {}
            }
        }
    }

    fn ticks(&self) -> u32 {
        cortex_m::peripheral::DWT::cycle_count()
    }

    fn store(&mut self) -> &mut Store<F> {
        &mut self.store
    }
}

//! From the frame interrupt to the session.
//!
//! The interrupt puts each frame into a short queue and is done. While the session is busy for longer
//! than a frame (a calibration is checked, a page of flash erased) the queue fills; what does not fit is
//! lost, and the next scan that fits says how many. It never stops the instrument.
//!
//! The watchdog is fed here and nowhere else: by scans that have come all the way, or by a pause that was
//! asked for.

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
use crate::stack;

/// Frames that may wait: 1 ms at 4 kHz.
const QUEUE: usize = 4;
/// Microseconds by which an interrupt is late at most where nothing holds it up but critical sections.
const PROMPT: u32 = 8;

/// The interrupt's end of the queue.
pub struct Frames {
    queue: Channel<CriticalSectionRawMutex, Scan, QUEUE>,
    /// Frames that were lost since the last that was queued.
    lost: AtomicU32,
    /// The scan stands still on purpose.
    paused: AtomicBool,
    /// How long a frame takes, in microseconds.
    period: AtomicU32,
    /// When the last frame's interrupt came, in microseconds.
    last: AtomicU32,
    /// Frames read since power-up.
    count: AtomicU32,
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
            lost: AtomicU32::new(0),
            paused: AtomicBool::new(true),
            period: AtomicU32::new(0),
            last: AtomicU32::new(0),
            count: AtomicU32::new(0),
            cost: AtomicU32::new(0),
            worst: AtomicU32::new(0),
        }
    }

    /// The scan begins, from a standstill; a frame takes so many microseconds.
    pub fn begin(&self, period_us: u32) {
        self.period.store(period_us, Ordering::Relaxed);
        self.last.store(now_us(), Ordering::Relaxed);
        self.paused.store(false, Ordering::Relaxed);
    }

    /// The scan stands still on purpose, in the middle of a frame.
    pub fn halt(&self) {
        self.paused.store(true, Ordering::Relaxed);
        self.lose(1);
    }

    /// A frame's interrupt has come: when. Interrupts that were held up have become one; time tells how
    /// many there were, and of their frames all but the last are lost.
    pub fn tick(&self) -> Instant {
        let now = Instant::now();
        let us = now.as_micros() as u32;
        let since = us.wrapping_sub(self.last.load(Ordering::Relaxed));
        let period = self.period.load(Ordering::Relaxed).max(1);
        let frames = ((since + PROMPT) / period).max(1);
        // An interrupt that was held up says nothing of when its frame was complete; the ones before do.
        let late = since.saturating_sub(frames * period);
        let complete = if late > PROMPT { us.wrapping_sub(late) } else { us };
        self.last.store(complete, Ordering::Relaxed);
        self.lose(frames - 1);
        now
    }

    /// A frame has been read, that ended at `end`.
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

    /// Frames came that could not be read whole.
    pub fn lose(&self, frames: u32) {
        // From the frame's interrupt and what cannot be interrupted by it.
        let lost = self.lost.load(Ordering::Relaxed);
        self.lost.store(lost.saturating_add(frames), Ordering::Relaxed);
    }

    /// Frames that still wait are lost: they were read in another way than those to come.
    fn forget(&self) {
        while self.queue.try_receive().is_ok() {
            cortex_m::interrupt::free(|_| self.lose(1));
        }
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
}

fn now_us() -> u32 {
    Instant::now().as_micros() as u32
}

/// What a scanner asks of its chip.
pub trait Chip {
    /// Feeds the watchdog.
    fn feed(&self);

    /// How it scans.
    fn scan_settings(&self) -> ScanSettings;

    /// Scans differently from now on; the codes' full scale.
    ///
    /// # Errors
    /// The setting that is in the way; the scan goes on as it was.
    fn set_scan(&self, settings: &ScanSettings) -> Result<FullScale, Refusal>;
}

/// The session's end of the queue, and all else that a session asks of a board.
pub struct Scanner<C, F> {
    frames: &'static Frames,
    chip: C,
    store: Store<F>,
    started: Started,
    /// When to go to the bootloader, if it is asked for.
    leave: Option<Instant>,
}

/// How a board came to run.
pub struct Started {
    /// Why it was reset.
    pub reset: Reset,
    /// The panic before that, if it was one.
    pub panic: Option<String<MESSAGE>>,
}

impl<C: Chip, F> Scanner<C, F> {
    /// How often a pause feeds the watchdog.
    const PAUSE: Duration = Duration::from_millis(100);
    /// An answer leaves in that time.
    const FAREWELL: Duration = Duration::from_millis(200);

    /// Scans from `frames`; `store` survives power-off.
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
            // Waits without the scan, which every hand that it goes through would copy.
            match select(self.frames.queue.ready_to_receive(), Timer::after(Self::PAUSE)).await {
                Either::First(()) => {
                    self.chip.feed();
                    if let Ok(scan) = self.frames.queue.try_receive() {
                        return Some(scan);
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
}

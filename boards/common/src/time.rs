//! embassy-time driver on TIM2, which has 32 bits and the same address on both chips.
//!
//! The HAL's own driver uses 16 bits of it and loses time if an interrupt is delayed by 33 ms.
//! Erasing a flash sector delays all interrupts for up to a second. Here the counter counts
//! microseconds and continues meanwhile. Only each half turn must be counted, with up to 35 minutes
//! of delay.

use core::cell::RefCell;
use core::ptr::with_exposed_provenance_mut;
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};
use core::task::Waker;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time_driver::{Driver, TICK_HZ, time_driver_impl};
use embassy_time_queue_utils::Queue;

/// Register of TIM2 by its offset (RM0440 §30.5, RM0383 §13.4).
#[derive(Clone, Copy)]
struct Register(usize);

const CR1: Register = Register(0x00);
const DIER: Register = Register(0x0C);
const SR: Register = Register(0x10);
const EGR: Register = Register(0x14);
const CNT: Register = Register(0x24);
const PSC: Register = Register(0x28);
const ARR: Register = Register(0x2C);
const CCR1: Register = Register(0x34);
const CCR2: Register = Register(0x38);

/// Counter enable; with URS only an overflow counts as an update.
const CEN: u32 = 1 << 0;
const URS: u32 = 1 << 2;
/// Bits of both flags and enables: a whole turn, half a turn, the next deadline.
const UPDATE: u32 = 1 << 0;
const HALF_TURN: u32 = 1 << 1;
const DEADLINE: u32 = 1 << 2;

impl Register {
    fn place(self) -> *mut u32 {
        const TIM2: usize = 0x4000_0000;
        with_exposed_provenance_mut(TIM2 + self.0)
    }

    fn read(self) -> u32 {
        // SAFETY: a word register that always exists; reading it has no effect.
        unsafe { self.place().read_volatile() }
    }

    fn write(self, value: u32) {
        // SAFETY: a word register that only this driver uses.
        unsafe { self.place().write_volatile(value) }
    }
}

struct Tim2 {
    /// Half turns of the counter since [`start`].
    halves: AtomicU32,
    queue: Mutex<CriticalSectionRawMutex, RefCell<Queue>>,
}

time_driver_impl!(static DRIVER: Tim2 = Tim2 {
    halves: AtomicU32::new(0),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

/// Starts the clock on a timer in its reset state that counts `clock_hz`.
///
/// The timer's clock must be on, and the board's handler of TIM2 must call [`on_interrupt`].
pub fn start(clock_hz: u32) {
    PSC.write(clock_hz / TICK_HZ as u32 - 1);
    ARR.write(u32::MAX);
    CCR1.write(1 << 31);
    CR1.write(URS);
    // The update makes the prescaler effective.
    EGR.write(1);
    DIER.write(UPDATE | HALF_TURN | DEADLINE);
    CR1.write(URS | CEN);
}

/// Handles TIM2's interrupt.
pub fn on_interrupt() {
    let flags = SR.read();
    // Writing zero clears the flags that were read as set.
    SR.write(!flags);
    for turned in [UPDATE, HALF_TURN] {
        if flags & turned != 0 {
            // Nothing else writes this counter.
            let halves = DRIVER.halves.load(Ordering::Relaxed);
            DRIVER.halves.store(halves.wrapping_add(1), Ordering::Relaxed);
        }
    }
    DRIVER.queue.lock(|queue| DRIVER.wake(&mut queue.borrow_mut()));
}

impl Tim2 {
    /// Wakes the tasks that are due, and sets the compare value for the next one.
    ///
    /// A deadline more than a turn ahead causes an early look once a turn.
    fn wake(&self, queue: &mut Queue) {
        loop {
            let next = queue.next_expiration(self.now());
            CCR2.write(next as u32);
            if next > self.now() {
                return;
            }
        }
    }
}

impl Driver for Tim2 {
    fn now(&self) -> u64 {
        let halves = self.halves.load(Ordering::Relaxed);
        compiler_fence(Ordering::Acquire);
        // If the counter is in the other half than the count, it has just entered that half.
        let within = CNT.read() ^ (halves & 1) << 31;
        (u64::from(halves) << 31) + u64::from(within)
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        self.queue.lock(|queue| {
            let mut queue = queue.borrow_mut();
            if queue.schedule_wake(at, waker) {
                self.wake(&mut queue);
            }
        });
    }
}

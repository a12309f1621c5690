//! embassy-time on two counters of the same 25 MHz clock.
//!
//! SysTick runs free and is never reloaded by software, so time cannot drift; its interrupt only counts
//! wraps of the 24-bit counter (every 0.67 s). The CMSDK timer 0 counts down once to the next deadline.
//! An alarm may come up to one microsecond late, never early.

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Waker;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;
use critical_section::Mutex;
use embassy_time_driver::{Driver, TICK_HZ, time_driver_impl};
use embassy_time_queue_utils::Queue;

use crate::mmio::{CLOCK_HZ, Irq, Reg, unmask};

const TIMER0: usize = 0x4000_0000;
const CTRL: Reg = Reg::apb(TIMER0, 0x0);
const VALUE: Reg = Reg::apb(TIMER0, 0x4);
const RELOAD: Reg = Reg::apb(TIMER0, 0x8);
const INT_CLEAR: Reg = Reg::apb(TIMER0, 0xC);
const CTRL_ENABLE: u32 = 1 << 0;
const CTRL_INT: u32 = 1 << 3;

const CYCLES_PER_TICK: u64 = CLOCK_HZ as u64 / TICK_HZ;
const _: () = assert!(CYCLES_PER_TICK * TICK_HZ == CLOCK_HZ as u64);
const SYSTICK_BITS: u32 = 24;
const SYSTICK_MASK: u32 = (1 << SYSTICK_BITS) - 1;

/// SysTick wraps counted so far. With the 24 bits below it the clock has 56 bits: 91 years.
static WRAPS: AtomicU32 = AtomicU32::new(0);

struct TimeDriver {
    queue: Mutex<RefCell<Queue>>,
}

time_driver_impl!(static DRIVER: TimeDriver = TimeDriver {
    queue: Mutex::new(RefCell::new(Queue::new())),
});

/// Starts the clock. Call once, before the first task runs.
pub fn init(mut syst: SYST) {
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(SYSTICK_MASK);
    syst.clear_current();
    syst.enable_interrupt();
    syst.enable_counter();

    // With a reload of zero the timer stops at zero. Enabling it at zero would make QEMU complain.
    RELOAD.write(0);
    VALUE.write(u32::MAX);
    CTRL.write(CTRL_ENABLE | CTRL_INT);
    unmask(Irq::Timer0);
}

/// Core clock cycles since [`init`]: 40 ns each.
pub fn cycles() -> u64 {
    critical_section::with(|_| {
        loop {
            let pending = SCB::is_pendst_pending();
            let wraps = WRAPS.load(Ordering::Relaxed).wrapping_add(pending.into());
            let value = SYST::get_current();
            // Read again if the wrap fell between the two reads. Zero lasts one cycle in silicon, but
            // under QEMU until the wrap has been pended.
            if value != 0 && pending == SCB::is_pendst_pending() {
                let elapsed = value.wrapping_neg() & SYSTICK_MASK;
                return (u64::from(wraps) << SYSTICK_BITS) | u64::from(elapsed);
            }
        }
    })
}

#[exception]
fn SysTick() {
    WRAPS.fetch_add(1, Ordering::Relaxed);
}

/// Handler of [`Irq::Timer0`].
pub fn on_timer0() {
    INT_CLEAR.write(1);
    critical_section::with(|cs| DRIVER.rearm(&mut DRIVER.queue.borrow_ref_mut(cs)));
}

impl TimeDriver {
    /// Wakes what is due and sets the timer for what is due next.
    fn rearm(&self, queue: &mut Queue) {
        let now = self.now();
        let next = queue.next_expiration(now);
        // Farther away than the 32-bit timer reaches (171 s): come back then.
        let cycles = (next - now).saturating_mul(CYCLES_PER_TICK);
        VALUE.write(u32::try_from(cycles).unwrap_or(u32::MAX));
    }
}

impl Driver for TimeDriver {
    fn now(&self) -> u64 {
        cycles() / CYCLES_PER_TICK
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let mut queue = self.queue.borrow_ref_mut(cs);
            if queue.schedule_wake(at, waker) {
                self.rearm(&mut queue);
            }
        });
    }
}

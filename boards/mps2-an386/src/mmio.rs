//! Device registers and interrupt lines.

use core::ptr::{
    read_volatile, with_exposed_provenance, with_exposed_provenance_mut, write_volatile,
};
use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;

/// Clock of the core, SysTick and the APB peripherals in the AN386 image.
pub const CLOCK_HZ: u32 = 25_000_000;

/// A 32-bit register of an AN386 peripheral.
#[derive(Clone, Copy)]
pub struct Reg(usize);

impl Reg {
    /// The register `offset` bytes into the APB peripheral at `base`.
    pub const fn apb(base: usize, offset: usize) -> Self {
        // The CMSDK APB window holds peripherals only, so no access through a `Reg` can touch memory
        // that Rust owns.
        assert!(base >= 0x4000_0000 && base < 0x4001_0000 && base.is_multiple_of(0x1000));
        assert!(offset < 0x1000 && offset.is_multiple_of(4));
        Self(base + offset)
    }

    pub fn read(self) -> u32 {
        // SAFETY: `apb` admits only aligned addresses of device registers.
        unsafe { read_volatile(with_exposed_provenance(self.0)) }
    }

    pub fn write(self, value: u32) {
        // SAFETY: as in `read`; none of these peripherals can master the bus.
        unsafe { write_volatile(with_exposed_provenance_mut(self.0), value) }
    }

    /// Not atomic: call it where no interrupt can change the same register.
    pub fn modify(self, f: impl FnOnce(u32) -> u32) {
        self.write(f(self.read()));
    }
}

/// External interrupts in use, numbered as on AN385/AN386.
#[derive(Clone, Copy)]
#[repr(u16)]
pub enum Irq {
    Uart0Rx = 0,
    Uart0Tx = 1,
    Timer0 = 8,
    /// Nothing in the image drives this line; software pends it to run tasks.
    Executor = 31,
}

// SAFETY: the numbers are fixed by the enum and below the image's 32 lines.
unsafe impl InterruptNumber for Irq {
    fn number(self) -> u16 {
        self as u16
    }
}

/// Lets `irq` through. The drivers are ready for it: each calls this last.
pub fn unmask(irq: Irq) {
    // SAFETY: no critical section of this firmware relies on a masked line; they all mask with PRIMASK.
    unsafe { NVIC::unmask(irq) }
}

//! Ready flags of oscillators and PLLs, which follow their switches after a start-up time.

use super::time::Tick;

/// Switch and ready flag of an oscillator, and its start-up time.
#[derive(Clone, Copy, Debug)]
pub struct Oscillator {
    /// Offset of the register.
    pub register: u32,
    /// Bit that switches it on; the ready flag is the bit at `ready`.
    pub on: u32,
    /// Bit of the ready flag.
    pub ready: u32,
    /// Start-up time.
    pub start: Tick,
}

/// Oscillators of a chip.
#[derive(Clone, Debug)]
pub struct Oscillators {
    all: &'static [Oscillator],
    /// Time at which each is ready; `None` if it is off.
    ready: Vec<Option<Tick>>,
}

impl Oscillators {
    /// Oscillators after a reset, when the one at `running` is ready and all others are off.
    pub fn new(all: &'static [Oscillator], running: usize) -> Self {
        Self { all, ready: (0..all.len()).map(|i| (i == running).then_some(0)).collect() }
    }

    /// Whether an oscillator is on.
    pub fn is_on(&self, i: usize) -> bool {
        self.ready[i].is_some()
    }

    /// Whether an oscillator is on and its start-up time is over.
    pub fn is_ready(&self, i: usize, now: Tick) -> bool {
        self.ready[i].is_some_and(|at| at <= now)
    }

    /// Value of the register at `offset` with the present ready flags.
    pub fn read(&self, offset: u32, value: u32, now: Tick) -> u32 {
        let its = self.all.iter().enumerate().filter(|(_, one)| one.register == offset);
        its.fold(value, |value, (i, one)| {
            value & !(1 << one.ready) | u32::from(self.is_ready(i, now)) << one.ready
        })
    }

    /// Switches the oscillators of the register at `offset` as `value` says.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick) {
        for (one, ready) in self.all.iter().zip(&mut self.ready) {
            if one.register == offset {
                let on = value >> one.on & 1 == 1;
                *ready = on.then(|| ready.unwrap_or(now + one.start));
            }
        }
    }
}

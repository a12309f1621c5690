//! Virtual time.

/// Ticks since power-up. A tick is the longest time of which each clock's period is a multiple.
pub type Tick = u64;

/// Ticks a second: the least common multiple of 170 MHz, 96 MHz, 16 MHz and 48 MHz.
pub const HZ: u64 = 8_160_000_000;

/// Ticks of so many microseconds.
pub const fn micros(us: u64) -> Tick {
    us * (HZ / 1_000_000)
}

/// The period of a clock, where it is whole ticks.
pub fn period(hz: u64) -> Option<Tick> {
    (hz > 0 && HZ.is_multiple_of(hz)).then(|| HZ / hz)
}

/// In seconds, for people.
pub fn seconds(at: Tick) -> f64 {
    at as f64 / HZ as f64
}

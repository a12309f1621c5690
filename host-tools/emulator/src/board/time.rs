//! Virtual time in ticks.

/// Ticks since power-up; every clock's period is a whole number of ticks.
pub type Tick = u64;

/// Ticks per second: the least common multiple of 170 MHz, 96 MHz, 16 MHz and 48 MHz.
pub const HZ: u64 = 8_160_000_000;

/// Ticks in `us` microseconds.
pub const fn micros(us: u64) -> Tick {
    us * (HZ / 1_000_000)
}

/// Ticks in `ns` nanoseconds, rounded up.
pub const fn nanos(ns: u64) -> Tick {
    (ns * (HZ / 1_000_000)).div_ceil(1_000)
}

/// Period of a clock of `hz`; `None` if it is no whole number of ticks.
pub fn period(hz: u64) -> Option<Tick> {
    (hz > 0 && HZ.is_multiple_of(hz)).then(|| HZ / hz)
}

/// Fails if an ADC's input is sampled for a shorter time than it needs.
pub fn check_sampling(input: u32, time: Tick, least: Tick) -> super::Outcome {
    if time >= least {
        return Ok(());
    }
    let [time, least] = [time, least].map(|ticks| ticks * 1_000 / micros(1));
    Err(format!("input {input} is sampled for {time} ns, and its source needs {least} ns"))
}

/// Ticks in seconds.
pub fn seconds(at: Tick) -> f64 {
    at as f64 / HZ as f64
}

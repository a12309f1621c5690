//! Up-counting timer (RM0440 §29, §30; RM0383 §12, §13) with update, compare, DMA requests and
//! triggers.

use super::time::Tick;
use super::{Outcome, UNMODELLED};

/// Number of compare channels; 5 and 6 have neither flag nor request here.
const CHANNELS: usize = 6;
const FLAGGED: usize = 4;
/// OCxM: output frozen.
const FROZEN: u32 = 0;
/// OCxM: output inactive below the compare value, active from it on.
const PWM2: u32 = 7;

/// Effects of one count.
#[derive(Clone, Copy, Debug, Default)]
pub struct Edges {
    /// DMA requests of CCx.
    pub compare_dma: [bool; FLAGGED],
    /// Whether TRGO rises.
    pub trgo: bool,
    /// Whether TRGO2 rises.
    pub trgo2: bool,
    /// Rising outputs of driven channels.
    pub outputs: [bool; FLAGGED],
}

/// Up-counting timer.
pub struct Timer {
    cr1: u32,
    cr2: u32,
    dier: u32,
    sr: u32,
    ccmr: [u32; 3],
    ccer: u32,
    bdtr: u32,
    psc: u32,
    arr: u32,
    ccr: [u32; CHANNELS],
    /// Effective values; written ones above may wait for the next update.
    active: Active,
    /// Time at which the running counter was zero, or would have been.
    origin: Tick,
    /// Count while the timer is stopped.
    held: u32,
    /// Time up to which everything has happened.
    cursor: Tick,
    /// Time of the first start.
    started: Option<Tick>,
    /// Period of the timer's clock before the prescaler.
    clock: Tick,
    /// Highest possible count.
    top: u32,
    /// Number of compare channels.
    channels: usize,
}

#[derive(Clone, Copy)]
struct Active {
    psc: u32,
    arr: u32,
    ccr: [u32; CHANNELS],
}

impl Timer {
    /// Timer of 16 or 32 bits with `channels` compare channels.
    pub fn new(bits: u32, channels: usize) -> Self {
        Self::counting_to(u32::MAX >> (32 - bits), channels)
    }

    /// Timer of the same kind after a reset.
    pub fn fresh(&self) -> Self {
        Self::counting_to(self.top, self.channels)
    }

    fn counting_to(top: u32, channels: usize) -> Self {
        let active = Active { psc: 0, arr: top, ccr: [0; CHANNELS] };
        Self {
            cr1: 0,
            cr2: 0,
            dier: 0,
            sr: 0,
            ccmr: [0; 3],
            ccer: 0,
            bdtr: 0,
            psc: 0,
            arr: top,
            ccr: [0; CHANNELS],
            active,
            origin: 0,
            held: 0,
            cursor: 0,
            started: None,
            clock: 1,
            top,
            channels,
        }
    }

    /// Whether the counter runs.
    pub fn is_running(&self) -> bool {
        self.cr1 & 1 == 1
    }

    /// Time of the first start.
    pub fn started(&self) -> Option<Tick> {
        self.started
    }

    /// Ticks of one count.
    fn step(&self) -> Tick {
        self.clock * (Tick::from(self.active.psc) + 1)
    }

    fn count(&self, now: Tick) -> u32 {
        if self.is_running() { ((now - self.origin) / self.step()) as u32 } else { self.held }
    }

    fn at_count(&self, count: u32) -> Tick {
        self.origin + Tick::from(count) * self.step()
    }

    /// Count before the next zero: a counter that is already beyond ARR goes on to the top.
    fn last(&self) -> u32 {
        let passed = (self.cursor.saturating_sub(self.origin)) / self.step();
        if passed > Tick::from(self.active.arr) { self.top } else { self.active.arr }
    }

    fn mode(&self, channel: usize) -> u32 {
        let half = self.ccmr[channel / 2] >> (8 * (channel % 2));
        half >> 4 & 7 | half >> 13 & 8
    }

    /// Reference signal of a PWM channel's output; false in other modes.
    pub fn output(&self, channel: usize, now: Tick) -> bool {
        self.mode(channel) == PWM2 && self.count(now) >= self.active.ccr[channel]
    }

    /// Whether a channel's output is enabled, and MOE is set.
    pub fn is_driven(&self, channel: usize) -> bool {
        self.ccer >> (4 * channel) & 1 == 1 && self.bdtr >> 15 & 1 == 1
    }

    /// Whether the timer requests an interrupt.
    pub fn interrupt(&self) -> bool {
        self.sr & self.dier & 0x1f != 0
    }

    /// Time from zero to the first compare match, and to zero again.
    pub fn spans(&self) -> [Tick; 2] {
        [self.active.ccr[0], self.active.arr].map(|count| Tick::from(count) * self.step())
    }

    /// Time of the next compare match or update.
    pub fn next(&self) -> Option<Tick> {
        if !self.is_running() {
            return None;
        }
        let last = self.last();
        let matches = self.active.ccr.iter().filter(|ccr| **ccr <= last);
        let compare = matches.map(|ccr| self.at_count(*ccr)).filter(|at| *at >= self.cursor).min();
        let update = self.at_count(last) + self.step();
        Some(compare.map_or(update, |compare| compare.min(update)))
    }

    /// Runs the compare match or update at [`Self::next`].
    pub fn advance(&mut self, now: Tick) -> Edges {
        let mut edges = Edges::default();
        let (count, last) = (self.count(now), self.last());
        if now >= self.at_count(last) + self.step() {
            (self.origin, self.cursor) = (now, now);
            // Beyond ARR there is no update, but only the counter's end.
            if last == self.active.arr {
                self.update();
            }
            return edges;
        }
        self.cursor = now + 1;
        for channel in (0..CHANNELS).filter(|channel| self.active.ccr[*channel] == count) {
            if channel < FLAGGED {
                self.sr |= 2 << channel;
                edges.compare_dma[channel] = self.dier >> (9 + channel) & 1 == 1;
            }
            let rises = self.mode(channel) == PWM2;
            if channel < FLAGGED {
                edges.outputs[channel] = rises && self.is_driven(channel);
            }
            edges.trgo |= rises && self.cr2 >> 4 & 7 == 4 + channel as u32;
            edges.trgo2 |= rises && self.cr2 >> 20 & 0xf == 4 + channel as u32;
        }
        edges
    }

    fn update(&mut self) {
        self.sr |= 1;
        self.active = Active { psc: self.psc, arr: self.arr, ccr: self.ccr };
    }

    /// Whether the timer has the register at `offset`; channels 5 and 6 add some.
    fn has(&self, offset: u32) -> bool {
        self.channels == CHANNELS || offset < 0x48
    }

    /// Reads the register at `offset` at the time `now`.
    pub fn read(&self, offset: u32, now: Tick) -> Outcome<u32> {
        Ok(match offset {
            _ if !self.has(offset) => return Err(UNMODELLED.into()),
            0x00 => self.cr1,
            0x04 => self.cr2,
            0x0c => self.dier,
            0x10 => self.sr,
            0x18 => self.ccmr[0],
            0x1c => self.ccmr[1],
            0x20 => self.ccer,
            0x24 => self.count(now),
            0x28 => self.psc,
            0x2c => self.arr,
            0x34..=0x40 => self.ccr[(offset as usize - 0x34) / 4],
            0x44 => self.bdtr,
            0x48 => self.ccr[4],
            0x4c => self.ccr[5],
            0x50 => self.ccmr[2],
            _ => return Err(UNMODELLED.into()),
        })
    }

    /// Writes the register at `offset`; `clock` is the period of the timer's clock.
    pub fn write(&mut self, offset: u32, value: u32, now: Tick, clock: Tick) -> Outcome {
        match offset {
            _ if !self.has(offset) => return Err(UNMODELLED.into()),
            0x00 => return self.control(value, now, clock),
            0x04 => self.cr2 = value,
            // BIE, TIE and the requests of update, trigger and commutation are not modelled.
            0x0c if value & !0x1e1f != 0 => return Err(UNMODELLED.into()),
            0x0c => self.dier = value,
            0x10 => self.sr &= value,
            0x14 if value != 1 => return Err(UNMODELLED.into()),
            0x14 => {
                // Update generation: restarts at zero with all written values; with URS without the
                // flag.
                let flag = self.sr & 1;
                self.update();
                if self.cr1 & 1 << 2 != 0 {
                    self.sr = self.sr & !1 | flag;
                }
                (self.held, self.origin, self.cursor) = (0, now, now);
            }
            0x18 => self.ccmr[0] = value,
            0x1c => self.ccmr[1] = value,
            0x20 => self.ccer = value,
            0x24 => {
                self.held = value & self.top;
                let origin = now.checked_sub(Tick::from(self.held) * self.step());
                self.origin = origin.ok_or("count from before power-up")?;
                self.cursor = now;
            }
            0x28 => self.psc = value & 0xffff,
            0x2c => {
                self.arr = value & self.top;
                // ARPE
                if self.cr1 & 1 << 7 == 0 {
                    self.active.arr = self.arr;
                    self.cursor = self.cursor.max(now);
                }
            }
            0x34..=0x40 => self.compare((offset as usize - 0x34) / 4, value, now),
            0x44 => self.bdtr = value,
            0x48 => self.compare(4, value, now),
            0x4c => self.compare(5, value, now),
            0x50 => self.ccmr[2] = value,
            _ => return Err(UNMODELLED.into()),
        }
        Ok(())
    }

    fn compare(&mut self, channel: usize, value: u32, now: Tick) {
        self.ccr[channel] = value & self.top;
        // OCxPE
        if self.ccmr[channel / 2] >> (8 * (channel % 2) + 3) & 1 == 0 {
            self.active.ccr[channel] = self.ccr[channel];
            // Matches earlier in this turn do not repeat.
            self.cursor = self.cursor.max(now);
        }
    }

    fn control(&mut self, value: u32, now: Tick, clock: Tick) -> Outcome {
        // Only CEN, URS and ARPE: no one-pulse, downward or centre-aligned mode.
        if value & !0b1000_0101 != 0 {
            return Err(UNMODELLED.into());
        }
        let started = !self.is_running() && value & 1 == 1;
        if self.is_running() && value & 1 == 0 {
            self.held = self.count(now);
        }
        self.cr1 = value;
        if started {
            self.clock = clock;
            self.started.get_or_insert(now);
            let origin = now.checked_sub(Tick::from(self.held) * self.step());
            self.origin = origin.ok_or("count from before power-up")?;
            self.cursor = now;
            for channel in 0..CHANNELS {
                if ![FROZEN, PWM2].contains(&self.mode(channel)) {
                    return Err(format!(
                        "output mode {} of channel {}, which is not modelled",
                        self.mode(channel),
                        channel + 1
                    ));
                }
            }
            for (name, select) in [("MMS", self.cr2 >> 4 & 7), ("MMS2", self.cr2 >> 20 & 0xf)] {
                if select != 0 && !(4..10).contains(&select) {
                    return Err(format!("{name} = {select}, which is not modelled"));
                }
            }
        }
        Ok(())
    }
}

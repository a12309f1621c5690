//! Ticks kept for a page that opens or lags: two minutes, the longest window of its charts.

use std::collections::VecDeque;

/// Device time of a tick, in microseconds. By arrival, a stalled host would draw a wedge.
pub(super) const TICK_US: u64 = 5_000;
/// Ticks kept as they came: 30 s.
pub(super) const FINE: usize = 6_000;
/// Ticks merged into one after that: one every 20 ms, some six for each pixel of a long window.
const MERGED: u64 = 4;
/// Merged ticks kept: 90 s. Together they take a quarter of the memory of two minutes of fine ones.
pub(super) const MERGED_KEPT: usize = 4_500;

/// Minimum and maximum of a column.
pub(super) type Range = Option<(f32, f32)>;

/// Rows of one interval of device time.
pub(super) struct Tick {
    /// Number of the interval.
    pub(super) interval: u64,
    /// Device time of the last row, in seconds.
    pub(super) time: f64,
    pub(super) rows: u32,
    /// Status bits that were set in any row.
    pub(super) status: u32,
    /// Minimum and maximum of each ranged column.
    pub(super) range: Vec<Range>,
}

impl Tick {
    /// Adds the rows of the following tick.
    fn merge(&mut self, next: &Self) {
        (self.interval, self.time) = (next.interval, next.time);
        self.rows += next.rows;
        self.status |= next.status;
        for (range, next) in self.range.iter_mut().zip(&next.range) {
            widen(range, *next);
        }
    }
}

/// Widens a range by another.
pub(super) fn widen(range: &mut Range, by: Range) {
    let Some((low, high)) = by else { return };
    let (least, most) = range.unwrap_or((low, high));
    *range = Some((least.min(low), most.max(high)));
}

/// Last ticks, each with its number; a merged one has the number of its last.
#[derive(Default)]
pub(super) struct History {
    merged: VecDeque<(u64, Tick)>,
    fine: VecDeque<(u64, Tick)>,
    /// Number of ticks pushed so far.
    count: u64,
}

impl History {
    /// Adds a tick; the oldest ones are merged, and discarded later.
    pub(super) fn push(&mut self, tick: Tick) {
        self.fine.push_back((self.count, tick));
        self.count += 1;
        if self.fine.len() > FINE
            && let Some((number, old)) = self.fine.pop_front()
        {
            self.retire(number, old);
        }
    }

    fn retire(&mut self, number: u64, tick: Tick) {
        match self.merged.back_mut() {
            // Ticks apart stay apart, so that a gap in the stream remains one.
            Some((last, into)) if into.interval / MERGED == tick.interval / MERGED => {
                *last = number;
                into.merge(&tick);
            }
            _ => {
                if self.merged.len() == MERGED_KEPT {
                    self.merged.pop_front();
                }
                self.merged.push_back((number, tick));
            }
        }
    }

    /// Returns at most `most` ticks from the number `seen` on, and the number that follows them.
    pub(super) fn since(&self, seen: u64, most: usize) -> (Vec<&Tick>, u64) {
        let after = |ticks: &VecDeque<(u64, Tick)>| ticks.partition_point(|(at, _)| *at < seen);
        let merged = self.merged.iter().skip(after(&self.merged));
        let ticks = merged.chain(self.fine.iter().skip(after(&self.fine))).take(most);
        let ticks: Vec<_> = ticks.collect();
        let next = ticks.last().map_or(seen, |(number, _)| number + 1);
        (ticks.into_iter().map(|(_, tick)| tick).collect(), next)
    }

    pub(super) fn last(&self) -> Option<&Tick> {
        self.fine.back().map(|(_, tick)| tick)
    }

    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut Tick> {
        self.merged.iter_mut().chain(&mut self.fine).map(|(_, tick)| tick)
    }
}

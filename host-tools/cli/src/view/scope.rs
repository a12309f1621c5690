//! State of one finger on the page: takes rows at any rate, returns ticks.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use taxel_files::frames::{Cell, Column, Kind, reason};

use crate::view::spectrum::Spectrum;

/// Interval between ticks: one frame of a 60 Hz screen.
const TICK: Duration = Duration::from_micros(16_667);
/// Ticks kept for a page that opens or lags: 60 s.
const KEPT: usize = 3600;

/// Rows between two updates of the screen.
struct Tick {
    /// Device time of the last row, in seconds.
    time: f64,
    rows: u32,
    /// Status bits that were set in any row.
    status: u32,
    /// Minimum and maximum of each measured column.
    range: Vec<Option<(f32, f32)>>,
}

/// Counts, round trip and clock of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Link {
    /// Rows received.
    pub(crate) frames: u64,
    /// Rows lost.
    pub(crate) lost: u64,
    /// Last round-trip time.
    pub(crate) echo: Option<Duration>,
    /// Device clock: rate over the host's in ppm, once known, and error bound on this host.
    pub(crate) clock: Option<(Option<f64>, Duration)>,
}

/// State of one finger.
pub(crate) struct Scope {
    columns: Vec<Column>,
    measured: Vec<usize>,
    status_at: Option<usize>,
    time_at: Option<usize>,
    seq_at: Option<usize>,
    /// Number of restarts; a page discards what it has of an earlier number.
    epoch: u64,
    latest: Vec<Cell>,
    open: Option<(Instant, Tick)>,
    ticks: VecDeque<Tick>,
    /// Number of ticks closed so far.
    count: u64,
    channel: Option<String>,
    spectrum: Spectrum,
    rate: Rate,
    pub(crate) link: Link,
    /// Identity and settings of the finger, for the page.
    pub(crate) facts: Value,
    /// Reason for a missing stream.
    pub(crate) trouble: Option<String>,
    /// Reason for the end of a recording, or another notice.
    pub(crate) mishap: Option<String>,
    /// Name of the file being recorded.
    pub(crate) recording: Option<String>,
    /// Position of a playback in seconds, its length once known, and whether it runs.
    pub(crate) playback: Option<(f64, Option<f64>, bool)>,
}

impl Scope {
    pub(crate) fn new() -> Self {
        Self {
            columns: Vec::new(),
            measured: Vec::new(),
            status_at: None,
            time_at: None,
            seq_at: None,
            epoch: 0,
            latest: Vec::new(),
            open: None,
            ticks: VecDeque::new(),
            count: 0,
            channel: None,
            spectrum: Spectrum::default(),
            rate: Rate::default(),
            link: Link::default(),
            facts: json!({}),
            trouble: None,
            mishap: None,
            recording: None,
            playback: None,
        }
    }

    /// Sets the columns of the following rows.
    pub(crate) fn set_columns(&mut self, columns: Vec<Column>) {
        let find = |name| columns.iter().position(|column| column.name == name);
        (self.time_at, self.seq_at, self.status_at) = (find("t_us"), find("seq"), find("status"));
        let measured = columns.iter().enumerate().filter(|(_, c)| c.kind == Kind::Measured);
        self.measured = measured.map(|(at, _)| at).collect();
        self.latest = vec![Cell::Empty; columns.len()];
        self.columns = columns;
        self.restart();
    }

    /// Discards all ticks, after a seek or when the finger has restarted.
    pub(crate) fn restart(&mut self) {
        self.epoch += 1;
        self.open = None;
        self.ticks.clear();
        self.count = 0;
        self.spectrum.clear();
        self.rate = Rate::default();
    }

    /// Selects the channel of the spectrum.
    pub(crate) fn set_channel(&mut self, name: &str) {
        self.channel = Some(name.to_owned());
        self.spectrum.clear();
    }

    /// Adds a row, received at `at`.
    pub(crate) fn push(&mut self, row: &[Cell], at: Instant) {
        let whole = |at: Option<usize>| match at.and_then(|at| row.get(at)) {
            Some(Cell::Whole(value)) => *value,
            _ => 0,
        };
        let time_us = whole(self.time_at);
        let time = time_us as f64 * 1e-6;
        if self.ticks.back().is_some_and(|last| time < last.time) {
            // The finger has restarted.
            self.restart();
        }
        self.rate.push(time);
        if let Some((opened, _)) = &self.open
            && at.saturating_duration_since(*opened) >= TICK
        {
            self.close();
        }
        let (_, tick) = self.open.get_or_insert_with(|| {
            let range = vec![None; self.measured.len()];
            (at, Tick { time, rows: 0, status: 0, range })
        });
        tick.time = time;
        tick.rows += 1;
        tick.status |= whole(self.status_at) as u32;
        for (range, at) in tick.range.iter_mut().zip(&self.measured) {
            if let Some(Cell::Real(value)) = row.get(*at) {
                let (low, high) = range.unwrap_or((*value, *value));
                *range = Some((low.min(*value), high.max(*value)));
            }
        }
        let channel = self.channel.as_ref();
        let channel = channel.and_then(|name| self.columns.iter().position(|c| c.name == *name));
        if let Some(at) = channel {
            let value = match row.get(at) {
                Some(Cell::Real(value)) => Some(*value),
                Some(Cell::Whole(value)) => Some(*value as f32),
                _ => None,
            };
            self.spectrum.push(whole(self.seq_at), time_us, value);
        }
        self.latest.clear();
        self.latest.extend_from_slice(row);
    }

    /// Closes the present tick early, because no row follows.
    pub(crate) fn settle(&mut self) {
        self.close();
    }

    fn close(&mut self) {
        let Some((_, tick)) = self.open.take() else { return };
        if self.ticks.len() == KEPT {
            self.ticks.pop_front();
        }
        self.ticks.push_back(tick);
        self.count += 1;
    }

    /// Returns the changes since `seen`, and updates `seen`.
    pub(crate) fn news(&mut self, seen: &mut Seen) -> Value {
        if self.open.as_ref().is_some_and(|(opened, _)| opened.elapsed() >= TICK) {
            self.close();
        }
        let mut news = json!({
            "latest": self.latest.iter().map(cell).collect::<Vec<_>>(),
            "rate": self.rate.hertz(),
            "frames": self.link.frames,
            "lost": self.link.lost,
            "echo_ms": self.link.echo.map(|echo| echo.as_secs_f64() * 1e3),
            "clock": self.link.clock.map(|(ppm, error)| json!([ppm, error.as_secs_f64() * 1e3])),
            "trouble": self.trouble.as_ref().or(self.mishap.as_ref()),
            "recording": self.recording,
            "playback": self.playback.map(|(at, of, runs)| json!({ "at": at, "of": of, "runs": runs })),
        });
        if seen.epoch != Some(self.epoch) {
            *seen = Seen { epoch: Some(self.epoch), ..Seen::default() };
            news["columns"] = self
                .columns
                .iter()
                .map(|c| json!({ "name": c.name, "measured": c.kind == Kind::Measured }))
                .collect();
        }
        if seen.facts.as_ref() != Some(&self.facts) {
            seen.facts = Some(self.facts.clone());
            news["facts"] = self.facts.clone();
        }
        let first = self.count - self.ticks.len() as u64;
        let skip = seen.ticks.saturating_sub(first) as usize;
        let ticks = || self.ticks.iter().skip(skip);
        seen.ticks = self.count;
        news["ticks"] = json!({
            "time": ticks().map(|tick| tick.time).collect::<Vec<_>>(),
            "rows": ticks().map(|tick| tick.rows).collect::<Vec<_>>(),
            "status": ticks().map(|tick| tick.status).collect::<Vec<_>>(),
            "low": ticks().map(|tick| ends(tick, |(low, _)| low)).collect::<Vec<_>>(),
            "high": ticks().map(|tick| ends(tick, |(_, high)| high)).collect::<Vec<_>>(),
        });
        news
    }

    /// Returns the spectrum of the selected channel, or the share of samples collected.
    pub(crate) fn spectrum(&self) -> Value {
        let lines = self.spectrum.lines();
        json!({
            "channel": self.channel,
            "filled": self.spectrum.filled(),
            "step_hz": lines.as_ref().map(|(step, _)| step),
            "lines": lines.map(|(_, lines)| lines),
        })
    }
}

/// Part of the state that a page has already shown.
#[derive(Default)]
pub(crate) struct Seen {
    epoch: Option<u64>,
    ticks: u64,
    facts: Option<Value>,
}

fn ends(tick: &Tick, end: fn((f32, f32)) -> f32) -> Vec<Option<f32>> {
    tick.range.iter().map(|range| range.map(end)).collect()
}

/// Converts a cell to JSON: a number, a reason, or null.
fn cell(cell: &Cell) -> Value {
    match cell {
        Cell::Empty => Value::Null,
        Cell::Whole(value) => json!(value),
        Cell::Real(value) => json!(value),
        Cell::Withheld(why) => json!(reason(*why)),
    }
}

/// Rate of rows in device time, over the last second.
#[derive(Default)]
struct Rate {
    times: VecDeque<f64>,
}

impl Rate {
    fn push(&mut self, time: f64) {
        self.times.push_back(time);
        while self.times.front().is_some_and(|first| time - first > 1.0 || *first > time) {
            self.times.pop_front();
        }
    }

    fn hertz(&self) -> Option<f64> {
        let span = self.times.back()? - self.times.front()?;
        (span > 0.0).then(|| (self.times.len() - 1) as f64 / span)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scope() -> Scope {
        let column = |name: &str, kind| Column { name: name.to_owned(), kind };
        let mut scope = Scope::new();
        scope.set_columns(vec![
            column("t_us", Kind::Whole),
            column("seq", Kind::Whole),
            column("status", Kind::Whole),
            column("fz_n", Kind::Measured),
        ]);
        scope
    }

    /// Pushes a stream of 4 kHz with one outlier at `peak`.
    fn stream(scope: &mut Scope, rows: u64, peak: u64) {
        let start = Instant::now().checked_sub(Duration::from_micros(rows * 250)).unwrap();
        for i in 0..rows {
            let force = if i == peak { 9.5 } else { 1.0 };
            let status = u64::from(i == peak) << 5;
            let row =
                [Cell::Whole(i * 250), Cell::Whole(i), Cell::Whole(status), Cell::Real(force)];
            scope.push(&row, start + Duration::from_micros(i * 250));
        }
    }

    #[test]
    fn ticks_keep_every_peak_and_flag() {
        let mut scope = scope();
        stream(&mut scope, 4000, 1234);
        let news = scope.news(&mut Seen::default());
        let high: Vec<f64> = news["ticks"]["high"]
            .as_array()
            .unwrap()
            .iter()
            .map(|tick| tick[0].as_f64().unwrap())
            .collect();
        assert!((58..=60).contains(&high.len()), "{}", high.len());
        assert_eq!(high.iter().filter(|high| **high == 9.5).count(), 1);
        let status = news["ticks"]["status"].as_array().unwrap();
        assert_eq!(status.iter().filter(|bits| **bits == 32).count(), 1);
        assert!((news["rate"].as_f64().unwrap() - 4000.0).abs() < 1.0);
    }

    #[test]
    fn slow_page_gets_every_tick_once() {
        let mut scope = scope();
        let mut seen = Seen::default();
        stream(&mut scope, 2000, 0);
        let mut told = |seen: &mut Seen| {
            let news = scope.news(seen);
            let ends = news["ticks"]["time"].as_array().unwrap().iter();
            let ends: Vec<f64> = ends.map(|time| time.as_f64().unwrap()).collect();
            let rows = news["ticks"]["rows"].as_array().unwrap().iter();
            (ends, rows.map(|rows| rows.as_u64().unwrap()).sum::<u64>())
        };
        let (mut ends, first) = told(&mut seen);
        assert!(ends.len() > 20);
        std::thread::sleep(TICK);
        // The last tick, if it was still open then.
        let (last, rest) = told(&mut seen);
        ends.extend(last);
        assert_eq!(first + rest, 2000);
        assert!(ends.windows(2).all(|pair| pair[0] < pair[1]), "{ends:?}");
        let news = scope.news(&mut seen);
        assert_eq!(news["ticks"]["time"], json!([]));
        assert_eq!(news.get("columns"), None);
    }

    #[test]
    fn missing_value_is_shown_as_its_reason() {
        let mut scope = scope();
        let why = taxel::measured::NoValue::NoContact;
        let row = [Cell::Whole(0), Cell::Whole(0), Cell::Whole(0), Cell::Withheld(why)];
        scope.push(&row, Instant::now());
        std::thread::sleep(TICK);
        let news = scope.news(&mut Seen::default());
        assert_eq!(news["latest"][3], "no contact");
        assert_eq!(news["ticks"]["low"], json!([[null]]));
    }
}

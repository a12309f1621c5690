//! State of one finger on the page: takes rows at any rate, returns ticks.

mod history;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use taxel_files::frames::{Cell, Column, Kind, reason};

use crate::view::spectrum::Spectrum;
use history::{History, TICK_US, Tick, widen};

/// Time after its last row when a tick is closed, because no row may follow.
const SETTLED: Duration = Duration::from_millis(50);
/// Ticks in one message. A page that opens gets the earlier ones in several.
const MOST: usize = 500;

/// Length of the force, a column that the page has and the frame does not.
const FORCE: &str = "f_n";
/// Components of that force.
const COMPONENTS: [&str; 3] = ["fx_n", "fy_n", "fz_n"];

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

/// Recording in progress.
#[derive(Clone, Debug)]
pub(crate) struct Recorded {
    pub(crate) name: String,
    pub(crate) begun: Instant,
    pub(crate) rows: u64,
    pub(crate) bytes: u64,
}

/// State of one finger.
pub(crate) struct Scope {
    columns: Vec<Column>,
    /// Number of changes of the columns.
    layout: u64,
    /// Columns whose minimum and maximum are in the ticks: measured ones and codes.
    ranged: Vec<usize>,
    status_at: Option<usize>,
    time_at: Option<usize>,
    seq_at: Option<usize>,
    /// Components of the force, if the rows have them all.
    force_at: Option<[usize; 3]>,
    /// Number of restarts; a page discards what it has of an earlier number.
    epoch: u64,
    latest: Vec<Cell>,
    /// Arrival of the last row.
    heard: Option<Instant>,
    open: Option<Tick>,
    ticks: History,
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
    /// File being recorded.
    pub(crate) recording: Option<Recorded>,
    /// Result of the last self-test; null before the first.
    pub(crate) self_test: Value,
    /// Position of a playback in seconds, its length once known, and whether it runs.
    pub(crate) playback: Option<(f64, Option<f64>, bool)>,
}

impl Scope {
    pub(crate) fn new() -> Self {
        Self {
            columns: Vec::new(),
            layout: 0,
            ranged: Vec::new(),
            status_at: None,
            time_at: None,
            seq_at: None,
            force_at: None,
            epoch: 0,
            latest: Vec::new(),
            heard: None,
            open: None,
            ticks: History::default(),
            channel: None,
            spectrum: Spectrum::default(),
            rate: Rate::default(),
            link: Link::default(),
            facts: json!({}),
            trouble: None,
            mishap: None,
            recording: None,
            self_test: Value::Null,
            playback: None,
        }
    }

    /// Sets the columns of the following rows. Ticks keep the columns that remain.
    pub(crate) fn set_columns(&mut self, mut columns: Vec<Column>) {
        let force = COMPONENTS.map(|name| columns.iter().position(|column| column.name == name));
        self.force_at = match force {
            [Some(x), Some(y), Some(z)] => Some([x, y, z]),
            _ => None,
        };
        if self.force_at.is_some() {
            columns.push(Column { name: FORCE.to_owned(), kind: Kind::Measured });
        }
        let find = |name| columns.iter().position(|column| column.name == name);
        (self.time_at, self.seq_at, self.status_at) = (find("t_us"), find("seq"), find("status"));
        let ranged = columns.iter().enumerate().filter(|(_, column)| is_ranged(column));
        let ranged: Vec<usize> = ranged.map(|(at, _)| at).collect();
        let place = |name: &str| self.ranged.iter().position(|at| self.columns[*at].name == name);
        let places: Vec<_> = ranged.iter().map(|at| place(&columns[*at].name)).collect();
        for tick in self.ticks.iter_mut().chain(&mut self.open) {
            let range = |place: &Option<usize>| tick.range.get((*place)?).copied().flatten();
            tick.range = places.iter().map(range).collect();
        }
        self.ranged = ranged;
        self.latest = vec![Cell::Empty; columns.len()];
        self.columns = columns;
        self.layout += 1;
    }

    /// Discards all ticks, after a seek or when the finger has restarted.
    pub(crate) fn restart(&mut self) {
        self.epoch += 1;
        self.open = None;
        self.ticks = History::default();
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
        if self.ticks.last().is_some_and(|last| time < last.time) {
            // The finger has restarted.
            self.restart();
        }
        self.latest.clear();
        self.latest.extend_from_slice(row);
        if let Some(force) = self.force_at {
            let cell = |at| row.get(at).copied().unwrap_or(Cell::Empty);
            self.latest.push(length(force.map(cell)));
        }
        self.rate.push(time);
        self.heard = Some(at);
        let interval = time_us / TICK_US;
        if self.open.as_ref().is_some_and(|open| open.interval != interval) {
            self.close();
        }
        let tick = self.open.get_or_insert_with(|| {
            let range = vec![None; self.ranged.len()];
            Tick { interval, time, rows: 0, status: 0, range }
        });
        tick.time = time;
        tick.rows += 1;
        tick.status |= whole(self.status_at) as u32;
        for (range, at) in tick.range.iter_mut().zip(&self.ranged) {
            widen(range, self.latest.get(*at).and_then(number).map(|value| (value, value)));
        }
        let channel = self.channel.as_ref();
        let channel = channel.and_then(|name| self.columns.iter().position(|c| c.name == *name));
        if let Some(at) = channel {
            let value = self.latest.get(at).and_then(number);
            self.spectrum.push(whole(self.seq_at), time_us, value);
        }
    }

    /// Closes the present tick early, because no row follows.
    pub(crate) fn settle(&mut self) {
        self.close();
    }

    fn close(&mut self) {
        if let Some(tick) = self.open.take() {
            self.ticks.push(tick);
        }
    }

    /// Returns the changes since `seen` as they are at the time `now`, and updates `seen`.
    pub(crate) fn news(&mut self, seen: &mut Seen, now: Instant) -> Value {
        let age = self.heard.map(|heard| now.saturating_duration_since(heard));
        if age.is_some_and(|age| age >= SETTLED) {
            self.close();
        }
        let recording = self.recording.as_ref().map(|recording| {
            let seconds = now.saturating_duration_since(recording.begun).as_secs_f64();
            let Recorded { name, rows, bytes, .. } = recording;
            json!({ "name": name, "seconds": seconds, "rows": rows, "bytes": bytes })
        });
        let mut news = json!({
            "latest": self.latest.iter().map(cell).collect::<Vec<_>>(),
            // A playback has no age: it is as old as its recording.
            "age": age.filter(|_| self.playback.is_none()).map(|age| age.as_secs_f64()),
            "rate": self.rate.hertz(),
            "frames": self.link.frames,
            "lost": self.link.lost,
            "echo_ms": self.link.echo.map(|echo| echo.as_secs_f64() * 1e3),
            "clock": self.link.clock.map(|(ppm, error)| json!([ppm, error.as_secs_f64() * 1e3])),
            "trouble": self.trouble.as_ref().or(self.mishap.as_ref()),
            "recording": recording,
            "playback": self.playback.map(|(at, of, runs)| json!({ "at": at, "of": of, "runs": runs })),
        });
        if seen.epoch != Some(self.epoch) {
            (seen.epoch, seen.ticks) = (Some(self.epoch), 0);
            news["restart"] = json!(true);
        }
        if seen.layout != Some(self.layout) {
            seen.layout = Some(self.layout);
            let ranged = |at| self.ranged.contains(&at);
            let columns = self.columns.iter().enumerate();
            news["columns"] =
                columns.map(|(at, c)| json!({ "name": c.name, "ranged": ranged(at) })).collect();
        }
        if seen.self_test != self.self_test {
            seen.self_test = self.self_test.clone();
            news["self_test"] = self.self_test.clone();
        }
        if seen.facts.as_ref() != Some(&self.facts) {
            seen.facts = Some(self.facts.clone());
            news["facts"] = self.facts.clone();
        }
        let (ticks, next) = self.ticks.since(seen.ticks, MOST);
        seen.ticks = next;
        let ticks = || ticks.iter();
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
    layout: Option<u64>,
    ticks: u64,
    facts: Option<Value>,
    self_test: Value,
}

/// Whether a column's minimum and maximum are in the ticks.
fn is_ranged(column: &Column) -> bool {
    let codes = ["lit_", "dark_", "bridge_s", "aux_"];
    column.kind == Kind::Measured || codes.iter().any(|prefix| column.name.starts_with(prefix))
}

fn number(cell: &Cell) -> Option<f32> {
    match cell {
        Cell::Real(value) => Some(*value),
        Cell::Whole(value) => Some(*value as f32),
        Cell::Empty | Cell::Withheld(_) => None,
    }
}

fn ends(tick: &Tick, end: fn((f32, f32)) -> f32) -> Vec<Option<f32>> {
    tick.range.iter().map(|range| range.map(end)).collect()
}

/// Returns the length of a force, or the reason for its first missing component.
fn length(force: [Cell; 3]) -> Cell {
    if let [Some(x), Some(y), Some(z)] = force.map(|cell| number(&cell)) {
        return Cell::Real(x.hypot(y).hypot(z));
    }
    let missing = force.into_iter().find(|cell| number(cell).is_none());
    missing.unwrap_or(Cell::Empty)
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
mod tests;

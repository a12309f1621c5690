//! Playback of a recording in its own time. A trace is computed by the core meanwhile.

use std::path::{Path, PathBuf};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::json;
use taxel::calibration::Calibration;
use taxel::frame::Fields;
use taxel_files::FileError;
use taxel_files::frames::{Cell, Column, cells, columns};
use taxel_files::recording::{Recording, Scans};
use taxel_files::stretch::Stretch;

use super::{Context, Feed, page_facts};
use crate::view::orders::{Order, Queue};

/// Wait of the thread while no row is due.
const LOOK: Duration = Duration::from_millis(8);
/// Seconds shown before the position of a seek.
const BEFORE: f64 = 20.0;

/// Time before each recording's first row.
const BEGINNING: f64 = f64::NEG_INFINITY;

type Rows = Box<dyn Iterator<Item = Result<Vec<Cell>, FileError>> + Send>;

/// Opens the file at or before a device time in seconds. A recording's frames are shown as
/// recorded. With a `calibration`, or for a trace, they are computed from the codes, from the first
/// one on, because the finger's state depends on them.
fn open(
    path: &Path,
    calibration: Option<&Calibration>,
    from: f64,
) -> Result<(Vec<Column>, Rows, serde_json::Value), FileError> {
    let recording = Recording::open_from(path, from);
    if let Ok(recording) = recording
        && recording.position("seq").is_some()
        && calibration.is_none()
    {
        let facts = json!(recording.header.facts);
        return Ok((recording.columns.clone(), Box::new(recording), facts));
    }
    let scans = Scans::open(path)?;
    let serial = match scans.header.fact("serial") {
        "" => "a trace, computed now".to_owned(),
        recorded => format!("{recorded}, computed now"),
    };
    let (finger, mut state) = scans.header.finger(calibration.cloned().or(scans.calibration));
    let rows = (0u32..).zip(scans.samples).map(move |(seq, sample)| {
        let scan = sample?.scan;
        let estimate = finger.estimate(&mut state, &scan);
        let mut row = Vec::new();
        cells(&estimate.frame(&scan.codes, seq, Fields::ALL).into(), Fields::ALL, &mut row);
        Ok(row)
    });
    Ok((columns(Fields::ALL), Box::new(rows), json!({ "serial": serial })))
}

/// Starts the feed of a file.
pub(super) fn start(path: PathBuf, calibration: Option<Calibration>) -> Result<Feed, FileError> {
    let (mut feed, context, orders) = Feed::new(format!("file:{}", path.display()));
    let (columns, rows, facts) = open(&path, calibration.as_ref(), BEGINNING)?;
    let time_at = columns.iter().position(|column| column.name == "t_us").unwrap_or_default();
    {
        let mut scope = context.scope.lock();
        scope.set_columns(columns);
        scope.facts = page_facts(facts);
        scope.playback = Some((0.0, None, true));
        let cut_short = Recording::open(&path).ok().filter(|recording| !recording.whole);
        scope.mishap = cut_short.map(|recording| recording.cut_short(&path));
    }
    let length = Arc::new(Mutex::new(None));
    let found = Arc::clone(&length);
    let (whole, with, stop) = (path.clone(), calibration.clone(), context.clone());
    feed.spawn("view-length", move || {
        let length = length_of(&whole, with.as_ref(), time_at, &stop);
        if let Ok(mut found) = found.lock() {
            *found = length;
        }
    });
    let mut player =
        Player { path, calibration, context, rows, time_at, length, start: None, next: None };
    feed.spawn("view-playback", move || player.run(orders));
    Ok(feed)
}

/// Returns the seconds from the first row to the last.
fn length_of(
    path: &Path,
    calibration: Option<&Calibration>,
    time_at: usize,
    context: &Context,
) -> Option<f64> {
    let times = |from| {
        let (_, rows, _) = open(path, calibration, from).ok()?;
        let rows = rows.take_while(|_| !context.stopped()).flatten();
        Some(rows.map(|row| seconds(&row, time_at)))
    };
    let first = times(BEGINNING)?.next()?;
    Some(times(f64::MAX)?.last()? - first)
}

fn seconds(row: &[Cell], time_at: usize) -> f64 {
    match row.get(time_at) {
        Some(Cell::Whole(micros)) => Stretch::seconds(*micros),
        _ => 0.0,
    }
}

struct Player {
    path: PathBuf,
    calibration: Option<Calibration>,
    context: Context,
    rows: Rows,
    time_at: usize,
    length: Arc<Mutex<Option<f64>>>,
    /// Time of the first row, in seconds.
    start: Option<f64>,
    next: Option<Vec<Cell>>,
}

impl Player {
    fn run(&mut self, mut orders: Queue) {
        let (mut runs, mut over, mut place) = (true, false, 0.0);
        // A moment of this host and its position in the recording.
        let mut origin = (Instant::now(), 0.0);
        while !self.context.stopped() {
            let answered = orders.answer(LOOK, |order| {
                let to = match order {
                    Order::Channel { name } => {
                        self.context.scope.lock().set_channel(&name);
                        return Ok(String::new());
                    }
                    Order::Play { on } => {
                        runs = on;
                        (on && over).then_some(0.0)
                    }
                    Order::Seek { to } => Some(to),
                    _ => return Err("this is a recording, not a finger".to_owned()),
                };
                if let Some(to) = to {
                    (over, place) = (false, self.seek(to).map_err(|error| error.to_string())?);
                }
                origin = (Instant::now(), place);
                Ok(String::new())
            });
            if answered == Err(RecvTimeoutError::Disconnected) {
                return;
            }
            if runs {
                let due = origin.1 + origin.0.elapsed().as_secs_f64();
                over = self.play(due, origin);
                (runs, place) = (!over, if over { place } else { due });
            }
            let length = self.length.lock().ok().and_then(|length| *length);
            let shown = length.filter(|_| over).unwrap_or(place);
            self.context.scope.lock().playback = Some((shown, length, runs));
        }
    }

    /// Pushes the rows up to `due`; true at the end of the recording.
    fn play(&mut self, due: f64, (moment, place): (Instant, f64)) -> bool {
        while let Some(at) = self.peek() {
            if at > due {
                return false;
            }
            if let Some(row) = self.next.take() {
                let later = Duration::from_secs_f64((at - place).max(0.0));
                self.context.scope.lock().push(&row, moment + later);
            }
        }
        true
    }

    /// Returns the position of the next readable row, in seconds.
    fn peek(&mut self) -> Option<f64> {
        while self.next.is_none() {
            match self.rows.next()? {
                Ok(row) => self.next = Some(row),
                Err(error) => self.context.scope.lock().trouble = Some(error.to_string()),
            }
        }
        let time = seconds(self.next.as_deref().unwrap_or_default(), self.time_at);
        Some(time - *self.start.get_or_insert(time))
    }

    /// Moves to a position, and shows the [`BEFORE`] seconds up to it.
    fn seek(&mut self, to: f64) -> Result<f64, FileError> {
        let to = if to.is_finite() { to.max(0.0) } else { 0.0 };
        let from = to - BEFORE;
        // The first row's time, if it is not known yet.
        self.peek();
        let start = self.start.unwrap_or_default();
        (_, self.rows, _) = open(&self.path, self.calibration.as_ref(), start + from)?;
        self.next = None;
        self.context.scope.lock().restart();
        // The base is arbitrary, because only differences matter here.
        let base = Instant::now();
        while let Some(at) = self.peek() {
            if at > to || self.context.stopped() {
                break;
            }
            if let Some(row) = self.next.take()
                && at >= from
            {
                let moment = base + Duration::from_secs_f64((at - from).max(0.0));
                self.context.scope.lock().push(&row, moment);
            }
        }
        self.context.scope.lock().settle();
        Ok(to)
    }
}

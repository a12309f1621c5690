//! Slides, grasps and faults of an independent finger, told from the frames of its record.

use std::path::Path;

use anyhow::{Context, Result};
use taxel::frame::Status;

use super::{Verdict, taxel};

/// Time before a slide in seconds at which it must have been warned of.
const AHEAD_S: f64 = 0.02;
/// Force in newtons above which a trace's row belongs to a touch.
const TOUCHES_N: f64 = 0.02;
/// Largest share of slides that may be warned of late, or told at no time.
const LATE: f64 = 0.05;
/// False warnings, or slides, that may be told in ten minutes of grasps.
const FALSE: f64 = 1.0;
const TEN_MINUTES_S: f64 = 600.0;

/// Time in seconds of the last sound scan of a recording of faults.
const FAULT_S: f64 = 2.0;
/// A recording of faults: the frames' flag of each.
const FAULTS: [(&str, Option<Status>); 4] = [
    ("d21_fault_taxel", Some(Status::DEAD_TAXEL)),
    ("d21_fault_row", Some(Status::DEAD_TAXEL)),
    ("d21_fault_arm", Some(Status::BRIDGE_FAULT)),
    // Daylight on a column is in lit and dark codes alike, and no fault.
    ("d21_fault_ambient", None),
];

/// A scan of a trace with the flags of its frame.
struct Row {
    s: f64,
    touches: bool,
    slides: bool,
    flags: Status,
}

/// Replays the recordings with a record, and judges what the frames warn of and tell.
pub(super) fn judged(calibration: &str, folder: &Path) -> Result<Vec<Verdict>> {
    let mut verdicts = Vec::new();
    let mut put = |what: &str, limit, reached| {
        verdicts.push(Verdict { what: what.into(), limit, reached, digits: 2 });
    };
    let slides = replayed(calibration, folder, "d21_slide")?;
    let touches: Vec<&[Row]> = touches(&slides).collect();
    let begun = touches.iter().filter_map(|touch| Some((*touch, begin(touch)?)));
    let (mut all, mut late, mut untold) = (0, 0, 0);
    for (touch, begun) in begun {
        let told = |flag, from, to| {
            touch.iter().any(|row| row.flags.contains(flag) && row.s >= from && row.s <= to)
        };
        all += 1;
        late += i32::from(!told(Status::SLIP_WARNING, 0.0, begun - AHEAD_S));
        untold += i32::from(!told(Status::SLIDES, begun, f64::INFINITY));
    }
    let share = |of: i32| f64::from(of) / f64::from(all);
    put("d21_slide, share warned of late", LATE, share(late));
    put("d21_slide, share never told", LATE, share(untold));
    put("d21_slide, share of frames with a fault", 0.0, faulty(&slides));
    let grasps = replayed(calibration, folder, "d21_grasp")?;
    let last = grasps.last().map_or(f64::NAN, |row| row.s);
    let in_ten_minutes = |flag| begins(&grasps, flag) as f64 * TEN_MINUTES_S / last;
    put("d21_grasp, warnings in 10 min", FALSE, in_ten_minutes(Status::SLIP_WARNING));
    put("d21_grasp, slides in 10 min", FALSE, in_ten_minutes(Status::SLIDES));
    put("d21_grasp, share of frames with a fault", 0.0, faulty(&grasps));
    for (name, fault) in FAULTS {
        let rows = replayed(calibration, folder, name)?;
        put(&format!("{name}, slides"), 0.0, begins(&rows, Status::SLIDES) as f64);
        put(&format!("{name}, slip warnings"), 0.0, begins(&rows, Status::SLIP_WARNING) as f64);
        let (sound, second) = rows.split_at(rows.partition_point(|row| row.s <= FAULT_S));
        put(&format!("{name}, share of sound frames with a fault"), 0.0, faulty(sound));
        let silent = fault.map(|flag| second.iter().filter(move |row| !row.flags.contains(flag)));
        if let Some(silent) = silent {
            put(&format!("{name}, faulty frames without the flag"), 0.0, silent.count() as f64);
        }
    }
    Ok(verdicts)
}

/// Replays a recording by the user's command, and reads it beside its frames.
fn replayed(calibration: &str, folder: &Path, name: &str) -> Result<Vec<Row>> {
    let trace = folder.join(format!("{name}.csv"));
    let made = tempfile::tempdir()?;
    let frames = made.path().join("frames.csv");
    let [trace_text, frames_text] = [&trace, &frames].map(|path| path.display().to_string());
    taxel(name, &["replay", &trace_text, "--calibration", calibration, "--out", &frames_text])?;
    let [truth, frames] = [&trace, &frames].map(|path| columns(path));
    let (truth, frames) = (truth?, frames?);
    let rows = truth.iter().zip(&frames).map(|(truth, [t_us, status, ..])| {
        let [at, _, force, slides] = truth;
        anyhow::ensure!(at == t_us, "{name}: row at {at} us has the frame of {t_us} us");
        Ok(Row {
            s: 1e-6 * at,
            touches: *force > TOUCHES_N,
            slides: *slides > 0.0,
            flags: Status::from_bits_retain(*status as u32),
        })
    });
    rows.collect()
}

/// Columns `t_us`, `status`, `fz_n` and `slip` of a table; 0 for those that it lacks.
fn columns(path: &Path) -> Result<Vec<[f64; 4]>> {
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .from_path(path)
        .with_context(|| path.display().to_string())?;
    let names = reader.headers()?.clone();
    let at = ["t_us", "status", "fz_n", "slip"].map(|name| names.iter().position(|n| n == name));
    let cells = reader.records().map(|row| {
        let row = row?;
        let cell = |at: usize| row.get(at).and_then(|cell| cell.parse().ok()).unwrap_or_default();
        Ok(at.map(|at| at.map_or(0.0, cell)))
    });
    cells.collect()
}

/// Stretches of rows that touch.
fn touches(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(|a, b| a.touches == b.touches)
        .filter(|rows| rows.first().is_some_and(|row| row.touches))
}

/// Time at which a touch begins to slide.
fn begin(touch: &[Row]) -> Option<f64> {
    touch.iter().find(|row| row.slides).map(|row| row.s)
}

/// Number of times that a flag appears.
fn begins(rows: &[Row], flag: Status) -> usize {
    let pairs = rows.iter().zip(rows.iter().skip(1));
    pairs.filter(|(a, b)| b.flags.contains(flag) && !a.flags.contains(flag)).count()
}

/// Share of frames that name a fault.
fn faulty(rows: &[Row]) -> f64 {
    let fault = Status::DEAD_TAXEL | Status::BRIDGE_FAULT | Status::STUCK_CHANNEL | Status::NOISY;
    let named = rows.iter().filter(|row| row.flags.intersects(fault)).count();
    named as f64 / rows.len() as f64
}

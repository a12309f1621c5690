//! Time until the last second of a long recording is read, with and without its index.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, ensure};
use taxel_files::frames::{Cell, columns};
use taxel_files::recording::{Existing, Header, Recorder, Recording};

use super::{FIELDS, fastest};

/// Length of the recording: ten minutes at 1 kHz.
const SECONDS: u64 = 600;
const HZ: u64 = 1000;
/// Number of timed runs.
const RUNS: usize = 3;

/// Time until the last second of a recording is read, in milliseconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Seek {
    /// Format of the recording.
    pub format: &'static str,
    /// Frames of the recording.
    pub frames: u64,
    /// Time with every frame from the first on.
    pub whole_ms: f64,
    /// Time by [`Recording::open_from`].
    pub index_ms: f64,
}

/// Writes a long recording of each format that has an index, with `rows` over and over, and reads
/// its end both ways.
pub(super) fn measure(rows: &[Vec<Cell>], folder: &Path) -> anyhow::Result<Vec<Seek>> {
    [("MCAP", "long.mcap"), ("Parquet", "long.parquet")]
        .map(|(format, name)| {
            let path = folder.join(name);
            record(rows, &path)?;
            let seek = seek(format, &path);
            std::fs::remove_file(path)?;
            seek
        })
        .into_iter()
        .collect()
}

fn record(rows: &[Vec<Cell>], path: &Path) -> anyhow::Result<()> {
    let mut recorder =
        Recorder::derived(path, &Header::default(), &columns(FIELDS), Existing::Replace)?;
    let mut row = Vec::new();
    for (i, other) in (0..SECONDS * HZ).zip(rows.iter().cycle()) {
        row.clone_from(other);
        let [time, seq, ..] = row.as_mut_slice() else { anyhow::bail!("a row without its time") };
        (*time, *seq) = (Cell::Whole(1_000_000 / HZ * i), Cell::Whole(i));
        recorder.write(&row)?;
    }
    Ok(recorder.finish()?)
}

fn seek(format: &'static str, path: &Path) -> anyhow::Result<Seek> {
    let from = SECONDS - 1;
    let timed = |open: &dyn Fn() -> anyhow::Result<Recording>| {
        let took = fastest(RUNS, || {
            let recording = open()?;
            let time = recording.position("t_us").context("no times")?;
            let mut found = 0;
            for row in recording {
                let row = row?;
                found += u64::from(
                    matches!(row.get(time), Some(Cell::Whole(t)) if *t >= from * 1_000_000),
                );
            }
            ensure!(found == HZ, "{format}: {found} of {HZ} frames");
            Ok(())
        })?;
        anyhow::Ok(took.as_secs_f64() * 1e3)
    };
    Ok(Seek {
        format,
        frames: SECONDS * HZ,
        whole_ms: timed(&|| Ok(Recording::open(path)?))?,
        index_ms: timed(&|| Ok(Recording::open_from(path, from as f64)?))?,
    })
}

/// Formats the table `seek.csv`.
#[must_use]
pub fn csv(seeks: &[Seek]) -> String {
    let mut table = String::from("format,frames,whole_ms,index_ms\n");
    for Seek { format, frames, whole_ms, index_ms } in seeks {
        // Writing into a string cannot fail.
        let _ = writeln!(table, "{format},{frames},{whole_ms:.1},{index_ms:.1}");
    }
    table
}

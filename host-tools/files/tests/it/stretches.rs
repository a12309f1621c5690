//! Tests of opening a stretch of a recording without reading what lies before it.

use std::path::Path;
use std::time::{Duration, Instant};

use taxel_files::frames::{Cell, Column, Kind};
use taxel_files::recording::{Existing, Header, Recorder, Recording, host_columns};

const HZ: u64 = 200;
const START_US: u64 = 5_000_000;

/// Ten minutes of frames with one value, in chunks of half a second as `taxel record` flushes them.
fn ten_minutes() -> Vec<Vec<Cell>> {
    (0..600 * HZ).map(|i| row(START_US + i * 1_000_000 / HZ, i, 1)).collect()
}

fn row(t_us: u64, i: u64, connection: u64) -> Vec<Cell> {
    let host = 1_790_000_000_000_000 + i * 1_000_000 / HZ;
    let value = Cell::Real(i as f32);
    [Cell::Whole(t_us), value]
        .into_iter()
        .chain([host, host, 250, connection].map(Cell::Whole))
        .collect()
}

fn record(path: &Path, rows: &[Vec<Cell>]) {
    let own = [("t_us", Kind::Whole), ("value", Kind::Real)];
    let own = own.map(|(name, kind)| Column { name: name.to_owned(), kind });
    let columns: Vec<_> = own.into_iter().chain(host_columns()).collect();
    let calibration = Some("taxel_calibration = 2\n".to_owned());
    let header = Header { calibration, ..Header::default().with("serial", "F-0042") };
    let mut recorder = Recorder::create(path, &header, &columns, Existing::Replace).unwrap();
    for rows in rows.chunks(HZ as usize / 2) {
        rows.iter().for_each(|row| recorder.write(row).unwrap());
        recorder.flush().unwrap();
    }
    recorder.finish().unwrap();
}

fn seconds(row: &[Cell]) -> f64 {
    match row[0] {
        Cell::Whole(micros) => micros as f64 / 1e6,
        other => panic!("{other:?}"),
    }
}

/// Returns the rows that are read, those from `from` on, and the time that it took.
fn opened(path: &Path, from: f64) -> (usize, Vec<Vec<Cell>>, Duration) {
    let began = Instant::now();
    let recording = Recording::open_from(path, from).unwrap();
    let (mut read, mut stretch) = (0, Vec::new());
    for row in recording.flatten() {
        read += 1;
        if seconds(&row) >= from {
            stretch.push(row);
        }
    }
    (read, stretch, began.elapsed())
}

fn after(rows: &[Vec<Cell>], from: f64) -> Vec<Vec<Cell>> {
    rows.iter().filter(|row| seconds(row) >= from).cloned().collect()
}

#[test]
fn end_of_ten_minutes_opens_ten_times_faster() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let rows = ten_minutes();
    record(&path, &rows);
    let best = |from| (0..3).map(|_| opened(&path, from).2).min().unwrap();
    let whole = best(f64::NEG_INFINITY);
    let end = best(604.0);
    println!("whole {whole:?}, its last second {end:?}");
    assert!(whole > 10 * end, "{whole:?}, {end:?}");
    let (read, stretch, _) = opened(&path, 604.0);
    assert_eq!(stretch, after(&rows, 604.0));
    assert!(read < 2 * HZ as usize, "{read}");
}

#[test]
fn stretch_of_parquet_reads_from_its_row_group() {
    /// Rows of a group.
    const GROUP: usize = 16_384;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let rows = ten_minutes();
    record(&path, &rows);
    let border = seconds(&rows[GROUP]);
    for from in [f64::NEG_INFINITY, 4.9, 5.0, border - 0.001, border, 300.0, 604.0, 1e9] {
        let (read, stretch, _) = opened(&path, from);
        let expected = after(&rows, from);
        assert_eq!(stretch, expected, "{from}");
        assert!(read - stretch.len() <= GROUP, "{from}: {read} read for {}", stretch.len());
    }
}

#[test]
fn every_stretch_has_the_rows_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let rows: Vec<_> = ten_minutes().into_iter().take(60 * HZ as usize).collect();
    record(&path, &rows);
    // A killed writer's file ends within a chunk and has no summary.
    let killed = folder.path().join("killed.mcap");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&killed, &bytes[..bytes.len() / 2]).unwrap();
    let (_, half, _) = opened(&killed, f64::NEG_INFINITY);
    assert!(half.len() > 500 && half.len() < rows.len());
    for from in [f64::NEG_INFINITY, -1.0, 0.0, 4.9, 5.0, 5.000_001, 5.5, 17.0, 17.49, 64.98, 1e9] {
        assert_eq!(opened(&path, from).1, after(&rows, from), "{from}");
        assert_eq!(opened(&killed, from).1, after(&half, from), "{from}");
    }
    assert!(opened(&killed, 17.0).0 < half.len() - 500);
}

/// Device time goes back where a finger restarted, with or without a new connection.
#[test]
fn restarted_finger_is_read_from_the_start() {
    let folder = tempfile::tempdir().unwrap();
    for (connection, format, scale) in
        [(1, "mcap", 1), (2, "mcap", 1), (1, "parquet", 5), (2, "parquet", 5)]
    {
        let path = folder.path().join(format!("{connection}.{format}"));
        let first = 20 * scale * HZ;
        let before = (0..first).map(|i| row(40_000_000 + i * 1_000_000 / HZ, i, 1));
        let again = (0..30 * scale * HZ)
            .map(|i| row(35_000_000 + i * 1_000_000 / HZ, i + first, connection));
        let rows: Vec<_> = before.chain(again).collect();
        record(&path, &rows);
        for from in [36.0, 45.0, 59.0, 64.0] {
            let (read, stretch, _) = opened(&path, from);
            assert_eq!(stretch, after(&rows, from), "{from}");
            assert_eq!(read, rows.len());
        }
    }
}

#[test]
fn damaged_length_or_chunk_falls_back_to_reading() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let rows: Vec<_> = ten_minutes().into_iter().take(60 * HZ as usize).collect();
    record(&path, &rows);
    let bytes = std::fs::read(&path).unwrap();
    let chunks: Vec<_> =
        (0..bytes.len()).filter(|at| bytes[*at..].starts_with(b"\x03\0\0\0lz4")).collect();
    assert!(chunks.len() > 100, "{}", chunks.len());
    let middle = chunks[chunks.len() / 2];
    // The chunk's own length, far before its compression's name; then a byte of its content.
    for at in [middle - 35, middle + 40] {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0xff;
        let bad = folder.path().join("bad.mcap");
        std::fs::write(&bad, &damaged).unwrap();
        let (_, readable, _) = opened(&bad, f64::NEG_INFINITY);
        assert!(readable.len() >= rows.len() - HZ as usize, "{}", readable.len());
        for from in [10.0, 34.0, 35.5, 60.0] {
            assert_eq!(opened(&bad, from).1, after(&readable, from), "{at} {from}");
        }
    }
}

//! Tests of recordings: every format reads back as written, and damaged files as far as possible.

use std::path::Path;

use taxel::condition::{Bias, BridgeBias, Health, Signals, TaxelBias};
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::{ContactPoint, Force};
use taxel::frame::{Fields, Frame, Status};
use taxel::measured::NoValue;
use taxel::units::{Micros, Millimetres, Newtons};
use taxel_files::frames::{Cell, Column, cells, columns};
use taxel_files::recording::{Existing, Header, Recorder, Recording, host_columns};

fn header() -> Header {
    let header = Header::default().with("serial", "F-0042").with("full_scale", 65535);
    Header { calibration: Some("taxel_calibration = 2\n".to_owned()), ..header }
}

fn all_columns() -> Vec<Column> {
    columns(Fields::ALL).into_iter().chain(host_columns()).collect()
}

/// Rows with every kind of cell, every reason, and numbers that only exact text or bits preserve.
fn rows(count: u64) -> Vec<Vec<Cell>> {
    (0..count)
        .map(|i| {
            let newtons = |value: f32| Ok(Newtons(value / 3.0));
            let why = NoValue::ALL[i as usize % NoValue::ALL.len()];
            let frame = Frame {
                seq: i as u32,
                time: Micros((1 << 40) + i * 250),
                status: Status::CONTACT,
                signals: Some(Signals {
                    taxels: Some(std::array::from_fn(|k| (k as f32 + i as f32).sin() * 1e-7)),
                    bridges: [Some([1.0e-30, -0.0, 3.4e38]), None, None, None],
                    health: Health { saturated: 0xffff, dead: 1, bridge_faults: 15 },
                }),
                force: Some(Force { x: newtons(i as f32), y: Err(why), z: newtons(-1.0) }),
                point: Some(if i % 2 == 0 {
                    Err(NoValue::NoContact)
                } else {
                    Ok(ContactPoint { x: Millimetres(0.1), y: Millimetres(-3.7) })
                }),
                ..Frame::default()
            };
            let mut row = Vec::new();
            cells(&frame, Fields::ALL, &mut row);
            let micros = Cell::Whole(1_790_000_000_000_000 + i);
            // The finger's clock is not known from the first frame on.
            let [scan, error] = if i < 40 { [Cell::Empty; 2] } else { [micros, Cell::Whole(250)] };
            row.extend([micros, scan, error, Cell::Whole(1)]);
            row
        })
        .collect()
}

fn record(path: &Path, rows: &[Vec<Cell>]) {
    let mut recorder =
        Recorder::create(path, &header(), &all_columns(), Existing::Replace).unwrap();
    for (i, row) in rows.iter().enumerate() {
        recorder.write(row).unwrap();
        if i % 100 == 99 {
            recorder.flush().unwrap();
        }
    }
    recorder.finish().unwrap();
}

fn read(path: &Path) -> (Vec<Vec<Cell>>, Vec<String>) {
    let mut errors = Vec::new();
    let rows = Recording::open(path).unwrap();
    let rows = rows.filter_map(|row| row.map_err(|error| errors.push(error.to_string())).ok());
    let rows = rows.collect();
    (rows, errors)
}

#[test]
fn mcap_and_parquet_keep_every_cell_and_reason() {
    let folder = tempfile::tempdir().unwrap();
    // More than one row group of Parquet.
    let rows = rows(20_000);
    for name in ["a.mcap", "a.parquet"] {
        let path = folder.path().join(name);
        record(&path, &rows);
        let recording = Recording::open(&path).unwrap();
        assert_eq!(recording.header, header());
        assert_eq!(recording.columns, all_columns());
        assert!(recording.map(Result::unwrap).eq(rows.iter().cloned()), "{name}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "the spool is gone");
}

#[test]
fn csv_keeps_values_and_drops_reasons() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    let mut rows = rows(50);
    record(&path, &rows);
    for cell in rows.iter_mut().flatten() {
        if let Cell::Withheld(_) = cell {
            *cell = Cell::Empty;
        }
    }
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.header.facts, header().facts);
    assert!(recording.map(Result::unwrap).eq(rows));
}

#[test]
fn line_break_in_a_fact_does_not_break_the_csv() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    let header = header().with("serial", "F\nt_us,7\r\x1b[2J");
    Recorder::create(&path, &header, &all_columns(), Existing::Keep).unwrap().finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.header.facts["serial"], "F?t_us,7??[2J");
}

#[test]
fn cut_mcap_file_loses_only_unflushed_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let rows = rows(1000);
    record(&path, &rows);
    let whole = std::fs::read(&path).unwrap();
    assert!(Recording::open(&path).unwrap().remarks(&path).is_empty());
    let mut longest = 0;
    for length in (0..whole.len()).step_by(whole.len() / 97) {
        std::fs::write(&path, &whole[..length]).unwrap();
        let Ok(recording) = Recording::open(&path) else {
            assert!(length < whole.len() / 5, "{length} bytes");
            continue;
        };
        // Remarks appear even where no row is missing.
        let remarks = recording.remarks(&path);
        assert!(
            remarks.iter().any(|remark| remark.contains("a.mcap: has no end: ")),
            "{remarks:?}"
        );
        let found: Vec<_> = recording.map(Result::unwrap).collect();
        assert_eq!(found, rows[..found.len()]);
        assert_eq!(found.len() % 100, 0);
        longest = found.len();
    }
    assert_eq!(longest, 1000);
}

#[test]
fn damaged_chunk_loses_its_rows_with_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let rows = rows(1000);
    record(&path, &rows);
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    std::fs::write(&path, &bytes).unwrap();
    let (found, errors) = read(&path);
    assert_eq!(found.len(), 900);
    assert!(found.iter().all(|row| rows.contains(row)));
    assert_eq!(errors.len(), 1);
    assert!(errors[0].contains("a.mcap: damaged after row "), "{errors:?}");
}

/// Rows of a chunk of the recordings whose bits are flipped.
const CHUNK: usize = 10;

/// Reads a damaged recording of `rows`. Returns whether rows are lost and whether damage is told.
///
/// # Errors
/// The damage is not detected, or costs more than a chunk.
fn judged(path: &Path, rows: &[Vec<Cell>], ended: bool) -> Result<(bool, bool), String> {
    let recording = match Recording::open(path) {
        Ok(recording) => recording,
        // Only a summary repeats the columns.
        Err(_) if !ended => return Ok((true, true)),
        Err(error) => return Err(error.to_string()),
    };
    let found = recording.header.clone();
    let (mut kept, mut errors) = (Vec::new(), 0);
    for row in recording {
        row.map_or_else(|_| errors += 1, |row| kept.push(row));
    }
    // A killed recording has its facts only once, with a CRC that may itself be damaged.
    let same = header().facts.iter().all(|(name, fact)| found.facts.get(name) == Some(fact));
    let fault = if found != header() && (ended || (errors == 0 && !same)) {
        "wrong facts"
    } else if kept.len() < rows.len() - CHUNK {
        "more than a chunk lost"
    } else if !kept.iter().all(|row| rows.contains(row)) {
        "a wrong row"
    } else if !kept.is_sorted_by_key(|row| sequence(row)) {
        "rows out of order"
    } else if kept.len() < rows.len() && errors == 0 {
        "not told"
    } else {
        return Ok((kept.len() < rows.len(), errors > 0));
    };
    Err(format!("{fault}: {} rows, {found:?}", kept.len()))
}

/// Writes a recording in chunks, and ends it or not.
fn chunked(path: &Path, rows: &[Vec<Cell>], ended: bool) {
    let mut recorder =
        Recorder::derived(path, &header(), &all_columns(), Existing::Replace).unwrap();
    for chunk in rows.chunks(CHUNK) {
        chunk.iter().for_each(|row| recorder.write(row).unwrap());
        recorder.flush().unwrap();
    }
    if ended {
        recorder.finish().unwrap();
    } else {
        std::mem::forget(recorder);
    }
}

/// A flip that no CRC shows stands for a defect of the reader, which the judge must find.
#[test]
fn undetected_flip_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let rows = rows(4 * CHUNK as u64);
    let mut flipped = rows.clone();
    let cell = flipped[17].iter_mut().find_map(|cell| match cell {
        Cell::Real(number) => Some(number),
        _ => None,
    });
    let number = cell.unwrap();
    *number = f32::from_bits(number.to_bits() ^ 1);
    for ended in [true, false] {
        chunked(&path, &rows, ended);
        assert_eq!(judged(&path, &rows, ended), Ok((false, false)));
        chunked(&path, &flipped, ended);
        let fault = judged(&path, &rows, ended).unwrap_err();
        assert!(fault.starts_with("a wrong row: 40 rows"), "{fault}");
    }
}

/// Flips bits of a recording, and checks that all but one chunk is read with the right facts.
///
/// `bits` lists the bits of a byte that are flipped, one at a time.
fn flip_every_byte(ended: bool, bits: impl Fn(usize) -> Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let rows = rows(4 * CHUNK as u64);
    chunked(&path, &rows, ended);
    let whole = std::fs::read(&path).unwrap();
    let (mut lost, mut told) = (0, 0);
    for at in 0..whole.len() {
        for bit in bits(at) {
            let mut bytes = whole.clone();
            bytes[at] ^= 1 << bit;
            std::fs::write(&path, &bytes).unwrap();
            let (rows_lost, damage_told) = judged(&path, &rows, ended)
                .unwrap_or_else(|fault| panic!("byte {at} of {}, bit {bit}: {fault}", whole.len()));
            lost += usize::from(rows_lost);
            told += usize::from(damage_told);
        }
    }
    println!("{} bytes: a chunk lost in {lost} cases, damage told in {told}", whole.len());
    // Most bytes are those of rows.
    assert!(lost > 0 && told >= lost, "{lost} lost, {told} told");
}

/// Takes a bit of every 17th byte; the nightly test takes all.
fn sampled(at: usize) -> Vec<u8> {
    if at.is_multiple_of(17) { vec![(at / 17 % 8) as u8] } else { Vec::new() }
}

fn sequence(row: &[Cell]) -> u64 {
    let Cell::Whole(sequence) = row[0] else { panic!("{:?}", row[0]) };
    sequence
}

#[test]
fn flipped_bit_costs_at_most_one_chunk() {
    flip_every_byte(true, sampled);
}

#[test]
fn flipped_bit_costs_a_killed_recording_one_chunk() {
    flip_every_byte(false, sampled);
}

mod nightly {
    use super::*;

    #[test]
    fn every_flipped_bit_costs_at_most_one_chunk() {
        flip_every_byte(true, |_| (0..8).collect());
    }
}

#[test]
fn damaged_bytes_give_no_wrong_row_or_panic() {
    let folder = tempfile::tempdir().unwrap();
    let rows = rows(60);
    for name in ["a.mcap", "a.parquet"] {
        let path = folder.path().join(name);
        record(&path, &rows);
        let whole = std::fs::read(&path).unwrap();
        for at in (0..whole.len()).step_by(whole.len() / 199) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0xff;
            std::fs::write(&path, &bytes).unwrap();
            let Ok(recording) = Recording::open(&path) else { continue };
            let found = recording.flatten().count();
            assert!(found <= 60);
        }
    }
}

#[test]
fn non_recording_is_an_error_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    for (name, content, message) in [
        ("a.mcap", "", "a.mcap: "),
        ("a.mcap", "hello, this is no such file", "a.mcap: damaged after row 0: Bad magic number"),
        ("a.parquet", "PAR1", "a.parquet: "),
        ("a.csv", "", "a.csv: the file is empty"),
        ("a.csv", "x,y\n1,2\n", "a.csv:1: `t_us`: the column is missing"),
        ("a.txt", "", "a.txt: unknown kind of recording; let it end in .mcap"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        let Err(error) = Recording::open(&path) else { panic!("{name} opened") };
        let error = error.to_string();
        assert!(error.contains(message), "{error}");
        assert!(!error.contains('\n'));
    }
}

#[test]
fn existing_file_stays_unless_replaced() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.mcap", "a.parquet", "a.csv"] {
        let path = folder.path().join(name);
        let create = |existing| Recorder::create(&path, &header(), &all_columns(), existing);
        create(Existing::Keep).unwrap().finish().unwrap();
        let before = std::fs::read(&path).unwrap();
        let error = create(Existing::Keep).err().unwrap().to_string();
        assert!(error.contains(&format!("{name}: the file exists already; ")), "{error}");
        assert!(error.contains("--force"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), before);
        record(&path, &rows(10));
        assert_eq!(read(&path).0.len(), 10);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
}

/// Follows the mend in the error: all rows reach the table, and the spooled file stays untouched.
#[test]
fn killed_recording_is_kept_and_recovered() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let spool = folder.path().join("a.parquet.part.mcap");
    let mut killed = Recorder::create(&path, &header(), &all_columns(), Existing::Keep).unwrap();
    rows(500).iter().for_each(|row| killed.write(row).unwrap());
    killed.flush().unwrap();
    std::mem::forget(killed);
    let saved = std::fs::read(&spool).unwrap();
    for existing in [Existing::Keep, Existing::Replace] {
        let error = Recorder::create(&path, &header(), &all_columns(), existing);
        let error = error.err().unwrap().to_string();
        assert!(error.contains("a recording that was killed; `taxel export "), "{error}");
        assert!(!error.contains('\n'));
    }
    let found = Recording::open(&spool).unwrap();
    let columns = found.columns.clone();
    let mut table = Recorder::derived(&path, &found.header, &columns, Existing::Keep).unwrap();
    found.for_each(|row| table.write(&row.unwrap()).unwrap());
    table.finish().unwrap();
    assert_eq!(read(&path).0, rows(500));
    assert_eq!(std::fs::read(&spool).unwrap(), saved);
}

#[test]
fn bad_bias_in_header_is_told_and_not_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let bias = Bias {
        taxels: Some(TaxelBias { level: [0.3; 16], noise: 1e-4 }),
        bridges: [Some(BridgeBias { level: [0.01, -0.02, 0.03], noise: 1e-4 }), None, None, None],
    };
    let good = header().with("biased", true);
    let good = good.with_settings(1000.0, 0, PointMethod::default(), Some(&bias));
    let remarks = |header: &Header| {
        let mut recorder =
            Recorder::create(&path, header, &all_columns(), Existing::Replace).unwrap();
        rows(2).iter().for_each(|row| recorder.write(row).unwrap());
        recorder.finish().unwrap();
        let recording = Recording::open(&path).unwrap();
        (recording.header.bias(), recording.remarks(&path))
    };
    assert_eq!(remarks(&good), (Some(bias), Vec::new()));
    let levels = |level: &str, count| format!("0.0001{}", format!(" {level}").repeat(count));
    for (part, bad) in [
        ("bias_matrix", levels("NaN", 16)),
        ("bias_matrix", levels("1e30", 16)),
        ("bias_matrix", levels("0.3", 15)),
        ("bias_matrix", levels("0.3", 17)),
        ("bias_matrix", format!("1e30 {}", levels("0.3", 15))),
        ("bias_matrix", String::new()),
        ("bias_s0", levels("inf", 3)),
        ("bias_s0", levels("-1e30", 3)),
        ("bias_s0", levels("0.01", 2)),
    ] {
        let (bias, remarks) = remarks(&good.clone().with(part, &bad));
        assert_eq!(bias, None, "{part}: {bad}");
        let [remark] = remarks.as_slice() else { panic!("{part}: {bad}: {remarks:?}") };
        let told = format!("{}: `{part}` of its header is damaged: ", path.display());
        assert!(remark.starts_with(&told) && remark.lines().count() == 1, "{remark}");
    }
}

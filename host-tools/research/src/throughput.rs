//! Frames per second of each stage on one core of a host, for the reference finger, and the time
//! to the end of a long recording: `throughput.csv` and `seek.csv`.
//!
//! Times are the process's own: other programs delay its work, but add little to its time.

mod plain;
pub mod seek;

use std::fmt::Write as _;
use std::fs::File;
use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, anyhow, ensure};
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::finger::{Estimate, Finger, Wanted};
use taxel::frame::{Fields, Frame};
use taxel::instrument::Instrument;
use taxel::scan::Scan;
use taxel::store::{RamFlash, Store};
use taxel::units::FullScale;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Command, Identity, Message, Request};
use taxel::wire::{MAX_PACKET, pack_frame};
use taxel_files::frames::{Cell, cells, columns};
use taxel_files::recording::{Existing, Header, Recorder};
use taxel_files::save;
use taxel_files::trace::{Sample, TraceHeader, TraceReader, TraceWriter};
use taxel_sim::Simulator;

use crate::bars::{self, Bar};
use crate::effort::Waiting;
use crate::picture::save_page;
use crate::reference::{calibrated, scene};
use plain::PlainReader;
use seek::Seek;

/// Scene that every stage works on: presses, shear and slides at 1 kHz.
const SCENE: &str = "tour";
const SEED: u64 = 11;
const SCAN_HZ: u16 = 4000;
/// Fields of a replayed frame, as `taxel replay` writes by default.
const FIELDS: Fields = Fields::ESTIMATES;
/// Number of timed runs, of which the fastest counts because the machine may disturb the others.
const RUNS: usize = 5;
/// Name of the trace in the folder for temporary files.
const TRACE: &str = "trace.csv";

/// End of the name of a stage that is measured by other means.
pub const PLAINLY: &str = " by csv and the standard library's numbers";
/// Least speed of a stage over that of the same stage by other means, which knows no errors of a
/// user, no cells beyond the codes and no other channels.
pub const FLOORS: [(&str, f64); 3] = [
    ("read a trace (CSV)", 0.6),
    ("write frames (CSV)", 1.8),
    ("replay a trace into frames (CSV)", 1.1),
];

/// One stage with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name of the stage.
    pub name: &'static str,
    /// Microseconds per frame.
    pub us_per_frame: f64,
}

/// Times of all stages and of seeking.
#[derive(Clone, Debug, PartialEq)]
pub struct Throughput {
    /// Stages in the order of a frame's way.
    pub stages: Vec<Stage>,
    /// Formats that have an index.
    pub seeks: Vec<Seek>,
}

/// Times every stage, then seeks; takes some seconds.
///
/// # Errors
/// A fit failed or a file in the folder for temporary ones cannot be written.
pub fn measure(waiting: Waiting<'_>) -> anyhow::Result<Throughput> {
    let calibration = calibrated(SEED, false, waiting.stop)?;
    let samples: Vec<Sample> = Simulator::new(&scene(SCENE, SEED, false, &[])?, SEED).collect();
    let folder = tempfile::tempdir()?;
    let rows = rows(&calibration, &samples)?;
    let mut stages = stages_of_core(&calibration, &samples)?;
    stages.extend(stages_of_traces(&samples, &folder.path().join(TRACE))?);
    stages.extend(stages_of_frames(&calibration, &rows, folder.path())?);
    Ok(Throughput { stages, seeks: seek::measure(&rows, folder.path())? })
}

fn stages_of_core(calibration: &Calibration, samples: &[Sample]) -> anyhow::Result<Vec<Stage>> {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration.to_bytes(&mut buffer)?;
    let scene = scene(SCENE, SEED, false, &[])?;
    let mut stages = vec![timed("simulate", samples.len(), || {
        Ok(Simulator::new(&scene, SEED).map(black_box).count())
    })?];
    let mut frames: Vec<Frame> = Vec::new();
    stages.push(timed("estimate, every section of the record", samples.len(), || {
        let mut instrument = instrument(record)?;
        frames.clear();
        for sample in samples {
            if instrument.scan(&sample.scan).frame {
                frames.push(instrument.frame(&sample.scan).into());
            }
        }
        Ok(frames.len())
    })?);
    let mut bytes: Vec<u8> = Vec::new();
    stages.push(timed("pack, every field", frames.len(), || {
        bytes.clear();
        let mut packet = [0; MAX_PACKET];
        for frame in &frames {
            let packed = pack_frame(frame, &mut packet);
            bytes.extend_from_slice(packed.map_err(|_| anyhow!("a frame does not fit a packet"))?);
        }
        Ok(frames.len())
    })?);
    stages.push(timed("unpack, every field", frames.len(), || {
        let mut deframer = Deframer::<MAX_PACKET>::default();
        let messages = bytes.iter().filter_map(|byte| deframer.push::<Message>(*byte));
        Ok(messages.filter(Result::is_ok).count())
    })?);
    Ok(stages)
}

/// Writes a trace, which stays, and reads it.
fn stages_of_traces(samples: &[Sample], path: &Path) -> anyhow::Result<Vec<Stage>> {
    let codes = samples.first().map(|sample| sample.scan.codes).context("an empty scene")?;
    let header = TraceHeader {
        full_scale: codes.full_scale,
        rows: 4,
        bridges: codes.bridges.map(|bridge| bridge.is_some()),
        reference: true,
        temperature: false,
        truth: true,
        sensor_truth: true,
    };
    let write = timed("write a trace (CSV)", samples.len(), || {
        let mut writer = TraceWriter::create(path, header)?;
        samples.iter().try_for_each(|sample| writer.write(sample))?;
        writer.finish()?;
        Ok(samples.len())
    })?;
    let read = timed("read a trace (CSV)", samples.len(), || count(TraceReader::open(path)?))?;
    let by_csv = "read a trace (CSV) by csv and the standard library's numbers";
    let plain = timed(by_csv, samples.len(), || count(PlainReader::open(path)?))?;
    Ok(vec![write, read, plain])
}

/// Writes frames, and replays the trace of [`stages_of_traces`] into frames.
fn stages_of_frames(
    calibration: &Calibration,
    rows: &[Vec<Cell>],
    folder: &Path,
) -> anyhow::Result<Vec<Stage>> {
    let (trace, frames) = (folder.join(TRACE), folder.join("frames.csv"));
    let recorder = || {
        let columns = columns(FIELDS);
        Recorder::derived(&frames, &Header::default(), &columns, Existing::Replace)
    };
    let write = timed("write frames (CSV)", rows.len(), || {
        let mut recorder = recorder()?;
        rows.iter().try_for_each(|row| recorder.write(row))?;
        recorder.finish()?;
        Ok(rows.len())
    })?;
    let by_csv = "write frames (CSV) by csv and the standard library's numbers";
    let plain_write = timed(by_csv, rows.len(), || {
        let mut records = csv::Writer::from_path(&frames)?;
        rows.iter().try_for_each(|row| write_plainly(&mut records, row))?;
        records.flush()?;
        Ok(rows.len())
    })?;
    let replays = timed("replay a trace into frames (CSV)", rows.len(), || {
        let mut recorder = recorder()?;
        let scans = TraceReader::open(&trace)?.map(|sample| Ok(sample?.scan));
        let done = replay(calibration, scans, |row| Ok(recorder.write(row)?))?;
        recorder.finish()?;
        Ok(done)
    })?;
    let by_csv = "replay a trace into frames (CSV) by csv and the standard library's numbers";
    let plain_replay = timed(by_csv, rows.len(), || {
        let mut records = csv::Writer::from_path(&frames)?;
        let write = |row: &[Cell]| write_plainly(&mut records, row);
        let done = replay(calibration, PlainReader::open(&trace)?, write)?;
        records.flush()?;
        Ok(done)
    })?;
    Ok(vec![write, plain_write, replays, plain_replay])
}

/// Counts what a reader reads.
fn count<T, E: Into<anyhow::Error>>(
    mut read: impl Iterator<Item = Result<T, E>>,
) -> anyhow::Result<usize> {
    read.try_fold(0, |count, item| {
        black_box(item.map_err(Into::into)?);
        Ok(count + 1)
    })
}

/// Estimates every scan, as `taxel replay` does, and returns their number.
fn replay(
    calibration: &Calibration,
    scans: impl Iterator<Item = anyhow::Result<Scan>>,
    mut write: impl FnMut(&[Cell]) -> anyhow::Result<()>,
) -> anyhow::Result<usize> {
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let mut estimate = Estimate::NOTHING;
    let (mut row, wanted) = (Vec::new(), Wanted { fields: FIELDS, due: true });
    let mut done = 0;
    for (seq, scan) in (0..).zip(scans) {
        let scan = scan?;
        finger.update(&mut estimate, &mut state, &scan, wanted);
        row.clear();
        cells(&estimate.frame(&scan.codes, seq, FIELDS).into(), FIELDS, &mut row);
        write(&row)?;
        done += 1;
    }
    Ok(done)
}

/// Frames of the samples as rows of a recording.
fn rows(calibration: &Calibration, samples: &[Sample]) -> anyhow::Result<Vec<Vec<Cell>>> {
    let mut rows = Vec::new();
    replay(calibration, samples.iter().map(|sample| Ok(sample.scan)), |row| {
        rows.push(row.to_vec());
        Ok(())
    })?;
    Ok(rows)
}

/// Writes a row by the crate `csv` and the standard library's formatting of numbers.
fn write_plainly(records: &mut csv::Writer<File>, row: &[Cell]) -> anyhow::Result<()> {
    let mut text = Vec::new();
    for cell in row {
        text.clear();
        std::io::Write::write_fmt(&mut text, format_args!("{cell}"))?;
        records.write_field(&text)?;
    }
    Ok(records.write_record(None::<&[u8]>)?)
}

/// Creates an instrument that sends every scan.
fn instrument(record: &[u8]) -> anyhow::Result<Instrument> {
    let mut instrument = Instrument::new(Identity {
        board: heapless::String::new(),
        serial: heapless::String::new(),
        build: heapless::String::new(),
        scan_hz: SCAN_HZ,
        full_scale: FullScale::BITS_16,
        tick_hz: 0,
    });
    let mut store = Store::new(RamFlash::new([0; RamFlash::SIZE]));
    let installed = instrument.install(record, &mut store);
    ensure!(installed.is_ok(), "the record is rejected: {installed:?}");
    let commands =
        [Command::SetRate { hz: SCAN_HZ }, Command::SetFields(Fields::ALL), Command::Stream(true)];
    for (tag, command) in (0..).zip(commands) {
        let _ = instrument.handle(&Request { tag, command }, &mut store);
    }
    Ok(instrument)
}

/// Times the fastest of [`RUNS`] runs; each must process all frames.
fn timed(
    name: &'static str,
    frames: usize,
    mut work: impl FnMut() -> anyhow::Result<usize>,
) -> anyhow::Result<Stage> {
    let best = fastest(RUNS, || {
        let done = work()?;
        ensure!(done == frames && frames > 0, "{name}: {done} of {frames} frames");
        Ok(())
    })?;
    Ok(Stage { name, us_per_frame: best.as_secs_f64() * 1e6 / frames as f64 })
}

/// Returns the processor time of the fastest run.
fn fastest(runs: usize, mut work: impl FnMut() -> anyhow::Result<()>) -> anyhow::Result<Duration> {
    let mut best = Duration::MAX;
    for _ in 0..runs {
        let begin = spent()?;
        work()?;
        best = best.min(spent()?.saturating_sub(begin));
    }
    Ok(best)
}

/// Processor time of this process.
#[cfg(unix)]
fn spent() -> anyhow::Result<Duration> {
    use nix::time::{ClockId, clock_gettime};
    Ok(clock_gettime(ClockId::CLOCK_PROCESS_CPUTIME_ID)?.into())
}

/// Time since the first call: other systems than Unix are measured by the wall clock.
#[cfg(not(unix))]
fn spent() -> anyhow::Result<Duration> {
    static FIRST: std::sync::LazyLock<std::time::Instant> =
        std::sync::LazyLock::new(std::time::Instant::now);
    Ok(FIRST.elapsed())
}

/// Formats the table `throughput.csv`.
#[must_use]
pub fn csv(stages: &[Stage]) -> String {
    let mut table = String::from("stage,frames_per_s,us_per_frame\n");
    for Stage { name, us_per_frame } in stages {
        // Writing into a string cannot fail.
        let _ = writeln!(table, "\"{name}\",{:.0},{us_per_frame:.3}", 1e6 / us_per_frame);
    }
    table
}

/// Writes tables, picture and page into `folder`.
///
/// # Errors
/// One of them cannot be written.
pub fn write(Throughput { stages, seeks }: &Throughput, folder: &Path) -> anyhow::Result<()> {
    let bars: Vec<Bar> = stages
        .iter()
        .map(|Stage { name, us_per_frame }| Bar {
            name: (*name).to_owned(),
            long: Some(*us_per_frame),
            figures: format!("{us_per_frame:.1} µs, {:.0} thousand a second", 1e3 / us_per_frame),
            own: false,
        })
        .collect();
    let title = "What a host does with a frame, µs on one core of the machine that drew this";
    save(folder.join("throughput.csv"), csv(stages))?;
    save(folder.join("seek.csv"), seek::csv(seeks))?;
    let picture = bars::draw(title, &bars)?;
    picture.save(folder.join("throughput.svg"))?;
    save_page(folder.join("throughput.html"), "What a host can take", title, &[&picture])
}

//! Frames per second of each stage on one core of a host, for the reference finger:
//! `throughput.csv`.

use std::fmt::Write as _;
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, ensure};
use taxel::calibration::MAX_BYTES;
use taxel::finger::{Estimate, Finger, Wanted};
use taxel::frame::{Fields, Frame};
use taxel::instrument::Instrument;
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

/// Scene that every stage works on: presses, shear and slides at 1 kHz.
const SCENE: &str = "tour";
const SEED: u64 = 11;
const SCAN_HZ: u16 = 4000;
/// Fields of a replayed frame, as `taxel replay` writes by default.
const FIELDS: Fields = Fields::ESTIMATES;
/// Number of timed runs, of which the fastest counts because the machine may disturb the others.
const RUNS: usize = 5;

/// One stage with its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name of the stage.
    pub name: &'static str,
    /// Microseconds per frame.
    pub us_per_frame: f64,
}

/// Times every stage; takes some seconds.
///
/// # Errors
/// A fit failed or a file in the folder for temporary ones cannot be written.
pub fn measure(waiting: Waiting<'_>) -> anyhow::Result<Vec<Stage>> {
    let calibration = calibrated(SEED, false, waiting.stop)?;
    let mut buffer = [0; MAX_BYTES];
    let record = calibration.to_bytes(&mut buffer)?;
    let scene = scene(SCENE, SEED, false, &[])?;
    let samples: Vec<Sample> = Simulator::new(&scene, SEED).collect();
    let mut stages = vec![timed("simulate", samples.len(), || {
        Ok(Simulator::new(&scene, SEED).map(black_box).count())
    })?];

    let mut frames: Vec<Frame> = Vec::new();
    stages.push(timed("estimate, every section of the record", samples.len(), || {
        let mut instrument = instrument(record)?;
        frames.clear();
        for sample in &samples {
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

    let folder = tempfile::tempdir()?;
    let path = folder.path().join("trace.csv");
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
    stages.push(timed("write a trace (CSV)", samples.len(), || {
        let mut writer = TraceWriter::create(&path, header)?;
        samples.iter().try_for_each(|sample| writer.write(sample))?;
        writer.finish()?;
        Ok(samples.len())
    })?);
    stages.push(timed("read a trace (CSV)", samples.len(), || {
        let mut read = 0;
        for sample in TraceReader::open(&path)? {
            black_box(sample?);
            read += 1;
        }
        Ok(read)
    })?);

    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let mut rows: Vec<Vec<Cell>> = Vec::new();
    for (seq, sample) in (0..).zip(&samples) {
        let estimate = finger.estimate(&mut state, &sample.scan);
        let mut row = Vec::new();
        cells(&estimate.frame(&sample.scan.codes, seq, FIELDS).into(), FIELDS, &mut row);
        rows.push(row);
    }
    let frames = folder.path().join("frames.csv");
    let recorder = || {
        let columns = columns(FIELDS);
        Recorder::derived(&frames, &Header::default(), &columns, Existing::Replace)
    };
    stages.push(timed("write frames (CSV)", rows.len(), || {
        let mut recorder = recorder()?;
        rows.iter().try_for_each(|row| recorder.write(row))?;
        recorder.finish()?;
        Ok(rows.len())
    })?);
    stages.push(timed("write frames (CSV) by the standard library's numbers", rows.len(), || {
        let mut records = csv::Writer::from_path(&frames)?;
        let mut text = Vec::new();
        for row in &rows {
            for cell in row {
                text.clear();
                std::io::Write::write_fmt(&mut text, format_args!("{cell}"))?;
                records.write_field(&text)?;
            }
            records.write_record(None::<&[u8]>)?;
        }
        records.flush()?;
        Ok(rows.len())
    })?);
    stages.push(timed("replay a trace into frames (CSV)", samples.len(), || {
        let mut recorder = recorder()?;
        let (finger, mut state) = Finger::new(Some(calibration.clone()));
        let mut estimate = Estimate::NOTHING;
        let (mut row, wanted) = (Vec::new(), Wanted { fields: FIELDS, due: true });
        let mut done = 0;
        for (seq, sample) in (0..).zip(TraceReader::open(&path)?) {
            let scan = sample?.scan;
            finger.update(&mut estimate, &mut state, &scan, wanted);
            row.clear();
            cells(&estimate.frame(&scan.codes, seq, FIELDS).into(), FIELDS, &mut row);
            recorder.write(&row)?;
            done += 1;
        }
        recorder.finish()?;
        Ok(done)
    })?);
    Ok(stages)
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
    let mut best = Duration::MAX;
    for _ in 0..RUNS {
        let begin = Instant::now();
        let done = work()?;
        best = best.min(begin.elapsed());
        ensure!(done == frames && frames > 0, "{name}: {done} of {frames} frames");
    }
    Ok(Stage { name, us_per_frame: best.as_secs_f64() * 1e6 / frames as f64 })
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

/// Writes table, picture and page into `folder`.
///
/// # Errors
/// One of them cannot be written.
pub fn write(stages: &[Stage], folder: &Path) -> anyhow::Result<()> {
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
    let picture = bars::draw(title, &bars)?;
    picture.save(folder.join("throughput.svg"))?;
    save_page(folder.join("throughput.html"), "What a host can take", title, &[&picture])
}

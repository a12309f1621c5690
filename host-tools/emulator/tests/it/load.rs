//! Tests of the flashed images' load with wait states: the share of time that the core is awake.
//!
//! The record of the reference finger's default fit is in the finger. Each scene is the recorded
//! run of its kind after a stretch without contact.

use std::path::PathBuf;

use cycles::kinds::{KINDS, Kind, PERIOD, UNTOUCHED};
use scan_plan::settle;
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::frame::{Fields, Frame};
use taxel::scan::{Codes, Scan, ScanSettings};
use taxel::units::FullScale;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::{Command, Counters, Message};
use taxel_files::trace::TraceReader;

use taxel_emulator::board::capture::Kind as Transfer;

use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::{HZ, Tick, micros};

use crate::page;
use crate::support::{self, info, name, repository};

/// Time over which a load is averaged: 40 scans at 4 kHz.
const WINDOW: Tick = micros(10_000);
/// Settings for 8 kHz: two samples a reading, and the settle time of the board's load.
pub const EIGHT_KHZ: ScanSettings =
    ScanSettings { scan_hz: 8000, oversampling: 2, settle_ns: settle::ON_LOAD_NS };

/// Path of the calibration and of the recorded runs.
fn whole() -> PathBuf {
    repository().join("host-tools/emulator/data/whole")
}

/// Record of the reference finger's default fit.
pub fn calibration() -> Calibration {
    taxel_files::calibration::read(whole().join("finger.cal.toml")).unwrap()
}

/// Recorded scans of a kind of scene.
pub fn scans(kind: &Kind) -> impl Iterator<Item = Scan> + use<> {
    let path = whole().join(kind.name.replace(' ', "-")).with_extension("csv");
    TraceReader::open(&path).unwrap().map(|sample| sample.unwrap().scan)
}

/// Recorded scans of a kind of scene, in codes of 12 bits.
pub fn run(kind: &Kind) -> Vec<Codes> {
    scans(kind).map(|scan| scan.codes.rescaled(FullScale::BITS_12)).collect()
}

/// Session with the record of a default fit that streams estimates.
pub fn session(model: Model, scan: Option<ScanSettings>, hz: u16) -> Session {
    let mut session = support::session(model, true);
    let mut record = [0; MAX_BYTES];
    session.upload(calibration().to_bytes(&mut record).unwrap()).unwrap();
    let scan = scan.map(Command::SetScan);
    let usual = [Command::SetFields(Fields::ESTIMATES), Command::SetRate { hz }];
    for command in scan.into_iter().chain(usual).chain([Command::Stream(true)]) {
        session.ask(command).unwrap();
    }
    session
}

/// Load of the core in a scene.
struct Load {
    scene: &'static str,
    /// Mean load, and the mean without the waits for the flash.
    mean: [f64; 2],
    /// Largest load of a window.
    worst: f64,
    /// Scans that did not reach the session, and frames that did not reach the host.
    lost: [u32; 2],
}

/// Shows a scene as fast as it was recorded, and measures from the begin of its run on.
fn load(session: &mut Session, kind: &Kind, hz: u64) -> Load {
    let nothing = self::run(&KINDS[0]);
    let times = (hz * PERIOD / 1_000_000) as usize;
    let run: Vec<Codes> =
        self::run(kind).into_iter().flat_map(|scan| std::iter::repeat_n(scan, times)).collect();
    let windows = run.len() as u64 * HZ / hz / WINDOW;
    let scene = nothing.into_iter().cycle().take(UNTOUCHED).chain(run).collect();
    session.board.finger().show(scene);
    session.run(UNTOUCHED as u64 * HZ / hz).unwrap();
    let before = info(session).counters;
    session.frames.clear();
    let awake = |session: &Session| session.board.now() - session.board.slept();
    let (begin, mut loads) = ([awake(session), session.board.waits()], Vec::new());
    let clock = session.board.chip().hclk();
    for _ in 0..windows {
        let (awoken, now) = (awake(session), session.board.now());
        session.run(WINDOW).unwrap();
        loads.push((awake(session) - awoken) as f64 / (session.board.now() - now) as f64);
    }
    let of_kind = session.frames.iter().filter(|(_, frame)| kind.holds(frame.status)).count();
    let frames = session.frames.len();
    println!("{}: {of_kind} of {frames} frames are of the kind", kind.name);
    assert!(of_kind > 0, "{}: no frame is of the kind", kind.name);
    let waits = (session.board.waits() - begin[1]) * clock;
    let time = (windows * WINDOW) as f64;
    let mean = (awake(session) - begin[0]) as f64 / time;
    let after = info(session).counters;
    let lost = |counters: Counters| [counters.overruns, counters.lost];
    let lost = [0, 1].map(|i| lost(after)[i] - lost(before)[i]);
    let worst = loads.into_iter().fold(0.0, f64::max);
    Load { scene: kind.name, mean: [mean, mean - waits as f64 / time], worst, lost }
}

/// Measures all scenes and prints the table.
///
/// Fails where the page states another load, and where a scene of [`KINDS`] has a larger load than
/// `most`, or loses more scans or frames than `most` has for it.
fn holds(model: Model, scan: Option<ScanSettings>, hz: u16, most: [(f64, u32); KINDS.len()]) {
    let mut session = session(model, scan, hz);
    let scan_hz = scan.map_or(4000, |scan| u64::from(scan.scan_hz));
    println!("{}, {scan_hz} Hz of scans, {hz} Hz of frames:", name(model));
    println!(
        "| scene | mean load | without wait states | worst 10 ms | scans lost | frames lost |"
    );
    println!("|---|---|---|---|---|---|");
    let (mut broken, mut rows) = (Vec::new(), Vec::new());
    for (kind, (most, most_lost)) in KINDS.into_iter().zip(most) {
        let Load { scene, mean: [mean, ideal], worst, lost: [scans, frames] } =
            load(&mut session, &kind, scan_hz);
        let [mean, ideal, worst] = [mean, ideal, worst].map(|share| 100.0 * share);
        println!("| {scene} | {mean:.0} % | {ideal:.0} % | {worst:.0} % | {scans} | {frames} |");
        let row = format!("{scene}, {} kHz, frames at {} kHz", scan_hz / 1000, hz / 1000);
        let [mean, ideal, worst_share] = [mean, ideal, worst].map(|share| format!("{share:.0} %"));
        // How many scans an overloaded core loses depends on single bytes of the image.
        let at_most = if scans == 0 { 0 } else { most_lost };
        rows.push((row, [mean, ideal, worst_share, at_most.to_string()]));
        if scans + frames > most_lost || worst > 100.0 * most {
            broken.push(scene);
        }
    }
    rows.iter().for_each(|(row, cells)| _ = page::row(model, row, cells));
    assert!(broken.is_empty(), "lost too much or exceeds its load: {broken:?}");
}

#[test]
fn g431_streams_at_4_khz_without_loss() {
    holds(G431, None, 4000, [(0.52, 0), (1.0, 0), (1.0, 0), (1.0, 0)]);
}

#[test]
fn g431_scans_untouched_at_8_khz_in_four_fifths_of_its_time() {
    holds(G431, Some(EIGHT_KHZ), 4000, [(0.8, 0), (1.0, 0), (1.0, 130), (1.0, 140)]);
}

#[test]
fn f411_sends_1000_frames_without_a_loss() {
    holds(F411, None, 1000, [(1.0, 0); KINDS.len()]);
}

/// Frames on the bus, each with the time at which its first byte has arrived.
fn arrivals(session: &mut Session) -> Vec<(Tick, Frame)> {
    let mut deframer: Deframer = Deframer::default();
    let (mut first, mut frames) = (None, Vec::new());
    for urb in session.board.host().capture.iter_mut().flat_map(std::mem::take) {
        let sent = urb.kind == Transfer::Bulk && urb.endpoint & 0x80 != 0;
        for byte in urb.data.into_iter().filter(|_| sent) {
            let at = *first.get_or_insert(urb.done);
            let Some(message) = deframer.push::<Message>(byte) else { continue };
            if let Ok(Message::Frame(frame)) = message {
                frames.push((at, frame));
            }
            first = None;
        }
    }
    frames
}

/// Returns the longest time from a scan's end to the first byte of its frame, in a touch that
/// begins so many scans after the session.
fn touch_delay(scan: Option<ScanSettings>, untouched: usize) -> Tick {
    let mut session = session(G431, scan, 4000);
    let scan_hz = scan.map_or(4000, |scan| u64::from(scan.scan_hz));
    // The device's clock, compared with the world's by codes that a converter and a frame hold.
    session.board.finger().seen.clear();
    let mut frames = support::stream_codes(&mut session, micros(10_000));
    frames.retain(|(_, frame)| frame.codes.is_some());
    let divider = (scan_hz / 4000) as usize;
    let seen = &session.board.finger().seen;
    let first = &seen[support::first_seen(seen, &frames[2..], divider)];
    let offset = first.begin - frames[2].1.time.0 * micros(1);
    let estimates = [Command::SetFields(Fields::ESTIMATES), Command::Stream(true)];
    estimates.into_iter().for_each(|command| drop(session.ask(command).unwrap()));

    let (nothing, touch) = (run(&KINDS[0]), run(&KINDS[1]));
    let scene = nothing.into_iter().cycle().take(untouched).chain(touch).collect();
    let begin = session.board.now();
    session.board.finger().show(scene);
    session.run(untouched as u64 * HZ / scan_hz + micros(20_000)).unwrap();
    let period = HZ / scan_hz;
    let after_scan: Vec<Tick> = arrivals(&mut session)
        .into_iter()
        .map(|(at, frame)| (at, frame.time.0 * micros(1) + offset + period))
        .filter(|(_, end)| *end > begin + untouched as u64 * period)
        .map(|(at, end)| at - end)
        .collect();
    assert!(after_scan.len() > 60, "{} frames", after_scan.len());
    after_scan.into_iter().max().unwrap_or_default()
}

/// Fails if a touch takes longer than `most_us` on average to the first byte of its frame.
fn touch_arrives_within(scan: Option<ScanSettings>, most_us: f64) {
    let scan_hz = scan.map_or(4000, |scan| u64::from(scan.scan_hz));
    let period = HZ / scan_hz;
    // How long the first fit takes depends on what the finger has seen before.
    let delays: Vec<Tick> = (0..4).map(|i| touch_delay(scan, UNTOUCHED + i)).collect();
    let us = |time: Tick| time as f64 / micros(1) as f64;
    println!("{:?} µs", delays.iter().map(|delay| us(*delay)).collect::<Vec<_>>());
    let worst = delays.into_iter().max().map_or(0.0, us);
    // A touch comes at any time of a scan.
    let (mean, most) = (us(period) / 2.0 + worst, us(period) + worst);
    println!(
        "{scan_hz} Hz: first byte {worst:.0} µs after the scan at most; after a touch {mean:.0} µs on \
         average, {most:.0} µs at most"
    );
    let row = format!("touch to the first byte, {} kHz", scan_hz / 1000);
    page::row(G431, &row, &[worst, mean, most].map(|us| format!("{us:.0} µs")));
    assert!(mean <= most_us, "{mean:.0} µs, at most {most_us}");
}

#[test]
fn touch_reaches_usb_within_370_us_at_4_khz() {
    touch_arrives_within(None, 370.0);
}

//! Tests of the flashed images' load with wait states: the share of time that the core is awake.
//!
//! A default fit's record is in the finger, with every section. Each scene is the recorded run of
//! its kind after a stretch without contact.

use cycles::kinds::{KINDS, Kind};
use taxel::calibration::MAX_BYTES;
use taxel::frame::Fields;
use taxel::scan::{Codes, ScanSettings};
use taxel::wire::message::{Command, Counters};
use taxel_files::trace::TraceReader;

use taxel_emulator::board::finger::in_12_bits;
use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::{HZ, Tick, micros};

use crate::support::{self, info, name, repository};

/// Scans without contact before a run, enough for the vibration detector to learn its noise floor.
const UNTOUCHED: usize = 880;
/// Time over which a load is averaged: 40 scans at 4 kHz.
const WINDOW: Tick = micros(10_000);

/// Recorded scans of a kind of scene, in codes of 12 bits.
fn run(kind: &Kind) -> Vec<Codes> {
    let whole = repository().join("host-tools/emulator/data/whole");
    let path = whole.join(kind.name.replace(' ', "-")).with_extension("csv");
    let scans = TraceReader::open(&path).unwrap().map(|sample| sample.unwrap().scan.codes);
    scans.map(in_12_bits).collect()
}

/// Session with the record of a default fit that streams estimates.
fn session(model: Model, scan: Option<ScanSettings>, hz: u16) -> Session {
    let mut session = support::session(model, false);
    let path = repository().join("host-tools/emulator/data/whole/finger.cal.toml");
    let calibration = taxel_files::calibration::read(&path).unwrap();
    let mut record = [0; MAX_BYTES];
    session.upload(calibration.to_bytes(&mut record).unwrap()).unwrap();
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

/// Shows a scene and measures from the begin of its run on.
fn load(session: &mut Session, kind: &Kind, hz: u64) -> Load {
    let (nothing, run) = (self::run(&KINDS[0]), self::run(kind));
    let windows = run.len() as u64 * HZ / hz / WINDOW;
    let scene = nothing.into_iter().cycle().take(UNTOUCHED).chain(run).collect();
    session.board.finger().show(scene);
    session.run(UNTOUCHED as u64 * HZ / hz).unwrap();
    let before = info(session).counters;
    let awake = |session: &Session| session.board.now() - session.board.slept();
    let (begin, mut loads) = ([awake(session), session.board.waits()], Vec::new());
    let clock = session.board.chip().hclk();
    for _ in 0..windows {
        let (awoken, now) = (awake(session), session.board.now());
        session.run(WINDOW).unwrap();
        loads.push((awake(session) - awoken) as f64 / (session.board.now() - now) as f64);
    }
    let waits = (session.board.waits() - begin[1]) * clock;
    let time = (windows * WINDOW) as f64;
    let mean = (awake(session) - begin[0]) as f64 / time;
    let after = info(session).counters;
    let lost = |counters: Counters| [counters.overruns, counters.lost];
    let lost = [0, 1].map(|i| lost(after)[i] - lost(before)[i]);
    let worst = loads.into_iter().fold(0.0, f64::max);
    Load { scene: kind.name, mean: [mean, mean - waits as f64 / time], worst, lost }
}

/// Measures all scenes and prints the table; fails where a scan is lost or the load exceeds `most`.
fn holds(model: Model, scan: Option<ScanSettings>, hz: u16, most: f64) {
    let mut session = session(model, scan, hz);
    let scan_hz = scan.map_or(4000, |scan| u64::from(scan.scan_hz));
    println!("{}, {scan_hz} Hz of scans, {hz} Hz of frames:", name(model));
    println!(
        "| scene | mean load | without wait states | worst 10 ms | scans lost | frames lost |"
    );
    println!("|---|---|---|---|---|---|");
    let mut broken = Vec::new();
    for kind in KINDS {
        let Load { scene, mean: [mean, ideal], worst, lost: [scans, frames] } =
            load(&mut session, &kind, scan_hz);
        let [mean, ideal, worst] = [mean, ideal, worst].map(|share| 100.0 * share);
        println!("| {scene} | {mean:.0} % | {ideal:.0} % | {worst:.0} % | {scans} | {frames} |");
        if scans + frames > 0 || worst > 100.0 * most {
            broken.push(scene);
        }
    }
    assert!(broken.is_empty(), "lost a scan or exceeds {:.0} %: {broken:?}", 100.0 * most);
}

#[test]
fn g431_streams_4_khz_in_two_thirds_of_its_time() {
    holds(G431, None, 4000, 0.65);
}

#[test]
fn g431_scans_at_8_khz_in_four_fifths_of_its_time() {
    let scan = ScanSettings { scan_hz: 8000, oversampling: 1, settle_ns: 18_000 };
    holds(G431, Some(scan), 4000, 0.8);
}

#[test]
fn f411_sends_1000_frames_without_a_loss() {
    holds(F411, None, 1000, 1.0);
}

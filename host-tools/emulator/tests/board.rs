//! The very image that is flashed, `cargo xtask firmware stm32g431`.

use std::path::{Path, PathBuf};

use taxel::frame::{Fields, Frame, Status};
use taxel::scan::Codes;
use taxel::units::{Code, FullScale};
use taxel::wire::message::{Command, Info, Reset, Response};
use taxel_formats::trace::TraceReader;

use taxel_emulator::board::chip::Chip;
use taxel_emulator::board::cpu::Board;
use taxel_emulator::board::finger::Finger;
use taxel_emulator::board::host::Host;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::{Tick, micros};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn image() -> Vec<u8> {
    let directory = std::env::var_os("TAXEL_FIRMWARE_DIR").map(PathBuf::from);
    let directory = directory.unwrap_or_else(|| repository().join("boards/target/firmware"));
    let path = directory.join("stm32g431.elf");
    std::fs::read(&path).unwrap_or_else(|error| {
        panic!("{}: {error}; build it with `cargo xtask firmware stm32g431`", path.display())
    })
}

/// Scans of a finger that is touched now and then, in codes of 12 bits.
fn scene() -> Vec<Codes> {
    let trace = repository().join("host-tools/emulator/data/scans.csv");
    let scans = TraceReader::open(&trace).unwrap().map(|sample| sample.unwrap().scan.codes);
    scans.map(in_12_bits).collect()
}

fn in_12_bits(codes: Codes) -> Codes {
    let scale = 4095.0 / f32::from(codes.full_scale.top().0);
    let code = |code: Code| Code((f32::from(code.0) * scale).round() as u16);
    let mut codes = codes;
    codes.full_scale = FullScale::BITS_12;
    if let Some(taxels) = &mut codes.taxels {
        taxels.lit = taxels.lit.map(|row| row.map(code));
        taxels.dark = taxels.dark.map(code);
    }
    for midpoints in codes.bridges.iter_mut().flatten() {
        for midpoint in [&mut midpoints.a, &mut midpoints.b, &mut midpoints.c, &mut midpoints.d] {
            *midpoint = code(*midpoint);
        }
    }
    codes.reference = codes.reference.map(code);
    codes.temperature = codes.temperature.map(code);
    codes
}

fn session(capture: bool) -> Session {
    let board = Board::new(&image(), Finger::new(scene()), Host::new(capture)).unwrap();
    Session::open(board).unwrap()
}

fn info(session: &mut Session) -> Info {
    match session.ask(Command::Info).unwrap() {
        Response::Info(info) => info,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_image_boots_enumerates_and_streams_a_second_without_a_loss() {
    let mut session = session(false);
    session.ask(Command::SetFields(Fields::ALL)).unwrap();
    let before = info(&mut session);
    assert_eq!((before.identity.board.as_str(), before.identity.scan_hz), ("stm32g431", 4000));
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(1_000_000)).unwrap();
    let after = info(&mut session);

    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    assert_eq!(health.reset, Reset::Power);
    assert_eq!(health.panic, None);
    assert_eq!(after.counters.lost, 0);
    assert_eq!(after.counters.overruns, before.counters.overruns);
    assert_eq!(after.counters.bad_packets, 0);
    assert_eq!(session.bad, 0);
    assert!((1000..1010).contains(&session.frames.len()), "{} frames", session.frames.len());
    for pair in session.frames.windows(2) {
        let [(_, a), (_, b)] = pair else { panic!() };
        assert_eq!(b.seq, a.seq + 1);
        assert!((999..=1001).contains(&(b.time.0 - a.time.0)), "{} to {}", a.time.0, b.time.0);
        assert!(!b.status.contains(Status::OVERRUN));
    }
}

#[test]
fn what_is_streamed_is_what_the_converters_saw() {
    let mut session = session(false);
    session.ask(Command::SetFields(Fields::CODES)).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(300_000)).unwrap();
    let frames = std::mem::take(&mut session.frames);
    assert!(frames.len() > 290);
    first_seen(session.board.chip(), &frames, 4);
}

/// The scan of the first frame among those that the converters saw, where every later frame is `divider`
/// scans after the one before.
fn first_seen(chip: &Chip, frames: &[(Tick, Frame)], divider: usize) -> usize {
    let seen = &chip.finger.seen;
    let fits = |first: &usize| {
        let scans = seen.iter().skip(*first).step_by(divider);
        frames.iter().zip(scans).all(|((_, frame), seen)| frame.codes == Some(seen.codes))
    };
    let last = seen.len() - divider * (frames.len() - 1);
    (0..last)
        .find(fits)
        .expect("the codes of all frames, in order, are among those that were converted")
}

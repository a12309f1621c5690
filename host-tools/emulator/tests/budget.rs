//! What the very image that is flashed leaves of a frame when everything in it is at work, and what the
//! board's page says of it.

use std::path::{Path, PathBuf};

use scan_plan::g431::CLOCK_HZ;
use taxel::calibration::MAX_BYTES;
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Status};
use taxel::wire::message::{Command, Response};
use taxel_formats::trace::TraceReader;

use taxel_emulator::board::cpu::Board;
use taxel_emulator::board::finger::{Finger, Pace, in_12_bits};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::micros;

/// Cycles of a frame.
const FRAME: u32 = CLOCK_HZ / 4000;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A finger with every section of a record, each at its dearest, that streams every scan.
fn session(fields: Fields) -> Session {
    let directory = std::env::var_os("TAXEL_FIRMWARE_DIR").map(PathBuf::from);
    let directory = directory.unwrap_or_else(|| repository().join("boards/target/firmware"));
    let image = std::fs::read(directory.join("stm32g431.elf"))
        .expect("the firmware: build it with `cargo xtask firmware stm32g431`");
    let trace = repository().join("host-tools/emulator/data/scans.csv");
    let scans = TraceReader::open(&trace).unwrap().map(|sample| sample.unwrap().scan.codes);
    let finger = Finger::new(scans.map(in_12_bits).collect(), Pace::Scans);
    let mut session = Session::open(Board::new(&image, finger, Host::new(false)).unwrap()).unwrap();

    let path = repository().join("host-tools/cli/assets/virtual-finger.cal.toml");
    let calibration = cycles::dearest(&taxel_formats::calibration::read(&path).unwrap());
    let mut record = [0; MAX_BYTES];
    session.upload(calibration.to_bytes(&mut record).unwrap()).unwrap();
    for command in [
        Command::SetPointMethod(PointMethod::ArgMin),
        Command::SetFields(fields),
        Command::SetRate { hz: 4000 },
        Command::Stream(true),
    ] {
        session.ask(command).unwrap();
    }
    session.run(micros(300_000)).unwrap();
    let ran = Status::RAN_NET.0 | Status::RAN_ARRAY.0 | Status::RAN_SLIP.0 | Status::RAN_SENSORS.0;
    assert!(session.frames.iter().any(|(_, frame)| frame.status.0 & ran == ran));
    session
}

/// Worst so far of reading, estimating and sending a scan.
fn worst(session: &mut Session) -> [u32; 3] {
    let Response::Info(info) = session.ask(Command::Info).unwrap() else { panic!() };
    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    [health.reading.unwrap(), info.cost, health.sending.unwrap()].map(|cost| cost.worst)
}

/// The number of cycles in the page's row of this name.
fn stated(row: &str) -> u32 {
    let page = std::fs::read_to_string(repository().join("docs/boards/stm32g431.md")).unwrap();
    let line = page.lines().find(|line| line.starts_with(&format!("| {row} |")));
    let cell = line.unwrap_or_else(|| panic!("no row `{row}`")).split('|').nth(2).unwrap();
    cell.chars().filter(char::is_ascii_digit).collect::<String>().parse().unwrap()
}

/// Another compiler version shuffles instructions.
fn agrees(row: &str, cycles: u32) {
    let (stated, cycles) = (f64::from(stated(row)), f64::from(cycles));
    assert!((0.95..=1.05).contains(&(cycles / stated)), "{row}: {cycles}, the page says {stated}");
}

#[test]
fn the_dearest_frame_takes_less_than_half_of_its_time() {
    let mut session = session(Fields::ESTIMATES);
    let [reading, estimating, sending] = worst(&mut session);
    // The frame's own interrupt comes once a frame, and has come in the middle of the worst of the others.
    let frame = estimating + sending;
    assert!(frame < FRAME / 2, "{estimating} + {sending} of {FRAME}");
    agrees("reading: the frame's interrupt", reading);
    agrees("estimating, interrupted", estimating);
    agrees("sending the estimates, interrupted", sending);
    agrees("**a frame of estimates**", frame);

    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    let (deepest, _) = health.stack.unwrap();
    let page = "stack, the deepest that the machine code can take";
    assert!(f64::from(deepest) <= 1.05 * 1024.0 / 10.0 * f64::from(stated(page)), "{deepest}");

    // All that the core does, the executor and USB included.
    let before = (session.board.now(), session.board.cycles());
    session.run(micros(200_000)).unwrap();
    let frames = (session.board.now() - before.0) / micros(250);
    let mean = ((session.board.cycles() - before.1) / frames) as u32;
    assert!(mean < FRAME, "{mean} of {FRAME}");
    agrees("all that the core does, mean of a frame", mean);

    // The last scan of a self-test has all the channels' roots to take: once, within its frame.
    session.ask(Command::SelfTest { scans: 100 }).unwrap();
    let [_, tested, _] = worst(&mut session);
    assert!(tested < FRAME, "{tested} of {FRAME}");
    agrees("the last scan of a self-test", tested);
}

#[test]
fn every_field_of_every_scan_is_more_than_usb_carries_but_not_more_than_the_core_does() {
    let mut session = session(Fields::ALL);
    let [_, estimating, sending] = worst(&mut session);
    assert!(estimating + sending < FRAME, "{estimating} + {sending} of {FRAME}");
    agrees("a frame with every field", estimating + sending);
    let Response::Info(info) = session.ask(Command::Info).unwrap() else { panic!() };
    assert!(info.counters.lost > 0, "USB carries it: then half a frame is its budget, too");
}

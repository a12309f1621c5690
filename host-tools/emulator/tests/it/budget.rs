//! Tests of the flashed image's cycles per frame against the limits and the board's page.
//!
//! They run without wait states, as the page's table does.

use scan_plan::g431::CLOCK_HZ;
use taxel::calibration::MAX_BYTES;
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Status};
use taxel::wire::message::{Command, Request, Response};
use taxel::wire::{MAX_PACKET, pack};

use taxel_emulator::board::model::Model::G431;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::micros;
use taxel_emulator::fetch::Settings;

use crate::support::{self, repository, stated};

/// Cycles in a frame at 4 kHz.
const FRAME: u32 = CLOCK_HZ / 4000;

/// Session with the costliest calibration record, filter and stream of every scan.
fn session(fields: Fields) -> Session {
    let mut session = support::session(G431, false);
    session.board.clock().fetch().fix(Settings::default());
    let path = repository().join("host-tools/cli/assets/virtual-finger.cal.toml");
    let calibration = cycles::dearest(&taxel_files::calibration::read(&path).unwrap());
    let mut record = [0; MAX_BYTES];
    session.upload(calibration.to_bytes(&mut record).unwrap()).unwrap();
    for command in [
        Command::SetPointMethod(PointMethod::ArgMin),
        Command::SetFilter { hz: 300 },
        Command::SetFields(fields),
        Command::SetRate { hz: 4000 },
        Command::Stream(true),
    ] {
        session.ask(command).unwrap();
    }
    session.run(micros(300_000)).unwrap();
    let ran = Status::RAN_NET | Status::RAN_ARRAY | Status::RAN_SLIP | Status::RAN_SENSORS;
    assert!(session.frames.iter().any(|(_, frame)| frame.status.contains(ran)));
    session
}

/// Worst cycles so far to read, estimate and send a scan.
fn worst(session: &mut Session) -> [u32; 3] {
    let Response::Info(info) = session.ask(Command::Info).unwrap() else { panic!() };
    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    [health.reading.unwrap(), info.cost, health.sending.unwrap()].map(|cost| cost.worst)
}

/// Checks that the cycles match the page's row within 5 % and stay below its limit.
///
/// The 5 % are for instructions that differ between compiler versions.
fn agrees(row: &str, cycles: u32) {
    let (stated, most) = stated(row);
    let share = f64::from(cycles) / f64::from(stated);
    assert!((0.95..=1.05).contains(&share), "{row}: {cycles}, the page says {stated}");
    let most = most.unwrap_or_else(|| panic!("{row}: how much it may take at most"));
    let share = 100.0 * f64::from(cycles) / f64::from(FRAME);
    assert!(share < f64::from(most), "{row}: {share:.1} % of a frame, at most {most}");
}

/// Mean cycles per frame that the core is awake, with executor and USB.
fn mean(session: &mut Session) -> u32 {
    let before = (session.board.now(), session.board.cycles());
    session.run(micros(200_000)).unwrap();
    let frames = (session.board.now() - before.0) / micros(250);
    ((session.board.cycles() - before.1) / frames) as u32
}

#[test]
fn costliest_frame_takes_less_than_half_a_frame() {
    let mut session = session(Fields::ESTIMATES);
    let [reading, estimating, sending] = worst(&mut session);
    agrees("reading: the frame's interrupt", reading);
    agrees("estimating, interrupted", estimating);
    agrees("sending the estimates, interrupted", sending);

    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    let (deepest, _) = health.stack.unwrap();
    let seen = f64::from(deepest) / 1024.0;
    let (bound, stated) = support::stack("stm32g431");
    assert!(seen <= bound && (seen / stated - 1.0).abs() < 0.05, "{seen:.1} KB of {bound}");

    agrees("all that the core does, mean of a frame", mean(&mut session));
    session.ask(Command::SetRate { hz: 1000 }).unwrap();
    agrees("all that it does at the default, a frame every millisecond", mean(&mut session));
    session.ask(Command::SetRate { hz: 4000 }).unwrap();

    // This bias takes longer than the test.
    let command = Command::TakeBias { scans: u16::MAX };
    let mut buffer = [0; MAX_PACKET];
    let packet = pack(&Request { tag: 0, command }, &mut buffer).unwrap();
    session.board.host().send(packet);
    session.run(micros(100_000)).unwrap();
    let [_, biasing, sending] = worst(&mut session);
    assert!(biasing > estimating, "no bias is being taken");
    agrees("the same while a bias is taken", biasing);
    // The frame's own interrupt occurs once a frame, and the worst cases include it.
    let frame = biasing + sending;
    assert!(frame < FRAME / 2, "{biasing} + {sending} of {FRAME}");
    agrees("**a frame of estimates**", frame);
}

#[test]
fn full_stream_exceeds_usb_but_not_the_core() {
    let mut session = session(Fields::ALL);
    let [_, estimating, sending] = worst(&mut session);
    agrees("a frame with every field", estimating + sending);
    let Response::Info(info) = session.ask(Command::Info).unwrap() else { panic!() };
    assert!(
        info.counters.lost > 0,
        "USB carries every frame, so half a frame is the limit here too"
    );

    // The last scan of a self-test computes all channels' square roots, once and within its frame.
    session.ask(Command::SelfTest { scans: 100 }).unwrap();
    let [_, tested, _] = worst(&mut session);
    agrees("the last scan of a self-test", tested);
}

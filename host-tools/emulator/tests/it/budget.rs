//! Tests of the flashed image's cycles per frame against the limits and the board's page.
//!
//! They run twice: as flashed, and without wait states.

use scan_plan::g431::CLOCK_HZ;
use taxel::calibration::MAX_BYTES;
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::{Fields, Status};
use taxel::wire::message::{Command, Request};
use taxel::wire::{MAX_PACKET, pack};

use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::micros;
use taxel_emulator::fetch::Settings;

use crate::page::{self, thousands};
use crate::support::{self, repository};

/// Cycles in a frame at 4 kHz.
const FRAME: u32 = CLOCK_HZ / 4000;

/// Session with the costliest calibration record, filter and stream; `ideal` has no wait states.
fn session(board: Model, ideal: bool, fields: Fields, hz: u16) -> Session {
    let mut session = support::session(board, false);
    if ideal {
        session.board.clock().fetch().fix(Settings::default());
    }
    let path = repository().join("host-tools/cli/assets/virtual-finger.cal.toml");
    let calibration = cycles::costliest(&taxel_files::calibration::read(&path).unwrap());
    let mut record = [0; MAX_BYTES];
    session.upload(calibration.to_bytes(&mut record).unwrap()).unwrap();
    for command in [
        Command::SetPointMethod(PointMethod::ArgMin),
        Command::SetFilter { hz: 300 },
        Command::SetFields(fields),
        Command::SetRate { hz },
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
    let info = support::info(session);
    let health = support::health(session);
    [health.reading.unwrap(), info.cost, health.sending.unwrap()].map(|cost| cost.worst)
}

/// Cycles of each row, with or without wait states.
type Rows = Vec<(&'static str, u32)>;

/// Compares the rows with the page, and each figure without wait states with the row's limit.
fn agree(board: Model, frame: u32, [flashed, ideal]: [Rows; 2]) {
    for ((row, flashed), (_, ideal)) in flashed.into_iter().zip(ideal) {
        let cells = [flashed, ideal].map(|cycles| {
            let share = 100.0 * f64::from(cycles) / f64::from(frame);
            [thousands(cycles), format!("{share:.0} %")]
        });
        let most = page::row(board, row, cells.as_flattened());
        let most = most.unwrap_or_else(|| panic!("{row}: how much it may take at most"));
        let share = 100.0 * f64::from(ideal) / f64::from(frame);
        assert!(share < most, "{row}: {share:.1} % of a frame, at most {most}");
        assert!(flashed < frame, "{row}: {flashed} cycles with wait states, a frame has {frame}");
    }
}

/// Measures with the wait states that the image sets, and without.
fn both(measure: fn(bool) -> Rows) -> [Rows; 2] {
    [false, true].map(measure)
}

/// Mean cycles per scan that the core is awake, with executor and USB.
fn mean(session: &mut Session) -> u32 {
    let before = (session.board.now(), session.board.slept());
    session.run(micros(200_000)).unwrap();
    let (time, slept) = (session.board.now() - before.0, session.board.slept() - before.1);
    let awake = (time - slept) / session.board.chip().hclk();
    (awake / (time / micros(250))) as u32
}

/// Starts a bias that takes longer than the test.
fn take_bias(session: &mut Session) {
    let command = Command::TakeBias { scans: u16::MAX };
    let mut buffer = [0; MAX_PACKET];
    let packet = pack(&Request { tag: 0, command }, &mut buffer).unwrap();
    session.board.host().send(packet);
    session.run(micros(100_000)).unwrap();
}

/// Rows of a frame: reading, estimating, the same while a bias is taken, sending, their sum.
fn frame(session: &mut Session) -> Rows {
    let [reading, estimating, sending] = worst(session);
    take_bias(session);
    let [_, biasing, sent] = worst(session);
    assert!(biasing > estimating, "no bias is being taken");
    vec![
        ("reading: the frame's interrupt", reading),
        ("estimating, interrupted", estimating),
        ("the same while a bias is taken", biasing),
        ("sending the estimates, interrupted", sending),
        // The frame's own interrupt occurs once a frame, and the worst cases include it.
        ("**a frame of estimates**", biasing + sent),
    ]
}

/// Compares the deepest stack so far with the images' table.
fn has_its_stated_stack(session: &mut Session, board: Model) {
    let health = support::health(session);
    let (deepest, _) = health.stack.unwrap();
    let seen = f64::from(deepest) / 1024.0;
    let (bound, stated) = support::stack(support::name(board));
    let off = (seen / stated - 1.0).abs();
    assert!(seen <= bound && off < 0.05, "{seen:.1} KB, stated {stated}, at most {bound}");
}

#[test]
fn costliest_frame_takes_about_half_a_frame() {
    let rows = both(|ideal| {
        let mut session = session(G431, ideal, Fields::ESTIMATES, 4000);
        let streaming = mean(&mut session);
        session.ask(Command::SetRate { hz: 1000 }).unwrap();
        let default = mean(&mut session);
        session.ask(Command::SetRate { hz: 4000 }).unwrap();
        let mut rows = frame(&mut session);
        has_its_stated_stack(&mut session, G431);
        rows.extend([
            ("all that the core does, mean of a frame", streaming),
            ("all that it does at the default, a frame every millisecond", default),
        ]);
        rows
    });
    let (row, sum) = rows[1][4];
    assert!(sum < FRAME * 53 / 100, "{row} without wait states: {sum} of {FRAME}");
    agree(G431, FRAME, rows);
}

#[test]
fn full_stream_exceeds_usb_but_not_the_core() {
    let rows = both(|ideal| {
        let mut session = session(G431, ideal, Fields::ALL, 4000);
        let [_, estimating, sending] = worst(&mut session);
        let info = support::info(&mut session);
        assert!(
            info.counters.lost > 0,
            "USB carries every frame, so half a frame is the limit here too"
        );
        // The last scan of a self-test computes all channels' square roots, once and within its
        // frame.
        session.ask(Command::SelfTest { scans: 100 }).unwrap();
        let [_, tested, _] = worst(&mut session);
        vec![
            ("a frame with every field", estimating + sending),
            ("the last scan of a self-test", tested),
        ]
    });
    agree(G431, FRAME, rows);
}

#[test]
fn f411_has_its_stated_costs() {
    let rows = both(|ideal| {
        let mut session = session(F411, ideal, Fields::ESTIMATES, 1000);
        let default = mean(&mut session);
        let mut rows = frame(&mut session);
        has_its_stated_stack(&mut session, F411);
        rows.push(("all that the core does, mean, a frame every millisecond", default));
        rows
    });
    agree(F411, scan_plan::f411::CLOCK_HZ / 4000, rows);
}

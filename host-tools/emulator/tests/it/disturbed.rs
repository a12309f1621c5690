//! Tests of the flashed image under faults: lost readings, stalls, broken parts, panics.

use taxel::calibration::MAX_BYTES;
use taxel::frame::{Fields, Status};
use taxel::wire::message::{Command, Counters, Reset};

use taxel_emulator::board::chip::Cause;
use taxel_emulator::board::cpu::End;
use taxel_emulator::board::model::Model::G431;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::system::NMI;
use taxel_emulator::board::time::{Tick, micros};

use crate::support::{self, info, repository, stated};

/// Time between two scans.
const PERIOD: Tick = micros(250);

fn session() -> Session {
    let mut session = support::session(G431, false);
    session.ask(Command::SetFields(Fields::ESTIMATES)).unwrap();
    session.ask(Command::SetRate { hz: 4000 }).unwrap();
    session
}

fn counters(session: &mut Session) -> Counters {
    info(session).counters
}

/// Scans due since `before`, minus those that the board counts as taken or lost.
fn unaccounted(before: (Tick, Counters), after: (Tick, Counters)) -> i64 {
    let due = (after.0 - before.0) / PERIOD;
    let scans = |counters: Counters| i64::from(counters.scans) + i64::from(counters.overruns);
    due as i64 - (scans(after.1) - scans(before.1))
}

#[test]
fn missed_reading_costs_one_counted_scan() {
    let mut session = session();
    session.ask(Command::SetFields(Fields::CODES)).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    // Either converter, in any step.
    for (i, adc) in [0, 1, 0, 1, 1, 0].into_iter().enumerate() {
        session.run(micros(20_000) + i as Tick * micros(37)).unwrap();
        session.frames.clear();
        let before = counters(&mut session);
        session.board.chip().withhold(adc);
        session.run(micros(20_000)).unwrap();
        let after = counters(&mut session);
        assert_eq!(after.overruns - before.overruns, 1, "of ADC{}", adc + 1);
        let flagged = session.frames.iter().filter(|(_, f)| f.status.contains(Status::OVERRUN));
        assert_eq!(flagged.count(), 1);
        assert!(session.seen_in_order_since(Status::OVERRUN) > Some(60));
    }
}

#[test]
fn stalled_core_counts_each_lost_scan() {
    let mut session = session();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    let mut since = None;
    // Time to erase one page, two pages, or a sector of the other board.
    for stall_us in [22_000, 49_000, 130_000, 400_000] {
        let before = (session.board.now(), counters(&mut session));
        session.frames.clear();
        session.board.stall(micros(stall_us));
        session.run(micros(stall_us) + micros(30_000)).unwrap();
        let after = (session.board.now(), counters(&mut session));
        let lost = i64::from(after.1.overruns - before.1.overruns);
        let due = stall_us as i64 / 250;
        assert!((due - 6..=due).contains(&lost), "{lost} lost in {stall_us} µs");
        assert!(unaccounted(before, after).abs() <= 8, "{}", unaccounted(before, after));

        // The device's clock must not fall behind.
        let Some((arrived, last)) = session.frames.last() else { panic!("no frames") };
        let behind = (arrived / micros(1)).abs_diff(last.time.0);
        let first = *since.get_or_insert(behind);
        assert!(behind.abs_diff(first) < 1_500, "{behind} µs behind the world, was {first}");
    }
}

#[test]
fn losses_are_counted_while_port_is_closed() {
    let mut session = session();
    session.ask(Command::Stream(true)).unwrap();
    let before = (session.board.now(), counters(&mut session));
    session.board.host().open(false);
    session.run(micros(50_000)).unwrap();
    session.board.stall(micros(100_000));
    session.run(micros(200_000)).unwrap();
    for adc in [0, 1] {
        session.board.chip().withhold(adc);
        session.run(micros(10_000)).unwrap();
    }
    session.reopen().unwrap();
    let after = (session.board.now(), counters(&mut session));
    let lost = after.1.overruns - before.1.overruns;
    assert!((392..=402).contains(&lost), "{lost}");
    assert!(unaccounted(before, after).abs() <= 8, "{}", unaccounted(before, after));
}

#[test]
fn lost_bias_is_flagged_as_bridge_fault() {
    let mut session = session();
    session.ask(Command::Stream(true)).unwrap();
    let faulty = |session: &mut Session| {
        session.frames.clear();
        session.run(micros(20_000)).unwrap();
        let flagged =
            session.frames.iter().filter(|(_, f)| f.status.contains(Status::BRIDGE_FAULT));
        (flagged.count(), session.frames.len())
    };
    assert_eq!(faulty(&mut session).0, 0);
    // The buffer of the bias has lost its supply.
    session.board.finger().bias = 0.0;
    session.run(micros(2_000)).unwrap();
    let (flagged, frames) = faulty(&mut session);
    assert!(frames > 70 && flagged == frames, "{flagged} of {frames}");
}

#[test]
fn upload_loses_the_stated_scans() {
    let path = repository().join("host-tools/cli/assets/virtual-finger.cal.toml");
    let calibration = cycles::costliest(&taxel_files::calibration::read(&path).unwrap());
    let mut record = [0; MAX_BYTES];
    let record = calibration.to_bytes(&mut record).unwrap();
    let mut session = session();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    let lost_by = |session: &mut Session, what: fn(&mut Session, &[u8])| {
        let before = (session.board.now(), counters(session));
        session.frames.clear();
        what(session, record);
        session.run(micros(20_000)).unwrap();
        let after = (session.board.now(), counters(session));
        assert!(unaccounted(before, after).abs() <= 8, "{}", unaccounted(before, after));
        assert_eq!(session.bad, 0);
        let lost = after.1.overruns - before.1.overruns;
        if lost > 0 {
            assert!(session.frames.iter().any(|(_, f)| f.status.contains(Status::OVERRUN)));
        }
        lost
    };
    let erased = lost_by(&mut session, |session, record| {
        let length = record.len() as u16;
        session.ask(Command::CalibrationBegin { length }).unwrap();
    });
    let uploaded = lost_by(&mut session, |session, record| session.upload(record).unwrap());
    let saved = lost_by(&mut session, |session, _| {
        session.ask(Command::SaveSettings).unwrap();
    });
    for (lost, row) in [
        (erased, "scans lost to the erasure of a slot"),
        (uploaded, "scans lost to an upload of the longest record"),
        (saved, "scans lost to saved settings"),
    ] {
        let (stated, _) = stated(row);
        assert!(
            lost > 0 && lost <= stated && lost + 10 >= stated,
            "{row}: {lost}, the page says {stated}"
        );
    }
}

#[test]
fn panic_resets_and_is_reported_once() {
    let mut session = session();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(20_000)).unwrap();
    // The image panics on an NMI that its flash did not raise.
    session.board.chip().common_mut().system.pend(NMI);
    assert_eq!(session.board.run(micros(400_000)).unwrap(), End::Reset(Cause::Software));
    let health = |session: &mut Session| {
        session.reopen().unwrap();
        let health = support::health(session);
        (health.reset, health.panic)
    };
    let (reset, panic) = health(&mut session);
    let panic = panic.expect("the panic was kept over the reset");
    assert_eq!(reset, Reset::Software);
    let (file, line) = panic.rsplit_once(':').expect("a file and a line");
    assert!(file.ends_with("stm32g431/src/main.rs"), "{panic}");
    let source = include_str!("../../../../boards/stm32g431/src/main.rs");
    let line = source.lines().nth(line.parse::<usize>().expect("a line's number") - 1);
    assert!(line.is_some_and(|line| line.contains("NMI, not of flash")), "{panic}: {line:?}");
    // The next start must not report it again.
    session.board.power_cycle().unwrap();
    assert_eq!(health(&mut session), (Reset::Power, None));
}

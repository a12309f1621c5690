//! Tests that no scene, rate or request silences a board's link or stops its scan.

use std::collections::BTreeMap;

use cycles::kinds::KINDS;
use taxel::estimate::contact_point::PointMethod;
use taxel::frame::Fields;
use taxel::scan::ScanSettings;
use taxel::wire::message::{CHUNK, Command, Message, Request, Response};
use taxel::wire::{MAX_PACKET, pack};

use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::{Tick, micros};

use crate::load;
use crate::support::health;

/// Longest silence of a link with a stream, outside an erasure.
const SILENCE: Tick = micros(10_000);
/// Longest time for an answer that waits behind more frames than the bus or the core can take.
const PATIENCE: Tick = micros(50_000);
/// Scans that wait at a count or come before its answer, where scenes overload the core.
const LATE: u32 = 12;
/// Scans that wait at a count under a flood of requests.
const LATE_IN_FLOOD: u32 = 1;
/// Longest time without a scan that reaches the session, outside an erasure. The F411 is slower
/// than the 2 ms that a flood may cost.
fn longest_pause(model: Model) -> Tick {
    micros(if model == F411 { 2_500 } else { 2_000 })
}
/// Longest erasure of a calibration slot on a board.
const ERASURE: Tick = micros(600_000);
/// Time after a change of the scene: the first fit of a contact takes longest, flood or not.
const SETTLED: Tick = micros(50_000);
/// Longest time from the end of a contact that overloads the core to a scan that is not lost.
const RECOVERED: Tick = micros(500_000);
/// Bytes that the host keeps ready for the device.
const READY: usize = 1024;

/// Counts of scans.
#[derive(Clone, Copy)]
struct Scans {
    /// Completed by the converters.
    converted: u32,
    /// Taken by the session, and lost on the way to it.
    taken: u32,
    lost: u32,
}

/// Counts scans. The stream is off and the answer on its way within less than a scan.
fn scans(session: &mut Session) -> Scans {
    session.ask(Command::Stream(false)).unwrap();
    session.run(micros(20_000)).unwrap();
    let mut buffer = [0; MAX_PACKET];
    let packet = pack(&Request { tag: 0, command: Command::Info }, &mut buffer).unwrap();
    session.board.host().send(packet);
    session.replies.clear();
    while session.replies.is_empty() {
        session.run(micros(20)).unwrap();
    }
    let converted = session.board.finger().seen.len() as u32;
    let Some(Message::Reply { result: Ok(Response::Info(info)), .. }) = session.replies.pop()
    else {
        panic!()
    };
    session.ask(Command::Stream(true)).unwrap();
    Scans { converted, taken: info.counters.scans, lost: info.counters.overruns }
}

/// Violations that a test found.
#[derive(Default)]
struct Broken(Vec<String>);

impl Broken {
    /// Prints what was found, and keeps it if it is wrong.
    fn note(&mut self, right: bool, found: String) {
        println!("{found}");
        if !right {
            self.0.push(found);
        }
    }

    /// Notes whether since `before` all scans were taken or counted as lost but `late` ones.
    fn account(&mut self, session: &mut Session, before: Scans, late: u32, what: &str) {
        let after = scans(session);
        let due = after.converted - before.converted;
        let [taken, lost] = [after.taken - before.taken, after.lost - before.lost];
        let right = due.abs_diff(taken + lost) <= late;
        self.note(right, format!("{what}: {taken} taken and {lost} lost of {due} scans"));
    }

    /// As [`Self::account`], after a flood and on a finger that nothing touches any more.
    fn released(&mut self, session: &mut Session, before: Scans, what: &str) {
        session.board.finger().show(load::run(&KINDS[0]));
        session.run(SETTLED).unwrap();
        self.account(session, before, LATE_IN_FLOOD, what);
    }

    /// Notes whether no time is longer than allowed.
    fn time(&mut self, found: Tick, most: Tick, what: &str) {
        self.note(found <= most, format!("{what} for {} µs", found / micros(1)));
    }
}

impl Drop for Broken {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert!(self.0.is_empty(), "{:#?}", self.0);
        }
    }
}

/// Releases the finger and waits until no more scans are lost to the contact before.
fn recover(session: &mut Session) {
    session.board.finger().show(load::run(&KINDS[0]));
    let end = session.board.now() + RECOVERED;
    loop {
        session.run(SETTLED).unwrap();
        let lost = scans(session).lost;
        if scans(session).lost == lost {
            return;
        }
        assert!(session.board.now() < end, "scans of an untouched finger are lost");
    }
}

/// Counts scans, and then shows the finger a shear force.
fn touched(session: &mut Session) -> Scans {
    let before = scans(session);
    session.board.finger().show(load::run(&KINDS[2]));
    session.run(SETTLED).unwrap();
    before
}

/// Longest time without a scan since the last call: each one that is taken feeds the watchdog.
fn pause(session: &mut Session) -> Tick {
    let now = session.board.now();
    session.board.chip().common_mut().unfed(now)
}

/// Runs every scene at a rate with some field masks.
fn scenes(model: Model, scan: Option<ScanSettings>, hz: u16) {
    let mut session = load::session(model, scan, hz);
    let mut broken = Broken::default();
    for kind in &KINDS {
        let before = scans(&mut session);
        session.board.finger().show(load::run(kind));
        let masks = (0..9).map(|bit| Fields(1 << bit));
        let masks = [Fields(0), Fields::ESTIMATES, Fields::ALL].into_iter().chain(masks);
        for fields in masks {
            let what = format!("{}, {hz} Hz, fields {:#x}", kind.name, fields.0);
            session.ask(Command::SetFields(fields)).unwrap();
            session.silence = 0;
            session.run(micros(10_000)).unwrap();
            let asked = session.board.now();
            session.ask(Command::ReadBias).unwrap();
            let (waited, silence) = (session.board.now() - asked, session.silence);
            broken.time(waited, PATIENCE, &format!("{what}: waiting"));
            broken.time(silence, SILENCE, &format!("{what}: silent"));
        }
        broken.account(&mut session, before, LATE, kind.name);
    }
    let health = health(&mut session);
    assert_eq!(health.panic, None);
}

#[test]
fn no_scene_silences_the_g431() {
    scenes(G431, None, 1000);
    scenes(G431, None, 4000);
    scenes(G431, Some(load::EIGHT_KHZ), 8000);
}

#[test]
fn no_scene_silences_the_f411() {
    scenes(F411, None, 1000);
    scenes(F411, None, 4000);
}

/// Requests of every kind that does not end the session.
fn requests() -> Vec<Command> {
    let data = heapless::Vec::from_slice(&[7; CHUNK]).unwrap();
    vec![
        Command::Version,
        Command::Info,
        Command::Stream(true),
        Command::SetRate { hz: 1000 },
        Command::SetFields(Fields::FORCE),
        Command::SetPointMethod(PointMethod::ArgMin),
        Command::TakeBias { scans: 2 },
        Command::ReadBias,
        Command::ClearBias,
        Command::CalibrationBegin { length: 4000 },
        Command::CalibrationChunk { offset: 0, data },
        Command::CalibrationCommit,
        Command::CalibrationRead { offset: 0 },
        Command::SaveSettings,
        Command::SaveBias,
        Command::Health,
        Command::SelfTest { scans: 2 },
        Command::SetFilter { hz: 50 },
        Command::HoldRow { row: Some(1) },
        Command::HoldRow { row: None },
    ]
}

/// Source of packets to send.
type Packets = Box<dyn FnMut() -> Vec<u8>>;

/// Time and least number of packets of a flood.
#[derive(Clone, Copy)]
struct Flood(Tick, usize);

/// Sends bytes without pause, and lets the board handle the rest.
///
/// Returns how many packets were sent; each has a reply if `answered`.
fn flood(
    session: &mut Session,
    Flood(time, least): Flood,
    answered: bool,
    mut next: impl FnMut() -> Vec<u8>,
) -> usize {
    let end = session.board.now() + time;
    let mut packets = 0;
    while session.board.now() < end || packets < least {
        while session.board.host().unsent() < READY {
            session.board.host().send(&next());
            packets += 1;
        }
        session.run(micros(1_000)).unwrap();
    }
    let rest = session.board.now() + PATIENCE + packets as Tick * ERASURE;
    while session.board.host().unsent() > 0 || answered && session.replies.len() < packets {
        assert!(session.board.now() < rest, "{} of {packets} answers", session.replies.len());
        session.run(micros(1_000)).unwrap();
    }
    packets
}

/// Floods a board with zeros, with garbage and with requests of each kind.
fn floods(model: Model, size: Flood) {
    let mut session = load::session(model, None, 1000);
    let mut broken = Broken::default();
    let scan = match session.ask(Command::Health).unwrap() {
        Response::Health(health) => Command::SetScan(health.scan.unwrap()),
        other => panic!("{other:?}"),
    };
    recover(&mut session);
    for command in requests().into_iter().chain([scan]) {
        let before = touched(&mut session);
        (session.silence, session.replies) = (0, Vec::new());
        pause(&mut session);
        let mut tag = 0;
        let erases = matches!(
            command,
            Command::CalibrationBegin { .. } | Command::SaveSettings | Command::SaveBias
        );
        let sent = flood(&mut session, size, true, || {
            tag = (tag + 1) % 256;
            let request = Request { tag: tag as u8, command: command.clone() };
            pack(&request, &mut [0; MAX_PACKET]).unwrap().to_vec()
        });
        let most = longest_pause(model) + if erases { ERASURE } else { 0 };
        broken.time(pause(&mut session), most, &format!("{command:?}: no scan"));
        let mut unanswered = BTreeMap::new();
        (1..=sent).for_each(|i| *unanswered.entry((i % 256) as u8).or_insert(0) += 1);
        for message in std::mem::take(&mut session.replies) {
            let (Message::Reply { tag, .. } | Message::Version { tag, .. }) = message else {
                continue;
            };
            *unanswered.entry(tag).or_insert(0) -= 1;
        }
        unanswered.retain(|_, count| *count != 0);
        let right = unanswered.is_empty();
        broken.note(right, format!("{command:?}: {sent} sent, unanswered by tag {unanswered:?}"));
        // The reply to one erasure may wait for the next one.
        let most = SILENCE + if erases { 2 * ERASURE } else { 0 };
        broken.time(session.silence, most, &format!("{command:?}: silent"));
        // A restart loses the scan under way, which no converter completes.
        if !matches!(command, Command::SetScan(_) | Command::HoldRow { .. }) {
            broken.released(&mut session, before, &format!("{command:?}"));
        }
        session.ask(Command::SetRate { hz: 1000 }).unwrap();
    }
    let mut state = 1_u32;
    let garbage = move || {
        let byte = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        std::iter::repeat_with(byte).take(64).collect()
    };
    let noise: [(&str, Packets); 2] =
        [("zeros", Box::new(|| vec![0; 64])), ("garbage", Box::new(garbage))];
    for (what, next) in noise {
        let before = touched(&mut session);
        session.silence = 0;
        pause(&mut session);
        let sent = flood(&mut session, size, false, next);
        // Ends the garbage.
        session.board.host().send(&[0]);
        broken.time(pause(&mut session), longest_pause(model), &format!("{what}: no scan"));
        broken.time(session.silence, SILENCE, &format!("{sent} packets of {what}: silent"));
        broken.released(&mut session, before, what);
    }
    let health = health(&mut session);
    assert_eq!(health.panic, None);
}

#[test]
fn no_request_silences_the_g431() {
    floods(G431, Flood(micros(20_000), 0));
}

#[test]
fn no_request_silences_the_f411() {
    floods(F411, Flood(micros(20_000), 0));
}

#[test]
fn core_that_stands_still_is_noticed() {
    let mut session = load::session(G431, None, 1000);
    let before = touched(&mut session);
    pause(&mut session);
    session.run(micros(20_000)).unwrap();
    assert!(pause(&mut session) < longest_pause(G431));
    session.board.stall(micros(3_000));
    session.run(micros(20_000)).unwrap();
    assert!(pause(&mut session) > longest_pause(G431));
    let after = scans(&mut session);
    assert!(after.lost - before.lost > 6, "a scan came each 0.25 ms meanwhile");
}

/// Long floods that run nightly.
mod nightly {
    use super::*;

    const LONG: Flood = Flood(micros(10_000_000), 10_000);

    #[test]
    fn ten_seconds_of_no_request_silence_the_g431() {
        floods(G431, LONG);
    }

    #[test]
    fn ten_seconds_of_no_request_silence_the_f411() {
        floods(F411, LONG);
    }
}

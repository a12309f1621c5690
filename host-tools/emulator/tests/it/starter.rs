//! Test of the board to start a port from, whose image uses the HAL alone.

use taxel::frame::{Fields, Status};
use taxel::scan::TaxelCodes;
use taxel::wire::message::{Command, Response};

use taxel_emulator::board::cpu::Board;
use taxel_emulator::board::finger::{Finger, Pace};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::model::Model;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::micros;

use crate::support::{firmware, info, scene};

/// Whether all codes are equal to one code; the inputs have not quite settled.
fn alike(read: Option<TaxelCodes>, expected: &TaxelCodes) -> bool {
    let all = |t: &TaxelCodes| t.lit.into_iter().chain([t.dark]).flatten().collect::<Vec<_>>();
    let read = all(&read.unwrap());
    read.iter().zip(all(expected)).all(|(read, expected)| read.0.abs_diff(expected.0) <= 1)
}

#[test]
fn starter_streams_the_matrix_by_the_hal_alone() {
    let still = scene()[..1].to_vec();
    let TaxelCodes { lit, dark } = still[0].taxels.unwrap();
    let finger = Finger::new(still, Pace::Scans);
    let board = Board::new(Model::F411, &firmware("starter"), finger, Host::new(false)).unwrap();
    let mut session = Session::open(board).unwrap();
    assert_eq!(info(&mut session).identity.board, "starter");
    session.ask(Command::SetFields(Fields::CODES)).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(500_000)).unwrap();
    assert!((245..=255).contains(&session.frames.len()), "{} frames", session.frames.len());
    for (_, frame) in &session.frames {
        let taxels = frame.codes.unwrap().taxels;
        assert!(alike(taxels, &TaxelCodes { lit, dark }), "{taxels:?}");
    }
    for pair in session.frames.windows(2) {
        let [(_, a), (_, b)] = pair else { panic!() };
        assert!(b.seq == a.seq + 1 && (b.time.0 - a.time.0).abs_diff(2000) < 200, "{}", b.time.0);
    }
    assert_eq!(session.ask(Command::HoldRow { row: Some(2) }).unwrap(), Response::Done);
    session.frames.clear();
    session.run(micros(50_000)).unwrap();
    assert!(session.frames.len() > 20);
    for (_, frame) in &session.frames {
        assert!(frame.status.contains(Status::ROW_HELD));
        let held = TaxelCodes { lit: [lit[2]; 4], dark: lit[2] };
        let taxels = frame.codes.unwrap().taxels;
        assert!(alike(taxels, &held), "{taxels:?}");
    }
    assert_eq!(session.board.finger().rows(), 0b0100);
    // A scan under way is lost, which depends on the moment of the request.
    const CHANGES: u32 = 20;
    let before = info(&mut session).counters.overruns;
    assert!(before <= 1, "{before}");
    for i in 0..CHANGES {
        let row = (i % 2 == 1).then_some(2);
        session.ask(Command::HoldRow { row }).unwrap();
        session.run(micros(3_300)).unwrap();
    }
    let lost = info(&mut session).counters.overruns - before;
    assert!((1..=CHANGES).contains(&lost), "{lost}");
}

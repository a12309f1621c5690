//! Tests of the product's firmware on the chip with more memory.

use taxel::calibration::MAX_BYTES;
use taxel::frame::Frame;

use taxel_emulator::board::model::Model::G473;
use taxel_emulator::board::time::micros;

use crate::support::{first_seen, info, repository, session, stream_codes};

#[test]
fn g473_streams_the_codes_that_its_converters_saw() {
    let mut session = session(G473, false);
    assert_eq!(info(&mut session).identity.board, "stm32g473");
    let frames = stream_codes(&mut session, micros(200_000));
    assert!((195..=205).contains(&frames.len()), "{} frames", frames.len());
    first_seen(&session.board.finger().seen, &frames, 4);
    let steps = |pair: &[(_, Frame)]| pair[1].1.time.0 - pair[0].1.time.0;
    assert!(frames.windows(2).all(|pair| (999..=1001).contains(&steps(pair))));
}

#[test]
fn g473_keeps_a_calibration_in_its_second_bank() {
    let path = repository().join("host-tools/cli/assets/virtual-finger.cal.toml");
    let calibration = taxel_files::calibration::read(&path).unwrap();
    let mut session = session(G473, false);
    assert!(info(&mut session).calibration.is_none());
    let mut record = [0; MAX_BYTES];
    session.upload(calibration.to_bytes(&mut record).unwrap()).unwrap();
    let flash = session.board.flash();
    assert_eq!(flash.start, 0x0807_d000);
    assert!(flash.cells.data.iter().any(|byte| *byte != 0xff));
    session.board.power_cycle().unwrap();
    session.reopen().unwrap();
    assert_eq!(info(&mut session).calibration.unwrap().date, calibration.date);
}

//! Counters at the end of their 32 bits: each goes on from zero, and so do those who read it.
//!
//! The finger's own clock has 64 bits. Its lower half, which the vibration detector keeps, wraps
//! every 71.6 minutes.

use embassy_futures::yield_now;
use taxel::condition::Signals;
use taxel::estimate::vibration::VibrationDetector;
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel::instrument::Instrument;
use taxel::scan::TAXELS;
use taxel::session::{End, Pace};
use taxel::units::Micros;
use taxel::wire::message::{Command, Message};

use crate::common::{everything, pressed, unloaded};
use crate::session::{Host, fresh, run, scans};

/// Time in microseconds at which the lower half of the clock wraps.
const WRAP: u64 = 1 << 32;

async fn stream(host: &mut Host) {
    host.ask(Command::SetRate { hz: 4000 }).await.unwrap();
    host.ask(Command::Stream(true)).await.unwrap();
}

/// Receives frames until the finger ends the session.
async fn receive_rest(host: &mut Host) {
    while let Some(message) = host.message().await {
        let Message::Frame(frame) = message else { panic!("{message:?}") };
        host.frames.push(frame);
    }
}

#[test]
fn frame_numbers_go_on_from_zero() {
    let mut instrument = fresh();
    let start = u32::MAX - 100;
    instrument.counters().frames = start;
    run(instrument, scans(500), Pace::Lossless, 4096, async |host| {
        stream(host).await;
        receive_rest(host).await;
        let numbers = host.frames.iter().map(|frame| frame.seq);
        assert!(numbers.eq((0..500).map(|i| start.wrapping_add(i))));
    });
}

#[test]
fn lost_frames_are_counted_past_the_wrap() {
    let (start, mut received) = (u32::MAX - 100, 0);
    let mut instrument = fresh();
    instrument.counters().lost = start;
    let (mut instrument, end) = run(instrument, scans(5_000), Pace::Live, 256, async |host| {
        stream(host).await;
        for _ in 0..2_000 {
            yield_now().await;
        }
        receive_rest(host).await;
        received = host.frames.len() as u32;
    });
    assert_eq!(end, End::Scans);
    let counters = instrument.counters();
    let lost = counters.lost.wrapping_sub(start);
    assert!(lost > 1000, "{counters:?}");
    assert_eq!(received + lost, counters.frames, "{counters:?}");
}

#[test]
fn bad_packets_are_counted_past_the_wrap() {
    let mut instrument = fresh();
    instrument.counters().bad_packets = u32::MAX - 2;
    run(instrument, scans(1_000_000), Pace::Live, 4096, async |host| {
        use embedded_io_async::Write;
        host.to.write_all(&[9, 0, 9, 9, 0, 1, 2, 3, 0, 9, 0]).await.unwrap();
        assert_eq!(host.info().await.counters.bad_packets, 1);
    });
}

#[test]
fn scans_and_overruns_are_counted_past_the_wrap() {
    let mut instrument = Instrument::new(crate::common::identity());
    let counters = instrument.counters();
    (counters.scans, counters.overruns) = (u32::MAX, u32::MAX - 1);
    let mut scan = unloaded(0);
    scan.lost = 3;
    let _ = instrument.scan(&scan);
    assert_eq!((instrument.counters().scans, instrument.counters().overruns), (0, 1));
}

/// Rubbing at 150 Hz from one second on, a thousandth of the range.
fn rubbing(i: u64) -> f32 {
    let rub = (core::f32::consts::TAU * 150.0 * 250e-6 * i as f32).sin();
    if i >= 4000 { 1e-3 * rub } else { 0.0 }
}

#[test]
fn vibration_is_detected_across_the_wrap() {
    // The clock wraps before the rubbing, as it begins, and during it.
    for before in [2000, 4000, 4100] {
        let (mut early, mut late) = (VibrationDetector::default(), VibrationDetector::default());
        let mut heard = 0;
        for i in 0..8000 {
            let signals = Signals { taxels: Some([rubbing(i); TAXELS]), ..Signals::default() };
            let expected = early.update(Micros(250 * i), &signals);
            let vibrates = late.update(Micros(WRAP - 250 * before + 250 * i), &signals);
            assert_eq!(vibrates, expected, "scan {i}");
            heard += u32::from(vibrates);
        }
        assert!((3900..4000).contains(&heard), "{heard}");
    }
}

#[test]
fn estimates_are_the_same_across_the_wrap() {
    let (finger, mut early) = Finger::new(Some(everything()));
    let (_, mut late) = Finger::new(Some(everything()));
    let mut ran = Status(0);
    for i in 0..8000 {
        let codes = match i {
            0..1000 => 0,
            _ => (3000.0 + 65_535.0 * rubbing(i)) as u16,
        };
        let scan = |time| pressed(time, 5, codes);
        let expected = finger.estimate(&mut early, &scan(250 * i));
        let mut estimate = finger.estimate(&mut late, &scan(WRAP - 250 * 4100 + 250 * i));
        estimate.time = expected.time;
        assert_eq!(estimate, expected, "scan {i}");
        ran |= estimate.status;
    }
    assert!(ran.contains(Status::CONTACT | Status::SLIDES | Status::RAN_SLIP), "{ran:?}");
}

//! The firmware of `boards/mps2-an386` on an emulated Cortex-M4F, fed through its memory and heard through
//! its UART, and the product's on its emulated pins and USB, against the same core on this machine. Needs
//! `qemu-system-arm`, a Cortex-M compiler and what `host-tools/emulator` builds with: `cargo xtask test`
//! sees to all.

use std::ops::ControlFlow;

use crate::common;
use crate::common::{calibration, pressed, unloaded};
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::estimate::contact_point::PointMethod;
use taxel::finger::Finger;
use taxel::frame::{Fields, Frame, Status};
use taxel::scan::{Codes, Scan};
use taxel_cli::emulated::{Hardware, OnPins, Replay, Settings, replay};
use taxel_sim::{Scene, Simulator};

fn on_host(scans: &[Scan], calibration: Option<Calibration>) -> Vec<Frame> {
    let (finger, mut state) = Finger::new(calibration);
    let seqs = 0..;
    seqs.zip(scans)
        .map(|(seq, scan)| {
            finger.estimate(&mut state, scan).frame(&scan.codes, seq, Fields::ALL).into()
        })
        .collect()
}

fn on_board(scans: &[Scan], calibration: Option<&Calibration>) -> (Vec<Frame>, Replay) {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration.map(|calibration| calibration.to_bytes(&mut buffer).unwrap());
    let mut frames = vec![];
    let replay = replay(scans, record, &settings(Fields::ALL), |frame| {
        frames.push(*frame);
        ControlFlow::Continue(())
    });
    let replay = replay.unwrap().unwrap();
    (frames, replay)
}

/// The wire's bytes: two floats are the same only if all their bits are.
fn bytes(frame: &Frame) -> Vec<u8> {
    let mut buffer = [0; taxel::wire::MAX_PACKET];
    taxel::wire::pack(frame, &mut buffer).unwrap().to_vec()
}

fn tour() -> Vec<Scan> {
    let scene = Scene::load("tour").unwrap();
    Simulator::new(&scene, 7).take(3000).map(|sample| sample.scan).collect()
}

fn virtual_finger() -> Calibration {
    let path =
        concat!(env!("CARGO_MANIFEST_DIR"), "/../host-tools/cli/assets/virtual-finger.cal.toml");
    taxel_files::calibration::read(path).unwrap()
}

#[test]
fn emulated_frames_equal_those_of_this_machine_bit_for_bit() {
    let (scans, calibration) = (tour(), virtual_finger());
    let (board, replay) = on_board(&scans, Some(&calibration));
    let host = on_host(&scans, Some(calibration));
    assert_eq!(board.len(), host.len());
    for (board, host) in board.iter().zip(&host) {
        assert_eq!(bytes(board), bytes(host), "{board:?}\n{host:?}");
    }
    assert!(host.iter().any(|frame| frame.force.is_some_and(|f| f.z.is_ok_and(|z| z.0 > 0.1))));
    // The calibration of this finger was uploaded, all frames had all fields: no path is deeper.
    let stack = replay.stack.unwrap();
    eprintln!("stack {stack} bytes");
    assert!(stack <= 8 * 1024, "{stack}");
    let counters = replay.info.counters;
    assert_eq!((counters.scans, counters.lost, counters.overruns), (3000, 0, 0));
}

#[test]
fn emulated_faults_are_flagged_as_on_this_machine() {
    let mut scans: Vec<Scan> = (0..40).map(|t| unloaded(250 * t)).collect();
    scans.extend((40..80).map(|t| pressed(250 * t, 6, 6_554)));
    scans.extend((80..90).map(|t| pressed(250 * t, 6, u16::MAX - common::LIT)));
    scans.extend((90..100).map(|t| pressed(250 * t, 6, 39_000)));
    scans.extend((100..110).map(|t| Scan { lost: 1, ..unloaded(250 * t) }));
    for calibration in [None, Some(calibration())] {
        let (board, _) = on_board(&scans, calibration.as_ref());
        assert_eq!(board, on_host(&scans, calibration));
    }
}

#[test]
fn emulated_cost_is_counted_and_repeatable() {
    let scans: Vec<Scan> = (0..200).map(|t| pressed(250 * t, 6, 6_554)).collect();
    let (_, first) = on_board(&scans, Some(&calibration()));
    let (_, second) = on_board(&scans, Some(&calibration()));
    // An instruction is 1.6 ticks of the board's clock, and where within a tick it begins depends on how long
    // the board slept: the same instructions may count one tick more or less.
    let (first_cost, second_cost) = (first.info.cost, second.info.cost);
    assert!(first_cost.last.abs_diff(second_cost.last) <= 1, "{first_cost:?} {second_cost:?}");
    assert!(first_cost.worst.abs_diff(second_cost.worst) <= 1, "{first_cost:?} {second_cost:?}");
    let instructions = first.worst_instructions();
    // A count of nothing, or of something else, would lie far outside.
    assert!((500..20_000).contains(&instructions), "{instructions}");
}

#[test]
fn emulated_replay_of_nothing_is_refused_in_one_line() {
    let error = replay(&[], None, &settings(Fields::ALL), |_| ControlFlow::Continue(()))
        .unwrap_err()
        .to_string();
    assert_eq!(error, "the trace has no scans; give one that has");
}

#[test]
fn emulated_replay_ends_when_its_listener_has_enough() {
    let scans = tour();
    let mut heard = 0;
    let replay = replay(&scans, None, &settings(Fields::ESTIMATES), |_| {
        heard += 1;
        if heard < 10 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    assert_eq!(replay.unwrap(), None);
    assert_eq!(heard, 10);
}

/// A board as it comes, but for its fields.
fn settings(fields: Fields) -> Settings {
    Settings { fields, filter_hz: 0, point_method: PointMethod::default() }
}

/// These scans on the product's pins.
fn on_pins(scans: &[Scan], calibration: Option<&Calibration>, fields: Fields) -> Vec<Frame> {
    let mut buffer = [0; MAX_BYTES];
    let record = calibration.map(|calibration| calibration.to_bytes(&mut buffer).unwrap());
    let mut frames = vec![];
    let replay = OnPins::prepare(Hardware::Stm32G431, scans, record, &settings(fields)).unwrap();
    assert_eq!(replay.full_scale().top().0, 8 * 4095);
    replay
        .run(|frame| {
            frames.push(*frame);
            ControlFlow::Continue(())
        })
        .unwrap();
    frames
}

/// The greatest distance of the codes that the converters read from those of the trace, in steps of 12 bits.
fn off(frame: &Frame, scan: &Scan) -> f32 {
    let steps = |codes: &Codes| {
        let step = f32::from(codes.full_scale.top().0) / 4095.0;
        let taxels = codes.taxels.unwrap();
        let bridges = codes.bridges.into_iter().flatten().flat_map(|m| [m.a, m.b, m.c, m.d]);
        let codes = taxels.lit.into_iter().flatten().chain(taxels.dark).chain(bridges);
        codes.map(move |code| f32::from(code.0) / step).collect::<Vec<_>>()
    };
    let (read, shown) = (steps(&frame.codes.unwrap()), steps(&scan.codes));
    read.iter().zip(&shown).map(|(read, shown)| (read - shown).abs()).fold(0.0, f32::max)
}

#[test]
fn emulated_pins_bring_a_trace_to_the_client_as_this_machine_would_have_it() {
    // The product's image leaves the model of the skin out, and passes over its section.
    let (tour, calibration) = (tour(), Calibration { model: None, ..virtual_finger() });
    let scans = &tour[1500..2500];
    let frames = on_pins(scans, Some(&calibration), Fields::ALL);
    assert_eq!(frames.len(), scans.len());
    let (finger, mut state) = Finger::new(Some(calibration));
    for ((seq, frame), scan) in (0..).zip(&frames).zip(scans) {
        // Half a step of the trace's own rounding, and one for what has not quite settled.
        assert!(off(frame, scan) <= 1.5, "scan {seq}: {}", off(frame, scan));
        let overrun = frame.status.contains(Status::OVERRUN);
        let read = Scan { time: frame.time, lost: overrun.into(), codes: frame.codes.unwrap() };
        let host = finger.estimate(&mut state, &read);
        let host = Frame::from(host.frame(&read.codes, seq, Fields::ALL));
        assert_eq!(bytes(frame), bytes(&host), "{frame:?}\n{host:?}");
        assert_eq!(overrun, seq == 0);
        assert!(frame.time.0.abs_diff(scan.time.0) <= 5, "{} for {}", frame.time.0, scan.time.0);
    }
    assert!(frames.iter().any(|frame| frame.status.contains(Status::CONTACT)));
}

#[test]
fn emulated_pins_show_a_slow_trace_as_long_as_it_lasts() {
    let scans: Vec<Scan> = tour()
        .iter()
        .step_by(8)
        .enumerate()
        .map(|(i, scan)| Scan { time: taxel::units::Micros(4_000 * i as u64), ..*scan })
        .take(100)
        .collect();
    let frames = on_pins(&scans, None, Fields::CODES);
    assert_eq!(frames.len(), scans.len());
    for (frame, scan) in frames.iter().zip(&scans) {
        assert!(off(frame, scan) <= 1.5, "{}", off(frame, scan));
        assert!(frame.time.0.abs_diff(scan.time.0) < 500, "{} for {}", frame.time.0, scan.time.0);
    }
}

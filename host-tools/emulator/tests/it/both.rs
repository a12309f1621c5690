//! Tests of both boards: boot, enumeration, streaming, counted losses and stored settings.

use std::process::Command as Process;

use taxel::calibration::MAX_BYTES;
use taxel::finger::Finger;
use taxel::frame::{Fields, Status};
use taxel::measured::NoValue;
use taxel::scan::Scan;
use taxel::units::Micros;
use taxel::wire::message::{Command, Reset, Response};

use taxel_emulator::board::capture::pcap;
use taxel_emulator::board::chip::Cause;
use taxel_emulator::board::cpu::End;
use taxel_emulator::board::finger::Moment;
use taxel_emulator::board::model::Model;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::micros;

use crate::support::{
    board, deviation, first_seen, health, info, name, packed, repository, scene, session,
    stream_codes, tim1,
};

fn streams_without_a_loss(model: Model, seconds: u64) {
    let mut session = session(model, false);
    session.ask(Command::SetFields(Fields::ALL)).unwrap();
    let before = info(&mut session);
    assert_eq!((before.identity.board.as_str(), before.identity.scan_hz), (name(model), 4000));
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(1_000_000 * seconds)).unwrap();
    let after = info(&mut session);

    let health = health(&mut session);
    assert_eq!((health.reset, health.panic), (Reset::Power, None));
    assert_eq!(after.counters.lost, 0);
    assert_eq!(after.counters.overruns, before.counters.overruns);
    assert_eq!((after.counters.bad_packets, session.bad), (0, 0));
    let due = 1000 * seconds as usize;
    assert!((due..due + 10).contains(&session.frames.len()), "{} frames", session.frames.len());
    for pair in session.frames.windows(2) {
        let [(_, a), (_, b)] = pair else { panic!() };
        assert_eq!(b.seq, a.seq + 1);
        assert!((999..=1001).contains(&(b.time.0 - a.time.0)), "{} to {}", a.time.0, b.time.0);
        assert!(!b.status.contains(Status::OVERRUN));
    }
}

fn streams_two_seconds_without_loss(model: Model) {
    streams_without_a_loss(model, 2);
}

fn streamed_codes_match_converters_and_scene(model: Model) {
    let mut session = session(model, false);
    let frames = stream_codes(&mut session, micros(300_000));
    assert!(frames.len() > 290);
    first_seen(&session.board.finger().seen, &frames, 4);
    // One code of tolerance, because inputs have not quite settled.
    let deviation = deviation(&frames, &scene(), 4);
    assert!(deviation <= 1.0, "{deviation} codes");
}

fn image_holds_every_estimator(model: Model) {
    // The emulator is built with all of the core's features.
    assert_eq!(info(&mut session(model, false)).estimators, Status::BUILT);
}

fn stack_overflow_faults_and_is_reported(model: Model) {
    let mut session = session(model, false);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(20_000)).unwrap();
    // The stack is at the start of its memory.
    let low = match model {
        Model::G431 | Model::G473 => 0x1000_0008,
        Model::F411 => 0x2000_0008,
    };
    // In its sleep, so that the next thing on the stack is an interrupt's frame.
    while {
        let before = session.board.slept();
        session.board.run(micros(5)).unwrap();
        session.board.slept() - before < micros(4)
    } {}
    session.board.lower_stack(low).unwrap();
    assert_eq!(session.board.run(micros(400_000)).unwrap(), End::Reset(Cause::Software));
    session.reopen().unwrap();
    let health = health(&mut session);
    assert_eq!((health.reset, health.panic.as_deref()), (Reset::Software, Some("stack overflow")));
}

fn frames_match_host_byte_for_byte(model: Model) {
    let path = repository().join("host-tools/emulator/data/finger.cal.toml");
    let calibration = taxel_files::calibration::read(&path).unwrap();
    let mut record = [0; MAX_BYTES];
    let record = calibration.to_bytes(&mut record).unwrap();
    let mut session = session(model, false);
    session.ask(Command::SetFields(Fields::ALL)).unwrap();
    session.upload(record).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(300_000)).unwrap();
    let frames = std::mem::take(&mut session.frames);
    assert!(frames.iter().any(|(_, frame)| frame.status.contains(Status::CONTACT)));

    // The board restarted with the calibration some scans before the first frame.
    let seen = &session.board.finger().seen;
    let first = first_seen(seen, &frames, 4);
    let equal = |begin: &usize| {
        let (finger, mut state) = Finger::new(Some(calibration.clone()));
        let mut expected = frames.iter();
        (*begin..first + 4 * frames.len()).zip(seen.iter().skip(*begin)).all(|(scan, seen)| {
            let due = scan >= first && (scan - first).is_multiple_of(4);
            let expected = if due { expected.next() } else { None };
            let time = expected.map_or(Micros(0), |(_, frame)| frame.time);
            let scan = Scan { time, lost: 0, codes: seen.codes };
            let estimate = finger.estimate(&mut state, &scan);
            expected.is_none_or(|(_, device)| {
                packed(&estimate.frame(&scan.codes, device.seq, Fields::ALL).into())
                    == packed(device)
            })
        })
    };
    assert!((first.saturating_sub(40)..=first).any(|begin| equal(&begin)));
}

/// Stops reading for longer than both watchdogs' timeouts, 0.5 s and 3 s.
fn stalled_reader_loses_only_counted_frames(model: Model) {
    let mut session = session(model, false);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(100_000)).unwrap();
    let before = info(&mut session);
    session.board.host().reading = false;
    session.run(micros(4_000_000)).unwrap();
    session.board.host().reading = true;
    session.run(micros(100_000)).unwrap();
    let after = info(&mut session);
    assert_eq!((after.counters.bad_packets, session.bad), (0, 0));
    let lost = after.counters.lost;
    assert!(lost > 3900, "{lost} frames lost");
    let gaps: u32 = session.frames.windows(2).map(|pair| pair[1].1.seq - pair[0].1.seq - 1).sum();
    assert_eq!(gaps, lost);
    assert_eq!(after.counters.overruns, before.counters.overruns);
    // The scan continued. A frame's time is that of its interrupt, which masking delays at most
    // this much.
    for pair in session.frames.windows(2) {
        let [(_, a), (_, b)] = pair else { panic!() };
        let late = (b.time.0 - a.time.0).abs_diff(1000 * u64::from(b.seq - a.seq));
        assert!(late <= 10, "{late} µs at {}", a.seq);
    }
}

/// Counts the frames received after closing the port, and after replugging the cable without
/// opening it.
fn frames_of_a_closed_port(model: Model, misread: Option<fn([u8; 8]) -> [u8; 8]>) -> [usize; 2] {
    let mut session = session(model, false);
    session.board.host().misread = misread;
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    session.board.host().open(false);
    let frames = |session: &mut Session| {
        session.run(micros(50_000)).unwrap();
        session.frames.clear();
        session.run(micros(200_000)).unwrap();
        std::mem::take(&mut session.frames).len()
    };
    let closed = frames(&mut session);
    session.board.host().plug(false);
    session.run(micros(10_000)).unwrap();
    session.board.host().plug(true);
    session.run(micros(400_000)).unwrap();
    assert!(session.board.host().is_ready());
    [closed, frames(&mut session)]
}

fn closed_port_receives_no_frames(model: Model) {
    assert_eq!(frames_of_a_closed_port(model, None), [0, 0]);
}

fn ignored_dtr_is_detected(model: Model) {
    // The firmware reads DTR as set in every SET_CONTROL_LINE_STATE.
    let ignored = frames_of_a_closed_port(
        model,
        Some(|setup| match setup {
            [0x21, 0x22, low, rest @ ..] => {
                let mut seen = [0x21, 0x22, low | 1, 0, 0, 0, 0, 0];
                seen[3..].copy_from_slice(&rest);
                seen
            }
            other => other,
        }),
    );
    assert!(ignored[0] > 150, "{ignored:?}");
}

fn suspended_bus_stops_the_scan_until_wake(model: Model) {
    let mut session = session(model, false);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    let now = session.board.now();
    session.board.host().suspend(true, now);
    // The bus must be idle for 3 ms first.
    session.run(micros(10_000)).unwrap();
    session.frames.clear();
    session.board.finger().timing = Some(Vec::new());
    // Longer than the watchdog's timeout.
    session.run(micros(800_000)).unwrap();
    assert_eq!(session.board.finger().timing.take().unwrap(), []);
    assert_eq!(session.board.finger().rows(), 0);
    assert_eq!(session.frames.len(), 0);
    let now = session.board.now();
    session.board.host().suspend(false, now);
    session.run(micros(200_000)).unwrap();
    assert!(session.frames.len() > 190, "{} frames", session.frames.len());
    assert_eq!(session.bad, 0);
    let health = health(&mut session);
    assert_eq!(health.reset, Reset::Power);
}

fn halted_endpoint_resumes_when_cleared(model: Model) {
    let mut session = session(model, false);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    session.board.host().halt(true);
    session.run(micros(50_000)).unwrap();
    assert!(session.board.host().stalls > 0);
    session.frames.clear();
    session.run(micros(200_000)).unwrap();
    assert!(session.frames.len() > 190, "{} frames", session.frames.len());
    // A host may clear a halt that is not set: data restart with DATA0, whichever toggle was next.
    for _ in 0..6 {
        session.board.host().halt(false);
        session.run(micros(7_000)).unwrap();
    }
    session.frames.clear();
    session.run(micros(200_000)).unwrap();
    assert!(session.frames.len() > 190, "{} frames", session.frames.len());
    assert_eq!(info(&mut session).counters.bad_packets, 0);
}

fn self_test_measures_the_pins(model: Model) {
    let still = scene()[..1].to_vec();
    let mut session = Session::open(board(model, still.clone(), false)).unwrap();
    let Response::SelfTest(test) = session.ask(Command::SelfTest { scans: 200 }).unwrap() else {
        panic!()
    };
    let samples = match model {
        Model::G431 | Model::G473 => 8,
        Model::F411 => 1,
    };
    assert_eq!((test.scans, test.full_scale.top().0), (200, samples * 4095));
    let lit = still[0].taxels.unwrap().lit.into_iter().flatten();
    for (channel, code) in test.channels.lit.into_iter().flatten().zip(lit) {
        let channel = channel.unwrap();
        assert!(
            (channel.mean / f32::from(samples) - f32::from(code.0)).abs() <= 1.0
                && channel.noise == 0.0
        );
    }
}

fn held_row_stays_lit_until_the_port_closes(model: Model) {
    let still = scene()[..1].to_vec();
    let lit = still[0].taxels.unwrap().lit;
    let mut session = Session::open(board(model, still, false)).unwrap();
    session.ask(Command::SetFields(Fields::CODES | Fields::FORCE)).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    for row in [1, 3] {
        assert_eq!(session.ask(Command::HoldRow { row: Some(row) }).unwrap(), Response::Done);
        session.frames.clear();
        session.board.finger().timing = Some(Vec::new());
        session.run(micros(100_000)).unwrap();
        let timing = session.board.finger().timing.take().unwrap();
        let patterns: Vec<_> = timing
            .iter()
            .filter_map(|(_, moment)| match moment {
                Moment::Pattern(rows, sensor) => Some((*rows, *sensor)),
                _ => None,
            })
            .collect();
        // 400 frames of five steps: the row's pin is high in all, and the multiplexer turns.
        assert!(patterns.len() > 1_990, "{} patterns", patterns.len());
        assert!(patterns.iter().all(|(rows, _)| *rows == 1 << row));
        assert!((0..4).all(|sensor| patterns.iter().any(|(_, connected)| *connected == sensor)));
        assert!(session.frames.len() > 90, "{} frames", session.frames.len());
        let expected = lit[usize::from(row)].map(|code| i32::from(code.0));
        for (_, frame) in &session.frames {
            assert_eq!(frame.status & Status::ROW_HELD, Status::ROW_HELD);
            assert_eq!(frame.force.unwrap().z, Err(NoValue::NotEstimated));
            let codes = frame.codes.unwrap();
            let samples = i32::from(codes.full_scale.top().0) / 4095;
            let taxels = codes.taxels.unwrap();
            for read in taxels.lit.into_iter().chain([taxels.dark]) {
                let read = read.map(|code| i32::from(code.0));
                let off = read.iter().zip(expected).map(|(r, e)| (r - e * samples).abs());
                assert!(off.max() <= Some(samples), "{read:?}, expected {expected:?}");
            }
        }
    }
    session.board.host().open(false);
    session.run(micros(20_000)).unwrap();
    session.board.finger().timing = Some(Vec::new());
    session.run(micros(10_000)).unwrap();
    let timing = session.board.finger().timing.take().unwrap();
    assert!(timing.iter().any(|(_, moment)| matches!(moment, Moment::Pattern(0, _))));
    assert!(
        timing.iter().all(
            |(_, moment)| !matches!(moment, Moment::Pattern(rows, _) if rows.count_ones() > 1)
        )
    );
}

fn bootloader_starts_after_its_answer(model: Model) {
    let mut session = session(model, false);
    assert_eq!(session.ask(Command::Bootloader).unwrap(), Response::Done);
    assert_eq!(session.board.run(micros(400_000)).unwrap(), End::Reset(Cause::Software));
    assert_eq!(session.board.run(micros(20_000)).unwrap(), End::Bootloader);
    let now = (session.board.now(), 0);
    // VTOR: the ROM's own vectors.
    assert_eq!(session.board.chip().read(0xe000_ed08, 4, now).unwrap(), 0x1fff_0000);
}

fn program_starts_anew_after_leaving_the_bootloader(model: Model) {
    let mut board = board(model, scene(), false);
    board.leave_bootloader().unwrap();
    assert_eq!(board.run(micros(1_000)).unwrap(), End::Reset(Cause::Software));
    let mut session = Session::open(board).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(100_000)).unwrap();
    assert!(session.frames.len() > 90, "{} frames", session.frames.len());
    let health = health(&mut session);
    assert_eq!((health.reset, health.panic), (Reset::Software, None));
}

fn flash_is_accelerated_where_it_has_wait_states(model: Model) {
    let acr = match model {
        Model::G431 | Model::G473 => 0x4002_2000,
        Model::F411 => 0x4002_3c00,
    };
    let mut session = session(model, false);
    let now = (session.board.now(), 0);
    let acr = session.board.chip().read(acr, 4, now).unwrap();
    // LATENCY; PRFTEN, ICEN, DCEN
    assert!(acr & 0xf > 0 && acr & 0x700 == 0x700, "{acr:#x}");
}

fn debugger_freezes_watchdog_scan_and_time(model: Model) {
    // Freeze bits of IWDG and TIM2 on APB1, of TIM1 on APB2.
    let (apb2, tim1) = match model {
        Model::G431 | Model::G473 => (0x10, 1 << 11),
        Model::F411 => (0x0c, 1),
    };
    let mut session = session(model, false);
    let now = (session.board.now(), 0);
    let mut frozen = |offset: u32| session.board.chip().read(0xe004_2000 + offset, 4, now).unwrap();
    assert_eq!([frozen(0x08), frozen(apb2)], [1 << 12 | 1, tim1]);
}

fn settings_survive_unplug_and_saved_power_cycle(model: Model) {
    let mut session = session(model, false);
    session.ask(Command::SetRate { hz: 500 }).unwrap();
    session.board.host().plug(false);
    session.run(micros(500_000)).unwrap();
    session.board.host().plug(true);
    session.reopen().unwrap();
    assert_eq!(info(&mut session).rate_millihertz, 500_000);
    session.ask(Command::SetRate { hz: 250 }).unwrap();
    session.ask(Command::SaveSettings).unwrap();
    session.ask(Command::SetRate { hz: 125 }).unwrap();
    session.board.power_cycle().unwrap();
    session.reopen().unwrap();
    assert_eq!(info(&mut session).rate_millihertz, 250_000);
}

/// Checks the start after power cuts in an upload: every `each`-th operation, and the first and
/// last three.
///
/// `FlashContents::keep_cuts` keeps the contents after a cut in each operation. The program stalls
/// during an operation, and only the flash survives the cut. One upload therefore covers all cuts.
fn power_cuts(model: Model, each: usize) {
    let path = repository().join("host-tools/cli/assets/virtual-finger.cal.toml");
    let mut calibration = taxel_files::calibration::read(&path).unwrap();
    let mut session = session(model, false);
    session.board.host().hurries = true;
    let mut buffer = [0; MAX_BYTES];
    session.upload(calibration.to_bytes(&mut buffer).unwrap()).unwrap();
    let old = calibration.date;
    let before = session.board.flash().cells.clone();

    calibration.date += 1;
    let record = calibration.to_bytes(&mut buffer).unwrap();
    session.board.flash().keep_cuts();
    session.upload(record).unwrap();
    let cuts = session.board.flash().take_cuts();
    // An upload erases a slot, then programs one word after the other.
    assert!(cuts.len() > record.len() / 8, "{} operations", cuts.len());

    let (mut dates, ends) = (Vec::new(), [0..3, cuts.len() - 3..cuts.len()]);
    for (i, cut) in cuts.iter().enumerate() {
        if i % each > 0 && !ends.iter().any(|end| end.contains(&i)) {
            continue;
        }
        session.board.flash().cells = cut.clone();
        session.board.power_cycle().unwrap();
        session.reopen().unwrap();
        let calibration = info(&mut session).calibration.expect("the board has a calibration");
        dates.push((i, calibration.date));
    }
    // The old calibration, and from some operation on the new one.
    let kept = dates.iter().take_while(|(_, date)| *date == old).count();
    assert!(dates[kept - 1].0 > record.len() / 8, "{kept} of {}", dates.len());
    assert!(dates[kept..].iter().all(|(_, date)| *date == calibration.date), "{dates:?}");
    println!("{} operations, the old calibration after {kept} of {} cuts", cuts.len(), dates.len());

    // Two real cuts must leave the kept contents. The upload is the same in each run.
    for moment in [1, cuts.len() / 2] {
        session.board.flash().cells = before.clone();
        session.board.power_cycle().unwrap();
        session.reopen().unwrap();
        session.board.flash().cut_power_after(Some(moment as u64));
        session.upload(record).unwrap_err();
        assert_eq!(session.board.flash().cells, cuts[moment], "operation {moment}");
        session.reopen().unwrap();
        session.upload(record).unwrap();
        assert_eq!(info(&mut session).calibration.unwrap().date, calibration.date);
    }
}

fn power_cut_leaves_old_or_new_calibration(model: Model) {
    let each = match model {
        Model::G431 | Model::G473 => 1,
        Model::F411 => 61,
    };
    power_cuts(model, each);
}

fn watchdog_resets_when_no_scan_comes(model: Model) {
    let mut session = session(model, false);
    // TIM1 stops without a command.
    let now = (session.board.now(), 0);
    session.board.chip().write(tim1(model), 4, 0, now).unwrap();
    // The timeout is 0.5 s, and 3 s on the Black Pill, where erasing takes longer.
    let end = session.board.run(micros(4_000_000)).unwrap();
    assert_eq!(end, End::Reset(Cause::Watchdog));
    session.reopen().unwrap();
    let health = health(&mut session);
    assert_eq!((health.reset, health.panic), (Reset::Watchdog, None));
}

fn tshark_accepts_the_usb_capture(model: Model) {
    let mut session = session(model, true);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    let urbs = session.board.host().capture.take().unwrap();
    let path =
        std::env::temp_dir().join(format!("taxel-{}-{}.pcap", name(model), std::process::id()));
    std::fs::write(&path, pcap(&urbs)).unwrap();
    let tshark = |arguments: &[&str]| {
        let output = Process::new("tshark").arg("-r").arg(&path).args(arguments).output();
        let output = output.expect("tshark is needed: `sudo apt-get install tshark`");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let complaints = tshark(&["-Y", "_ws.malformed || _ws.expert"]);
    let subtypes = tshark(&[
        "-Y",
        "usbcom.descriptor.subtype",
        "-T",
        "fields",
        "-e",
        "usbcom.descriptor.subtype",
    ]);
    let vendor = tshark(&["-Y", "usb.idVendor == 0x1209 && usb.idProduct == 0x0001"]);
    let coding = tshark(&["-V", "-Y", "frame contains 21:20"]);
    let bulk = tshark(&["-Y", "usb.transfer_type == 3 && usb.endpoint_address.direction == 1"]);
    std::fs::remove_file(&path).unwrap();
    assert_eq!(complaints, "");
    // Header, abstract control management, union.
    assert_eq!(subtypes.trim(), "0x00,0x02,0x06");
    assert_eq!(vendor.lines().count(), 2, "{vendor}");
    assert!(coding.contains("SET LINE CODING"), "{coding}");
    assert!(bulk.lines().count() > 40, "{bulk}");
}

macro_rules! on_both {
    ($($test:ident)*) => {
        mod g431 {
            $(#[test] fn $test() { super::$test(super::Model::G431); })*
        }
        mod f411 {
            $(#[test] fn $test() { super::$test(super::Model::F411); })*
        }
    };
}

on_both! {
    streams_two_seconds_without_loss
    streamed_codes_match_converters_and_scene
    image_holds_every_estimator
    stack_overflow_faults_and_is_reported
    frames_match_host_byte_for_byte
    stalled_reader_loses_only_counted_frames
    closed_port_receives_no_frames
    ignored_dtr_is_detected
    suspended_bus_stops_the_scan_until_wake
    halted_endpoint_resumes_when_cleared
    self_test_measures_the_pins
    held_row_stays_lit_until_the_port_closes
    bootloader_starts_after_its_answer
    program_starts_anew_after_leaving_the_bootloader
    flash_is_accelerated_where_it_has_wait_states
    debugger_freezes_watchdog_scan_and_time
    settings_survive_unplug_and_saved_power_cycle
    power_cut_leaves_old_or_new_calibration
    watchdog_resets_when_no_scan_comes
    tshark_accepts_the_usb_capture
}

/// Long tests that run nightly.
mod nightly {
    use super::{Model, power_cuts, streams_without_a_loss};

    #[test]
    fn g431_streams_ten_seconds_without_a_loss() {
        streams_without_a_loss(Model::G431, 10);
    }

    #[test]
    fn f411_streams_ten_seconds_without_a_loss() {
        streams_without_a_loss(Model::F411, 10);
    }

    #[test]
    fn f411_keeps_a_calibration_over_many_power_cuts() {
        power_cuts(Model::F411, 13);
    }
}

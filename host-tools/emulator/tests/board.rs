//! The very image that is flashed, `cargo xtask firmware stm32g431`.

use std::path::{Path, PathBuf};
use std::process::Command as Process;

use scan_plan::g431::{CLOCK_HZ, TICKS_PER_CYCLE, plan};
use scan_plan::{Settings, settle};
use taxel::calibration::MAX_BYTES;
use taxel::finger::Finger;
use taxel::frame::{Fields, Frame, Status};
use taxel::scan::{Codes, Scan};
use taxel::units::{Code, Micros};
use taxel::wire::message::{Command, Info, Reset, Response, ScanSettings};
use taxel::wire::{MAX_PACKET, pack_frame};
use taxel_formats::trace::TraceReader;

use taxel_emulator::board::capture::pcap;
use taxel_emulator::board::chip::Chip;
use taxel_emulator::board::cpu::{Board, End};
use taxel_emulator::board::diagram;
use taxel_emulator::board::finger::{Finger as Wired, Moment, Pace, Source, in_12_bits};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::names::base;
use taxel_emulator::board::rcc::Cause;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::time::{HZ, Tick, micros};
use taxel_emulator::board::timing::vcd;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn image() -> Vec<u8> {
    let directory = std::env::var_os("TAXEL_FIRMWARE_DIR").map(PathBuf::from);
    let directory = directory.unwrap_or_else(|| repository().join("boards/target/firmware"));
    let path = directory.join("stm32g431.elf");
    std::fs::read(&path).unwrap_or_else(|error| {
        panic!("{}: {error}; build it with `cargo xtask firmware stm32g431`", path.display())
    })
}

/// Scans of a finger that is touched now and then, in codes of 12 bits.
fn scene() -> Vec<Codes> {
    let trace = repository().join("host-tools/emulator/data/scans.csv");
    let scans = TraceReader::open(&trace).unwrap().map(|sample| sample.unwrap().scan.codes);
    scans.map(in_12_bits).collect()
}

fn session(capture: bool) -> Session {
    let board = Board::new(&image(), Wired::new(scene(), Pace::Scans), Host::new(capture)).unwrap();
    Session::open(board).unwrap()
}

fn info(session: &mut Session) -> Info {
    match session.ask(Command::Info).unwrap() {
        Response::Info(info) => info,
        other => panic!("{other:?}"),
    }
}

/// The greatest distance of a streamed code from what the scene shows, in codes of 12 bits; all channels of
/// all frames, which are `divider` scans apart.
fn deviation(frames: &[(Tick, Frame)], scene: &[Codes], divider: usize) -> f32 {
    let distance = |first: usize| {
        let shown = scene.iter().cycle().skip(first).step_by(divider);
        let pairs = frames.iter().zip(shown);
        pairs.map(|((_, frame), shown)| worst(&frame.codes.unwrap(), shown)).fold(0.0, f32::max)
    };
    (0..scene.len()).map(distance).fold(f32::INFINITY, f32::min)
}

fn worst(read: &Codes, shown: &Codes) -> f32 {
    let samples = f32::from(read.full_scale.top().0) / 4095.0;
    let (read, shown) = (channels(read), channels(shown));
    read.zip(shown)
        .map(|(read, shown)| (f32::from(read.0) / samples - f32::from(shown.0)).abs())
        .fold(0.0, f32::max)
}

fn channels(codes: &Codes) -> impl Iterator<Item = Code> {
    let taxels = codes.taxels.unwrap();
    let bridges = codes.bridges.into_iter().flatten().flat_map(|m| [m.a, m.b, m.c, m.d]);
    taxels.lit.into_iter().flatten().chain(taxels.dark).chain(bridges)
}

fn stream_codes(session: &mut Session, time: Tick) -> Vec<(Tick, Frame)> {
    session.ask(Command::SetFields(Fields::CODES)).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    session.run(time).unwrap();
    session.ask(Command::Stream(false)).unwrap();
    std::mem::take(&mut session.frames)
}

#[test]
fn the_image_boots_enumerates_and_streams_ten_seconds_without_a_loss() {
    let mut session = session(false);
    session.ask(Command::SetFields(Fields::ALL)).unwrap();
    let before = info(&mut session);
    assert_eq!((before.identity.board.as_str(), before.identity.scan_hz), ("stm32g431", 4000));
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(10_000_000)).unwrap();
    let after = info(&mut session);

    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    assert_eq!((health.reset, health.panic), (Reset::Power, None));
    assert_eq!(after.counters.lost, 0);
    assert_eq!(after.counters.overruns, before.counters.overruns);
    assert_eq!((after.counters.bad_packets, session.bad), (0, 0));
    assert!((10_000..10_010).contains(&session.frames.len()), "{} frames", session.frames.len());
    for pair in session.frames.windows(2) {
        let [(_, a), (_, b)] = pair else { panic!() };
        assert_eq!(b.seq, a.seq + 1);
        assert!((999..=1001).contains(&(b.time.0 - a.time.0)), "{} to {}", a.time.0, b.time.0);
        assert!(!b.status.contains(Status::OVERRUN));
    }
}

#[test]
fn what_is_streamed_is_what_the_converters_saw_and_what_the_scene_shows() {
    let mut session = session(false);
    let frames = stream_codes(&mut session, micros(300_000));
    assert!(frames.len() > 290);
    first_seen(session.board.chip(), &frames, 4);
    // A step of a converter, for what has not quite settled.
    let deviation = deviation(&frames, &scene(), 4);
    assert!(deviation <= 1.0, "{deviation} codes");
}

#[test]
fn frames_are_the_hosts_own_byte_for_byte() {
    let path = repository().join("host-tools/emulator/data/finger.cal.toml");
    let mut calibration = taxel_formats::calibration::read(&path).unwrap();
    // The image leaves the model of the skin out, and passes over its section.
    calibration.model = None;
    let mut record = [0; MAX_BYTES];
    let record = calibration.to_bytes(&mut record).unwrap();
    let mut session = session(false);
    session.ask(Command::SetFields(Fields::ALL)).unwrap();
    session.upload(record).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(300_000)).unwrap();
    let frames = std::mem::take(&mut session.frames);
    assert!(frames.iter().any(|(_, frame)| frame.status.contains(Status::CONTACT)));

    // The board began anew with the calibration some scans before the first frame.
    let chip = session.board.chip();
    let (seen, first) = (&chip.finger.seen, first_seen(chip, &frames, 4));
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
                packed(&estimate.frame(device.seq, Fields::ALL)) == packed(device)
            })
        })
    };
    assert!((first.saturating_sub(40)..=first).any(|begin| equal(&begin)));
}

fn packed(frame: &Frame) -> Vec<u8> {
    let mut buffer = [0; MAX_PACKET];
    pack_frame(frame, &mut buffer).unwrap().to_vec()
}

#[test]
fn a_host_that_stops_reading_costs_frames_that_are_counted_and_nothing_else() {
    let mut session = session(false);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(100_000)).unwrap();
    let before = info(&mut session);
    session.board.chip().host.reading = false;
    session.run(micros(5_000_000)).unwrap();
    session.board.chip().host.reading = true;
    session.run(micros(100_000)).unwrap();
    let after = info(&mut session);
    assert_eq!((after.counters.bad_packets, session.bad), (0, 0));
    assert!(after.counters.lost > 4900, "{} frames lost", after.counters.lost);
    let gaps: u32 = session.frames.windows(2).map(|pair| pair[1].1.seq - pair[0].1.seq - 1).sum();
    assert_eq!(gaps, after.counters.lost);
    assert_eq!(after.counters.overruns, before.counters.overruns);
    // The scan went on. A frame's time is when its interrupt came, which waits for what masks it at most.
    for pair in session.frames.windows(2) {
        let [(_, a), (_, b)] = pair else { panic!() };
        let late = (b.time.0 - a.time.0).abs_diff(1000 * u64::from(b.seq - a.seq));
        assert!(late <= 10, "{late} µs at {}", a.seq);
    }
}

/// Frames that come after the port is closed, while the stream is on, and after the cable was out and in
/// and nobody has opened it.
fn frames_of_a_closed_port(misread: Option<fn([u8; 8]) -> [u8; 8]>) -> [usize; 2] {
    let mut session = session(false);
    session.board.chip().host.misread = misread;
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    session.board.chip().host.open(false);
    let frames = |session: &mut Session| {
        session.run(micros(50_000)).unwrap();
        session.frames.clear();
        session.run(micros(200_000)).unwrap();
        std::mem::take(&mut session.frames).len()
    };
    let closed = frames(&mut session);
    session.board.chip().host.plug(false);
    session.run(micros(10_000)).unwrap();
    session.board.chip().host.plug(true);
    session.run(micros(400_000)).unwrap();
    assert!(session.board.chip().host.is_ready());
    [closed, frames(&mut session)]
}

#[test]
fn nothing_is_sent_before_the_port_is_open_and_nothing_after_it_is_closed() {
    assert_eq!(frames_of_a_closed_port(None), [0, 0]);
}

#[test]
fn a_firmware_that_ignores_dtr_shows() {
    // It takes every SET_CONTROL_LINE_STATE for one with DTR.
    let ignored = frames_of_a_closed_port(Some(|setup| match setup {
        [0x21, 0x22, low, rest @ ..] => {
            let mut seen = [0x21, 0x22, low | 1, 0, 0, 0, 0, 0];
            seen[3..].copy_from_slice(&rest);
            seen
        }
        other => other,
    }));
    assert!(ignored[0] > 150, "{ignored:?}");
}

#[test]
fn a_suspended_bus_puts_the_light_out_until_it_wakes() {
    let mut session = session(false);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    let now = session.board.now();
    session.board.chip().host.suspend(true, now);
    // The bus is idle for 3 ms first.
    session.run(micros(10_000)).unwrap();
    session.frames.clear();
    session.board.chip().finger.timing = Some(Vec::new());
    // Longer than the watchdog waits.
    session.run(micros(800_000)).unwrap();
    assert_eq!(session.board.chip().finger.timing.take().unwrap(), []);
    assert_eq!(session.board.chip().finger.rows(), 0);
    assert_eq!(session.frames.len(), 0);
    let now = session.board.now();
    session.board.chip().host.suspend(false, now);
    session.run(micros(200_000)).unwrap();
    assert!(session.frames.len() > 190, "{} frames", session.frames.len());
    assert_eq!(session.bad, 0);
    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    assert_eq!(health.reset, Reset::Power);
}

#[test]
fn an_endpoint_that_the_host_halts_goes_on_when_it_is_let() {
    let mut session = session(false);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    session.board.chip().host.halt(true);
    session.run(micros(50_000)).unwrap();
    assert!(session.board.chip().host.stalls > 0);
    session.frames.clear();
    session.run(micros(200_000)).unwrap();
    assert!(session.frames.len() > 190, "{} frames", session.frames.len());
    // A host may clear a halt that there is none of.
    session.board.chip().host.halt(false);
    session.run(micros(50_000)).unwrap();
    session.frames.clear();
    session.run(micros(200_000)).unwrap();
    assert!(session.frames.len() > 190, "{} frames", session.frames.len());
    assert_eq!(info(&mut session).counters.bad_packets, 0);
}

#[test]
fn the_scan_is_set_anew_at_once_or_refused_and_goes_on() {
    let mut session = session(false);
    let wish = ScanSettings { scan_hz: 2000, oversampling: 4, settle_ns: 40_000 };
    session.ask(Command::SetScan(wish)).unwrap();
    session.board.chip().finger.timing = Some(Vec::new());
    let frames = stream_codes(&mut session, micros(100_000));
    let timing = session.board.chip().finger.timing.take().unwrap();
    let patterns = timing.iter().filter(|(_, moment)| matches!(moment, Moment::Pattern(..)));
    let steps: Vec<_> = patterns.map(|(at, _)| *at).collect();
    assert!(steps.windows(2).all(|pair| pair[1] - pair[0] == micros(100)));
    let sampled = timing.iter().filter(|(_, m)| *m == Moment::Sample(Source::Pin("PA0")));
    for (at, _) in sampled.take(500) {
        let since = steps.iter().filter(|step| **step <= *at).map(|step| at - step).min();
        assert!(since.is_none_or(|since| since >= micros(40)));
    }
    assert!(frames.iter().all(|(_, frame)| frame.codes.unwrap().full_scale.top().0 == 4 * 4095));
    let refused = session.ask(Command::SetScan(ScanSettings { scan_hz: 60_000, ..wish }));
    assert!(refused.unwrap_err().to_string().contains("ScanHz"));
    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    assert_eq!(health.scan, Some(wish));
}

#[test]
fn a_self_test_measures_what_is_on_the_pins() {
    let still = scene()[..1].to_vec();
    let board = Board::new(&image(), Wired::new(still.clone(), Pace::Scans), Host::new(false));
    let mut session = Session::open(board.unwrap()).unwrap();
    let Response::SelfTest(test) = session.ask(Command::SelfTest { scans: 200 }).unwrap() else {
        panic!()
    };
    assert_eq!((test.scans, test.full_scale.top().0), (200, 8 * 4095));
    let lit = still[0].taxels.unwrap().lit.into_iter().flatten();
    for (channel, code) in test.channels.lit.into_iter().flatten().zip(lit) {
        let channel = channel.unwrap();
        assert!((channel.mean / 8.0 - f32::from(code.0)).abs() <= 1.0 && channel.noise == 0.0);
    }
}

#[test]
fn the_bootloader_is_entered_after_the_answer() {
    let mut session = session(false);
    assert_eq!(session.ask(Command::Bootloader).unwrap(), Response::Done);
    assert_eq!(session.board.run(micros(400_000)).unwrap(), End::Reset(Cause::Software));
    assert_eq!(session.board.run(micros(10_000)).unwrap(), End::Bootloader);
}

#[test]
fn settings_outlast_the_cable_and_saved_ones_the_power() {
    let mut session = session(false);
    session.ask(Command::SetRate { hz: 500 }).unwrap();
    session.board.chip().host.plug(false);
    session.run(micros(500_000)).unwrap();
    session.board.chip().host.plug(true);
    session.reopen().unwrap();
    assert_eq!(info(&mut session).rate_millihertz, 500_000);
    session.ask(Command::SetRate { hz: 250 }).unwrap();
    session.ask(Command::SaveSettings).unwrap();
    session.ask(Command::SetRate { hz: 125 }).unwrap();
    session.board.power_cycle().unwrap();
    session.reopen().unwrap();
    assert_eq!(info(&mut session).rate_millihertz, 250_000);
}

/// After a cut in any operation the flash holds what [`Flash::keep_cuts`] keeps: the program stands still
/// meanwhile, and nothing else outlasts the power. So one upload shows all cuts, and each is started from.
#[test]
fn a_power_cut_in_any_operation_of_an_upload_leaves_one_calibration_or_the_other() {
    let path = repository().join("host-tools/cli/assets/virtual-finger.cal.toml");
    let mut calibration = taxel_formats::calibration::read(&path).unwrap();
    let mut session = session(false);
    session.board.chip().host.hurries = true;
    let mut buffer = [0; MAX_BYTES];
    session.upload(calibration.to_bytes(&mut buffer).unwrap()).unwrap();
    let old = calibration.date;
    let before = session.board.chip().flash().cells();

    calibration.date += 1;
    let record = calibration.to_bytes(&mut buffer).unwrap();
    session.board.chip().flash().keep_cuts();
    session.upload(record).unwrap();
    let cuts = session.board.chip().flash().take_cuts();
    // A slot's pages are erased, then a double word after the other.
    assert!(cuts.len() > record.len() / 8, "{} operations", cuts.len());

    let mut dates = Vec::new();
    for cut in &cuts {
        session.board.chip().flash().put(cut.clone());
        session.board.power_cycle().unwrap();
        session.reopen().unwrap();
        dates.push(info(&mut session).calibration.expect("a calibration is in force").date);
    }
    // The old one, until from some operation on it is the new one.
    let kept = dates.iter().take_while(|date| **date == old).count();
    assert!(kept > record.len() / 8, "{kept} of {}", cuts.len());
    assert!(dates[kept..].iter().all(|date| *date == calibration.date), "{:?}", &dates[kept..]);
    println!("{} operations, the old calibration after {kept} of the cuts", cuts.len());

    // What is kept is what a cut leaves: two of them are made. The upload is the same, whatever went before.
    for moment in [1, cuts.len() / 2] {
        session.board.chip().flash().put(before.clone());
        session.board.power_cycle().unwrap();
        session.reopen().unwrap();
        session.board.chip().flash().cut_power_after(Some(moment as u64));
        session.upload(record).unwrap_err();
        assert_eq!(session.board.chip().flash().cells(), cuts[moment], "operation {moment}");
        session.reopen().unwrap();
        session.upload(record).unwrap();
        assert_eq!(info(&mut session).calibration.unwrap().date, calibration.date);
    }
}

#[test]
fn the_watchdog_bites_where_no_scan_comes() {
    let mut session = session(false);
    // TIM1 stands still, and nobody has asked for it.
    let now = (session.board.now(), 0);
    session.board.chip().write(base("TIM1"), 4, 0, now).unwrap();
    let end = session.board.run(micros(1_000_000)).unwrap();
    assert_eq!(end, End::Reset(Cause::Watchdog));
    session.reopen().unwrap();
    let Response::Health(health) = session.ask(Command::Health).unwrap() else { panic!() };
    assert_eq!((health.reset, health.panic), (Reset::Watchdog, None));
}

#[test]
fn the_scan_keeps_time_to_the_tick_of_its_timer() {
    let mut session = session(false);
    session.board.chip().finger.timing = Some(Vec::new());
    session.run(micros(20_000)).unwrap();
    let timing = session.board.chip().finger.timing.take().unwrap();
    let plan =
        plan(Settings { scan_hz: 4000, oversampling: 8, settle_ns: settle::DEFAULT_NS }).unwrap();
    let tick = HZ / u64::from(CLOCK_HZ);

    let patterns: Vec<_> = timing
        .iter()
        .filter_map(|(at, moment)| match moment {
            Moment::Pattern(rows, sensor) => Some((*at, *rows, *sensor)),
            _ => None,
        })
        .collect();
    let order = [(0b0000, 0), (0b0001, 0), (0b0010, 1), (0b0100, 2), (0b1000, 3)];
    let first = patterns.iter().position(|(_, rows, _)| *rows == 0).unwrap();
    let steps = &patterns[first..];
    assert!(steps.len() > 390);
    for ((_, rows, sensor), expected) in steps.iter().zip(order.iter().cycle()) {
        assert_eq!((*rows, *sensor), *expected);
    }
    for pair in steps.windows(2) {
        assert_eq!(pair[1].0 - pair[0].0, u64::from(plan.step.top + 1) * tick);
    }

    // The first sample of a column after a pattern: never before the light has settled, and always then.
    let delays: Vec<_> = steps
        .iter()
        .filter_map(|(begin, ..)| {
            let column = |(at, moment): &&(Tick, Moment)| {
                at > begin && *moment == Moment::Sample(Source::Pin("PA0"))
            };
            timing.iter().find(column).map(|(at, _)| at - begin)
        })
        .collect();
    let settled = u64::from(settle::DEFAULT_NS) * HZ / 1_000_000_000;
    assert!(delays.len() > 390);
    assert!(delays.iter().all(|delay| *delay == delays[0] && *delay >= settled), "{delays:?}");

    // Both converters follow one timer: so do their first samples.
    let amplifier = |(_, moment): &&(Tick, Moment)| *moment == Moment::Sample(Source::Amplifier(0));
    let internal = |(_, moment): &&(Tick, Moment)| *moment == Moment::Sample(Source::Temperature);
    let apart = |first: Option<&(Tick, Moment)>, begin: Tick| first.map(|(at, _)| at - begin);
    for pair in steps.windows(2).take(100) {
        let within = || timing.iter().filter(|(at, _)| (pair[0].0..pair[1].0).contains(at));
        let [bridge, chip] =
            [apart(within().find(amplifier), pair[0].0), apart(within().find(internal), pair[0].0)];
        // ADC2's first sample ends after 24.5 of its cycles, ADC1's injected one after 247.5.
        assert_eq!(
            chip.unwrap() - bridge.unwrap(),
            (495 - 49) * u64::from(TICKS_PER_CYCLE) * tick / 2
        );
    }
}

#[test]
fn every_step_is_the_same_to_the_tick_and_both_converters_start_together() {
    let mut session = session(false);
    session.board.chip().finger.timing = Some(Vec::new());
    session.run(micros(10_000)).unwrap();
    let timing = session.board.chip().finger.timing.take().unwrap();
    let plan =
        plan(Settings { scan_hz: 4000, oversampling: 8, settle_ns: settle::DEFAULT_NS }).unwrap();
    let tick = HZ / u64::from(CLOCK_HZ);
    let steps: Vec<Tick> = moments(&timing, |m| matches!(m, Moment::Pattern(..)));
    let after =
        |at: &Tick| steps.iter().filter(|step| **step <= *at).map(|step| (at - step) / tick).min();
    let distinct = |wanted: Moment| {
        let mut found: Vec<_> =
            moments(&timing, |m| *m == wanted).iter().filter_map(after).collect();
        found.sort_unstable();
        found.dedup();
        found
    };
    // From the pattern: what does not wait for light starts on both converters at once, and then the columns.
    let [slow, columns] =
        [plan.step.slow, plan.step.columns].map(|at| u64::from(at - plan.step.light));
    assert_eq!(distinct(Moment::Trigger(0)), [slow, columns]);
    assert_eq!(distinct(Moment::Trigger(1)), [slow]);
    assert_eq!(distinct(Moment::Turn(0, 1)), [u64::from(plan.second_input - plan.step.light)]);
    // Two internal channels and four columns; A, C, bias, B, D.
    assert_eq!((distinct(Moment::Result(0)).len(), distinct(Moment::Result(1)).len()), (6, 5));
}

fn moments(timing: &[(Tick, Moment)], wanted: impl Fn(&Moment) -> bool) -> Vec<Tick> {
    timing.iter().filter(|(_, moment)| wanted(moment)).map(|(at, _)| *at).collect()
}

#[test]
fn the_diagram_of_the_boards_page_is_what_happens_on_the_pins() {
    let mut board =
        Board::new(&image(), Wired::new(scene(), Pace::Scans), Host::new(false)).unwrap();
    board.chip().finger.timing = Some(Vec::new());
    assert_eq!(board.run(micros(50_000)).unwrap(), End::Time);
    let timing = board.chip().finger.timing.take().unwrap();
    let path = repository().join("docs/boards/stm32g431-pins.svg");
    let committed = std::fs::read_to_string(&path).unwrap();
    assert!(committed == diagram::svg(&timing).unwrap(), "the page says how it is drawn anew");

    // The dump has the same edges as the diagram's steps.
    let mut dump = Vec::new();
    vcd(&timing, &mut dump).unwrap();
    let mut parser = vcd::Parser::new(&dump[..]);
    let header = parser.parse_header().unwrap();
    let row = header.find_var(&["stm32g431", "row_0"]).unwrap().code;
    let (mut now, mut edges) = (0, Vec::new());
    for command in parser {
        match command.unwrap() {
            vcd::Command::Timestamp(at) => now = at,
            vcd::Command::ChangeScalar(id, vcd::Value::V1) if id == row => edges.push(now),
            _ => {}
        }
    }
    assert!(edges.len() > 150);
    // A frame of 250 µs each, to the picosecond that a tick is rounded to.
    assert!(edges.windows(2).skip(1).all(|pair| (pair[1] - pair[0]).abs_diff(250_000_000) <= 1));
}

#[test]
fn a_dissector_finds_nothing_malformed_and_a_serial_port() {
    let mut session = session(true);
    session.ask(Command::Stream(true)).unwrap();
    session.run(micros(50_000)).unwrap();
    let urbs = session.board.chip().host.capture.take().unwrap();
    let path = std::env::temp_dir().join(format!("taxel-board-{}.pcap", std::process::id()));
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

/// Streams with a fault planted; how far the codes are off.
fn deviation_with(address: u32, change: fn(u32) -> u32) -> f32 {
    let mut board =
        Board::new(&image(), Wired::new(scene(), Pace::Scans), Host::new(false)).unwrap();
    board.chip().plant(address, change);
    let mut session = Session::open(board).unwrap();
    deviation(&stream_codes(&mut session, micros(100_000)), &scene(), 4)
}

#[test]
fn planted_faults_of_the_scan_show() {
    const CCR1: u32 = 0x34;
    const SQR1: u32 = 0x30;
    const CMAR1: u32 = 0x14;
    // The row is lit 18 µs late, so that 8 µs are left to settle.
    let settle = deviation_with(base("TIM1") + CCR1, |count| count + 3060);
    assert!(settle > 10.0, "{settle} codes");
    // The first two columns are swapped.
    let swapped = deviation_with(base("ADC1") + SQR1, |sqr| {
        sqr & !0x3_ffc0 | sqr >> 6 & 0xfc0 | (sqr & 0xfc0) << 6
    });
    assert!(swapped > 10.0, "{swapped} codes");
    // The patterns begin one row late.
    let shifted = deviation_with(base("DMA1") + CMAR1, |address| address + 4);
    assert!(shifted > 10.0, "{shifted} codes");
}

/// The scan of the first frame among those that the converters saw, where every later frame is `divider`
/// scans after the one before.
fn first_seen(chip: &Chip, frames: &[(Tick, Frame)], divider: usize) -> usize {
    let seen = &chip.finger.seen;
    let fits = |first: &usize| {
        let scans = seen.iter().skip(*first).step_by(divider);
        frames.iter().zip(scans).all(|((_, frame), seen)| frame.codes == Some(seen.codes))
    };
    let last = seen.len() - divider * (frames.len() - 1);
    (0..last)
        .find(fits)
        .expect("the codes of all frames, in order, are among those that were converted")
}

//! Tests of the product's scan on its pins.

use scan_plan::g431::{CLOCK_HZ, TICKS_PER_CYCLE, plan};
use scan_plan::settle;
use taxel::scan::ScanSettings;
use taxel::wire::message::Command;

use taxel_emulator::board::cpu::End;
use taxel_emulator::board::diagram;
use taxel_emulator::board::finger::{Moment, Source};
use taxel_emulator::board::g431::names::base;
use taxel_emulator::board::model::Model::G431;
use taxel_emulator::board::time::{HZ, Tick, micros};
use taxel_emulator::board::timing::vcd;

use crate::support::{
    board, deviation_with, health, moments, repository, scene, session, stop_with, stream_codes,
};

#[test]
fn scan_keeps_time_to_the_tick() {
    let mut session = session(G431, false);
    session.board.finger().timing = Some(Vec::new());
    session.run(micros(20_000)).unwrap();
    let timing = session.board.finger().timing.take().unwrap();
    let plan = plan(ScanSettings { scan_hz: 4000, oversampling: 8, settle_ns: settle::DEFAULT_NS })
        .unwrap();
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

    // The first sample of a column always comes after the light has settled.
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

    // One timer starts both converters, so their first samples keep a fixed distance.
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
fn steps_repeat_and_converters_start_together() {
    let mut session = session(G431, false);
    session.board.finger().timing = Some(Vec::new());
    session.run(micros(10_000)).unwrap();
    let timing = session.board.finger().timing.take().unwrap();
    let plan = plan(ScanSettings { scan_hz: 4000, oversampling: 8, settle_ns: settle::DEFAULT_NS })
        .unwrap();
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
    // From the pattern: both converters start at once on what does not need light, ADC1 then on the
    // columns.
    let [slow, columns] =
        [plan.step.slow, plan.step.columns].map(|at| u64::from(at - plan.step.light));
    assert_eq!(distinct(Moment::Trigger(0)), [slow, columns]);
    assert_eq!(distinct(Moment::Trigger(1)), [slow]);
    assert_eq!(distinct(Moment::Turn(0, 1)), [u64::from(plan.second_input - plan.step.light)]);
    // Two internal channels and four columns; A, C, bias, B, D.
    assert_eq!((distinct(Moment::Result(0)).len(), distinct(Moment::Result(1)).len()), (6, 5));
}

#[test]
fn diagram_matches_the_pins() {
    let mut board = board(G431, scene(), false);
    board.finger().timing = Some(Vec::new());
    assert_eq!(board.run(micros(50_000)).unwrap(), End::Time);
    let timing = board.finger().timing.take().unwrap();
    let path = repository().join("docs/boards/stm32g431-pins.svg");
    let committed = std::fs::read_to_string(&path).unwrap();
    assert!(committed == diagram::svg(&timing).unwrap(), "the page says how it is drawn again");

    // The dump has the same edges as the diagram's steps.
    let mut dump = Vec::new();
    vcd(&timing, board.finger().wiring().unwrap(), &mut dump).unwrap();
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
    // Each frame lasts 250 µs, within 1 ps of rounding.
    assert!(edges.windows(2).skip(1).all(|pair| (pair[1] - pair[0]).abs_diff(250_000_000) <= 1));
}

#[test]
fn injected_scan_faults_are_detected() {
    const CCR1: u32 = 0x34;
    const SQR1: u32 = 0x30;
    const CMAR1: u32 = 0x14;
    // The row is lit 18 µs late, so that 8 µs are left to settle.
    let settle = deviation_with(G431, base("TIM1") + CCR1, |count| count + 3060);
    assert!(settle > 10.0, "{settle} codes");
    // The first two columns are swapped.
    let swapped = deviation_with(G431, base("ADC1") + SQR1, |sqr| {
        sqr & !0x3_ffc0 | sqr >> 6 & 0xfc0 | (sqr & 0xfc0) << 6
    });
    assert!(swapped > 10.0, "{swapped} codes");
    // The patterns begin one row late.
    let shifted = deviation_with(G431, base("DMA1") + CMAR1, |address| address + 4);
    assert!(shifted > 10.0, "{shifted} codes");
}

#[test]
fn scan_settings_apply_at_once_or_are_refused() {
    let mut session = session(G431, false);
    let wish = ScanSettings { scan_hz: 2000, oversampling: 4, settle_ns: 40_000 };
    session.ask(Command::SetScan(wish)).unwrap();
    session.board.finger().timing = Some(Vec::new());
    let frames = stream_codes(&mut session, micros(100_000));
    let timing = session.board.finger().timing.take().unwrap();
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
    let health = health(&mut session);
    assert_eq!(health.scan, Some(wish));
}

#[test]
fn wrong_gain_shows_in_the_codes() {
    // PGA_GAIN: 4, 32 and 64 instead of 16, about the bias; 16 from ground.
    let faults: [fn(u32) -> u32; 4] = [
        |csr| csr & !(0x1f << 14) | 0b01001 << 14,
        |csr| csr & !(0x1f << 14) | 0b01100 << 14,
        |csr| csr & !(0x1f << 14) | 0b01101 << 14,
        |csr| csr & !(0x1f << 14) | 0b00011 << 14,
    ];
    for fault in faults {
        let wrong = deviation_with(G431, base("OPAMP2"), fault);
        assert!(wrong > 100.0, "{wrong} codes");
    }
}

#[test]
fn dual_mode_starts_both_converters_at_once() {
    let triggers = |change: fn(u32) -> u32| {
        let mut board = board(G431, scene(), false);
        board.chip().plant(base("ADC12_COMMON") + 8, change);
        board.finger().timing = Some(Vec::new());
        board.run(micros(20_000)).unwrap();
        let timing = board.finger().timing.take().unwrap();
        [0, 1].map(|adc| moments(&timing, |moment| *moment == Moment::Trigger(adc)))
    };
    // ADC1's sequence begins behind ADC2's, and with DUAL = 2 together with it.
    let [first, second] = triggers(|ccr| ccr);
    let columns: Vec<_> = first.iter().filter(|at| !second.contains(at)).copied().collect();
    assert!(columns.len() > 100 && second.len() > 100);
    assert_eq!(triggers(|ccr| ccr | 2)[1][..100], columns[..100]);
}

#[test]
fn memory_out_of_reach_stops_the_machine() {
    const CMAR2: u32 = 0x28;
    // The columns' readings go to the CCM SRAM, and into the flash.
    let core = stop_with(G431, base("DMA1") + CMAR2, |_| 0x1000_0430);
    assert!(core.contains("the DMA writes 0x10000430"), "{core}");
    let flash = stop_with(G431, base("DMA1") + CMAR2, |_| 0x0800_0430);
    assert!(flash.contains("the DMA writes 0x08000430"), "{flash}");
}

#[test]
fn wrong_bits_stop_the_machine_by_name() {
    const CSR: u32 = 0x00;
    // Reserved bits, bits without a model, and a clock that nothing trims.
    let reserved = stop_with(G431, base("PWR") + 0x80, |cr5| cr5 | 1);
    assert!(reserved.contains("PWR.CR5 (0x40007080): sets reserved bits 0x1"), "{reserved}");
    let unknown = stop_with(G431, base("OPAMP2") + CSR, |csr| csr | 1 << 11);
    assert!(unknown.contains("sets bits that are not modelled: 0x800"), "{unknown}");
    let untrimmed = stop_with(G431, base("CRS"), |cr| cr & !0x60);
    assert!(untrimmed.contains("HSI48 does not follow the host"), "{untrimmed}");
    let reset = stop_with(G431, base("RCC") + 0x38, |resets| resets | 1);
    assert!(reset.contains("it is held in reset"), "{reset}");
    let slow = stop_with(G431, base("PWR"), |cr1| cr1 ^ 3 << 9);
    assert!(slow.contains("outside voltage range 1"), "{slow}");
}

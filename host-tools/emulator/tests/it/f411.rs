//! Tests of the Black Pill's scan on its pins.

use scan_plan::f411::{CLOCK_HZ, INPUTS, TICKS_PER_CYCLE, plan};
use scan_plan::settle;
use taxel::frame::{Fields, Status};
use taxel::scan::ScanSettings;
use taxel::wire::message::Command;

use taxel_emulator::board::f411::registers::base;
use taxel_emulator::board::finger::{Moment, Source};
use taxel_emulator::board::model::Model::F411;
use taxel_emulator::board::time::{HZ, Tick, micros};

use crate::support::{deviation_with, health, info, moments, session, stop_with, stream_codes};

const TICK: Tick = HZ / CLOCK_HZ as Tick;

fn is_pattern(moment: &Moment) -> bool {
    matches!(moment, Moment::Pattern(..))
}

#[test]
fn rows_and_steps_repeat_to_the_tick() {
    let mut session = session(F411, false);
    session.board.finger().timing = Some(Vec::new());
    session.run(micros(20_000)).unwrap();
    let timing = session.board.finger().timing.take().unwrap();
    let plan = plan(ScanSettings { scan_hz: 4000, oversampling: 1, settle_ns: settle::DEFAULT_NS })
        .unwrap();

    let first = timing.iter().position(|(_, m)| *m == Moment::Pattern(0, 0)).unwrap();
    let patterns: Vec<_> = timing[first..].iter().filter(|(_, m)| is_pattern(m)).collect();
    assert!(patterns.len() > 390);
    let order = [(0b0000, 0), (0b0001, 0), (0b0010, 1), (0b0100, 2), (0b1000, 3)];
    for ((_, moment), (rows, sensor)) in patterns.iter().zip(order.into_iter().cycle()) {
        assert_eq!(*moment, Moment::Pattern(rows, sensor));
    }
    for pair in patterns.windows(2) {
        assert_eq!(pair[1].0 - pair[0].0, Tick::from(plan.step.top + 1) * TICK);
    }

    // Distinct times in all steps, in timer ticks from the pattern.
    let steps = moments(&timing[first..], is_pattern);
    let after = |at: &Tick| steps.iter().rev().find(|step| *step <= at).map(|step| at - step);
    let distinct = |wanted: &dyn Fn(&Moment) -> bool| {
        let mut found: Vec<_> = moments(&timing, wanted).iter().filter_map(after).collect();
        found.sort_unstable();
        found.dedup();
        found
    };
    let ticks = |counts: u32| Tick::from(counts) * TICK;
    let [slow, columns] = [plan.step.slow, plan.step.columns].map(|at| ticks(at - plan.step.light));
    assert_eq!(distinct(&|m| *m == Moment::Trigger(0)), [slow, columns]);
    // Each input is sampled once a step, the first after the light has settled.
    let pins = ["PA1", "PA2", "PA3", "PA4", "PA5", "PA6", "PA7", "PB0"];
    assert_eq!(pins.len(), INPUTS.len());
    let each = ticks(27 * TICKS_PER_CYCLE);
    for (pin, due) in pins.into_iter().zip((columns..).step_by(each as usize)) {
        let [sampled] = distinct(&|m| *m == Moment::Sample(Source::Pin(pin)))[..] else {
            panic!("{pin} is sampled at several places of a step")
        };
        assert_eq!(sampled - due, ticks(18 * TICKS_PER_CYCLE), "3 cycles to begin, 15 to sample");
    }
    let settled = Tick::from(settle::DEFAULT_NS) * HZ / 1_000_000_000;
    assert!(columns >= settled);
    // Temperature and reference alternate at one time of the step.
    let internal = [Source::Temperature, Source::Reference];
    let [temperature, reference] =
        internal.map(|source| distinct(&|m| *m == Moment::Sample(source)));
    assert_eq!((temperature.len(), &temperature), (1, &reference));
    let turns = moments(&timing, |m| internal.iter().any(|source| *m == Moment::Sample(*source)));
    assert!(turns.len() > 390);
}

#[test]
fn injected_scan_faults_are_detected() {
    const CCR1: u32 = 0x34;
    const SQR3: u32 = 0x34;
    const S1M0AR: u32 = 0x34;
    // The row is lit 18 µs late, so that 8 µs are left to settle.
    let settle = deviation_with(F411, base("TIM1") + CCR1, |count| count + 1728);
    assert!(settle > 10.0, "{settle} codes");
    // The first two columns are swapped.
    let swapped = deviation_with(F411, base("ADC1") + SQR3, |sqr| {
        sqr & !0x3ff | sqr >> 5 & 0x1f | sqr << 5 & 0x3e0
    });
    assert!(swapped > 10.0, "{swapped} codes");
    // The patterns begin one row late.
    let shifted = deviation_with(F411, base("DMA2") + S1M0AR, |address| address + 4);
    assert!(shifted > 10.0, "{shifted} codes");
}

#[test]
fn missed_reading_costs_one_counted_scan() {
    let mut session = session(F411, false);
    session.ask(Command::SetRate { hz: 4000 }).unwrap();
    session.ask(Command::SetFields(Fields::CODES)).unwrap();
    session.ask(Command::Stream(true)).unwrap();
    // In any step.
    for i in 0..4 {
        session.run(micros(20_000) + i * micros(37)).unwrap();
        session.frames.clear();
        let before = info(&mut session).counters;
        session.board.chip().withhold(0);
        session.run(micros(20_000)).unwrap();
        assert_eq!(info(&mut session).counters.overruns - before.overruns, 1);
        assert!(session.seen_in_order_since(Status::OVERRUN) > Some(60));
    }
}

#[test]
fn scan_settings_apply_at_once_or_are_refused() {
    let mut session = session(F411, false);
    let wish = ScanSettings { scan_hz: 2000, oversampling: 1, settle_ns: 40_000 };
    session.ask(Command::SetScan(wish)).unwrap();
    session.board.finger().timing = Some(Vec::new());
    let frames = stream_codes(&mut session, micros(100_000));
    assert!(frames.len() > 95);
    let timing = session.board.finger().timing.take().unwrap();
    let steps = moments(&timing, is_pattern);
    assert!(steps.windows(2).all(|pair| pair[1] - pair[0] == micros(100)));
    // The chip has no oversampler.
    let refused = session.ask(Command::SetScan(ScanSettings { oversampling: 2, ..wish }));
    assert!(refused.unwrap_err().to_string().contains("Oversampling"));
    let health = health(&mut session);
    assert_eq!(health.scan, Some(wish));
}

#[test]
fn usb_on_wrong_pins_stops_the_machine() {
    const MODER: u32 = 0x00;
    const AFRH: u32 = 0x24;
    // PA11 and PA12 as inputs, and with another alternate function.
    let inputs = stop_with(F411, base("GPIOA") + MODER, |moder| moder & !(0xf << 22));
    let other = stop_with(F411, base("GPIOA") + AFRH, |_| 0);
    for stop in [inputs, other] {
        assert!(stop.contains("PA11 and PA12 are not the OTG core's"), "{stop}");
    }
}

#[test]
fn pull_up_or_misplaced_fifo_stops_the_machine() {
    const PUPDR: u32 = 0x0c;
    const DIEPTXF1: u32 = 0x104;
    let pulled = stop_with(F411, base("GPIOA") + PUPDR, |pulls| pulls | 1 << 2);
    assert!(pulled.contains("ADC1's input PA1 has a pull-up or pull-down"), "{pulled}");
    let fifo = stop_with(F411, base("OTG_FS") + DIEPTXF1, |fifo| fifo + 2);
    assert!(fifo.contains("a FIFO begins at"), "{fifo}");
}

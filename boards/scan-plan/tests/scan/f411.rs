//! Tests of the STM32F411's plan: its registers are decoded by RM0383 and simulated on a time line.

use crate::common::{Span, grid, overlaps};
use scan_plan::f411::{ADC_HZ, INTERNAL_NS, Plan, READINGS, plan};
use scan_plan::{STEPS, settle};
use taxel::scan::ScanSetting::{Oversampling, ScanHz, SettleNs};
use taxel::scan::ScanSettings;
use taxel::wire::message::Refusal;

pub const DEFAULT: ScanSettings =
    ScanSettings { scan_hz: 4000, oversampling: 1, settle_ns: settle::DEFAULT_NS };

fn plans() -> impl Iterator<Item = (ScanSettings, Plan)> {
    grid(&[1]).filter_map(|settings| Some((settings, plan(settings).ok()?)))
}

/// Bits `at` to `at + count` of `value`.
fn bits(value: u32, at: u32, count: u32) -> u32 {
    value >> at & ((1 << count) - 1)
}

/// HCLK cycles of a count of the timer.
fn clocks(plan: &Plan, count: u32) -> u64 {
    u64::from(count) * u64::from(plan.timer.psc + 1)
}

/// Times in ticks of each input's sample and result, converted in turn from `start` on.
pub fn conversions(plan: &Plan, inputs: &[u32], start: u32) -> Vec<(Span, u64)> {
    const CYCLES: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
    let mut now = clocks(plan, start) + 16;
    inputs
        .iter()
        .map(|input| {
            let code = match input {
                0..10 => bits(plan.adc.smpr2, 3 * input, 3),
                _ => bits(plan.adc.smpr1, 3 * (input - 10), 3),
            };
            let sample = now..now + CYCLES[code as usize] * 4;
            now = sample.end + 12 * 4;
            (sample, now)
        })
        .collect()
}

pub fn regular(plan: &Plan) -> Vec<u32> {
    let place = |i: u32| match i {
        0..6 => bits(plan.adc.sqr3, 5 * i, 5),
        6..12 => bits(plan.adc.sqr2, 5 * (i - 6), 5),
        _ => bits(plan.adc.sqr1, 5 * (i - 12), 5),
    };
    (0..=bits(plan.adc.sqr1, 20, 4)).map(place).collect()
}

/// Injected inputs; with JL = 1 the two conversions are JSQ3 and JSQ4.
pub fn injected(plan: &Plan) -> [u32; 2] {
    assert_eq!(bits(plan.adc.jsqr, 20, 2), 1);
    [bits(plan.adc.jsqr, 10, 5), bits(plan.adc.jsqr, 15, 5)]
}

#[test]
fn black_pill_reaches_5674_hz_and_runs_at_4_khz() {
    assert_eq!(plan(DEFAULT).unwrap().step.scan_millihertz(), 4_000_000);
    let Err(Refusal::Scan { setting: ScanHz, low, high }) =
        plan(ScanSettings { scan_hz: u16::MAX, ..DEFAULT })
    else {
        panic!("65 kHz are too fast")
    };
    assert_eq!((low, high), (147, 5674));
}

#[test]
fn inputs_are_sampled_before_the_next_pattern() {
    for (settings, plan) in plans() {
        let inputs = regular(&plan);
        assert_eq!(inputs, [1, 2, 3, 4, 5, 6, 7, 8]);
        let light = clocks(&plan, plan.timer.ccr1);
        let settled = light + u64::from(settings.settle_ns) * 96 / 1000;
        let next = clocks(&plan, plan.timer.arr + 1) + light;
        for (sample, _) in conversions(&plan, &inputs, plan.timer.ccr2) {
            assert!(sample.start >= settled && sample.end <= next, "{settings:?}");
        }
    }
}

#[test]
fn internal_inputs_alternate_in_the_settle_time() {
    for (settings, plan) in plans() {
        assert_eq!(injected(&plan), [18, 17]);
        assert_eq!(bits(plan.adc.cr1, 12, 1), 1, "JDISCEN: one a trigger");
        let period = clocks(&plan, plan.timer.arr + 1);
        let inputs = conversions(&plan, &regular(&plan), plan.timer.ccr2);
        for input in injected(&plan) {
            let (sample, end) = conversions(&plan, &[input], plan.timer.ccr3).remove(0);
            assert!((sample.end - sample.start) * 1000 / 96 >= u64::from(INTERNAL_NS));
            let mut spans: Vec<Span> = inputs.iter().map(|(s, end)| s.start..*end).collect();
            spans.push(sample.start..end);
            assert!(!overlaps(&spans, period), "{settings:?}");
        }
    }
}

#[test]
fn triggers_clocks_and_dma_follow_the_reference_manual() {
    let plan = plan(DEFAULT).unwrap();
    const { assert!(ADC_HZ <= 36_000_000) };
    assert_eq!(bits(plan.adc.ccr, 16, 2), 1, "PCLK2/4");
    assert_eq!(bits(plan.adc.ccr, 23, 1), 1, "TSVREFE");
    assert_eq!(bits(plan.adc.cr2, 24, 4), 1, "EXTSEL: TIM1_CC2");
    assert_eq!(bits(plan.adc.cr2, 16, 4), 1, "JEXTSEL: TIM1_TRGO");
    assert_eq!((bits(plan.adc.cr2, 28, 2), bits(plan.adc.cr2, 20, 2)), (1, 1), "rising");
    assert_eq!(bits(plan.adc.cr2, 8, 2), 3, "DMA without end");
    assert_eq!(bits(plan.adc.cr1, 8, 1), 1, "SCAN");
    assert_eq!(bits(plan.adc.cr1, 26, 1), 1, "OVRIE: an overrun stops the DMA");
    let timer = plan.timer;
    assert_eq!(bits(timer.cr2, 4, 3), 0b110, "TRGO = OC3REF");
    assert_eq!((bits(timer.ccmr1, 12, 3), bits(timer.ccmr2, 4, 3)), (7, 7), "PWM mode 2");
    assert_eq!((timer.ccer, timer.bdtr, timer.dier), (1 << 4, 1 << 15, 1 << 9));
    // RM0383 table 28: stream 1 channel 6 is TIM1_CH1, stream 0 channel 0 is ADC1.
    let (patterns, readings) = (plan.patterns, plan.readings);
    assert_eq!((bits(patterns.cr, 25, 3), bits(readings.cr, 25, 3)), (6, 0));
    assert_eq!((bits(patterns.cr, 6, 2), bits(readings.cr, 6, 2)), (1, 0), "direction");
    assert_eq!((bits(patterns.cr, 11, 4), bits(readings.cr, 11, 4)), (0b1010, 0b0101), "sizes");
    assert_eq!((bits(patterns.cr, 3, 2), bits(readings.cr, 3, 2)), (0, 3), "interrupts");
    for stream in [patterns, readings] {
        assert_eq!((bits(stream.cr, 8, 1), bits(stream.cr, 10, 1), stream.cr & 1), (1, 1, 0));
    }
    assert_eq!((patterns.count, readings.count), (STEPS, 2 * READINGS as u32));
}

#[test]
fn oversampling_and_short_settle_times_are_refused() {
    assert_eq!(
        plan(ScanSettings { oversampling: 2, ..DEFAULT }),
        Err(Refusal::Scan { setting: Oversampling, low: 1, high: 1 })
    );
    for scan_hz in [200, 600, 1000, 3333, 4000] {
        let with = |settle_ns| plan(ScanSettings { settle_ns, scan_hz, ..DEFAULT });
        let Err(Refusal::Scan { setting: SettleNs, low, high }) = with(9000) else {
            panic!("9 µs leave no time for the temperature")
        };
        // A tick is 10.4 ns, or twice as much below 293 Hz.
        let tick = if scan_hz < 293 { 21 } else { 11 };
        assert!(
            with(low).is_ok()
                && matches!(with(low - tick - 1), Err(Refusal::Scan { setting: SettleNs, .. }))
        );
        assert!(with(high).is_ok() && with(high + tick).is_err(), "{low}..={high} at {scan_hz} Hz");
    }
}

#[test]
fn ticks_round_exact_quotient_up() {
    for hz in [96_000_000, 170_000_000] {
        for ns in (0..20_000_000).step_by(997).chain([20_000_000]) {
            let exact = (u64::from(ns) * u64::from(hz)).div_ceil(1_000_000_000);
            assert_eq!(u64::from(scan_plan::ticks(ns, hz)), exact, "{ns} ns at {hz} Hz");
        }
    }
}

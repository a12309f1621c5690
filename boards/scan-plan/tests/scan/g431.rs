//! Tests of the STM32G431's plan: its registers are decoded and simulated on a time line.
//!
//! The bit positions are those of the vendor's register description (`stm32-metapac`), not the
//! plan's.

use crate::common::{Span, grid, overlaps};
use scan_plan::g431::{
    ADC_HZ, AMPLIFIER_NS, BRIDGE_READINGS, CLOCK_HZ, COLUMN_READINGS, Channel, INTERNAL_NS, Last,
    Plan, plan,
};
use scan_plan::{COLUMNS, STEPS, settle};
use stm32_metapac as pac;
use stm32_metapac::adc::regs::{Cfgr, Cfgr2, Jsqr, Smpr, Smpr2, Sqr1, Sqr2};
use stm32_metapac::bdma::regs::Cr;
use stm32_metapac::timer::regs::{BdtrAdv, Ccmr3Adv, CcmrOutputGp16, Cr1Core, Cr2Adv, DierAdv};
use taxel::scan::ScanSetting::{Oversampling, ScanHz, SettleNs};
use taxel::scan::ScanSettings;
use taxel::wire::message::Refusal;

pub const DEFAULT: ScanSettings =
    ScanSettings { scan_hz: 4000, oversampling: 8, settle_ns: settle::DEFAULT_NS };

/// Sampling times of `SMPR`, in half cycles (RM0440 §21.7.6).
const HALVES: [u64; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];

/// Accepted plans of a grid of settings.
fn plans() -> impl Iterator<Item = (ScanSettings, Plan)> {
    grid(&[1, 2, 4, 8, 16]).filter_map(|settings| Some((settings, plan(settings).ok()?)))
}

/// Conversion: its input, the times of its samples and of its last result, in half timer ticks.
pub struct Conversion {
    pub input: u8,
    pub samples: Vec<Span>,
    pub end: u64,
}

/// Conversions of an ADC after a trigger at `start` (half ticks).
fn conversions(
    inputs: &[u8],
    sample: impl Fn(u8) -> u8,
    ratio: u64,
    start: u64,
) -> Vec<Conversion> {
    // A half cycle of the ADC clock is two ticks, which are four half ticks.
    const HALF: u64 = 4;
    let mut now = start;
    inputs
        .iter()
        .map(|input| {
            let samples = (0..ratio)
                .map(|_| {
                    let begin = now;
                    let end = begin + HALVES[usize::from(sample(*input))] * HALF;
                    now = end + 25 * HALF;
                    begin..end
                })
                .collect();
            Conversion { input: *input, samples, end: now }
        })
        .collect()
}

fn ratio(cfgr2: u32) -> u64 {
    let cfgr2 = Cfgr2(cfgr2);
    assert_eq!(cfgr2.ovss(), 0, "readings are sums");
    assert!(!cfgr2.jovse() && cfgr2.trovs().to_bits() == 0);
    if cfgr2.rovse() { 2 << cfgr2.ovsr() } else { 1 }
}

fn sampling(adc: &scan_plan::g431::Adc) -> impl Fn(u8) -> u8 {
    let (low, high) = (Smpr(adc.smpr1), Smpr2(adc.smpr2));
    move |input| match input {
        0..10 => low.smp(input.into()).to_bits(),
        _ => high.smp(usize::from(input) - 10).to_bits(),
    }
}

fn regular(adc: &scan_plan::g431::Adc) -> Vec<u8> {
    let (first, second) = (Sqr1(adc.sqr1), Sqr2(adc.sqr2));
    let all = (0..4).map(|i| first.sq(i)).chain((0..5).map(|i| second.sq(i)));
    all.take(usize::from(first.l()) + 1).collect()
}

/// Greatest latency of a trigger in half ticks: four ADC cycles.
const LATENCY: u64 = 4 * 8;

/// HCLK cycles of a count of the timer.
fn clocks(plan: &Plan, count: u32) -> u64 {
    u64::from(count) * u64::from(plan.timer.psc + 1)
}

pub struct Line {
    pub columns: Vec<Conversion>,
    pub internal: Vec<Conversion>,
    pub bridges: Vec<Conversion>,
}

/// Time line of one step, with triggers at their latest.
pub fn line(plan: &Plan) -> Line {
    let start = |compare: u32| clocks(plan, compare) * 2 + LATENCY;
    let jsqr = Jsqr(plan.adc1.jsqr);
    let injected: Vec<_> = (0..usize::from(jsqr.jl()) + 1).map(|i| jsqr.jsq(i)).collect();
    Line {
        columns: conversions(
            &regular(&plan.adc1),
            sampling(&plan.adc1),
            ratio(plan.adc1.cfgr2),
            start(plan.timer.ccr2),
        ),
        internal: conversions(&injected, sampling(&plan.adc1), 1, start(plan.timer.ccr3)),
        bridges: conversions(
            &regular(&plan.adc2),
            sampling(&plan.adc2),
            ratio(plan.adc2.cfgr2),
            start(plan.timer.ccr3),
        ),
    }
}

#[test]
fn default_scans_at_4_khz_with_eight_samples() {
    let plan = plan(DEFAULT).unwrap();
    assert_eq!(plan.step.scan_millihertz(), 4_000_000);
    assert_eq!(plan.full_scale, 8 * 4095);
    assert_eq!(ratio(plan.adc1.cfgr2), 8);
}

#[test]
fn fastest_scan_reaches_nine_tenths_of_settle_limit() {
    let wish = ScanSettings { scan_hz: u16::MAX, oversampling: 1, ..DEFAULT };
    let Err(Refusal::Scan { setting: ScanHz, high, .. }) = plan(wish) else {
        panic!("65 kHz are too fast")
    };
    let fastest = plan(ScanSettings { scan_hz: high as u16, ..wish }).unwrap();
    // Five settle times and nothing else: 7.5 kHz.
    let ceiling = 1e9 / (5.0 * f64::from(DEFAULT.settle_ns));
    let share = f64::from(fastest.step.scan_millihertz()) / 1000.0 / ceiling;
    assert!((0.90..1.0).contains(&share), "{high} Hz is {share} of it");
    assert_eq!(high, 6969);
}

#[test]
fn settle_time_of_the_load_allows_8_khz() {
    let with =
        |scan_hz, oversampling, settle_ns| plan(ScanSettings { scan_hz, oversampling, settle_ns });
    let fast = with(8000, 2, settle::ON_LOAD_NS).unwrap();
    assert_eq!(fast.step.scan_millihertz(), 8_000_000);
    // Refused with the rates that are possible: too many samples, and the default settle time.
    let most = |refused| match refused {
        Err(Refusal::Scan { setting: ScanHz, high, .. }) => high,
        other => panic!("{other:?}"),
    };
    assert_eq!(most(with(8000, 4, settle::ON_LOAD_NS)), 7304);
    assert_eq!(most(with(8000, 2, settle::DEFAULT_NS)), 6441);
    assert_eq!(most(with(u16::MAX, 1, settle::ON_LOAD_NS)), 9842);
}

#[test]
fn columns_are_sampled_settled_before_next_row() {
    for (settings, plan) in plans() {
        let light = clocks(&plan, plan.timer.ccr1) * 2;
        let settled = light + u64::from(settings.settle_ns) * 340 / 1000;
        let next = clocks(&plan, plan.timer.arr + 1) * 2 + light;
        for conversion in line(&plan).columns {
            for sample in conversion.samples {
                assert!(sample.start >= settled && sample.end <= next, "{settings:?}");
            }
        }
    }
}

#[test]
fn midpoints_are_sampled_on_settled_amplifiers() {
    for (settings, plan) in plans() {
        let turn = clocks(&plan, plan.timer.ccr6) * 2;
        let settle = u64::from(AMPLIFIER_NS) * 340 / 1000;
        let light = clocks(&plan, plan.timer.ccr1) * 2;
        let period = clocks(&plan, plan.timer.arr + 1) * 2;
        let bridges = line(&plan).bridges;
        assert_eq!(bridges.iter().map(|c| c.input).collect::<Vec<_>>(), [16, 18, 13, 16, 18]);
        for (place, conversion) in bridges.iter().enumerate() {
            for sample in &conversion.samples {
                match place {
                    0 | 1 => assert!(sample.start >= light + settle && sample.end <= turn),
                    2 => {}
                    _ => assert!(
                        sample.start >= turn + settle && sample.end <= period,
                        "{settings:?}: {sample:?} after {turn}"
                    ),
                }
            }
        }
    }
}

#[test]
fn internal_inputs_are_sampled_before_the_columns() {
    for (settings, plan) in plans() {
        let Line { columns, internal, .. } = line(&plan);
        assert_eq!(internal.iter().map(|c| c.input).collect::<Vec<_>>(), [16, 18]);
        // Earliest trigger for the columns, latest for the injected group.
        let begin = clocks(&plan, plan.timer.ccr2) * 2;
        for conversion in &internal {
            let sample = &conversion.samples[0];
            assert!((sample.end - sample.start) * 1000 / 340 >= u64::from(INTERNAL_NS));
            assert!(conversion.end <= begin, "{settings:?}");
        }
        // The last column's conversion may reach into the next step, but not to its injected group.
        let period = clocks(&plan, plan.timer.arr + 1) * 2;
        assert!(columns.last().unwrap().end <= period + clocks(&plan, plan.timer.ccr3) * 2);
    }
}

#[test]
fn conversions_of_a_converter_never_overlap() {
    for (settings, plan) in plans() {
        let Line { columns, internal, bridges } = line(&plan);
        let period = clocks(&plan, plan.timer.arr + 1) * 2;
        let spans = |all: &[Conversion]| -> Vec<Span> {
            all.iter().map(|c| c.samples[0].start..c.end).collect()
        };
        let adc1 = [spans(&columns), spans(&internal)].concat();
        assert!(!overlaps(&adc1, period), "{settings:?}");
        assert!(!overlaps(&spans(&bridges), period), "{settings:?}");
    }
}

#[test]
fn last_converter_raises_the_frame_interrupt() {
    let mut seen = [false; 2];
    for (settings, plan) in plans() {
        let Line { columns, bridges, .. } = line(&plan);
        let (columns, bridges) = (columns.last().unwrap().end, bridges.last().unwrap().end);
        let interrupts = |channel: Channel| (Cr(channel.ccr).htie(), Cr(channel.ccr).tcie());
        let (on, off) = ((true, true), (false, false));
        let both = (interrupts(plan.columns), interrupts(plan.bridges));
        match plan.last {
            Last::Columns => assert!(columns >= bridges && both == (on, off), "{settings:?}"),
            Last::Bridges => assert!(bridges >= columns && both == (off, on), "{settings:?}"),
        }
        seen[usize::from(plan.last == Last::Bridges)] = true;
    }
    assert_eq!(seen, [true; 2]);
}

#[test]
fn sampling_time_suits_a_load_of_680_ohms() {
    // Least nanoseconds of sampling for a source of at most so many ohms (DS12589 table 67, fast
    // channels).
    const TABLE: [(f64, f64); 5] =
        [(41.67, 100.0), (108.33, 330.0), (208.33, 680.0), (408.33, 1500.0), (791.67, 2200.0)];
    let plan = plan(DEFAULT).unwrap();
    for column in regular(&plan.adc1) {
        let halves = HALVES[usize::from(sampling(&plan.adc1)(column))];
        let ns = halves as f64 * 0.5e9 / f64::from(ADC_HZ);
        let ohms = TABLE.iter().rfind(|(least, _)| *least <= ns).unwrap().1;
        assert!(ohms >= 680.0, "input {column}: {ns} ns for {ohms} Ω");
    }
}

#[test]
fn clocks_and_triggers_follow_the_reference_manual() {
    let plan = plan(DEFAULT).unwrap();
    const { assert!(ADC_HZ <= 52_000_000) };
    let common = pac::adccommon::regs::Ccr(plan.adc_common);
    assert_eq!(common.ckmode(), pac::adccommon::vals::Ckmode::SYNC_DIV4);
    assert_eq!(common.dual(), pac::adccommon::vals::Dual::INDEPENDENT);
    assert!(common.vrefen() && common.vsenseen());

    // RM0440 tables 163 and 164: EXTSEL 9 is TIM1_TRGO, 10 TIM1_TRGO2; JEXTSEL 8 is TIM1_TRGO2.
    let (adc1, adc2) = (Cfgr(plan.adc1.cfgr), Cfgr(plan.adc2.cfgr));
    assert_eq!((adc1.extsel(), adc2.extsel()), (9, 10));
    let jsqr = Jsqr(plan.adc1.jsqr);
    assert_eq!(jsqr.jextsel(), 8);
    assert_eq!(jsqr.jexten(), pac::adc::vals::Exten::RISING_EDGE);
    assert_eq!(plan.adc2.jsqr, 0);
    for ier in [plan.adc1.ier, plan.adc2.ier].map(pac::adc::regs::Ier) {
        assert!(ier.ovrie(), "an overrun stops the DMA: only its own interrupt tells of it");
        assert_eq!(ier.0.count_ones(), 1);
    }
    for cfgr in [adc1, adc2] {
        assert_eq!(cfgr.exten(), pac::adc::vals::Exten::RISING_EDGE);
        assert_eq!(cfgr.res(), pac::adc::vals::Res::BITS12);
        assert_eq!(cfgr.dmacfg(), pac::adc::vals::Dmacfg::CIRCULAR);
        assert!(cfgr.dmaen().to_bits() == 1 && cfgr.jqdis());
        assert!(!cfgr.cont() && !cfgr.discen() && !cfgr.jdiscen() && !cfgr.jauto());
    }
    assert_eq!(regular(&plan.adc1), [1, 2, 3, 4]);
}

#[test]
fn timer_compares_raise_the_triggers() {
    for (_, plan) in plans() {
        let t = &plan.timer;
        assert!(Cr1Core(t.cr1).arpe() && !Cr1Core(t.cr1).cen(), "started last");
        let cr2 = Cr2Adv(t.cr2);
        assert_eq!(cr2.mms(), pac::timer::vals::Mms::COMPARE_OC2);
        assert_eq!(cr2.mms2(), pac::timer::vals::Mms2::COMPARE_OC3);
        assert_eq!(cr2.ccds().to_bits(), 0, "the DMA is asked by the compare, not by the update");
        let dier = DierAdv(t.dier);
        assert_eq!(dier.0, 1 << 9, "compare 1 asks the DMA; no interrupt");
        assert!(dier.ccde(0));
        let pwm2 = pac::timer::vals::Ocm::PWM_MODE2;
        let (low, high, six) =
            (CcmrOutputGp16(t.ccmr1), CcmrOutputGp16(t.ccmr2), Ccmr3Adv(t.ccmr3));
        assert_eq!((low.ocm(0), low.ocm(1)), (pac::timer::vals::Ocm::FROZEN, pwm2));
        assert_eq!((high.ocm(0), six.ocm(1)), (pwm2, pwm2));
        assert!(low.ocpe(1) && high.ocpe(0) && six.ocpe(1));
        assert_eq!(t.ccer, 1 << 20, "CC6E alone: no channel reaches a pin");
        assert!(BdtrAdv(t.bdtr).moe());
        assert!(0 < t.ccr1 && t.ccr1 < t.ccr3 && t.ccr3 < t.ccr6 && t.ccr6 < t.arr);
        assert!(t.ccr3 < t.ccr2 && t.ccr2 < t.arr && t.arr <= 0xFFFF);
        // ES0430: an ADC must not stay idle for 1 ms.
        assert!(t.psc <= 1 && clocks(&plan, t.arr + 1) < u64::from(CLOCK_HZ / 1000));
    }
}

#[test]
fn dma_circulates_five_patterns_and_two_frames() {
    let plan = plan(DEFAULT).unwrap();
    let word = |cr: Cr| (cr.psize().to_bits(), cr.msize().to_bits());
    for channel in [plan.patterns, plan.columns, plan.bridges] {
        let cr = Cr(channel.ccr);
        assert!(cr.circ() && cr.minc() && !cr.pinc() && !cr.mem2mem() && !cr.en());
    }
    let patterns = Cr(plan.patterns.ccr);
    assert_eq!(patterns.dir(), pac::bdma::vals::Dir::FROM_MEMORY);
    assert_eq!((word(patterns), plan.patterns.count), ((2, 2), STEPS));
    assert_eq!(patterns.pl(), pac::bdma::vals::Pl::VERY_HIGH);
    let (columns, bridges) = (Cr(plan.columns.ccr), Cr(plan.bridges.ccr));
    assert_eq!((word(columns), word(bridges)), ((1, 1), (1, 1)));
    assert_eq!(plan.columns.count as usize, 2 * COLUMN_READINGS);
    assert_eq!(plan.bridges.count as usize, 2 * BRIDGE_READINGS);
    assert_eq!(COLUMN_READINGS, (STEPS * COLUMNS) as usize);
    // RM0440 table 91: 5 ADC1, 36 ADC2, 42 TIM1_CH1.
    assert_eq!([plan.columns, plan.bridges, plan.patterns].map(|c| c.request), [5, 36, 42]);
}

#[test]
fn amplifiers_have_gain_16_and_two_inputs() {
    let amplifier = plan(DEFAULT).unwrap().amplifier;
    let csr = pac::opamp::regs::Csr(amplifier.csr);
    assert!(csr.opampen() && csr.opaintoen() && !csr.opahsm());
    assert_eq!(csr.vm_sel().to_bits(), 0b10, "PGA");
    assert_eq!(csr.vp_sel().to_bits(), 0b00, "VINP0");
    assert_eq!(csr.pga_gain().to_bits(), 0b01011, "16 with the bias on VINM0");
    let tcmr = pac::opamp::regs::Tcmr(amplifier.tcmr);
    assert_eq!(tcmr.vps_sel().to_bits(), 0b01, "VINP1");
    assert!(!tcmr.vms_sel(), "PGA");
    assert!(tcmr.t1cm_en() && !tcmr.t8cm_en());
}

#[test]
fn invalid_settings_are_refused_with_a_range() {
    let refused = |change: fn(&mut ScanSettings)| {
        let mut settings = DEFAULT;
        change(&mut settings);
        plan(settings).unwrap_err()
    };
    assert_eq!(
        refused(|s| s.oversampling = 3),
        Refusal::Scan { setting: Oversampling, low: 1, high: 16 }
    );
    assert_eq!(
        refused(|s| s.oversampling = 32),
        Refusal::Scan { setting: Oversampling, low: 1, high: 16 }
    );
    assert!(matches!(
        refused(|s| s.settle_ns = 1000),
        Refusal::Scan { setting: SettleNs, low: 17_000..18_000, .. }
    ));
    assert!(matches!(
        refused(|s| s.settle_ns = 10_000_000),
        Refusal::Scan { setting: SettleNs, .. }
    ));
    assert!(matches!(refused(|s| s.settle_ns = u32::MAX), Refusal::Scan { setting: SettleNs, .. }));
    assert!(matches!(refused(|s| s.scan_hz = 0), Refusal::Scan { setting: ScanHz, low: 260, .. }));
    assert!(matches!(
        refused(|s| s.scan_hz = 259),
        Refusal::Scan { setting: ScanHz, low: 260, .. }
    ));
}

#[test]
fn refused_ranges_are_exact() {
    for oversampling in [1, 2, 4, 8, 16] {
        for settle_us in [18, 20, 27, 50, 100] {
            let with = |scan_hz: u32| {
                let settle_ns = settle_us * 1000;
                plan(ScanSettings { scan_hz: scan_hz as u16, oversampling, settle_ns })
            };
            let Err(Refusal::Scan { setting: ScanHz, low, high }) = with(0) else {
                panic!("0 Hz is no rate")
            };
            assert!(with(low).is_ok() && with(high).is_ok(), "{low}..={high}");
            assert!(with(low - 1).is_err() && with(high + 1).is_err(), "{low}..={high}");
        }
    }
    for oversampling in [1, 2, 4, 8, 16] {
        for scan_hz in [300, 600, 1000, 3333, 4000, 5000] {
            let with = |settle_ns| plan(ScanSettings { settle_ns, oversampling, scan_hz });
            for wrong in [0, 1_000_000_000] {
                let Err(Refusal::Scan { setting: SettleNs, low, high }) = with(wrong) else {
                    panic!("{wrong} ns is no settle time")
                };
                if with(low).is_err() {
                    // No settle time is short enough for this rate; the range is that of the
                    // slowest.
                    assert!(matches!(with(low), Err(Refusal::Scan { setting: ScanHz, .. })));
                    continue;
                }
                assert!(with(high).is_ok(), "{low}..={high} at {scan_hz} Hz");
                // A tick is 5.9 ns, or twice as much below 519 Hz.
                let tick = if scan_hz < 519 { 12 } else { 6 };
                let less = with(low - tick - 1);
                assert!(matches!(less, Err(Refusal::Scan { setting: SettleNs, .. })));
                assert!(with(high + tick).is_err(), "{low}..={high} at {scan_hz} Hz");
            }
        }
    }
    let Err(Refusal::Scan { setting: SettleNs, high, .. }) =
        plan(ScanSettings { settle_ns: 0, ..DEFAULT })
    else {
        panic!("no settling is refused")
    };
    // The columns take 18.68 µs of a step of 50 µs, from their trigger to their last sample.
    assert!((31_310..31_330).contains(&high), "{high}");
}

#[test]
fn no_settings_overflow() {
    for scan_hz in [0, 1, 260, 519, 4000, u16::MAX] {
        for oversampling in [0, 1, 2, 16, 17, u16::MAX] {
            for settle_ns in [0, 1, 26_500, u32::MAX / 2, u32::MAX] {
                let _ = plan(ScanSettings { scan_hz, oversampling, settle_ns });
            }
        }
    }
    // 20 ms, which no step can hold.
    assert_eq!(scan_plan::ticks(u32::MAX, CLOCK_HZ), 3_400_000);
}

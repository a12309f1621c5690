//! Scan plan of the STM32F411: TIM1, DMA2 and its ADC (RM0383 Rev 3, DS10314 Rev 8).
//!
//! The frame is that of the product within the limits of this chip. It has no second ADC, so that
//! the bridges are converted after the columns. It has no oversampler, so that a reading is one
//! sample, and no amplifiers. Only DMA2 reaches the GPIO ports, and only TIM1 can trigger DMA2, so
//! both are used.
//!
//! Temperature and reference need 10 µs each, more than fits into the settle time together. They
//! are an injected group that converts one of them per step, in turn (JDISCEN).

use taxel::scan::{ScanSetting, ScanSettings};
use taxel::wire::message::Refusal;

use crate::{STEPS, Step, divider, fit, refusal, settle_refusal, ticks};

/// HCLK, APB2 and timer clock in hertz: the highest that also gives 48 MHz to the USB.
pub const CLOCK_HZ: u32 = 96_000_000;
/// HCLK cycles in a cycle of the ADC clock: ADCPRE = PCLK2/4.
pub const TICKS_PER_CYCLE: u32 = 4;
/// ADC clock in hertz.
///
/// The limit is 36 MHz (DS10314 table 66), and PCLK2/2 would be 48 MHz.
pub const ADC_HZ: u32 = CLOCK_HZ / TICKS_PER_CYCLE;

/// Cycles from sampling to result for 12 bits.
const CONVERT_CYCLES: u32 = 12;
/// Most cycles from trigger to sampling: 3 (DS10314 table 66) and the clocks' phase.
const LATENCY_CYCLES: u32 = 4;
const TOP_CODE: u16 = 4095;

/// Compare A, in ticks.
const LIGHT: u32 = 8;
/// Nanoseconds from a new pattern to a settled multiplexer.
const MULTIPLEXER_NS: u32 = 1_000;
/// Least sampling time of temperature sensor and reference, nanoseconds (DS10314 tables 71, 74).
pub const INTERNAL_NS: u32 = 10_000;

/// Sampling times in cycles, by their code in `SMPR`.
const SAMPLE_CYCLES: [u32; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
/// Sampling code of columns and midpoints.
///
/// It allows a source of (15 − 0.5) / (24 MHz · 7 pF · ln 2^14) − 6 kΩ = 2.9 kΩ (DS10314, equation
/// 1 with the worst R_ADC and C_ADC).
const INPUT_SAMPLE: u32 = 1;
/// Sampling code of temperature and reference: 480 cycles are 20 µs; 144 would be 6 µs.
const INTERNAL_SAMPLE: u32 = 7;

/// Inputs of the ADC in order: columns, then midpoints A … D.
///
/// PA1 … PA4 are the columns, PA5, PA6, PA7 and PB0 the midpoints.
pub const INPUTS: [u32; 8] = [1, 2, 3, 4, 5, 6, 7, 8];
/// Inputs of the temperature sensor and the reference.
pub const INTERNAL_INPUTS: [u32; 2] = [18, 17];
/// Number of readings in a frame.
pub const READINGS: usize = STEPS as usize * INPUTS.len();

/// Register values of TIM1, named as in RM0383 §12.4.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the registers' own names")]
pub struct Timer {
    pub psc: u32,
    pub cr1: u32,
    pub cr2: u32,
    pub dier: u32,
    pub ccmr1: u32,
    pub ccmr2: u32,
    pub ccer: u32,
    pub bdtr: u32,
    pub arr: u32,
    pub ccr1: u32,
    pub ccr2: u32,
    pub ccr3: u32,
}

/// Register values of ADC1, named as in RM0383 §11.12.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the registers' own names")]
pub struct Adc {
    pub cr1: u32,
    pub cr2: u32,
    pub smpr1: u32,
    pub smpr2: u32,
    pub sqr1: u32,
    pub sqr2: u32,
    pub sqr3: u32,
    pub jsqr: u32,
    pub ccr: u32,
}

/// Register values of a DMA stream (RM0383 §9.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// `DMA_SxCR`, not yet enabled.
    pub cr: u32,
    /// `DMA_SxNDTR`.
    pub count: u32,
}

/// Register values of a scan, and the resulting times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Times of a step.
    pub step: Step,
    /// Code of a channel at the top of its range.
    pub full_scale: u16,
    /// TIM1.
    pub timer: Timer,
    /// ADC1.
    pub adc: Adc,
    /// DMA2 stream 1: patterns to the GPIO port.
    pub patterns: Stream,
    /// DMA2 stream 0: readings to memory; its half and full transfers are the frame interrupts.
    pub readings: Stream,
}

/// Computes the register values for scan settings.
///
/// # Errors
/// The first setting that does not fit the others, in the order oversampling, settle time, rate.
pub const fn plan(settings: ScanSettings) -> Result<Plan, Refusal> {
    if settings.oversampling != 1 {
        return Err(refusal(ScanSetting::Oversampling, 1, 1));
    }
    // All times below are in ticks of the timer's divided clock, each rounded up.
    let divider = divider(settings.scan_hz, CLOCK_HZ);
    let tick_hz = CLOCK_HZ / divider;
    let latency = (LATENCY_CYCLES * TICKS_PER_CYCLE).div_ceil(divider);
    let slow = LIGHT + ticks(MULTIPLEXER_NS, tick_hz);
    let internal = latency + conversion(INTERNAL_SAMPLE).div_ceil(divider);
    let columns = LIGHT + ticks(settings.settle_ns, tick_hz);
    // The multiplexer switches with the LED row: every input must have been sampled before.
    let all = INPUTS.len() as u32 * conversion(INPUT_SAMPLE) - CONVERT_CYCLES * TICKS_PER_CYCLE;
    let sampling = latency + all.div_ceil(divider);
    let done = columns + sampling;
    if columns < slow + internal || done > crate::LONGEST_STEP {
        let least = slow + internal - LIGHT;
        return Err(settle_refusal(least, LIGHT + sampling, settings.scan_hz, tick_hz));
    }
    let top = match fit(settings.scan_hz, done, CLOCK_HZ, divider) {
        Ok(top) => top,
        Err(refusal) => return Err(refusal),
    };
    let step = Step { tick_hz, light: LIGHT, slow, columns, done, top };
    Ok(Plan {
        step,
        full_scale: TOP_CODE,
        timer: timer(&step, divider),
        adc: adc(),
        // Channel 6: TIM1_CH1; very high priority, words, memory to peripheral.
        patterns: Stream { cr: dma(6, 3, 2, 1 << 6), count: STEPS },
        // Channel 0: ADC1; high priority, half words, HTIE and TCIE.
        readings: Stream { cr: dma(0, 2, 1, 1 << 3 | 1 << 4), count: 2 * READINGS as u32 },
    })
}

/// HCLK cycles of one conversion with this sampling code.
const fn conversion(sample: u32) -> u32 {
    (SAMPLE_CYCLES[sample as usize] + CONVERT_CYCLES) * TICKS_PER_CYCLE
}

const fn timer(step: &Step, divider: u32) -> Timer {
    /// PWM mode 2: inactive below the compare value, active from there to the top.
    const PWM2: u32 = 0b111;
    Timer {
        psc: divider - 1,
        // ARPE
        cr1: 1 << 7,
        // MMS = OC3REF
        cr2: 0b110 << 4,
        // CC1DE
        dier: 1 << 9,
        // Channel 1 only compares. OC2M, OC2PE.
        ccmr1: PWM2 << 12 | 1 << 11,
        // OC3M, OC3PE
        ccmr2: PWM2 << 4 | 1 << 3,
        // CC2E and MOE, because here the output of the channel triggers the ADC, not its reference
        // signal.
        ccer: 1 << 4,
        bdtr: 1 << 15,
        arr: step.top,
        ccr1: step.light,
        ccr2: step.columns,
        ccr3: step.slow,
    }
}

const fn adc() -> Adc {
    let (mut smpr1, mut smpr2) = (0, 0);
    let mut sqr = [0; 3];
    let mut i = 0;
    while i < INPUTS.len() {
        smpr2 |= INPUT_SAMPLE << (3 * INPUTS[i]);
        sqr[i / 6] |= INPUTS[i] << (5 * (i % 6));
        i += 1;
    }
    let [first, second] = INTERNAL_INPUTS;
    smpr1 |= INTERNAL_SAMPLE << (3 * (first - 10)) | INTERNAL_SAMPLE << (3 * (second - 10));
    Adc {
        // SCAN, JDISCEN; OVRIE, because an overrun stops the DMA requests (RM0383 §11.8.1), and so
        // the frame interrupt.
        cr1: 1 << 8 | 1 << 12 | 1 << 26,
        // DMA, DDS; JEXTSEL = TIM1_TRGO, EXTSEL = TIM1_CC2, both rising
        cr2: 1 << 8 | 1 << 9 | 1 << 16 | 1 << 20 | 1 << 24 | 1 << 28,
        smpr1,
        smpr2,
        sqr1: (INPUTS.len() as u32 - 1) << 20 | sqr[2],
        sqr2: sqr[1],
        sqr3: sqr[0],
        // JL = 2 conversions: they are JSQ3 and JSQ4
        jsqr: 1 << 20 | first << 10 | second << 15,
        // ADCPRE = PCLK2/4, TSVREFE
        ccr: 1 << 16 | 1 << 23,
    }
}

/// Value of `DMA_SxCR`: circular, memory incremented.
///
/// Both sides have the same `size` (1: 16 bits, 2: 32 bits).
const fn dma(channel: u32, priority: u32, size: u32, direction_and_interrupts: u32) -> u32 {
    channel << 25
        | priority << 16
        | size << 13
        | size << 11
        | 1 << 10
        | 1 << 8
        | direction_and_interrupts
}

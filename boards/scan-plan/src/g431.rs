//! The STM32G431's scan: TIM1, DMA1, ADC1, ADC2, OPAMP2 and OPAMP3 (RM0440 Rev 8, DS12589 Rev 6).
//!
//! * **TIM1** counts one step a period. Compare 1 asks the DMA for the next pattern; OC2REF is TRGO and
//!   starts ADC1's columns; OC3REF is TRGO2 and starts what does not wait for light; OC6 turns the
//!   amplifiers' inputs over. No channel has a pin.
//! * **ADC1** converts the four columns, oversampled, and as its injected group temperature and
//!   reference, which this chip gives to ADC1 only. The injected group runs inside the settle time, so
//!   that it never meets the columns.
//! * **ADC2** converts the bridge midpoints behind the amplifiers. Two amplifiers reach ADC2 and there
//!   are four midpoints, so each has two inputs: A then B on OPAMP2, C then D on OPAMP3. Between the
//!   pairs the amplifiers' bias pin is converted: it is the bridges' own reference, and meanwhile the
//!   amplifiers settle on their second input.
//!
//! Both ADCs run on HCLK/4, in step with the timer: a trigger is taken after the same number of cycles
//! every time, so that the jitter of a sample is the jitter of the crystal-less clock and nothing else.

use taxel::scan::{ScanSetting, ScanSettings};
use taxel::wire::message::Refusal;

use crate::{COLUMNS, STEPS, Step, fit, refusal, settle_refusal, ticks};

/// HCLK, APB2 and the timer's clock.
pub const CLOCK_HZ: u32 = 170_000_000;
/// Timer ticks in a cycle of the ADC clock: CKMODE = HCLK/4.
pub const TICKS_PER_CYCLE: u32 = 4;
/// The ADC clock. 52 MHz is the most with both converters running (DS12589 table 66).
pub const ADC_HZ: u32 = CLOCK_HZ / TICKS_PER_CYCLE;

/// Half cycles from sampling to result: 12.5 cycles for 12 bits.
const CONVERT_HALVES: u32 = 25;
/// Cycles from trigger to sampling, at most: 3.125 for an injected group at HCLK/4 (DS12589 table 66).
const LATENCY_CYCLES: u32 = 4;
/// The highest code of one sample.
const TOP_CODE: u16 = 4095;
/// Most samples that fit 16 bits unshifted.
const MOST_SAMPLES: u16 = 16;

/// Compare A. Not zero: there OC6 turns the amplifiers' inputs back.
const LIGHT: u32 = 8;
/// From a new pattern to a settled amplifier output: 120 Ω of multiplexer into some 20 pF are nothing;
/// the amplifier slews 3.3 V at 2.5 V/µs (1.3 µs) and then settles to 12 bits with a bandwidth of
/// 7 MHz / 16 (8.3 τ = 3.0 µs), each the data sheet's worst case.
pub const AMPLIFIER_NS: u32 = 5_000;
/// Least sampling time of the temperature sensor (DS12589 table 79); the reference needs 4 µs.
pub const INTERNAL_NS: u32 = 5_000;

/// Sampling times in half cycles, by their code in `SMPR`.
const SAMPLE_HALVES: [u32; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
/// A column: 680 Ω of load need 208 ns (DS12589 table 67, fast channel); 12.5 cycles are 294 ns.
const COLUMN_SAMPLE: u32 = 2;
/// An amplifier's output: 24.5 cycles are 576 ns, and the amplifier drives it (DS12589 table 88).
const AMPLIFIER_SAMPLE: u32 = 3;
/// Temperature and reference: 247.5 cycles are 5.8 µs.
const INTERNAL_SAMPLE: u32 = 6;

/// ADC1's columns: PA0 … PA3 are its inputs 1 … 4.
pub const COLUMN_INPUTS: [u32; COLUMNS as usize] = [1, 2, 3, 4];
/// ADC1's inputs for the temperature sensor and the reference.
pub const INTERNAL_INPUTS: [u32; 2] = [16, 18];
/// ADC2's conversions: A, C, bias, B, D. 16 is OPAMP2's output, 18 OPAMP3's, 13 the bias on PA5.
pub const BRIDGE_INPUTS: [u32; 5] = [16, 18, 13, 16, 18];

/// Readings in ADC1's and ADC2's half of the buffer.
pub const COLUMN_READINGS: usize = (STEPS * COLUMNS) as usize;
/// See [`COLUMN_READINGS`].
pub const BRIDGE_READINGS: usize = STEPS as usize * BRIDGE_INPUTS.len();

/// What is written to TIM1, named as in RM0440 §29.6. Everything else stays at its reset value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the registers' own names")]
pub struct Timer {
    pub cr1: u32,
    pub cr2: u32,
    pub dier: u32,
    pub ccmr1: u32,
    pub ccmr2: u32,
    pub ccmr3: u32,
    pub ccer: u32,
    pub bdtr: u32,
    pub arr: u32,
    pub ccr1: u32,
    pub ccr2: u32,
    pub ccr3: u32,
    pub ccr6: u32,
}

/// What is written to one ADC, named as in RM0440 §21.7.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the registers' own names")]
pub struct Adc {
    pub ier: u32,
    pub cfgr: u32,
    pub cfgr2: u32,
    pub smpr1: u32,
    pub smpr2: u32,
    pub sqr1: u32,
    pub sqr2: u32,
    pub jsqr: u32,
}

/// What is written to one DMA channel and its multiplexer (RM0440 §12.6, §13.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channel {
    /// `DMAMUX_CxCR`: who asks for transfers.
    pub request: u32,
    /// `DMA_CCRx`, not yet enabled.
    pub ccr: u32,
    /// `DMA_CNDTRx`.
    pub count: u32,
}

/// The converter that is done last in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Last {
    /// ADC1, with the columns.
    Columns,
    /// ADC2, with the bridges.
    Bridges,
}

/// What is written to one operational amplifier (RM0440 §25.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the registers' own names")]
pub struct Amplifier {
    pub csr: u32,
    pub tcmr: u32,
}

/// Everything there is to write, and what comes of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// When things happen.
    pub step: Step,
    /// When the amplifiers turn to their second inputs.
    pub second_input: u32,
    /// The code that a channel reads at the top of its range.
    pub full_scale: u16,
    /// TIM1.
    pub timer: Timer,
    /// ADC1: columns, temperature, reference.
    pub adc1: Adc,
    /// ADC2: bridges.
    pub adc2: Adc,
    /// `ADC12_CCR`.
    pub adc_common: u32,
    /// Patterns to the GPIO port.
    pub patterns: Channel,
    /// ADC1's readings to memory.
    pub columns: Channel,
    /// ADC2's readings to memory.
    pub bridges: Channel,
    /// Which of the two ends a frame: its half and full transfers are the interrupts.
    pub last: Last,
    /// OPAMP2 and OPAMP3 alike.
    pub amplifier: Amplifier,
}

/// The registers for these settings.
///
/// # Errors
/// The first setting that cannot be had with the others, in the order oversampling, settle time, rate.
pub const fn plan(settings: ScanSettings) -> Result<Plan, Refusal> {
    let samples = settings.oversampling;
    if !samples.is_power_of_two() || samples > MOST_SAMPLES {
        return Err(refusal(ScanSetting::Oversampling, 1, MOST_SAMPLES as u32));
    }
    let latency = LATENCY_CYCLES * TICKS_PER_CYCLE;
    let slow = LIGHT + ticks(AMPLIFIER_NS, CLOCK_HZ);

    // The injected group must be out of the columns' way.
    let internal = latency + INTERNAL_INPUTS.len() as u32 * conversion(INTERNAL_SAMPLE);
    let columns = LIGHT + ticks(settings.settle_ns, CLOCK_HZ);
    let sampling = latency + sampled(COLUMNS * samples as u32, COLUMN_SAMPLE);
    // The next pattern may come as soon as the last column has been sampled.
    let columns_done = columns + sampling;
    if columns < slow + internal || columns_done > crate::LONGEST_STEP {
        let least = slow + internal - LIGHT;
        return Err(settle_refusal(least, LIGHT + sampling, settings.scan_hz, CLOCK_HZ));
    }

    let amplified = conversion(AMPLIFIER_SAMPLE) * samples as u32;
    let second_input = slow + latency + 2 * amplified;
    let bias_sample = bias_sample(samples as u32);
    let bias = conversion(bias_sample) * samples as u32;
    // Behind the turn the bias, B and D; the amplifiers are read as long as the bias lets them settle.
    let second_done = second_input + bias + amplified + sampled(samples as u32, AMPLIFIER_SAMPLE);

    // Results follow their samples at the same distance on both.
    let (last, done) = if columns_done > second_done {
        (Last::Columns, columns_done)
    } else {
        (Last::Bridges, second_done)
    };
    let top = match fit(settings.scan_hz, done, CLOCK_HZ) {
        Ok(top) => top,
        Err(refusal) => return Err(refusal),
    };
    let step = Step { tick_hz: CLOCK_HZ, light: LIGHT, slow, columns, done, top };
    Ok(Plan {
        step,
        second_input,
        full_scale: TOP_CODE * samples,
        timer: timer(&step, second_input),
        adc1: adc(samples, TRGO, &COLUMN_INPUTS, Some(INTERNAL_INPUTS), COLUMN_SAMPLE),
        adc2: adc(samples, TRGO2, &BRIDGE_INPUTS, None, bias_sample),
        // CKMODE = 3: HCLK/4; VREFEN, VSENSESEL: the internal channels are connected.
        adc_common: 3 << 16 | 1 << 22 | 1 << 23,
        // Memory to peripheral, words, in a circle, before all other transfers.
        patterns: Channel { request: 42, ccr: dma(1 << 4, 2, 3), count: STEPS },
        columns: Channel {
            request: 5,
            ccr: dma(interrupts(matches!(last, Last::Columns)), 1, 2),
            count: 2 * COLUMN_READINGS as u32,
        },
        bridges: Channel {
            request: 36,
            ccr: dma(interrupts(matches!(last, Last::Bridges)), 1, 2),
            count: 2 * BRIDGE_READINGS as u32,
        },
        last,
        amplifier: Amplifier {
            // OPAEN; VP_SEL = VINP0; VM_SEL = PGA; OPAINTOEN: the output goes to the ADC, not to its
            // pin; PGA_GAIN: 16 around the bias on VINM0.
            csr: 1 | 2 << 5 | 1 << 8 | 0b01011 << 14,
            // VPS_SEL = VINP1, VMS_SEL = PGA, switched by TIM1's OC6.
            tcmr: 1 << 1 | 1 << 3,
        },
    })
}

/// Timer ticks of one conversion with this sampling code.
const fn conversion(sample: u32) -> u32 {
    (SAMPLE_HALVES[sample as usize] + CONVERT_HALVES) * TICKS_PER_CYCLE / 2
}

/// Timer ticks until the last of `count` conversions has taken its sample.
const fn sampled(count: u32, sample: u32) -> u32 {
    count * conversion(sample) - CONVERT_HALVES * TICKS_PER_CYCLE / 2
}

/// The shortest sampling of the bias pin that leaves the amplifiers time for their second inputs.
const fn bias_sample(samples: u32) -> u32 {
    let mut sample = AMPLIFIER_SAMPLE;
    while conversion(sample) * samples < ticks(AMPLIFIER_NS, CLOCK_HZ) {
        sample += 1;
    }
    sample
}

const fn timer(step: &Step, second_input: u32) -> Timer {
    /// PWM mode 2: inactive below the compare value, active from there to the top.
    const PWM2: u32 = 0b111;
    Timer {
        // ARPE
        cr1: 1 << 7,
        // MMS = OC2REF, MMS2 = OC3REF
        cr2: 0b101 << 4 | 0b0110 << 20,
        // CC1DE
        dier: 1 << 9,
        // Channel 1 frozen: it only compares. OC2M, OC2PE.
        ccmr1: PWM2 << 12 | 1 << 11,
        // OC3M, OC3PE
        ccmr2: PWM2 << 4 | 1 << 3,
        // OC6M, OC6PE
        ccmr3: PWM2 << 12 | 1 << 11,
        // CC6E and, below, MOE: OC6 reaches the amplifiers.
        ccer: 1 << 20,
        bdtr: 1 << 15,
        arr: step.top,
        ccr1: step.light,
        ccr2: step.columns,
        ccr3: step.slow,
        ccr6: second_input,
    }
}

/// EXTSEL of ADC1 and ADC2 (RM0440 table 163).
const TRGO: u32 = 9;
const TRGO2: u32 = 10;
/// JEXTSEL of ADC1 and ADC2 (RM0440 table 164).
const INJECTED_TRGO2: u32 = 8;

/// `odd` is the sampling code of the inputs below 16, which are not the chip's own.
const fn adc(
    samples: u16,
    trigger: u32,
    inputs: &[u32],
    injected: Option<[u32; 2]>,
    odd: u32,
) -> Adc {
    let (mut smpr1, mut smpr2) = (0, 0);
    let mut sqr = [inputs.len() as u32 - 1, 0];
    let mut i = 0;
    while i < inputs.len() {
        let input = inputs[i];
        let sample = if input < 16 { odd } else { AMPLIFIER_SAMPLE };
        (smpr1, smpr2) = with_sample(smpr1, smpr2, input, sample);
        // Five to a register, six bits apart; in the first the length comes before them.
        let place = i + 1;
        sqr[place / 5] |= input << (6 * (place % 5));
        i += 1;
    }
    let mut jsqr = 0;
    if let Some([first, second]) = injected {
        // JL = 2 conversions, JEXTEN = rising
        jsqr = 1 | INJECTED_TRGO2 << 2 | 1 << 7 | first << 9 | second << 15;
        (smpr1, smpr2) = with_sample(smpr1, smpr2, first, INTERNAL_SAMPLE);
        (smpr1, smpr2) = with_sample(smpr1, smpr2, second, INTERNAL_SAMPLE);
    }
    Adc {
        // OVRIE: an overrun stops the requests to the DMA (RM0440 §21.4.27), and so the frame's interrupt.
        ier: 1 << 4,
        // DMAEN, DMACFG: in a circle; EXTEN: rising; JQDIS: JSQR is no queue.
        cfgr: 1 | 1 << 1 | trigger << 5 | 1 << 10 | 1 << 31,
        // ROVSE and OVSR = 2^(n + 1), no shift: a reading is the sum of its samples.
        cfgr2: match samples.trailing_zeros() {
            0 => 0,
            n => 1 | (n - 1) << 2,
        },
        smpr1,
        smpr2,
        sqr1: sqr[0],
        sqr2: sqr[1],
        jsqr,
    }
}

const fn with_sample(smpr1: u32, smpr2: u32, input: u32, sample: u32) -> (u32, u32) {
    if input < 10 {
        (smpr1 & !(7 << (3 * input)) | sample << (3 * input), smpr2)
    } else {
        let at = 3 * (input - 10);
        (smpr1, smpr2 & !(7 << at) | sample << at)
    }
}

/// HTIE and TCIE: one interrupt a frame.
const fn interrupts(on: bool) -> u32 {
    if on { 1 << 2 | 1 << 1 } else { 0 }
}

/// `DMA_CCRx`: circular, memory incremented, both sides of the same `size` (1: 16 bits, 2: 32 bits).
const fn dma(direction_and_interrupts: u32, size: u32, priority: u32) -> u32 {
    direction_and_interrupts | 1 << 5 | 1 << 7 | size << 8 | size << 10 | priority << 12
}

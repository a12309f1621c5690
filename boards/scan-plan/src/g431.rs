//! Scan plan of the STM32G431: TIM1, DMA1, ADC1, ADC2, OPAMP2, OPAMP3 (RM0440 Rev 8, DS12589 Rev
//! 6).
//!
//! * **TIM1** counts one step a period. Compare 1 requests the next pattern from the DMA. OC2REF is
//!   TRGO and starts ADC1's columns. OC3REF is TRGO2 and starts the inputs that do not need light.
//!   OC6 switches the amplifiers' inputs. No channel has a pin.
//! * **ADC1** converts the four columns, oversampled, and as its injected group temperature and
//!   reference, which this chip connects to ADC1 only. The injected group runs inside the settle
//!   time, so that it never meets the columns.
//! * **ADC2** converts the bridge midpoints behind the amplifiers. Two amplifiers reach ADC2 and
//!   there are four midpoints, so each has two inputs: A then B on OPAMP2, C then D on OPAMP3.
//!   Between the pairs ADC2 converts the amplifiers' bias pin, which is the bridges' own reference,
//!   while the amplifiers settle on their second input.
//!
//! Slow scans divide the timer's clock. Both ADCs run on HCLK/4, synchronous with the timer. A
//! trigger is always taken after the same number of cycles, so that the only jitter of a sample is
//! that of the crystal-less clock.

use taxel::scan::{ScanSetting, ScanSettings};
use taxel::wire::message::Refusal;

use crate::{COLUMNS, STEPS, Step, divider, fit, refusal, settle_refusal, ticks};

/// HCLK, APB2 and timer clock in hertz.
pub const CLOCK_HZ: u32 = 170_000_000;
/// HCLK cycles in a cycle of the ADC clock: CKMODE = HCLK/4.
pub const TICKS_PER_CYCLE: u32 = 4;
/// ADC clock in hertz; the limit is 52 MHz with both converters running (DS12589 table 66).
pub const ADC_HZ: u32 = CLOCK_HZ / TICKS_PER_CYCLE;

/// Half cycles from sampling to result: 12.5 cycles for 12 bits.
const CONVERT_HALVES: u32 = 25;
/// Most cycles from trigger to sampling: 3.125 for an injected group at HCLK/4 (DS12589 table 66).
const LATENCY_CYCLES: u32 = 4;
/// Highest code of one sample.
const TOP_CODE: u16 = 4095;
/// Largest number of samples whose sum fits 16 bits.
const MOST_SAMPLES: u16 = 16;

/// Compare A, in ticks; not zero, because there OC6 switches the amplifiers' inputs back.
const LIGHT: u32 = 8;
/// Nanoseconds from a new pattern to a settled amplifier output.
///
/// 120 Ω of multiplexer into some 20 pF are negligible. The amplifier slews 3.3 V at 2.5 V/µs in
/// 1.3 µs. It then settles to 12 bits in 8.3 τ = 3.0 µs, with a bandwidth of 7 MHz / 16. Each
/// figure is the data sheet's worst case.
pub const AMPLIFIER_NS: u32 = 5_000;
/// Least sampling time of the temperature sensor, nanoseconds (DS12589 table 79); the reference
/// needs 4 µs.
pub const INTERNAL_NS: u32 = 5_000;

/// Sampling times in half cycles, by their code in `SMPR`.
const SAMPLE_HALVES: [u32; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
/// Sampling code of a column.
///
/// A source of 680 Ω needs 208 ns (DS12589 table 67, fast channel); 12.5 cycles are 294 ns. The
/// amplifier with 100 Ω in line is less.
const COLUMN_SAMPLE: u32 = 2;
/// Sampling code of an amplifier's output.
///
/// 24.5 cycles are 576 ns, and the amplifier drives the input (DS12589 table 88).
const AMPLIFIER_SAMPLE: u32 = 3;
/// Sampling code of temperature and reference: 247.5 cycles are 5.8 µs.
const INTERNAL_SAMPLE: u32 = 6;

/// Inputs of ADC1 for the columns: PA0 … PA3 are 1 … 4.
pub const COLUMN_INPUTS: [u32; COLUMNS as usize] = [1, 2, 3, 4];
/// Inputs of ADC1 for the temperature sensor and the reference.
pub const INTERNAL_INPUTS: [u32; 2] = [16, 18];
/// Inputs of ADC2 in order: A, C, bias, B, D.
///
/// 16 is OPAMP2's output, 18 OPAMP3's, 13 the bias on PA5.
pub const BRIDGE_INPUTS: [u32; 5] = [16, 18, 13, 16, 18];

/// Number of readings in ADC1's half of the buffer.
pub const COLUMN_READINGS: usize = (STEPS * COLUMNS) as usize;
/// Number of readings in ADC2's half of the buffer.
pub const BRIDGE_READINGS: usize = STEPS as usize * BRIDGE_INPUTS.len();

/// Register values of TIM1, named as in RM0440 §29.6; all others keep their reset values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the registers' own names")]
pub struct Timer {
    pub psc: u32,
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

/// Register values of an ADC, named as in RM0440 §21.7.
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

/// Register values of a DMA channel and its multiplexer (RM0440 §12.6, §13.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channel {
    /// `DMAMUX_CxCR`: source of the requests.
    pub request: u32,
    /// `DMA_CCRx`, not yet enabled.
    pub ccr: u32,
    /// `DMA_CNDTRx`.
    pub count: u32,
}

/// Converter that finishes last in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Last {
    /// ADC1, with the columns.
    Columns,
    /// ADC2, with the bridges.
    Bridges,
}

/// Register values of an operational amplifier (RM0440 §25.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the registers' own names")]
pub struct Amplifier {
    pub csr: u32,
    pub tcmr: u32,
}

/// Register values of a scan, and the resulting times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Times of a step.
    pub step: Step,
    /// Switch of the amplifiers to their second inputs, in ticks.
    pub second_input: u32,
    /// Code of a channel at the top of its range.
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
    /// Converter that ends a frame; its half and full transfers are the frame interrupts.
    pub last: Last,
    /// OPAMP2 and OPAMP3 alike.
    pub amplifier: Amplifier,
}

/// Computes the register values for scan settings.
///
/// # Errors
/// The first setting that does not fit the others, in the order oversampling, settle time, rate.
pub const fn plan(settings: ScanSettings) -> Result<Plan, Refusal> {
    let samples = settings.oversampling;
    if !samples.is_power_of_two() || samples > MOST_SAMPLES {
        return Err(refusal(ScanSetting::Oversampling, 1, MOST_SAMPLES as u32));
    }
    // All times below are in ticks of the timer's divided clock, each rounded up.
    let divider = divider(settings.scan_hz, CLOCK_HZ);
    let tick_hz = CLOCK_HZ / divider;
    let latency = (LATENCY_CYCLES * TICKS_PER_CYCLE).div_ceil(divider);
    let slow = LIGHT + ticks(AMPLIFIER_NS, tick_hz);

    // The injected group must end before the columns start.
    let internal = INTERNAL_INPUTS.len() as u32 * conversion(INTERNAL_SAMPLE);
    let internal = latency + internal.div_ceil(divider);
    let columns = LIGHT + ticks(settings.settle_ns, tick_hz);
    let sampling = sampled(COLUMNS * samples as u32, COLUMN_SAMPLE);
    let sampling = latency + sampling.div_ceil(divider);
    // The next pattern may come as soon as the last column has been sampled.
    let columns_done = columns + sampling;
    if columns < slow + internal || columns_done > crate::LONGEST_STEP {
        let least = slow + internal - LIGHT;
        return Err(settle_refusal(least, LIGHT + sampling, settings.scan_hz, tick_hz));
    }

    let amplified = conversion(AMPLIFIER_SAMPLE) * samples as u32;
    let second_input = slow + latency + (2 * amplified).div_ceil(divider);
    let bias_sample = bias_sample(samples as u32);
    let bias = conversion(bias_sample) * samples as u32;
    // After the switch ADC2 converts the bias, B and D; the amplifiers settle during the bias.
    let second = bias + amplified + sampled(samples as u32, AMPLIFIER_SAMPLE);
    let second_done = second_input + second.div_ceil(divider);

    // Results follow their samples after the same time on both converters.
    let (last, done) = if columns_done > second_done {
        (Last::Columns, columns_done)
    } else {
        (Last::Bridges, second_done)
    };
    let top = match fit(settings.scan_hz, done, CLOCK_HZ, divider) {
        Ok(top) => top,
        Err(refusal) => return Err(refusal),
    };
    let step = Step { tick_hz, light: LIGHT, slow, columns, done, top };
    Ok(Plan {
        step,
        second_input,
        full_scale: TOP_CODE * samples,
        timer: timer(&step, divider, second_input),
        adc1: adc(samples, TRGO, &COLUMN_INPUTS, Some(INTERNAL_INPUTS), COLUMN_SAMPLE),
        adc2: adc(samples, TRGO2, &BRIDGE_INPUTS, None, bias_sample),
        // CKMODE = 3: HCLK/4; VREFEN, VSENSESEL: the internal channels are connected.
        adc_common: 3 << 16 | 1 << 22 | 1 << 23,
        // Memory to peripheral, words, circular, highest priority.
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
            // OPAEN; VP_SEL = VINP0; VM_SEL = PGA; OPAINTOEN: the output goes to the ADC, not to
            // its pin; PGA_GAIN: 16 around the bias on VINM0.
            csr: 1 | 2 << 5 | 1 << 8 | 0b01011 << 14,
            // VPS_SEL = VINP1, VMS_SEL = PGA, switched by TIM1's OC6.
            tcmr: 1 << 1 | 1 << 3,
        },
    })
}

/// HCLK cycles of one conversion with this sampling code.
const fn conversion(sample: u32) -> u32 {
    (SAMPLE_HALVES[sample as usize] + CONVERT_HALVES) * TICKS_PER_CYCLE / 2
}

/// HCLK cycles until the last of `count` conversions has taken its sample.
const fn sampled(count: u32, sample: u32) -> u32 {
    count * conversion(sample) - CONVERT_HALVES * TICKS_PER_CYCLE / 2
}

/// Shortest sampling code of the bias pin that lets the amplifiers settle on their second inputs.
const fn bias_sample(samples: u32) -> u32 {
    let mut sample = AMPLIFIER_SAMPLE;
    while conversion(sample) * samples < ticks(AMPLIFIER_NS, CLOCK_HZ) {
        sample += 1;
    }
    sample
}

const fn timer(step: &Step, divider: u32, second_input: u32) -> Timer {
    /// PWM mode 2: inactive below the compare value, active from there to the top.
    const PWM2: u32 = 0b111;
    Timer {
        psc: divider - 1,
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
        // CC6E and, below, MOE, so that OC6 reaches the amplifiers.
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

/// Register values of an ADC; `odd` is the sampling code of inputs below 16, the pins.
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
        // Five fields a register, six bits apart; in the first register the length comes before
        // them.
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
        // OVRIE, because an overrun stops the DMA requests (RM0440 §21.4.27), and so the frame
        // interrupt.
        ier: 1 << 4,
        // DMAEN, DMACFG: circular; EXTEN: rising; JQDIS: JSQR without queue.
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

/// Bits HTIE and TCIE: one interrupt a frame.
const fn interrupts(on: bool) -> u32 {
    if on { 1 << 2 | 1 << 1 } else { 0 }
}

/// Value of `DMA_CCRx`: circular, memory incremented.
///
/// Both sides have the same `size` (1: 16 bits, 2: 32 bits).
const fn dma(direction_and_interrupts: u32, size: u32, priority: u32) -> u32 {
    direction_and_interrupts | 1 << 5 | 1 << 7 | size << 8 | size << 10 | priority << 12
}

//! Converters of the STM32G431: start-up, sequences, overrun, oversampling, sampling time, pins,
//! amplifiers.

use taxel_emulator::board::model::Model::G431;
use taxel_emulator::board::time::{HZ, Tick, micros};

use super::{DARK, Driver, RAM};

/// Cycle of the converters at HSI16 / 4.
const CYCLE: Tick = HZ / 4_000_000;

/// Registers of the STM32G431 (RM0440 §21.6, §25.5), and bits.
mod g4 {
    pub const AHB1ENR: u32 = 0x4002_1048;
    pub const AHB2ENR: u32 = 0x4002_104c;
    pub const APB2ENR: u32 = 0x4002_1060;
    pub const GPIOA_MODER: u32 = 0x4800_0000;
    pub const GPIOA_PUPDR: u32 = 0x4800_000c;
    pub const GPIOB_BSRR: u32 = 0x4800_0418;
    pub const ADC: u32 = 0x5000_0000;
    pub const ADC2: u32 = 0x5000_0100;
    pub const CCR: u32 = 0x5000_0308;
    pub const OPAMP2_CSR: u32 = 0x4001_0304;

    pub const ISR: u32 = 0x00;
    pub const CR: u32 = 0x08;
    pub const CFGR: u32 = 0x0c;
    pub const CFGR2: u32 = 0x10;
    pub const SMPR1: u32 = 0x14;
    pub const SMPR2: u32 = 0x18;
    pub const SQR1: u32 = 0x30;
    pub const DR: u32 = 0x40;
    pub const JSQR: u32 = 0x4c;
    pub const JDR1: u32 = 0x80;

    pub const ADRDY: u32 = 1;
    pub const EOC: u32 = 1 << 2;
    pub const EOS: u32 = 1 << 3;
    pub const OVR: u32 = 1 << 4;
    pub const JEOC: u32 = 1 << 5;
    pub const JEOS: u32 = 1 << 6;

    pub const ADEN: u32 = 1;
    pub const ADSTART: u32 = 1 << 2;
    pub const JADSTART: u32 = 1 << 3;
    pub const ADSTP: u32 = 1 << 4;
    pub const ADVREGEN: u32 = 1 << 28;
    pub const ADCAL: u32 = 1 << 31;
}

/// STM32G431 with the clocks of ports and converters on, HCLK/4.
fn g431() -> Driver {
    let mut driver = Driver::new(G431);
    // ADC12, ports A and B
    driver.set(g4::AHB2ENR, 1 << 13 | 0b11);
    driver.write(g4::CCR, 3 << 16);
    // The finger's columns settle.
    driver.write(g4::GPIOB_BSRR, 0);
    driver.wait(micros(1_000));
    driver
}

/// Starts a converter up as RM0440 §21.4.6 to §21.4.9 say.
fn start_up(driver: &mut Driver, adc: u32) {
    driver.write(adc + g4::CR, 0);
    driver.write(adc + g4::CR, g4::ADVREGEN);
    driver.wait(micros(20));
    driver.write(adc + g4::CR, g4::ADVREGEN | g4::ADCAL);
    assert!(driver.wait_for(adc + g4::CR, g4::ADCAL, 0) >= 116 * CYCLE);
    driver.wait(4 * CYCLE);
    driver.write(adc + g4::CR, g4::ADVREGEN | g4::ADEN);
    assert!(driver.wait_for(adc + g4::ISR, g4::ADRDY, g4::ADRDY) >= 15 * CYCLE);
}

/// STM32G431 with ADC1 started up, and a sequence of these inputs.
fn with_sequence(inputs: &[u32]) -> Driver {
    let mut driver = g431();
    start_up(&mut driver, g4::ADC);
    let places = inputs.iter().enumerate().map(|(i, input)| input << (6 * (i + 1)));
    driver.write(g4::ADC + g4::SQR1, (inputs.len() as u32 - 1) | places.sum::<u32>());
    driver
}

fn start(driver: &mut Driver, adc: u32, bit: u32) {
    let cr = driver.read(adc + g4::CR);
    driver.write(adc + g4::CR, cr | bit);
}

#[test]
fn start_up_refuses_each_missing_wait() {
    let adc = g4::ADC;
    let mut driver = g431();
    let asleep = driver.refused(adc + g4::CR, g4::ADEN);
    assert!(asleep.contains("before regulator and calibration"), "{asleep}");

    let mut driver = g431();
    driver.write(adc + g4::CR, g4::ADVREGEN);
    driver.wait(micros(20) - 1);
    let early = driver.refused(adc + g4::CR, g4::ADVREGEN | g4::ADCAL);
    assert!(early.contains("calibration before the regulator is up"), "{early}");

    let mut driver = g431();
    driver.write(adc + g4::CR, g4::ADVREGEN);
    driver.wait(micros(20));
    let uncalibrated = driver.refused(adc + g4::CR, g4::ADVREGEN | g4::ADEN);
    assert!(uncalibrated.contains("before regulator and calibration"), "{uncalibrated}");

    // Four cycles from the calibration's end to ADEN.
    let mut driver = g431();
    driver.write(adc + g4::CR, g4::ADVREGEN);
    driver.wait(micros(20));
    driver.write(adc + g4::CR, g4::ADVREGEN | g4::ADCAL);
    driver.wait(116 * CYCLE);
    assert_eq!(driver.read(adc + g4::CR), g4::ADVREGEN);
    driver.wait(4 * CYCLE - 1);
    let hasty = driver.refused(adc + g4::CR, g4::ADVREGEN | g4::ADEN);
    assert!(hasty.contains("before regulator and calibration"), "{hasty}");

    let mut driver = g431();
    driver.write(adc + g4::CR, g4::ADVREGEN);
    driver.wait(micros(20));
    driver.write(adc + g4::CR, g4::ADVREGEN | g4::ADCAL);
    driver.wait(120 * CYCLE);
    driver.write(adc + g4::CR, g4::ADVREGEN | g4::ADEN);
    assert_eq!(driver.read(adc + g4::ISR) & g4::ADRDY, 0);
    let unready = driver.refused(adc + g4::CR, g4::ADVREGEN | g4::ADEN | g4::ADSTART);
    assert!(unready.contains("started before the ADC is ready"), "{unready}");
}

#[test]
fn regulator_stays_on_while_enabled() {
    // Without ADVREGEN, with DEEPPWD, with ADCALDIF.
    for value in [g4::ADEN, g4::ADEN | g4::ADVREGEN | 1 << 29, g4::ADEN | g4::ADVREGEN | 1 << 30] {
        let off = with_sequence(&[1]).refused(g4::ADC + g4::CR, value);
        assert!(off.contains("changed while the ADC is enabled"), "{off}");
    }
}

#[test]
fn reserved_dual_modes_are_refused() {
    // DUAL = 4, 8 and 16; MDMA = 1.
    for bit in [2, 3, 4, 14] {
        let reserved = g431().refused(g4::CCR, 3 << 16 | 1 << bit);
        assert!(reserved.contains("a reserved mode (DUAL, MDMA)"), "{reserved}");
    }
}

#[test]
fn clock_must_be_set_first() {
    let mut driver = Driver::new(G431);
    driver.set(g4::AHB2ENR, 1 << 13);
    let unclocked = driver.refused(g4::ADC + g4::CR, g4::ADVREGEN | g4::ADEN);
    assert!(unclocked.contains("the ADC's clock is not HCLK/4"), "{unclocked}");
}

#[test]
fn sequence_converts_as_many_inputs_as_sqr1_says() {
    let adc = g4::ADC;
    let mut driver = with_sequence(&[1, 3, 2]);
    start(&mut driver, adc, g4::ADSTART);
    // 2.5 cycles of sampling and 12.5 of conversion each.
    for (code, last) in [(DARK[0], false), (DARK[2], false), (DARK[1], true)] {
        driver.wait(15 * CYCLE - 1);
        assert_eq!(driver.read(adc + g4::ISR) & (g4::EOC | g4::EOS), 0);
        driver.wait(1);
        let flags = g4::EOC | if last { g4::EOS } else { 0 };
        assert_eq!(driver.read(adc + g4::ISR) & (g4::EOC | g4::EOS), flags);
        // Reading the result clears EOC.
        assert_eq!(driver.read(adc + g4::DR), u32::from(code));
        assert_eq!(driver.read(adc + g4::ISR) & g4::EOC, 0);
    }
    assert_eq!(driver.read(adc + g4::CR) & g4::ADSTART, 0);
    driver.write(adc + g4::ISR, g4::EOS);
    driver.wait(100 * CYCLE);
    assert_eq!(driver.read(adc + g4::ISR) & (g4::EOC | g4::EOS | g4::OVR), 0);
}

#[test]
fn unread_result_is_an_overrun() {
    let adc = g4::ADC;
    let mut driver = with_sequence(&[1, 2, 3]);
    start(&mut driver, adc, g4::ADSTART);
    driver.wait(45 * CYCLE);
    assert_eq!(driver.read(adc + g4::ISR) & g4::OVR, g4::OVR);
    // The first result is kept.
    assert_eq!(driver.read(adc + g4::DR), u32::from(DARK[0]));
    driver.write(adc + g4::ISR, g4::OVR);
    assert_eq!(driver.read(adc + g4::ISR) & g4::OVR, 0);
}

#[test]
fn one_shot_requests_end_with_the_dma_turn() {
    // DMACFG: one shot, and circular. The DMA goes around after each of two sequences of one.
    for (dmacfg, taken) in [(0, 0), (1, 100)] {
        let adc = g4::ADC;
        let mut driver = with_sequence(&[1]);
        driver.set(g4::AHB1ENR, 0b101);
        driver.write(0x4002_0800, 5);
        driver.write(0x4002_0010, adc + g4::DR);
        driver.write(0x4002_0014, RAM);
        driver.write(0x4002_000c, 1);
        driver.write(0x4002_0008, 1 << 10 | 1 << 8 | 1 << 7 | 1 << 5 | 1);
        driver.write(adc + g4::CFGR, 1 << 31 | dmacfg << 1 | 1);
        start(&mut driver, adc, g4::ADSTART);
        driver.wait(15 * CYCLE);
        assert_eq!(driver.half(RAM), 100);
        driver.fill(&[0]);
        start(&mut driver, adc, g4::ADSTART);
        driver.wait(15 * CYCLE);
        assert_eq!(driver.half(RAM), taken);
    }
}

#[test]
fn dma_takes_each_result_until_an_overrun() {
    let adc = g4::ADC;
    let mut driver = with_sequence(&[1, 2, 3]);
    driver.set(g4::AHB1ENR, 0b101);
    // DMA1's channel 1: half words to memory, MINC; request 5 is ADC1's.
    driver.write(0x4002_0800, 5);
    driver.write(0x4002_0010, adc + g4::DR);
    driver.write(0x4002_0014, RAM);
    driver.write(0x4002_000c, 6);
    driver.write(0x4002_0008, 1 << 10 | 1 << 8 | 1 << 7 | 1);
    driver.write(adc + g4::CFGR, 1 << 31 | 0b11);
    start(&mut driver, adc, g4::ADSTART);
    driver.wait(45 * CYCLE);
    let read: Vec<_> = (0..4).map(|i| driver.half(RAM + 2 * i)).collect();
    assert_eq!(read, [100, 200, 300, 0]);
    assert_eq!(driver.read(adc + g4::ISR) & (g4::EOC | g4::OVR), 0);

    // The DMA misses one: no more are requested until OVR is cleared.
    driver.chip.withhold(0);
    start(&mut driver, adc, g4::ADSTART);
    driver.wait(45 * CYCLE);
    assert_eq!(driver.read(adc + g4::ISR) & g4::OVR, g4::OVR);
    assert_eq!(driver.half(RAM + 6), 0);
    driver.read(adc + g4::DR);
    start(&mut driver, adc, g4::ADSTART);
    driver.wait(45 * CYCLE);
    assert_eq!(driver.half(RAM + 6), 0);
    driver.read(adc + g4::DR);
    driver.write(adc + g4::ISR, g4::OVR);
    start(&mut driver, adc, g4::ADSTART);
    driver.wait(45 * CYCLE);
    assert_eq!(driver.half(RAM + 6), 100);
}

#[test]
fn oversampling_adds_and_shifts() {
    let adc = g4::ADC;
    // OVSR = 2: eight samples. OVSS: bits to shift.
    for (shift, code) in [(0, 800), (3, 100)] {
        let mut driver = with_sequence(&[1]);
        driver.write(adc + g4::CFGR2, shift << 5 | 2 << 2 | 1);
        start(&mut driver, adc, g4::ADSTART);
        driver.wait(8 * 15 * CYCLE - 1);
        assert_eq!(driver.read(adc + g4::ISR) & g4::EOC, 0);
        driver.wait(1);
        assert_eq!(driver.read(adc + g4::DR), code);
    }
}

#[test]
fn injected_group_has_registers_of_its_own() {
    let adc = g4::ADC;
    let mut driver = with_sequence(&[1]);
    // JL = 1: inputs 4 and 2.
    driver.write(adc + g4::JSQR, 2 << 15 | 4 << 9 | 1);
    start(&mut driver, adc, g4::JADSTART);
    driver.wait(15 * CYCLE);
    assert_eq!(driver.read(adc + g4::ISR) & (g4::JEOC | g4::JEOS), g4::JEOC);
    driver.wait(15 * CYCLE);
    assert_eq!(driver.read(adc + g4::ISR) & (g4::JEOC | g4::JEOS), g4::JEOC | g4::JEOS);
    assert_eq!([0, 4].map(|at| driver.read(adc + g4::JDR1 + at)), [400, 200]);
    assert_eq!(driver.read(adc + g4::CR) & g4::JADSTART, 0);
    assert_eq!(driver.read(adc + g4::ISR) & (g4::EOC | g4::EOS), 0);
}

#[test]
fn registers_are_closed_while_started() {
    let adc = g4::ADC;
    let mut driver = with_sequence(&[1, 2]);
    start(&mut driver, adc, g4::ADSTART);
    for register in [g4::SQR1, g4::SMPR1, g4::CFGR] {
        let closed = driver.refused(adc + register, 0);
        assert!(closed.contains("while conversions are started"), "{closed}");
    }
    // ADSTP ends the sequence.
    start(&mut driver, adc, g4::ADSTP);
    assert_eq!(driver.read(adc + g4::CR) & (g4::ADSTART | g4::ADSTP), 0);
    driver.write(adc + g4::SQR1, 1 << 6);
    driver.wait(100 * CYCLE);
    assert_eq!(driver.read(adc + g4::ISR) & g4::EOC, 0);
}

#[test]
fn sampling_must_suit_the_source() {
    let adc = g4::ADC;
    // 2.5 cycles of 250 ns are 625 ns: enough for 1.5 kΩ (DS12589 table 67), and 6.5 for 2 kΩ.
    for (ohm, code, enough) in [(1_500.0, 0, true), (2_000.0, 0, false), (2_000.0, 1, true)] {
        let mut driver = with_sequence(&[1]);
        driver.chip.common_mut().finger.column_ohm = ohm;
        driver.write(adc + g4::SMPR1, code << 3);
        start(&mut driver, adc, g4::ADSTART);
        let converted = driver.wait_or_stop(50 * CYCLE);
        assert_eq!(converted.is_ok(), enough, "{converted:?}");
        if let Err(why) = converted {
            assert!(why.contains("ADC1: input 1 is sampled for 625 ns"), "{why}");
            assert!(why.contains("needs 792 ns"), "{why}");
        }
    }
    // Temperature: 5 µs. 12.5 cycles are 3.1 µs, 24.5 are 6.1 µs.
    for (code, enough) in [(2, false), (3, true)] {
        let mut driver = with_sequence(&[16]);
        driver.write(g4::CCR, 1 << 23 | 3 << 16);
        driver.write(adc + g4::SMPR2, code << 18);
        start(&mut driver, adc, g4::ADSTART);
        assert_eq!(driver.wait_or_stop(50 * CYCLE).is_ok(), enough);
    }
}

#[test]
fn input_must_be_a_free_analogue_pin() {
    let refused = |register: u32, value: u32| {
        let mut driver = with_sequence(&[1]);
        driver.write(register, value);
        start(&mut driver, g4::ADC, g4::ADSTART);
        driver.wait_or_stop(15 * CYCLE).unwrap_err()
    };
    // PA0 as an input, and with a pull-up.
    let digital = refused(g4::GPIOA_MODER, 0xabff_fffc);
    assert!(digital.contains("ADC1's input PA0 is not set to analogue"), "{digital}");
    let pulled = refused(g4::GPIOA_PUPDR, 0x6400_0001);
    assert!(pulled.contains("ADC1's input PA0 has a pull-up or pull-down"), "{pulled}");
    // The temperature sensor without VSENSEEN.
    let mut driver = with_sequence(&[16]);
    start(&mut driver, g4::ADC, g4::ADSTART);
    let off = driver.wait_or_stop(15 * CYCLE).unwrap_err();
    assert!(off.contains("ADC1 has no such input"), "{off}");
}

/// STM32G431 whose ADC2 will convert OPAMP2's output.
fn with_amplifier() -> Driver {
    let mut driver = g431();
    driver.set(g4::APB2ENR, 1);
    start_up(&mut driver, g4::ADC2);
    driver.write(g4::ADC2 + g4::SQR1, 16 << 6);
    driver
}

/// OPAEN; OPAINTOEN; VM_SEL = PGA; PGA_GAIN = 16 about VINM0; VP_SEL = VINP0, which is PA7.
const AMPLIFIES: u32 = 0b01011 << 14 | 1 << 8 | 2 << 5 | 1;

#[test]
fn amplifier_multiplies_a_midpoint() {
    for (select, code) in [(0, 1_000), (1, 1_100)] {
        let mut driver = with_amplifier();
        driver.write(g4::OPAMP2_CSR, AMPLIFIES | select << 2);
        driver.wait(micros(10));
        start(&mut driver, g4::ADC2, g4::ADSTART);
        driver.wait(15 * CYCLE);
        assert_eq!(driver.read(g4::ADC2 + g4::DR), code);
    }
}

#[test]
fn wrong_gain_of_the_amplifier_shows_in_the_code() {
    let code = |csr: u32| {
        let mut driver = with_amplifier();
        driver.write(g4::OPAMP2_CSR, csr);
        driver.wait(micros(30));
        start(&mut driver, g4::ADC2, g4::ADSTART);
        driver.wait(15 * CYCLE);
        driver.read(g4::ADC2 + g4::DR)
    };
    // 2, 4, 8, 16, 32 and 64 times about a bias of 2048: at 16 times the midpoint is 1000.
    let gain = |gain: u32| code(AMPLIFIES & !(0x1f << 14) | gain << 14);
    assert_eq!([8, 9, 10, 11, 12, 13].map(gain), [1917, 1786, 1524, 1000, 0, 0]);
    // Without the bias: from ground. A follower (VM_SEL = 3) has the midpoint itself.
    assert_eq!([0, 3].map(gain), [3965, 4095]);
    assert_eq!(code(AMPLIFIES | 3 << 5), 1983);
}

#[test]
fn amplifier_must_be_awake_and_set_up() {
    let refused = |csr: u32, time: Tick| {
        let mut driver = with_amplifier();
        driver.write(g4::OPAMP2_CSR, csr);
        driver.wait(time);
        start(&mut driver, g4::ADC2, g4::ADSTART);
        driver.wait_or_stop(15 * CYCLE).unwrap_err()
    };
    let asleep = refused(AMPLIFIES, micros(5));
    assert!(asleep.contains("OPAMP2 has been on for less than its wake-up time"), "{asleep}");
    let off = refused(AMPLIFIES & !1, micros(10));
    assert!(off.contains("OPAMP2 is off"), "{off}");
    let outside = refused(AMPLIFIES & !(1 << 8), micros(10));
    assert!(outside.contains("does not reach the ADC"), "{outside}");
    // The pin of the bias, PA5, as an input.
    let mut driver = with_amplifier();
    driver.write(g4::OPAMP2_CSR, AMPLIFIES);
    driver.write(g4::GPIOA_MODER, 0xabff_f3ff);
    driver.wait(micros(10));
    start(&mut driver, g4::ADC2, g4::ADSTART);
    let digital = driver.wait_or_stop(15 * CYCLE).unwrap_err();
    assert!(digital.contains("OPAMP2's input PA5 is not set to analogue"), "{digital}");
    // A reserved gain, and 16 times with a filter.
    for gain in [0b01110, 0b10011] {
        let wrong = refused(AMPLIFIES & !(0x1f << 14) | gain << 14, micros(10));
        assert!(wrong.contains("PGA_GAIN is reserved or not modelled"), "{wrong}");
    }
}

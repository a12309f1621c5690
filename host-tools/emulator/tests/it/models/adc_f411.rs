//! Converter of the STM32F411: start-up, sequences, overrun, sampling time.

use taxel_emulator::board::model::Model::F411;
use taxel_emulator::board::time::{HZ, Tick, micros};

use super::{DARK, Driver, RAM};

/// Cycle of the converter at HSI16 / 4.
const CYCLE: Tick = HZ / 4_000_000;

/// Registers of the STM32F411 (RM0383 §11.12).
mod f4 {
    pub const AHB1ENR: u32 = 0x4002_3830;
    pub const APB2ENR: u32 = 0x4002_3844;
    pub const GPIOA_MODER: u32 = 0x4002_0000;
    pub const GPIOB_BSRR: u32 = 0x4002_0418;
    pub const SR: u32 = 0x4001_2000;
    pub const CR1: u32 = 0x4001_2004;
    pub const CR2: u32 = 0x4001_2008;
    pub const SMPR2: u32 = 0x4001_2010;
    pub const SQR1: u32 = 0x4001_202c;
    pub const SQR3: u32 = 0x4001_2034;
    pub const DR: u32 = 0x4001_204c;
    pub const CCR: u32 = 0x4001_2304;

    pub const EOC: u32 = 1 << 1;
    pub const OVR: u32 = 1 << 5;
    pub const SCAN: u32 = 1 << 8;
    pub const ADON: u32 = 1;
    pub const DMA: u32 = 1 << 8;
    pub const DDS: u32 = 1 << 9;
    pub const SWSTART: u32 = 1 << 30;
}

/// STM32F411 with its converter on and stable, and the columns' pins analogue.
fn f411() -> Driver {
    let mut driver = Driver::new(F411);
    driver.set(f4::AHB1ENR, 0b11);
    driver.set(f4::APB2ENR, 1 << 8);
    driver.write(f4::GPIOA_MODER, 0xa800_03fc);
    driver.write(f4::GPIOB_BSRR, 0);
    driver.write(f4::CCR, 1 << 16);
    driver.write(f4::CR2, f4::ADON);
    driver.wait(micros(1_000));
    driver
}

#[test]
fn converts_after_it_is_stable() {
    let mut driver = f411();
    driver.write(f4::CR2, 0);
    driver.write(f4::CR2, f4::ADON);
    driver.wait(micros(3) - 1);
    let early = driver.refused(f4::CR2, f4::ADON | f4::SWSTART);
    assert!(early.contains("SWSTART before the ADC is stable"), "{early}");

    let mut driver = f411();
    driver.write(f4::SQR3, 2);
    driver.write(f4::CR2, f4::ADON | f4::SWSTART);
    assert_eq!(driver.read(f4::CR2), f4::ADON);
    // Three cycles to begin, three of sampling, twelve of conversion.
    driver.wait(18 * CYCLE - 1);
    assert_eq!(driver.read(f4::SR) & f4::EOC, 0);
    driver.wait(1);
    assert_eq!(driver.read(f4::SR) & f4::EOC, f4::EOC);
    assert_eq!([driver.read(f4::DR), driver.read(f4::SR) & f4::EOC], [u32::from(DARK[1]), 0]);
}

/// Sets a sequence of inputs 1 to 3 with DMA.
fn sequence(driver: &mut Driver, stream: bool) {
    driver.write(f4::CR1, f4::SCAN);
    driver.write(f4::SQR1, 2 << 20);
    driver.write(f4::SQR3, 3 << 10 | 2 << 5 | 1);
    driver.set(f4::AHB1ENR, 1 << 22);
    // DMA2's stream 0, channel 0: half words to memory, MINC.
    driver.write(0x4002_6418, f4::DR);
    driver.write(0x4002_641c, RAM);
    driver.write(0x4002_6414, 6);
    driver.write(0x4002_6410, 1 << 13 | 1 << 11 | 1 << 10 | u32::from(stream));
    driver.write(f4::CR2, f4::ADON | f4::DMA | f4::DDS);
}

#[test]
fn sequence_goes_to_memory() {
    let mut driver = f411();
    sequence(&mut driver, true);
    driver.write(f4::CR2, f4::ADON | f4::DMA | f4::DDS | f4::SWSTART);
    driver.wait((3 + 3 * 15) * CYCLE);
    let read: Vec<_> = (0..4).map(|i| driver.half(RAM + 2 * i)).collect();
    assert_eq!(read, [100, 200, 300, 0]);
    assert_eq!(driver.read(f4::SR) & (f4::EOC | f4::OVR), 0);
}

#[test]
fn overrun_stops_conversions_until_it_is_cleared() {
    let mut driver = f411();
    sequence(&mut driver, false);
    let go = f4::ADON | f4::DMA | f4::DDS | f4::SWSTART;
    driver.write(f4::CR2, go);
    driver.wait(100 * CYCLE);
    assert_eq!(driver.read(f4::SR) & f4::OVR, f4::OVR);
    assert_eq!(driver.read(f4::DR), u32::from(DARK[0]));
    driver.write(f4::CR2, go);
    driver.wait(100 * CYCLE);
    assert_eq!(driver.read(f4::SR) & f4::EOC, 0);
    // A flag is cleared by a zero.
    driver.write(f4::SR, 0x3f & !f4::OVR);
    driver.write(f4::CR2, go);
    driver.wait(18 * CYCLE);
    assert_eq!(driver.read(f4::SR) & (f4::EOC | f4::OVR), f4::EOC);
}

#[test]
fn sampling_must_suit_the_source() {
    // Equation 1 of DS10314: 3 cycles of 250 ns suit 3.2 kΩ, 15 suit 47 kΩ.
    for (ohm, code, enough) in
        [(3_100.0, 0, true), (3_300.0, 0, false), (40_000.0, 1, true), (60_000.0, 1, false)]
    {
        let mut driver = f411();
        driver.chip.common_mut().finger.column_ohm = ohm;
        driver.write(f4::SQR3, 1);
        driver.write(f4::SMPR2, code << 3);
        driver.write(f4::CR2, f4::ADON | f4::SWSTART);
        let converted = driver.wait_or_stop(50 * CYCLE);
        assert_eq!(converted.is_ok(), enough, "{ohm}: {converted:?}");
    }
}

//! DMA: counter, circular reload, flags, requests, and registers that are closed while it is on.

use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::time::{HZ, Tick};

use super::{Driver, RAM};

/// Cycle of HSI16, which both chips start with.
const CYCLE: Tick = HZ / 16_000_000;
/// Cycles between two requests of TIM1.
const PERIOD: u32 = 100;

/// DMA channel or stream of a chip that TIM1's channel 1 requests, and port B.
struct Dma {
    model: Model,
    /// Clock enables: register and bits.
    clocks: [(u32, u32); 2],
    tim1: u32,
    bsrr: u32,
    odr: u32,
    cr: u32,
    ndtr: u32,
    par: u32,
    mar: u32,
    /// Configuration: words from memory to the peripheral, with MINC.
    words: u32,
    circular: u32,
    /// Register of flags, the one that clears them, and HT and TC of the channel.
    flags: (u32, u32, [u32; 2]),
}

/// DMA1's channel 2 by DMAMUX1 (RM0440 §12.6, §13.6; request 42 is TIM1_CH1).
const G4: Dma = Dma {
    model: G431,
    // DMA1, DMAMUX1; GPIOB. TIM1 follows.
    clocks: [(0x4002_1048, 0b101), (0x4002_104c, 0b10)],
    tim1: 0x4001_2c00,
    bsrr: 0x4800_0418,
    odr: 0x4800_0414,
    cr: 0x4002_001c,
    ndtr: 0x4002_0020,
    par: 0x4002_0024,
    mar: 0x4002_0028,
    words: 2 << 10 | 2 << 8 | 1 << 7 | 1 << 4,
    circular: 1 << 5,
    flags: (0x4002_0000, 0x4002_0004, [4 << 4, 2 << 4]),
};

/// DMA2's stream 1, channel 6 (RM0383 §9.5, table 28).
const F4: Dma = Dma {
    model: F411,
    clocks: [(0x4002_3830, 1 << 22), (0x4002_3830, 0b10)],
    tim1: 0x4001_0000,
    bsrr: 0x4002_0418,
    odr: 0x4002_0414,
    cr: 0x4002_6428,
    ndtr: 0x4002_642c,
    par: 0x4002_6430,
    mar: 0x4002_6434,
    words: 6 << 25 | 2 << 13 | 2 << 11 | 1 << 10 | 1 << 6,
    circular: 1 << 8,
    flags: (0x4002_6400, 0x4002_6408, [1 << 10, 1 << 11]),
};

impl Dma {
    /// Chip whose TIM1 requests a transfer every [`PERIOD`], and a channel set up for `count`
    /// words.
    fn set_up(&self, count: u32, mode: u32) -> Driver {
        let mut driver = Driver::new(self.model);
        self.clocks.iter().for_each(|(register, bits)| driver.set(*register, *bits));
        let tim1 = if self.model == G431 { (0x4002_1060, 1 << 11) } else { (0x4002_3844, 1) };
        driver.set(tim1.0, tim1.1);
        driver.fill(&[1, 2, 4, 8]);
        if self.model == G431 {
            // DMAMUX1's channel 1 serves DMA1's channel 2.
            driver.write(0x4002_0804, 42);
        }
        driver.write(self.par, self.bsrr);
        driver.write(self.mar, RAM);
        driver.write(self.ndtr, count);
        driver.write(self.cr, self.words | mode);
        driver.write(self.cr, self.words | mode | 1);
        // CC1DE; a match at count 50 of each period.
        driver.write(self.tim1 + 0x0c, 1 << 9);
        driver.write(self.tim1 + 0x2c, PERIOD - 1);
        driver.write(self.tim1 + 0x34, PERIOD / 2);
        driver.write(self.tim1, 1);
        driver.wait(Tick::from(PERIOD / 2 - 1) * CYCLE);
        assert_eq!(driver.read(self.odr), 0);
        driver.wait(CYCLE);
        driver
    }

    fn period(driver: &mut Driver) {
        driver.wait(Tick::from(PERIOD) * CYCLE);
    }

    /// HT and TC.
    fn flags(&self, driver: &mut Driver) -> [bool; 2] {
        let flags = driver.read(self.flags.0);
        self.flags.2.map(|bit| flags & bit != 0)
    }
}

#[test]
fn counter_counts_down_and_stops() {
    for dma in [G4, F4] {
        let mut driver = dma.set_up(4, 0);
        for (left, odr, flags) in [
            (3, 1, [false, false]),
            (2, 3, [true, false]),
            (1, 7, [true, false]),
            (0, 15, [true, true]),
            // No more transfers.
            (0, 15, [true, true]),
        ] {
            assert_eq!([driver.read(dma.ndtr), driver.read(dma.odr)], [left, odr]);
            assert_eq!(dma.flags(&mut driver), flags);
            Dma::period(&mut driver);
        }
        // A stream of the STM32F411 switches itself off, a channel of the STM32G431 does not.
        assert_eq!(driver.read(dma.cr) & 1, u32::from(dma.model == G431));
        driver.write(dma.flags.1, dma.flags.2[0]);
        assert_eq!(dma.flags(&mut driver), [false, true]);
        driver.write(dma.flags.1, dma.flags.2[1]);
        assert_eq!(dma.flags(&mut driver), [false, false]);
    }
}

#[test]
fn circular_channel_starts_over() {
    for dma in [G4, F4] {
        let mut driver = dma.set_up(3, dma.circular);
        // Bits 0 to 15 are set, 16 to 31 cleared.
        driver.fill(&[1, 2, 3 << 16]);
        let mut seen = Vec::new();
        for _ in 0..7 {
            seen.push([driver.read(dma.ndtr), driver.read(dma.odr)]);
            Dma::period(&mut driver);
        }
        assert_eq!(seen, [[2, 1], [1, 3], [3, 0], [2, 1], [1, 3], [3, 0], [2, 1]]);
        assert_eq!(dma.flags(&mut driver), [true, true]);
        assert_eq!(driver.read(dma.cr) & 1, 1);
    }
}

#[test]
fn registers_are_closed_while_the_channel_is_on() {
    for dma in [G4, F4] {
        let mut driver = dma.set_up(4, 0);
        for (register, value) in [
            (dma.ndtr, 9),
            (dma.par, dma.odr),
            (dma.mar, RAM + 4),
            (dma.cr, dma.words ^ 1 << 10 | 1),
        ] {
            let closed = driver.refused(register, value);
            assert!(closed.contains("is enabled"), "{closed}");
        }
        // Off, they are open, and requests pass by.
        driver.write(dma.cr, dma.words);
        driver.write(dma.ndtr, 2);
        Dma::period(&mut driver);
        assert_eq!([driver.read(dma.ndtr), driver.read(dma.odr)], [2, 1]);
    }
}

#[test]
fn other_requests_pass_by() {
    let mut driver = G4.set_up(4, 0);
    // Request 43 is TIM1_CH2.
    driver.write(0x4002_0804, 43);
    Dma::period(&mut driver);
    assert_eq!(driver.read(G4.ndtr), 3);
    let mut driver = F4.set_up(4, 0);
    driver.write(F4.cr, F4.words);
    driver.write(F4.flags.1, 0xf40);
    driver.write(F4.cr, F4.words ^ 1 << 25 | 1);
    Dma::period(&mut driver);
    assert_eq!(driver.read(F4.ndtr), 3);
}

#[test]
fn address_must_fit_the_size() {
    for dma in [G4, F4] {
        let mut driver = dma.set_up(4, 0);
        driver.write(dma.cr, dma.words);
        driver.write(dma.flags.1, if dma.model == G431 { 0xff } else { 0xf40 });
        driver.write(dma.mar, RAM + 2);
        let odd = driver.refused(dma.cr, dma.words | 1);
        assert!(odd.contains("an address that does not fit the size"), "{odd}");
    }
}

#[test]
fn g431_first_flag_stands_for_the_others() {
    let mut driver = G4.set_up(4, 0);
    Dma::period(&mut driver);
    assert_eq!(driver.read(G4.flags.0), 0b101 << 4);
    // CGIF clears all.
    driver.write(G4.flags.1, 1 << 4);
    assert_eq!(driver.read(G4.flags.0), 0);
}

#[test]
fn f411_stopped_stream_sets_tcif_and_must_be_cleared() {
    let mut driver = F4.set_up(4, 0);
    driver.write(F4.cr, F4.words);
    assert_eq!(F4.flags(&mut driver), [false, true]);
    let standing = driver.refused(F4.cr, F4.words | 1);
    assert!(standing.contains("while flags of the last transfer stand"), "{standing}");
    driver.write(F4.flags.1, F4.flags.2[1]);
    driver.write(F4.cr, F4.words | 1);
    Dma::period(&mut driver);
    assert_eq!(driver.read(F4.ndtr), 2);
}

//! Timers: prescaler, auto-reload, compare, update, with and without preload.

use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::time::{HZ, Tick};

use super::Driver;

const TIM2: u32 = 0x4000_0000;
const CR1: u32 = TIM2;
const DIER: u32 = TIM2 + 0x0c;
const SR: u32 = TIM2 + 0x10;
const EGR: u32 = TIM2 + 0x14;
const CCMR1: u32 = TIM2 + 0x18;
const CNT: u32 = TIM2 + 0x24;
const PSC: u32 = TIM2 + 0x28;
const ARR: u32 = TIM2 + 0x2c;
const CCR1: u32 = TIM2 + 0x34;
const CCR2: u32 = TIM2 + 0x38;

const CEN: u32 = 1;
const URS: u32 = 1 << 2;
const ARPE: u32 = 1 << 7;
const UIF: u32 = 1;
const CC1IF: u32 = 2;
const CC2IF: u32 = 4;

/// Cycle of HSI16, which both chips start with.
const CYCLE: Tick = HZ / 16_000_000;

/// Chip with TIM2's clock on: APB1ENR1 of the STM32G431, APB1ENR of the STM32F411.
fn driver(model: Model) -> Driver {
    let mut driver = Driver::new(model);
    driver.set(if model == G431 { 0x4002_1058 } else { 0x4002_3840 }, 1);
    driver
}

fn on_both(test: impl Fn(&mut Driver)) {
    [G431, F411].into_iter().for_each(|model| test(&mut driver(model)));
}

#[test]
fn counter_counts_to_arr_and_starts_over() {
    on_both(|driver| {
        assert_eq!([driver.read(CNT), driver.read(ARR)], [0, u32::MAX]);
        driver.write(ARR, 9);
        driver.write(CR1, CEN);
        driver.wait(9 * CYCLE);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [9, 0]);
        driver.wait(CYCLE);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [0, UIF]);
        // A flag is cleared by a zero and stays with a one.
        driver.write(SR, UIF);
        assert_eq!(driver.read(SR) & UIF, UIF);
        driver.write(SR, !UIF);
        assert_eq!(driver.read(SR) & UIF, 0);
        driver.wait(15 * CYCLE);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [5, UIF]);
        // A stopped counter keeps its count.
        driver.write(CR1, 0);
        driver.wait(100 * CYCLE);
        assert_eq!(driver.read(CNT), 5);
        driver.write(CR1, CEN);
        driver.wait(2 * CYCLE);
        assert_eq!(driver.read(CNT), 7);
    });
}

#[test]
fn prescaler_waits_for_the_next_update() {
    on_both(|driver| {
        driver.write(ARR, 99);
        driver.write(CR1, CEN);
        driver.write(PSC, 3);
        driver.wait(50 * CYCLE);
        assert_eq!(driver.read(CNT), 50);
        driver.wait(50 * CYCLE);
        driver.wait(40 * CYCLE);
        assert_eq!(driver.read(CNT), 10);
        // UG loads it at once and starts at zero; with URS it sets no flag.
        driver.write(SR, 0);
        driver.write(PSC, 7);
        driver.write(CR1, CEN | URS);
        driver.write(EGR, 1);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [0, 0]);
        driver.wait(40 * CYCLE);
        assert_eq!(driver.read(CNT), 5);
        driver.write(CR1, CEN);
        driver.write(EGR, 1);
        assert_eq!(driver.read(SR) & UIF, UIF);
    });
}

#[test]
fn preloaded_arr_takes_effect_at_the_update() {
    on_both(|driver| {
        driver.write(ARR, 9);
        driver.write(CR1, ARPE | CEN);
        driver.write(ARR, 4);
        driver.wait(9 * CYCLE);
        assert_eq!([driver.read(ARR), driver.read(CNT)], [4, 9]);
        driver.wait(CYCLE);
        driver.wait(5 * CYCLE);
        assert_eq!(driver.read(CNT), 0);
        // Without preload at once.
        driver.write(CR1, CEN);
        driver.write(ARR, 2);
        driver.write(SR, 0);
        driver.wait(3 * CYCLE);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [0, UIF]);
    });
}

#[test]
fn counter_beyond_a_lowered_arr_runs_to_its_top() {
    on_both(|driver| {
        // The count's begin must lie after the power-up.
        driver.wait(300 * HZ);
        driver.write(CNT, u32::MAX - 100);
        driver.write(CR1, CEN);
        driver.wait(50 * CYCLE);
        driver.write(ARR, 10);
        driver.wait(50 * CYCLE);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [u32::MAX, 0]);
        // Over the top without an update; from there on ARR holds.
        driver.wait(11 * CYCLE);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [10, 0]);
        driver.wait(CYCLE);
        assert_eq!([driver.read(CNT), driver.read(SR) & UIF], [0, UIF]);
    });
}

#[test]
fn compare_sets_its_flag_at_the_match() {
    on_both(|driver| {
        driver.write(ARR, 99);
        driver.write(CCR1, 30);
        driver.write(CCR2, 200);
        driver.write(CR1, CEN);
        driver.wait(30 * CYCLE - 1);
        assert_eq!(driver.read(SR) & CC1IF, 0);
        driver.wait(1);
        assert_eq!(driver.read(SR) & CC1IF, CC1IF);
        // Beyond ARR there is no match; UIE, CC1IE and CC2IE request no other flags.
        driver.write(DIER, 7);
        driver.wait(1_000 * CYCLE);
        assert_eq!(driver.read(SR) & CC2IF, 0);
        // A value that the counter has passed matches in the next turn.
        driver.write(EGR, 1);
        driver.wait(50 * CYCLE);
        driver.write(CCR1, 20);
        driver.write(SR, 0);
        driver.wait(49 * CYCLE);
        assert_eq!(driver.read(SR) & CC1IF, 0);
        driver.wait(21 * CYCLE);
        assert_eq!(driver.read(SR) & CC1IF, CC1IF);
    });
}

#[test]
fn preloaded_compare_takes_effect_at_the_update() {
    on_both(|driver| {
        // OC1PE
        driver.write(CCMR1, 1 << 3);
        driver.write(ARR, 99);
        driver.write(CCR1, 30);
        driver.write(EGR, 1);
        driver.write(CR1, CEN);
        driver.write(CCR1, 60);
        driver.write(SR, 0);
        driver.wait(30 * CYCLE);
        assert_eq!([driver.read(CCR1), driver.read(SR) & CC1IF], [60, CC1IF]);
        driver.wait(70 * CYCLE);
        driver.write(SR, 0);
        driver.wait(59 * CYCLE);
        assert_eq!(driver.read(SR) & CC1IF, 0);
        driver.wait(CYCLE);
        assert_eq!(driver.read(SR) & CC1IF, CC1IF);
    });
}

#[test]
fn other_modes_are_refused_by_name() {
    on_both(|driver| {
        // One pulse, downwards, centred.
        for mode in [1 << 3, 1 << 4, 1 << 5] {
            let refused = driver.refused(CR1, CEN | mode);
            assert!(refused.contains("TIM2.CR1"), "{refused}");
        }
        // Toggle on match
        driver.write(CCMR1, 3 << 4);
        let toggled = driver.refused(CR1, CEN);
        assert!(toggled.contains("output mode 3 of channel 1"), "{toggled}");
    });
}

//! Clocks: start-up times of oscillators, order of the switches, clock enables.

use taxel_emulator::board::model::Model::{F411, G431};
use taxel_emulator::board::time::{micros, nanos};

use super::Driver;

/// Registers of the STM32G431 (RM0440 §7.4, §3.7, §6.4).
mod g4 {
    pub const RCC: u32 = 0x4002_1000;
    pub const CR: u32 = RCC;
    pub const CFGR: u32 = RCC + 0x08;
    pub const PLLCFGR: u32 = RCC + 0x0c;
    pub const APB1ENR1: u32 = RCC + 0x58;
    pub const CSR: u32 = RCC + 0x94;
    pub const CRRCR: u32 = RCC + 0x98;
    pub const ACR: u32 = 0x4002_2000;
    pub const PWR_CR5: u32 = 0x4000_7080;
    pub const TIM2_PSC: u32 = 0x4000_0028;
}

/// Registers of the STM32F411 (RM0383 §6.3, §3.8, §5.5).
mod f4 {
    pub const RCC: u32 = 0x4002_3800;
    pub const CR: u32 = RCC;
    pub const PLLCFGR: u32 = RCC + 0x04;
    pub const CFGR: u32 = RCC + 0x08;
    pub const APB1ENR: u32 = RCC + 0x40;
    pub const ACR: u32 = 0x4002_3c00;
    pub const PWR_CR: u32 = 0x4000_7000;
    pub const PWR_CSR: u32 = 0x4000_7004;
    pub const TIM2_PSC: u32 = 0x4000_0028;
}

#[test]
fn g431_oscillators_are_ready_after_their_time() {
    let mut driver = Driver::new(G431);
    // HSIRDY after the reset.
    assert_eq!(driver.read(g4::CR) >> 8 & 7, 0b101);
    // HSI48ON, LSION: DS12589's typical start-up times.
    for (register, ns) in [(g4::CRRCR, 2_500), (g4::CSR, 80_000)] {
        driver.set(register, 1);
        assert_eq!(driver.read(register) & 3, 1);
        assert_eq!(driver.wait_for(register, 2, 2), nanos(ns));
        let off = driver.read(register) & !1;
        driver.write(register, off);
        assert_eq!(driver.read(register) & 3, 0);
    }
    // HSI16 feeds the core.
    let stopped = driver.refused(g4::CR, 0);
    assert!(stopped.contains("the system clock's source is switched off"), "{stopped}");
}

/// Starts the PLL at 170 MHz: HSI16 / 4 · 85 / 2.
fn start_pll(driver: &mut Driver) {
    driver.write(g4::PLLCFGR, 1 << 24 | 85 << 8 | 3 << 4 | 2);
    driver.set(g4::CR, 1 << 24);
    // Four wait states.
    driver.write(g4::ACR, 0x604);
}

#[test]
fn g431_pll_is_no_clock_before_it_has_locked() {
    let mut driver = Driver::new(G431);
    start_pll(&mut driver);
    assert_eq!(driver.read(g4::CR) >> 24 & 3, 1);
    let early = driver.refused(g4::CFGR, 8 << 4 | 3);
    assert!(early.contains("system clock 3, which is not ready"), "{early}");
    let running = driver.refused(g4::PLLCFGR, 1 << 24 | 80 << 8 | 3 << 4 | 2);
    assert!(running.contains("the PLL is running while it is set up"), "{running}");

    let mut driver = Driver::new(G431);
    start_pll(&mut driver);
    assert_eq!(driver.wait_for(g4::CR, 1 << 25, 1 << 25), micros(15));
    driver.write(g4::CFGR, 8 << 4 | 3);
    assert_eq!(driver.read(g4::CFGR) >> 2 & 3, 3);
}

#[test]
fn g431_rises_to_170_mhz_in_two_steps_with_boost() {
    let at_85_mhz = || {
        let mut driver = Driver::new(G431);
        driver.set(g4::APB1ENR1, 1 << 28);
        start_pll(&mut driver);
        driver.wait(micros(15));
        driver
    };
    let mut driver = at_85_mhz();
    let at_once = driver.refused(g4::CFGR, 3);
    assert!(at_once.contains("in one step, not with HPRE = 2"), "{at_once}");

    let mut driver = at_85_mhz();
    driver.write(g4::CFGR, 8 << 4 | 3);
    let short = driver.refused(g4::CFGR, 3);
    assert!(short.contains("less than a microsecond"), "{short}");

    let mut driver = at_85_mhz();
    driver.write(g4::CFGR, 8 << 4 | 3);
    driver.wait(micros(1));
    let weak = driver.refused(g4::CFGR, 3);
    assert!(weak.contains("without boost mode (PWR.CR5.R1MODE)"), "{weak}");

    let mut driver = at_85_mhz();
    driver.write(g4::PWR_CR5, 0);
    driver.write(g4::CFGR, 8 << 4 | 3);
    driver.wait(micros(1));
    driver.write(g4::CFGR, 3);
    let states = driver.refused(g4::ACR, 0x603);
    assert!(states.contains("needs 4 wait states, 3 are set"), "{states}");
}

#[test]
fn g431_wait_states_and_pll_are_checked() {
    let mut driver = Driver::new(G431);
    start_pll(&mut driver);
    driver.wait(micros(15));
    driver.write(g4::ACR, 0x601);
    let slow = driver.refused(g4::CFGR, 8 << 4 | 3);
    assert!(slow.contains("85000000 Hz needs 2 wait states, 1 are set"), "{slow}");

    // An oscillator of the PLL at 352 MHz.
    let mut driver = Driver::new(G431);
    driver.write(g4::PLLCFGR, 1 << 24 | 88 << 8 | 3 << 4 | 2);
    driver.set(g4::CR, 1 << 24);
    driver.write(g4::ACR, 0x604);
    driver.wait(micros(15));
    let fast = driver.refused(g4::CFGR, 8 << 4 | 3);
    assert!(fast.contains("352000000 Hz at its oscillator: out of range"), "{fast}");
}

#[test]
fn f411_crystal_pll_and_voltage_take_their_time() {
    let mut driver = Driver::new(F411);
    driver.set(f4::APB1ENR, 1 << 28);
    // VOS: scale 1.
    driver.write(f4::PWR_CR, 0xc000);
    // 25 MHz / 25 · 192 / 2, Q = 4, from HSE.
    driver.write(f4::PLLCFGR, 4 << 24 | 1 << 22 | 192 << 6 | 25);
    driver.set(f4::CR, 1 << 16);
    assert_eq!(driver.read(f4::CR) >> 16 & 3, 1);
    let cr = driver.read(f4::CR);
    let early = driver.refused(f4::CR, cr | 1 << 24);
    assert!(early.contains("the PLL's source is off or not ready (HSERDY"), "{early}");

    let mut driver = Driver::new(F411);
    driver.set(f4::APB1ENR, 1 << 28);
    driver.write(f4::PWR_CR, 0xc000);
    driver.write(f4::PLLCFGR, 4 << 24 | 1 << 22 | 192 << 6 | 25);
    driver.set(f4::CR, 1 << 16);
    assert_eq!(driver.wait_for(f4::CR, 1 << 17, 1 << 17), micros(2_000));
    driver.set(f4::CR, 1 << 24);
    let changed = driver.refused(f4::PWR_CR, 0x8000);
    assert!(changed.contains("VOS is changed while the PLL runs"), "{changed}");
    // Three wait states, APB1 at half.
    driver.write(f4::ACR, 3);
    assert_eq!(driver.read(f4::PWR_CSR) >> 14 & 1, 0);
    let unlocked = driver.refused(f4::CFGR, 4 << 10 | 2);
    assert!(unlocked.contains("system clock 2, which is not ready"), "{unlocked}");
    assert!(driver.wait_for(f4::CR, 1 << 25, 1 << 25) <= micros(300));
    assert_eq!(driver.read(f4::PWR_CSR) >> 14 & 1, 1);
    driver.write(f4::CFGR, 4 << 10 | 2);
    assert_eq!(driver.read(f4::CFGR) >> 2 & 3, 2);
}

#[test]
fn f411_voltage_scale_and_bus_limit_the_clock() {
    let locked = |vos: u32| {
        let mut driver = Driver::new(F411);
        driver.set(f4::APB1ENR, 1 << 28);
        driver.write(f4::PWR_CR, vos << 14);
        driver.write(f4::PLLCFGR, 4 << 24 | 1 << 22 | 192 << 6 | 25);
        driver.set(f4::CR, 1 << 16);
        driver.wait(micros(2_000));
        driver.set(f4::CR, 1 << 24);
        driver.wait(micros(300));
        driver.write(f4::ACR, 3);
        driver
    };
    let low = locked(2).refused(f4::CFGR, 4 << 10 | 2);
    assert!(low.contains("above the 84000000 of voltage scale 2"), "{low}");
    let bus = locked(3).refused(f4::CFGR, 2);
    assert!(bus.contains("APB1 at 96000000 Hz"), "{bus}");
}

#[test]
fn peripheral_answers_after_its_enable_is_read_back() {
    for (model, enable, register) in
        [(G431, g4::APB1ENR1, g4::TIM2_PSC), (F411, f4::APB1ENR, f4::TIM2_PSC)]
    {
        let mut driver = Driver::new(model);
        let off = driver.refused(register, 7);
        assert!(off.contains("its clock is off"), "{off}");
        let enables = driver.read(enable);
        driver.write(enable, enables | 1);
        let early = driver.refused(register, 7);
        assert!(early.contains("right after its clock is enabled"), "{early}");
        driver.write(enable, enables);
        driver.set(enable, 1);
        driver.write(register, 7);
        assert_eq!(driver.read(register), 7);
    }
}

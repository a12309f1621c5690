//! Clocks of the Black Pill: 96 MHz from its 25 MHz crystal.
//!
//! That is the highest rate that also gives the USB its 48 MHz.

use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::{self, interrupt};
use embassy_stm32::rcc::{
    APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk,
    mux::Clk48sel,
};
use embassy_stm32::time::Hertz;
use taxel::wire::message::Reset;

/// Whether the system clock is the one after a reset.
pub fn are_reset() -> bool {
    pac::RCC.cfgr().read().sws() == Sysclk::HSI
}

/// Clock configuration of the chip.
///
/// 25 MHz / 25 · 192 = 192 MHz, / 2 for the core, / 4 for the USB.
pub fn config() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hse = Some(Hse { freq: Hertz(25_000_000), mode: HseMode::Oscillator });
    config.rcc.pll_src = PllSource::HSE;
    config.rcc.pll = Some(Pll {
        prediv: PllPreDiv::DIV25,
        mul: PllMul::MUL192,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV4),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.mux.clk48sel = Clk48sel::PLL1_Q;
    config
}

/// Switches on the flash's caches and prefetch, which embassy-stm32 0.6 leaves off.
///
/// Without them every fetch has three wait states.
pub fn accelerate_flash() {
    pac::FLASH.acr().modify(|acr| {
        acr.set_icen(true);
        acr.set_dcen(true);
        acr.set_prften(true);
    });
}

/// Stops the watchdog, the scan and the time while a debugger halts the core.
pub fn freeze_in_debug() {
    pac::DBGMCU.apb1fzr().modify(|w| {
        w.set_iwdg(true);
        w.set_tim2(true);
    });
    pac::DBGMCU.apb2fzr().modify(|w| w.set_tim1(true));
}

/// Starts the clock on TIM2; the scan sets its interrupt's priority.
pub fn start_time() {
    pac::RCC.apb1enr().modify(|w| w.set_tim2en(true));
    // A peripheral responds two cycles after its clock starts; reading back takes longer.
    let _ = pac::RCC.apb1enr().read();
    // The timer runs on the core's clock.
    taxel_board::time::start(scan_plan::f411::CLOCK_HZ);
    // SAFETY: its handler is below, and no critical section relies on a masked line.
    unsafe { pac::Interrupt::TIM2.enable() };
}

#[interrupt]
fn TIM2() {
    taxel_board::time::on_interrupt();
}

/// Cause of the last reset; clears the record of it.
pub fn reset_cause() -> Reset {
    let csr = pac::RCC.csr().read();
    pac::RCC.csr().modify(|csr| csr.set_rmvf(true));
    match () {
        () if csr.wdgrstf() => Reset::Watchdog,
        () if csr.sftrstf() => Reset::Software,
        () if csr.lpwrrstf() => Reset::Other,
        () if csr.borrstf() => Reset::Power,
        () => Reset::Pin,
    }
}

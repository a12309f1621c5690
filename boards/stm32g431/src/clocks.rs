//! Clocks of the product, without a crystal.
//!
//! The core runs at 170 MHz from HSI16, the USB at 48 MHz from HSI48, which follows the host's
//! start of frame.

use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::pac::{self, interrupt};
use embassy_stm32::rcc::{
    AHBPrescaler, Hsi48Config, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk, mux::Clk48sel,
};
use taxel::wire::message::Reset;

/// Whether the system clock is the one after a reset.
pub fn are_reset() -> bool {
    pac::RCC.cfgr().read().sws() == Sysclk::HSI
}

/// Clock configuration: HSI16 / 4 · 85 / 2, and half of that for the core until [`boost`].
pub fn config() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hsi = true;
    config.rcc.pll = Some(Pll {
        source: PllSource::HSI,
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL85,
        divp: None,
        divq: None,
        divr: Some(PllRDiv::DIV2),
    });
    config.rcc.sys = Sysclk::PLL1_R;
    config.rcc.ahb_pre = AHBPrescaler::DIV2;
    config.rcc.hsi48 = Some(Hsi48Config { sync_from_usb: true });
    config.rcc.mux.clk48sel = Clk48sel::HSI48;
    config
}

/// Raises the core's voltage, as more than 150 MHz need, and then its clock (RM0440 §6.1.5).
///
/// embassy-stm32 0.6 cannot do it: its register description has R1MODE at bit 0 of `PWR_CR5`, and
/// the chip has it at bit 8. Call this right after `init`.
pub fn boost() {
    const R1MODE: u32 = 1 << 8;
    pac::PWR.cr5().modify(|cr5| cr5.0 &= !R1MODE);
    // Caches are on after a reset, the prefetch is not (RM0440 §3.7.1).
    pac::FLASH.acr().modify(|acr| {
        acr.set_latency(Latency::WS4);
        acr.set_prften(true);
    });
    while pac::FLASH.acr().read().latency() != Latency::WS4 {}
    // The voltage needs a microsecond.
    cortex_m::asm::delay(170);
    pac::RCC.cfgr().modify(|cfgr| cfgr.set_hpre(AHBPrescaler::DIV1));
}

/// Watchdog timeout in microseconds, within which a scan must reach the session.
///
/// It covers the erasure of the two pages of a calibration slot (49 ms, DS12589 table 44).
const WATCHDOG_US: u32 = 500_000;

/// Starts the watchdog, which only a reset stops.
///
/// The driver of embassy-stm32 finds a divider at run time, which takes 0.6 KB of flash.
pub fn start_watchdog() {
    // The watchdog counts a quarter of the LSI's 32 kHz.
    const COUNTS: u32 = WATCHDOG_US / 125;
    pac::IWDG.kr().write(|kr| kr.set_key(Key::ENABLE));
    pac::IWDG.pr().write(|pr| pr.set_pr(Pr::DIVIDE_BY4));
    pac::IWDG.rlr().write(|rlr| rlr.set_rl(COUNTS as u16 - 1));
    pac::IWDG.kr().write(|kr| kr.set_key(Key::START));
}

/// Stops the watchdog, the scan and the time while a debugger halts the core.
pub fn freeze_in_debug() {
    pac::DBGMCU.apb1lfzr().modify(|w| {
        w.set_iwdg(true);
        w.set_tim2(true);
    });
    pac::DBGMCU.apb2fzr().modify(|w| w.set_tim1(true));
}

/// Starts the clock on TIM2; the scan sets its interrupt's priority.
pub fn start_time() {
    pac::RCC.apb1enr1().modify(|w| w.set_tim2en(true));
    // A peripheral responds two cycles after its clock starts; reading back takes longer.
    let _ = pac::RCC.apb1enr1().read();
    // The timer runs on the core's clock.
    taxel_board::time::start(scan_plan::g431::CLOCK_HZ);
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
        () if csr.iwdgrstf() => Reset::Watchdog,
        () if csr.sftrstf() => Reset::Software,
        () if csr.lpwrrstf() || csr.oblrstf() => Reset::Other,
        () if csr.borrstf() => Reset::Power,
        () => Reset::Pin,
    }
}

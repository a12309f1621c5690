//! 170 MHz from the internal 16 MHz, 48 MHz for the USB from the internal oscillator that follows the
//! host's start of frame: no crystal.

use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::rcc::vals::Hpre;
use embassy_stm32::pac::{self, interrupt};
use embassy_stm32::rcc::{
    Hsi48Config, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk, mux::Clk48sel,
};
use taxel::wire::message::Reset;

/// The clocks: HSI16 / 4 · 85 / 2.
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
    config.rcc.boost = true;
    config.rcc.hsi48 = Some(Hsi48Config { sync_from_usb: true });
    config.rcc.mux.clk48sel = Clk48sel::HSI48;
    config
}

/// Raises the core's voltage, as more than 150 MHz need (RM0440 §6.1.5). embassy-stm32 0.6 means to do it
/// ([`Config::rcc`](embassy_stm32::Config)'s `boost`), but its register description has R1MODE at bit 0 of
/// `PWR_CR5` and the chip at bit 8; and what is written before `init` does not outlast it. Call right
/// after it.
pub fn boost() {
    const R1MODE: u32 = 1 << 8;
    pac::RCC.cfgr().modify(|cfgr| cfgr.set_hpre(Hpre::DIV2));
    pac::PWR.cr5().modify(|cr5| cr5.0 &= !R1MODE);
    // A microsecond until the voltage is there.
    cortex_m::asm::delay(170);
    pac::RCC.cfgr().modify(|cfgr| cfgr.set_hpre(Hpre::DIV1));
}

/// Lets time run, on TIM2. Its interrupt gets its priority with the scan's.
pub fn start_time() {
    pac::RCC.apb1enr1().modify(|w| w.set_tim2en(true));
    // Two cycles after its clock a peripheral answers; a read back takes longer.
    let _ = pac::RCC.apb1enr1().read();
    // The timer's clock is the core's on either bus of this chip.
    taxel_board::time::start(scan_plan::g431::CLOCK_HZ);
    // SAFETY: its handler is below, and no critical section relies on a masked line.
    unsafe { pac::Interrupt::TIM2.enable() };
}

#[interrupt]
fn TIM2() {
    taxel_board::time::on_interrupt();
}

/// Why the chip was reset; clears the record of it.
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

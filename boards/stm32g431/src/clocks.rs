//! 170 MHz from the internal 16 MHz, 48 MHz for the USB from the internal oscillator that follows the
//! host's start of frame: no crystal.

use embassy_stm32::pac;
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

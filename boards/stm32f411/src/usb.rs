//! Correction of embassy-usb-synopsys-otg 0.3.3 for endpoints with a cleared halt.
//!
//! There the data continue with the next toggle, and the host takes every second first packet for a
//! repetition (`Bus::endpoint_set_stalled`).

use embassy_stm32::pac::USB_OTG_FS;
use embassy_stm32::peripherals;
use embassy_usb::driver::{Direction, EndpointAddress};
use taxel_board::usb::Endpoints;

/// Driver with resumable endpoints.
pub type Driver = taxel_board::usb::Driver<
    embassy_stm32::usb::Driver<'static, peripherals::USB_OTG_FS>,
    Registers,
>;

/// Endpoints by their registers.
pub struct Registers;

impl Endpoints for Registers {
    // The HAL has cleared the stall already.
    fn release(address: EndpointAddress) {
        let index = address.index();
        cortex_m::interrupt::free(|_| match address.direction() {
            Direction::In => {
                USB_OTG_FS.diepctl(index).modify(|ctl| ctl.set_sd0pid_sevnfrm(true));
            }
            Direction::Out => {
                USB_OTG_FS.doepctl(index).modify(|ctl| ctl.set_sd0pid_sevnfrm(true));
            }
        });
    }
}

//! What embassy-usb-synopsys-otg 0.3.3 has wrong: data of an endpoint whose halt is cleared go on with the toggle that
//! was next, and the host takes every second first packet for a repetition (`Bus::endpoint_set_stalled`).

use embassy_stm32::pac::USB_OTG_FS;
use embassy_stm32::peripherals;
use embassy_usb::driver::{Direction, EndpointAddress};
use taxel_board::usb::Endpoints;

/// The driver, mended.
pub type Driver = taxel_board::usb::Driver<
    embassy_stm32::usb::Driver<'static, peripherals::USB_OTG_FS>,
    Registers,
>;

/// The endpoints, by their registers.
pub struct Registers;

impl Endpoints for Registers {
    // The HAL has let it go on.
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

//! Correction of embassy-stm32 0.6.0's USB driver for endpoints with a cleared halt.
//!
//! There a halted endpoint never resumes. Clearing the halt of one that was not halted, which a
//! host may do, keeps the driver in a loop without end (`Bus::endpoint_set_stalled`).

use embassy_stm32::pac::USB;
use embassy_stm32::pac::usb::regs::Epr;
use embassy_stm32::pac::usb::vals::Stat;
use embassy_stm32::peripherals;
use embassy_usb::driver::{Direction, EndpointAddress};
use taxel_board::usb::Endpoints;

/// Driver with resumable endpoints.
pub type Driver =
    taxel_board::usb::Driver<embassy_stm32::usb::Driver<'static, peripherals::USB>, Registers>;

/// Endpoints by their registers.
pub struct Registers;

impl Endpoints for Registers {
    fn release(address: EndpointAddress) {
        let register = USB.epr(address.index());
        let now = register.read();
        let mut change = Epr(0);
        // Writing 1 keeps these bits and toggles the others (RM0440 §45.6.2).
        change.set_ctr_rx(true);
        change.set_ctr_tx(true);
        change.set_ep_type(now.ep_type());
        change.set_ep_kind(now.ep_kind());
        change.set_ea(now.ea());
        let to = |from: Stat, to: Stat| Stat::from_bits(from.to_bits() ^ to.to_bits());
        match address.direction() {
            Direction::In => {
                change.set_dtog_tx(now.dtog_tx());
                if now.stat_tx() == Stat::STALL {
                    change.set_stat_tx(to(Stat::STALL, Stat::NAK));
                }
            }
            Direction::Out => {
                change.set_dtog_rx(now.dtog_rx());
                if now.stat_rx() == Stat::STALL {
                    change.set_stat_rx(to(Stat::STALL, Stat::VALID));
                }
            }
        }
        register.write_value(change);
    }
}

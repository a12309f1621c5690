//! The USB driver, with what embassy-stm32 0.6.0 has wrong mended: there a halted endpoint is never let go
//! on, and one that was not halted, of which a host may ask the same, keeps the driver in a loop for ever
//! (`Bus::endpoint_set_stalled`).

use embassy_stm32::pac::USB;
use embassy_stm32::pac::usb::regs::Epr;
use embassy_stm32::pac::usb::vals::Stat;
use embassy_stm32::peripherals;
use embassy_stm32::usb::Driver as Theirs;
use embassy_usb::driver::{
    Bus as BusOf, Direction, Driver as DriverOf, EndpointAddress, EndpointAllocError, EndpointType,
    Event, Unsupported,
};

type Inner = Theirs<'static, peripherals::USB>;
type InnerBus = <Inner as DriverOf<'static>>::Bus;

/// The driver.
pub struct Driver(pub Inner);

/// Its bus.
pub struct Bus(InnerBus);

impl DriverOf<'static> for Driver {
    type EndpointOut = <Inner as DriverOf<'static>>::EndpointOut;
    type EndpointIn = <Inner as DriverOf<'static>>::EndpointIn;
    type ControlPipe = <Inner as DriverOf<'static>>::ControlPipe;
    type Bus = Bus;

    fn alloc_endpoint_out(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointOut, EndpointAllocError> {
        self.0.alloc_endpoint_out(kind, address, max_packet_size, interval_ms)
    }

    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointIn, EndpointAllocError> {
        self.0.alloc_endpoint_in(kind, address, max_packet_size, interval_ms)
    }

    fn start(self, control_max_packet_size: u16) -> (Bus, Self::ControlPipe) {
        let (bus, pipe) = self.0.start(control_max_packet_size);
        (Bus(bus), pipe)
    }
}

impl BusOf for Bus {
    async fn enable(&mut self) {
        self.0.enable().await;
    }

    async fn disable(&mut self) {
        self.0.disable().await;
    }

    async fn poll(&mut self) -> Event {
        self.0.poll().await
    }

    fn endpoint_set_enabled(&mut self, address: EndpointAddress, enabled: bool) {
        self.0.endpoint_set_enabled(address, enabled);
    }

    fn endpoint_set_stalled(&mut self, address: EndpointAddress, stalled: bool) {
        // Theirs ends only on an endpoint that is stalled, or shall be; then it wakes who waits for it.
        if stalled || self.0.endpoint_is_stalled(address) {
            self.0.endpoint_set_stalled(address, stalled);
        }
        if !stalled {
            release(address);
        }
    }

    fn endpoint_is_stalled(&mut self, address: EndpointAddress) -> bool {
        self.0.endpoint_is_stalled(address)
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        self.0.remote_wakeup().await
    }
}

/// Lets a stalled endpoint go on; stalled or not, its data begin with DATA0 (USB 2.0, 9.4.5).
fn release(address: EndpointAddress) {
    let register = USB.epr(address.index());
    let now = register.read();
    let mut change = Epr(0);
    // Writing 1 leaves these, and toggles the others (RM0440 §45.6.2).
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

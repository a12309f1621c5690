//! USB driver that resumes halted endpoints.
//!
//! embassy's two drivers for these chips each fail to do that. A host may also clear the halt of an
//! endpoint that was never halted.

use core::marker::PhantomData;

use embassy_usb::driver::{
    Bus as BusOf, Driver as DriverOf, EndpointAddress, EndpointAllocError, EndpointType, Event,
    Unsupported,
};

/// Access to a chip's endpoint registers.
pub trait Endpoints {
    /// Resumes an endpoint if it is stalled.
    ///
    /// The endpoint's data restart with DATA0 in any case (USB 2.0, 9.4.5).
    fn release(address: EndpointAddress);
}

/// Driver of the chip with resumable endpoints.
pub struct Driver<D, E> {
    inner: D,
    endpoints: PhantomData<E>,
}

impl<D, E> Driver<D, E> {
    /// Wraps `inner`; `E` resumes its endpoints.
    pub const fn new(inner: D) -> Self {
        Self { inner, endpoints: PhantomData }
    }
}

/// Bus of the driver.
pub struct Bus<B, E> {
    inner: B,
    endpoints: PhantomData<E>,
}

impl<'d, D: DriverOf<'d>, E: Endpoints + 'd> DriverOf<'d> for Driver<D, E> {
    type EndpointOut = D::EndpointOut;
    type EndpointIn = D::EndpointIn;
    type ControlPipe = D::ControlPipe;
    type Bus = Bus<D::Bus, E>;

    fn alloc_endpoint_out(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointOut, EndpointAllocError> {
        self.inner.alloc_endpoint_out(kind, address, max_packet_size, interval_ms)
    }

    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointIn, EndpointAllocError> {
        self.inner.alloc_endpoint_in(kind, address, max_packet_size, interval_ms)
    }

    fn start(self, control_max_packet_size: u16) -> (Self::Bus, Self::ControlPipe) {
        let (bus, pipe) = self.inner.start(control_max_packet_size);
        (Bus { inner: bus, endpoints: PhantomData }, pipe)
    }
}

impl<B: BusOf, E: Endpoints> BusOf for Bus<B, E> {
    async fn enable(&mut self) {
        self.inner.enable().await;
    }

    async fn disable(&mut self) {
        self.inner.disable().await;
    }

    async fn poll(&mut self) -> Event {
        self.inner.poll().await
    }

    fn endpoint_set_enabled(&mut self, address: EndpointAddress, enabled: bool) {
        self.inner.endpoint_set_enabled(address, enabled);
    }

    fn endpoint_set_stalled(&mut self, address: EndpointAddress, stalled: bool) {
        // The G4's driver loops without end unless the endpoint is or becomes stalled. Both drivers
        // wake the waiting task.
        if stalled || self.inner.endpoint_is_stalled(address) {
            self.inner.endpoint_set_stalled(address, stalled);
        }
        if !stalled {
            E::release(address);
        }
    }

    fn endpoint_is_stalled(&mut self, address: EndpointAddress) -> bool {
        self.inner.endpoint_is_stalled(address)
    }

    async fn remote_wakeup(&mut self) -> Result<(), Unsupported> {
        self.inner.remote_wakeup().await
    }
}

//! USB device as the bus sees it: transactions come in, handshakes go out.

use super::Outcome;

/// Answer of a device to a transaction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Data accepted.
    Ack,
    /// Data with DATA1 (true) or DATA0.
    Data(bool, Vec<u8>),
    /// Not ready.
    Nak,
    /// Endpoint halted, or request refused.
    Stall,
    /// No answer: the device is not addressed or lacks the endpoint.
    Silence,
}

/// USB device.
pub trait Device {
    /// Whether the device shows itself to the host.
    fn is_attached(&self) -> bool;
    /// Begins a reset of the bus.
    fn bus_reset(&mut self);
    /// Ends a reset of the bus.
    fn bus_reset_over(&mut self) {}
    /// Records that the bus has been idle for 3 ms, or is active again.
    fn suspend(&mut self, suspended: bool);
    /// Whether an IN to this endpoint would not meet a NAK.
    fn ready_to_send(&self, address: u8, number: u8) -> bool;
    /// Whether an OUT to this endpoint would not meet a NAK.
    fn ready_to_receive(&self, address: u8, number: u8) -> bool;
    /// Receives a SETUP packet.
    fn setup(&mut self, address: u8, data: [u8; 8]) -> Outcome<Answer>;
    /// Receives an OUT packet with DATA1 (true) or DATA0.
    fn out(&mut self, address: u8, number: u8, data1: bool, data: &[u8]) -> Outcome<Answer>;
    /// Answers an IN packet, which the host acknowledges.
    fn take(&mut self, address: u8, number: u8) -> Outcome<Answer>;
}

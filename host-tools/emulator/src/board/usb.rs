//! A USB device as the bus sees it: transactions come in, handshakes go out.

use super::Outcome;

/// What a device answers to a transaction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Taken.
    Ack,
    /// Data with DATA1, or DATA0.
    Data(bool, Vec<u8>),
    /// Not now.
    Nak,
    /// Not at all.
    Stall,
    /// Nothing: it is not addressed, or has no such endpoint.
    Silence,
}

/// A device.
pub trait Device {
    /// It shows itself to the host.
    fn is_attached(&self) -> bool;
    /// The host resets the bus.
    fn bus_reset(&mut self);
    /// It has been reset for long enough.
    fn bus_reset_over(&mut self) {}
    /// The bus has been idle for 3 ms, or is so no longer.
    fn suspend(&mut self, suspended: bool);
    /// An IN of this endpoint would not meet a NAK.
    fn ready_to_send(&self, address: u8, number: u8) -> bool;
    /// An OUT of this endpoint would not.
    fn ready_to_receive(&self, address: u8, number: u8) -> bool;
    /// SETUP.
    fn setup(&mut self, address: u8, data: [u8; 8]) -> Outcome<Answer>;
    /// OUT with DATA1 or DATA0.
    fn out(&mut self, address: u8, number: u8, data1: bool, data: &[u8]) -> Outcome<Answer>;
    /// IN, acknowledged by the host.
    fn take(&mut self, address: u8, number: u8) -> Outcome<Answer>;
}

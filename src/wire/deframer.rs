//! Splits a byte stream into packets; the stream may start, stop or break anywhere.

use serde::de::DeserializeOwned;

use super::{MAX_PACKET, WireError, unpack};

/// Collects bytes up to the zero that ends a packet. Starting in mid-packet loses that packet.
#[derive(Clone, Debug)]
pub struct Deframer<const N: usize = MAX_PACKET> {
    buffer: [u8; N],
    length: usize,
    overlong: bool,
}

impl<const N: usize> Default for Deframer<N> {
    fn default() -> Self {
        Self { buffer: [0; N], length: 0, overlong: false }
    }
}

impl<const N: usize> Deframer<N> {
    /// Adds one byte. Returns `Some` if it ends a packet, good or bad; zeros between packets are
    /// ignored.
    pub fn push<M: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<M, WireError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.length) {
                // The last place is reserved for the final zero.
                Some(slot) if self.length + 1 < N => {
                    *slot = byte;
                    self.length += 1;
                }
                _ => self.overlong = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if core::mem::take(&mut self.overlong) {
            return Some(Err(WireError::TooLong));
        }
        match self.buffer.get_mut(..length) {
            None | Some([]) => None,
            Some(packet) => Some(unpack(packet)),
        }
    }
}

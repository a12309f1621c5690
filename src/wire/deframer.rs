//! Finds packets in a stream of bytes that may start, stop or break anywhere.

use serde::de::DeserializeOwned;

use super::{MAX_PACKET, WireError, unpack};

/// Collects bytes up to the zero that ends a packet. Starting in the middle of one costs that one.
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
    /// One more byte. `Some` where it ends a packet, good or bad; zeros between packets are nothing.
    pub fn push<M: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<M, WireError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.length) {
                // The last place is the final zero's.
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

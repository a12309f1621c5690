//! The link's bytes: `COBS(postcard(message) ‖ CRC-32 LE) ‖ 0x00` in both directions.
//!
//! [`message`] says what may be said, this module how it is packed, [`deframer`] how it is found in a
//! stream of bytes. `docs/protocol.md` is the specification for other languages, `tests/wire_golden.rs`
//! pins it byte by byte.

pub mod deframer;
pub mod message;

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Longest packet with its COBS overhead and final zero. The longest message is a frame with every
/// field (asserted in the tests).
pub const MAX_PACKET: usize = 448;

/// CRC-32/ISO-HDLC: the CRC that zip, Ethernet and most standard libraries call plain `crc32`.
pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Why a packet could not be packed or read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum WireError {
    /// Longer than [`MAX_PACKET`], or than the buffer given.
    TooLong,
    /// The COBS coding is broken: bytes were lost or added.
    Coding,
    /// The CRC does not match.
    Crc,
    /// The CRC is right, but the message is not one of this protocol version.
    Message,
}

/// Packs `message` into `buffer`, final zero included.
///
/// # Errors
/// [`WireError::TooLong`] when it does not fit.
pub fn pack<'b, M: Serialize>(message: &M, buffer: &'b mut [u8]) -> Result<&'b [u8], WireError> {
    use postcard::ser_flavors::{Cobs, Slice, crc::CrcModifier};
    let cobs = Cobs::try_new(Slice::new(buffer)).map_err(|_| WireError::TooLong)?;
    postcard::serialize_with_flavor(message, CrcModifier::new(cobs, CRC.digest()))
        .map(|packet| &*packet)
        .map_err(|_| WireError::TooLong)
}

/// Reads the packet in `bytes` (without the final zero), decoding in place.
///
/// # Errors
/// What is wrong with it.
pub fn unpack<M: DeserializeOwned>(bytes: &mut [u8]) -> Result<M, WireError> {
    let length = cobs::decode_in_place(bytes).map_err(|_| WireError::Coding)?;
    let packet = bytes.get(..length).ok_or(WireError::Coding)?;
    let (body, crc) = packet.split_last_chunk::<4>().ok_or(WireError::Coding)?;
    if crc32(body) != u32::from_le_bytes(*crc) {
        return Err(WireError::Crc);
    }
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(WireError::Message),
    }
}

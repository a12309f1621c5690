//! Wire format of the link: `COBS(postcard(message) ‖ CRC-32 LE) ‖ 0x00` in both directions.
//!
//! [`message`] defines the messages, this module packs and unpacks them, and [`deframer`] finds
//! packets in a stream of bytes. `docs/protocol.md` is the specification for other languages;
//! `tests/core/wire_golden.rs` pins it byte by byte.

mod cobs;
pub mod deframer;
mod frame;
pub mod message;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::crc32::crc32;
use crate::frame::FrameRef;

/// Longest packet in bytes, including COBS overhead and final zero. The longest message is a frame
/// with every field (asserted in the tests).
pub const MAX_PACKET: usize = 448;

/// Errors of packing and unpacking a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum WireError {
    /// The packet is longer than [`MAX_PACKET`] or than the given buffer.
    TooLong,
    /// The COBS coding is broken: bytes were lost or added.
    Coding,
    /// The CRC does not match.
    Crc,
    /// The CRC is right, but the message is not one of this protocol version.
    Message,
}

/// Packs `message` into `buffer` and returns the packet, final zero included.
///
/// # Errors
/// [`WireError::TooLong`] if the packet does not fit.
pub fn pack<'b, M: Serialize>(message: &M, buffer: &'b mut [u8]) -> Result<&'b [u8], WireError> {
    let put = |body: &mut [u8]| postcard::to_slice(message, body).ok().map(|message| message.len());
    finish(buffer, put, crc32)
}

/// Packs a frame as [`message::Message::Frame`] without copying it.
///
/// # Errors
/// [`WireError::TooLong`] if the packet does not fit.
pub fn pack_frame<'b, 'f>(
    frame: impl Into<FrameRef<'f>>,
    buffer: &'b mut [u8],
) -> Result<&'b [u8], WireError> {
    pack_frame_with(frame, buffer, crc32)
}

/// Packs a frame as [`pack_frame`] does, with the CRC of `crc`.
///
/// # Errors
/// [`WireError::TooLong`] if the packet does not fit.
#[inline(always)]
pub fn pack_frame_with<'b, 'f>(
    frame: impl Into<FrameRef<'f>>,
    buffer: &'b mut [u8],
    crc: impl Fn(&[u8]) -> u32,
) -> Result<&'b [u8], WireError> {
    let frame = frame.into();
    finish(buffer, |body| frame::serialize(&frame, body), crc)
}

/// Returns the packet of a message; `put` serializes the message and returns its length.
#[inline(always)]
fn finish(
    buffer: &mut [u8],
    put: impl Fn(&mut [u8]) -> Option<usize>,
    crc: impl Fn(&[u8]) -> u32,
) -> Result<&[u8], WireError> {
    let end = serialize_with_crc(buffer, &put, crc).ok_or(WireError::TooLong)?;
    let length = match cobs::cobs_encode_in_place(buffer, end) {
        Some(length) => length,
        None => encode_long_runs(buffer, &put).ok_or(WireError::TooLong)?,
    };
    buffer.get(..length).ok_or(WireError::TooLong)
}

/// Writes a message and its CRC from the buffer's second byte on and returns their end.
#[inline(always)]
fn serialize_with_crc(
    buffer: &mut [u8],
    put: impl Fn(&mut [u8]) -> Option<usize>,
    crc: impl Fn(&[u8]) -> u32,
) -> Option<usize> {
    let (_, body) = buffer.split_first_mut()?;
    let length = put(body)?;
    let (message, rest) = body.split_at_mut_checked(length)?;
    *rest.first_chunk_mut()? = crc(message).to_le_bytes();
    Some(1 + length + size_of::<u32>())
}

/// Encodes packets with a run of over 253 bytes without a zero. Such runs are rare, because nearly
/// every value follows a zero byte that marks its presence.
#[cold]
fn encode_long_runs(buffer: &mut [u8], put: impl Fn(&mut [u8]) -> Option<usize>) -> Option<usize> {
    let mut plain = [0; MAX_PACKET];
    let end = serialize_with_crc(&mut plain, put, crc32)?;
    let packet = plain.get(1..end)?;
    if buffer.len() <= ::cobs::max_encoding_length(packet.len()) {
        return None;
    }
    let length = ::cobs::encode(packet, buffer);
    *buffer.get_mut(length)? = 0;
    Some(length + 1)
}

/// Decodes and reads the packet in `bytes` (without the final zero) in place.
///
/// # Errors
/// [`WireError::Coding`], [`WireError::Crc`] or [`WireError::Message`].
pub fn unpack<M: DeserializeOwned>(bytes: &mut [u8]) -> Result<M, WireError> {
    let length = ::cobs::decode_in_place(bytes).map_err(|_| WireError::Coding)?;
    let end = length.checked_sub(4).ok_or(WireError::Coding)?;
    let body = bytes.get(..end).ok_or(WireError::Coding)?;
    let crc = bytes.get(end..length).and_then(<[u8]>::first_chunk).ok_or(WireError::Coding)?;
    if crc32(body) != u32::from_le_bytes(*crc) {
        return Err(WireError::Crc);
    }
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(WireError::Message),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heapless::Vec;

    #[test]
    fn message_without_zero_round_trips() {
        let message: Vec<u8, 420> = core::iter::repeat_n(7, 420).collect();
        let mut buffer = [0; MAX_PACKET];
        let length = pack(&message, &mut buffer).unwrap().len();
        let (end, packet) = buffer[..length].split_last_mut().unwrap();
        assert_eq!((*end, packet.contains(&0)), (0, false));
        assert_eq!(unpack(packet), Ok(message));
    }

    #[test]
    fn message_that_does_not_fit_is_refused() {
        let message: Vec<u8, 500> = core::iter::repeat_n(7, 500).collect();
        for length in [0, 1, 100, MAX_PACKET] {
            assert_eq!(pack(&message, &mut [0; MAX_PACKET][..length]), Err(WireError::TooLong));
        }
    }
}

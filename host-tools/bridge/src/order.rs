//! What comes through the pipe: orders, each as its length in four bytes, little-endian, and so many bytes of
//! postcard.

use std::io::{self, ErrorKind, Read};

use serde::{Deserialize, Serialize};

/// One order.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub enum Order<'a> {
    /// Something lives until the pipe closes: a liveliness token with this key.
    Token(&'a str),
    /// A publisher on this key. They are numbered from nought, in the order in which they come.
    Publisher(&'a str),
    /// A sample.
    Put {
        /// Whose.
        publisher: u32,
        /// What a subscriber gets beside it.
        attachment: &'a [u8],
        /// What it gets.
        payload: &'a [u8],
    },
    /// A channel of messages. They are numbered from nought, in the order in which they come; one with the
    /// topic of another takes its place.
    Channel {
        /// What it is called.
        topic: &'a str,
        /// The full name of its type.
        schema: &'a str,
        /// Its type, as protobuf describes it.
        descriptor: &'a [u8],
    },
    /// A message.
    Message {
        /// Where.
        channel: u32,
        /// When, in nanoseconds since 1970.
        nanos: u64,
        /// What.
        payload: &'a [u8],
    },
}

/// No order is nearly as long.
const LONGEST: usize = 1 << 20;

#[allow(dead_code, reason = "one side writes, the other reads")]
impl Order<'_> {
    /// Appends it as it goes through the pipe.
    ///
    /// # Errors
    /// It is longer than any order may be.
    pub fn append(&self, bytes: &mut Vec<u8>) -> io::Result<()> {
        let order = postcard::to_allocvec(self).map_err(io::Error::other)?;
        if order.len() > LONGEST {
            return Err(io::Error::new(ErrorKind::InvalidInput, "too long an order"));
        }
        bytes.extend_from_slice(&(order.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&order);
        Ok(())
    }
}

/// Takes the next order off the pipe, into `buffer`; `None` where the pipe has closed.
///
/// # Errors
/// The pipe broke, or what came is no order.
#[allow(dead_code, reason = "one side writes, the other reads")]
pub fn next<'b>(pipe: &mut impl Read, buffer: &'b mut Vec<u8>) -> io::Result<Option<Order<'b>>> {
    let mut length = [0; 4];
    match pipe.read_exact(&mut length) {
        Ok(()) => {}
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        Err(error) => return Err(error),
    }
    let length = u32::from_le_bytes(length) as usize;
    if length > LONGEST {
        return Err(io::Error::new(ErrorKind::InvalidData, "too long an order"));
    }
    buffer.resize(length, 0);
    pipe.read_exact(buffer)?;
    postcard::from_bytes(buffer).map(Some).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_come_out_as_they_went_in_and_the_end_is_no_error() {
        let orders = [
            Order::Token("@ros2_lv/0/1/0/0/NN/%/%/finger"),
            Order::Publisher("0/finger/wrench"),
            Order::Put { publisher: 0, attachment: &[1, 2], payload: &[0; 300] },
            Order::Channel { topic: "/taxel/finger", schema: "taxel.Frame", descriptor: &[3] },
            Order::Message { channel: 0, nanos: u64::MAX, payload: &[4, 5] },
        ];
        let mut bytes = Vec::new();
        orders.iter().for_each(|order| order.append(&mut bytes).unwrap());
        let (mut pipe, mut buffer) = (bytes.as_slice(), Vec::new());
        for order in &orders {
            assert_eq!(next(&mut pipe, &mut buffer).unwrap().as_ref(), Some(order));
        }
        assert_eq!(next(&mut pipe, &mut buffer).unwrap(), None);
    }

    #[test]
    fn what_is_no_order_is_an_error_and_takes_no_memory() {
        let mut buffer = Vec::new();
        for bytes in [&[0xff; 8][..], &[1, 0, 0, 0, 9], &[9, 0, 0, 0, 0]] {
            assert!(next(&mut &*bytes, &mut buffer).is_err(), "{bytes:?}");
        }
        assert!(buffer.len() < 100);
    }
}

//! Packets and requests as `docs/protocol.md` gives them, written slowly and without the core.

/// Longest packet in bytes, final zero included.
pub const LONGEST: usize = 448;
/// Most bytes of a calibration record in a message.
pub const CHUNK: usize = 128;

/// CRC-32/ISO-HDLC, bit by bit.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut register = u32::MAX;
    for byte in bytes {
        register ^= u32::from(*byte);
        for _ in 0..8 {
            let odd = register & 1 == 1;
            register >>= 1;
            if odd {
                register ^= 0xedb8_8320;
            }
        }
    }
    !register
}

/// Packet of a message: CRC, COBS and the final zero.
pub fn packet(message: &[u8]) -> Vec<u8> {
    let mut plain = message.to_vec();
    plain.extend(crc32(message).to_le_bytes());
    let mut coded = vec![];
    // Each group ends at a zero, at the end, or after 254 bytes.
    let mut group = vec![];
    for byte in plain.into_iter().chain([0]) {
        if byte != 0 {
            group.push(byte);
        }
        if byte == 0 || group.len() == 254 {
            coded.push(group.len() as u8 + 1);
            coded.append(&mut group);
        }
    }
    coded.push(0);
    coded
}

/// Message in a packet without its final zero; `None` if coding or CRC is wrong.
pub fn message(packet: &[u8]) -> Option<Vec<u8>> {
    let mut plain = vec![];
    let mut rest = packet;
    while let Some((code, tail)) = rest.split_first() {
        let (group, tail) = tail.split_at_checked(usize::from(*code).checked_sub(1)?)?;
        plain.extend_from_slice(group);
        if *code != 255 && !tail.is_empty() {
            plain.push(0);
        }
        rest = tail;
    }
    let (message, crc) = plain.split_last_chunk()?;
    let whole = crc32(message) == u32::from_le_bytes(*crc);
    let length = message.len();
    plain.truncate(length);
    whole.then_some(plain)
}

/// Appends a number: seven bits a byte, least significant first.
pub fn put(bytes: &mut Vec<u8>, mut number: u64) {
    while number > 127 {
        bytes.push(number as u8 | 128);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// Bytes still to be read.
pub struct Reader<'b>(pub &'b [u8]);

impl<'b> Reader<'b> {
    pub fn bytes(&mut self, count: usize) -> Option<&'b [u8]> {
        let (bytes, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(bytes)
    }

    pub fn byte(&mut self) -> Option<u8> {
        Some(self.bytes(1)?[0])
    }

    /// Reads a flag, which is 0 or 1.
    pub fn flag(&mut self) -> Option<bool> {
        self.byte().filter(|byte| *byte < 2).map(|byte| byte == 1)
    }

    /// Reads a number of so many bits. Leading zeros are allowed as far as the longest number goes.
    pub fn number(&mut self, bits: usize) -> Option<u64> {
        let mut number = 0_u128;
        for i in 0..bits.div_ceil(7) {
            let byte = self.byte()?;
            number |= u128::from(byte & 127) << (7 * i);
            if byte < 128 {
                return u64::try_from(number).ok().filter(|_| number >> bits == 0);
            }
        }
        None
    }
}

/// A request that the finger must answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    pub tag: u8,
    /// Number of the command.
    pub command: u8,
    /// Fields of the command in their order; a missing row is 256.
    pub fields: [u64; 3],
    /// Bytes of a chunk.
    pub data: Vec<u8>,
}

impl Request {
    /// Reads a request; `None` if the message is not one.
    pub fn read(message: &[u8]) -> Option<Self> {
        let mut rest = Reader(message);
        let tag = rest.byte()?;
        let command = u8::try_from(rest.number(32)?).ok()?;
        let (mut fields, mut data) = ([0; 3], vec![]);
        match command {
            0 | 1 | 7 | 8 | 11 | 13 | 14 | 15 | 17 => {}
            2 => fields[0] = u64::from(rest.flag()?),
            3 | 4 | 6 | 9 | 12 | 16 | 19 => fields[0] = rest.number(16)?,
            5 => fields[0] = rest.number(32).filter(|method| *method < 3)?,
            10 => {
                fields[0] = rest.number(16)?;
                let length = usize::try_from(rest.number(64)?).ok()?;
                data = rest.bytes(length).filter(|data| data.len() <= CHUNK)?.to_vec();
            }
            18 => fields = [rest.number(16)?, rest.number(16)?, rest.number(32)?],
            20 => fields[0] = if rest.flag()? { u64::from(rest.byte()?) } else { 256 },
            _ => return None,
        }
        rest.0.is_empty().then_some(Self { tag, command, fields, data })
    }

    /// Message of the request.
    pub fn write(&self) -> Vec<u8> {
        let mut bytes = vec![self.tag, self.command];
        let [first, second, third] = self.fields;
        match self.command {
            2 | 5 => bytes.push(first as u8),
            3 | 4 | 6 | 9 | 12 | 16 | 19 => put(&mut bytes, first),
            10 => {
                put(&mut bytes, first);
                put(&mut bytes, self.data.len() as u64);
                bytes.extend_from_slice(&self.data);
            }
            18 => [first, second, third].into_iter().for_each(|field| put(&mut bytes, field)),
            20 if first > 255 => bytes.push(0),
            20 => bytes.extend([1, first as u8]),
            _ => {}
        }
        bytes
    }
}

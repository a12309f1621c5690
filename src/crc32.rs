//! CRC-32/ISO-HDLC, a byte at a time, or half a byte with the feature `compact`.
//!
//! Own code because it needs one table, no initialised digest, and no check of an index. A chip's
//! CRC unit may take the frames' words ([`crate::session::Board::crc32`]); it then needs no large
//! table.

/// Bits that the table takes at once.
const BITS: u32 = if cfg!(feature = "compact") { 4 } else { 8 };
const MASK: u32 = (1 << BITS) - 1;

/// Effect of the lowest bits on the register.
#[expect(clippy::indexing_slicing, reason = "evaluated at compile time")]
static TABLE: [u32; 1 << BITS] = {
    /// CRC polynomial, bits reflected.
    const POLYNOMIAL: u32 = 0xedb8_8320;
    let mut table = [0; 1 << BITS];
    let mut low = 0;
    while low <= MASK {
        let mut register = low;
        let mut bit = 0;
        while bit < BITS {
            register = register >> 1 ^ if register & 1 == 1 { POLYNOMIAL } else { 0 };
            bit += 1;
        }
        table[low as usize] = register;
        low += 1;
    }
    table
};

/// Returns the CRC that zip, Ethernet and most standard libraries call plain `crc32`.
#[must_use]
pub fn crc32(bytes: &[u8]) -> u32 {
    finish(!0, bytes)
}

/// Returns the CRC of a message from the register before its last bytes, and these.
#[must_use]
pub fn finish(register: u32, last: &[u8]) -> u32 {
    !last.iter().fold(register, |register, byte| {
        let register = register ^ u32::from(*byte);
        if BITS == 8 { after_bits(register) } else { after_bits(after_bits(register)) }
    })
}

/// Returns the register after its lowest bits.
#[inline(always)]
fn after_bits(register: u32) -> u32 {
    // The mask keeps within the table; the compiler sees that and drops the check.
    register >> BITS ^ TABLE.get((register & MASK) as usize).map_or(0, |step| *step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn check_value_of_the_catalogue_matches() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
        assert_eq!(crc32(b""), 0);
    }

    #[test]
    fn any_length_matches_the_crc_crate() {
        let reference = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        let bytes: Vec<u8> =
            (0..1000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        for end in 0..bytes.len() {
            for start in 0..end.min(5) {
                let part = &bytes[start..end];
                assert_eq!(crc32(part), reference.checksum(part), "{start}..{end}");
            }
        }
    }
}

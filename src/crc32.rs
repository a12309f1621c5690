//! CRC-32/ISO-HDLC, a byte at a time.
//!
//! Own code because it needs one table of 1 KB, no initialised digest, and no check of an index. A
//! chip's CRC unit may take the frames' words ([`crate::session::Board::crc32`]).

/// Effect of a byte on the register.
#[expect(clippy::indexing_slicing, reason = "evaluated at compile time")]
static TABLE: [u32; 256] = {
    /// CRC polynomial, bits reflected.
    const POLYNOMIAL: u32 = 0xedb8_8320;
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut register = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            register = register >> 1 ^ if register & 1 == 1 { POLYNOMIAL } else { 0 };
            bit += 1;
        }
        table[byte] = register;
        byte += 1;
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
        let [low, ..] = register.to_le_bytes();
        // A byte never lies outside the table; the compiler proves it and drops the check.
        register >> 8 ^ TABLE.get(usize::from(low ^ byte)).map_or(0, |step| *step)
    })
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

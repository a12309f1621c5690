//! CRC-32 by the chips' CRC unit, which has the same address on all of them.
//!
//! The unit takes words with the highest bit first, and a frame has the lowest bit of each byte
//! first. The last bytes, less than a word, go through the core's table.

use core::ptr::with_exposed_provenance_mut;

/// Data register, and control register (RM0440 §16.4, RM0383 §4.4).
const DR: usize = 0x4002_3000;
const CR: usize = DR + 0x08;
/// Sets the data register to all ones.
const RESET: u32 = 1;

fn write(register: usize, value: u32) {
    // SAFETY: a word register of the CRC unit, which only the session's task uses.
    unsafe { with_exposed_provenance_mut::<u32>(register).write_volatile(value) }
}

/// Returns the CRC-32 of `bytes`. The unit's clock must run.
pub fn crc32(bytes: &[u8]) -> u32 {
    write(CR, RESET);
    let (words, last) = bytes.as_chunks::<4>();
    for word in words {
        write(DR, u32::from_le_bytes(*word).reverse_bits());
    }
    // SAFETY: as above; reading has no effect.
    let register = unsafe { with_exposed_provenance_mut::<u32>(DR).read_volatile() };
    taxel::crc32::finish(register.reverse_bits(), last)
}

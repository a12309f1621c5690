//! Words that the DMA writes to a GPIO port's set/reset register, one a step.

use crate::STEPS;

/// `BSRR` words of the steps: bits 0–15 set pins, bits 16–31 clear them (RM0440 §9.4.7).
///
/// `rows` are the pins that switch the LED rows on when high. `select` are the multiplexer's
/// address lines, least significant first. Row r and sensor r are read in the same step. In the
/// dark step every row is off and the multiplexer stays at sensor 0. Each word names every pin, so
/// that a step does not depend on the one before it.
#[must_use]
pub const fn words(rows: [u8; 4], select: [u8; 2]) -> [u32; STEPS as usize] {
    holding(rows, select, None)
}

/// As [`words`], but row `held`, if any, is on in every step and the others in none.
///
/// Its LEDs are on all the time. The multiplexer turns as ever.
#[must_use]
pub const fn holding(rows: [u8; 4], select: [u8; 2], held: Option<u8>) -> [u32; STEPS as usize] {
    let mut words = [0; STEPS as usize];
    let mut step = 0;
    while step < words.len() {
        let sensor = if step == 0 { 0 } else { step - 1 };
        let mut word = 0;
        let mut row = 0;
        while row < rows.len() {
            let on = match held {
                Some(held) => held as usize == row,
                None => step == row + 1,
            };
            word |= bit(rows[row], on);
            row += 1;
        }
        let mut line = 0;
        while line < select.len() {
            word |= bit(select[line], sensor >> line & 1 == 1);
            line += 1;
        }
        words[step] = word;
        step += 1;
    }
    words
}

/// `BSRR` word of a paused scan: every row off, the multiplexer at sensor 0.
#[must_use]
pub const fn dark(rows: [u8; 4], select: [u8; 2]) -> u32 {
    words(rows, select)[0]
}

const fn bit(pin: u8, high: bool) -> u32 {
    1 << (pin as u32 + if high { 0 } else { 16 })
}

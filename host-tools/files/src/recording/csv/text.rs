//! Text of a cell: that of `Display`, several times as fast.
//!
//! A number has the fewest digits that read back as the same bits. Where two texts do, as near the
//! number as each other, the even one is written.

use std::io::Write;

use crate::frames::Cell;

/// Appends a cell's text; a missing value has none.
pub(super) fn push(cell: &Cell, text: &mut Vec<u8>) {
    match cell {
        Cell::Empty | Cell::Withheld(_) => {}
        Cell::Whole(value) => {
            text.extend_from_slice(itoa::Buffer::new().format(*value).as_bytes());
        }
        Cell::Real(value) => push_real(*value, text),
    }
}

fn push_real(value: f32, text: &mut Vec<u8>) {
    let mut buffer = zmij::Buffer::new();
    let digits = buffer.format(value);
    if value.is_finite() && !digits.contains('e') {
        text.extend_from_slice(digits.strip_suffix(".0").unwrap_or(digits).as_bytes());
    } else {
        // `Display` has no exponents. Writing into a vector cannot fail.
        let _ = write!(text, "{value}");
    }
}

#[cfg(test)]
mod tests {
    use taxel::measured::NoValue;

    use super::*;

    fn text(cell: Cell) -> String {
        let mut text = Vec::new();
        push(&cell, &mut text);
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn text_is_as_short_as_display_and_reads_back() {
        let same = |cell: Cell| assert_eq!(text(cell), cell.to_string(), "{cell:?}");
        for value in [0.0, -0.0, 1.0, -1.5, 0.1, 1e-5, 1e-7, 1e16, 3.4e38, 1e-45, f32::EPSILON] {
            same(Cell::Real(value));
            same(Cell::Real(-value));
        }
        for value in [f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            same(Cell::Real(value));
        }
        // Steps through all exponents and many digits.
        for bits in (0..u32::MAX).step_by(40_009) {
            let value = f32::from_bits(bits);
            let (text, display) = (text(Cell::Real(value)), value.to_string());
            if text != display {
                let off = |text: &str| (text.parse::<f64>().unwrap() - f64::from(value)).abs();
                assert_eq!(text.parse::<f32>().unwrap().to_bits(), bits, "{text}");
                assert_eq!(text.len(), display.len(), "{text} {display}");
                assert!(off(&text) <= off(&display) * (1.0 + 1e-9), "{text} {display}");
            }
        }
        [0, 9, 10, 65_535, u64::MAX].into_iter().for_each(|value| same(Cell::Whole(value)));
        same(Cell::Empty);
        same(Cell::Withheld(NoValue::Absent));
    }
}

//! Numbers with units and escaped text, as the page prints them.

use crate::report::series::{fine, split_unit};

/// A number with the unit of its errors.
pub(super) fn quantity(value: f64, unit: &'static str) -> String {
    format!("{} {}", fixed(value, unit), fine(unit).1).trim_end().to_owned()
}

/// Two decimals in thousandths of the unit; otherwise four significant digits.
pub(super) fn fixed(value: f64, unit: &'static str) -> String {
    let (times, told) = fine(unit);
    if told != unit {
        return rounded(times * value, 2);
    }
    let digits = 3 - value.abs().max(1e-6).log10().floor() as i32;
    rounded(value, usize::try_from(digits).unwrap_or(0))
}

/// Rounds to decimals, without a sign on zero.
fn rounded(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|b| matches!(b, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}

pub(super) fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".into(), |value| rounded(value, digits))
}

/// A quantity with the unit of its errors: `fx / mN`.
pub(super) fn in_unit(name: &str, unit: &'static str) -> String {
    match fine(unit).1 {
        "" => short(name),
        unit => format!("{} / {unit}", short(name)),
    }
}

/// Name of a column without its unit.
pub(super) fn short(name: &str) -> String {
    escaped(split_unit(name).0)
}

/// Text with its first letter in upper case.
pub(super) fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// Text with the signs of markup replaced.
#[must_use]
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_escapes_markup_from_files() {
        assert_eq!(escaped("<b> & \"c\""), "&lt;b&gt; &amp; &quot;c&quot;");
        assert_eq!(short("s0_fx_n"), "s0_fx");
        assert_eq!(short("mass_total"), "mass_total");
    }

    #[test]
    fn quantity_uses_mn_or_significant_digits() {
        assert_eq!(quantity(0.012_345, "N"), "12.35 mN");
        assert_eq!(quantity(0.5, "mm"), "500.00 µm");
        assert_eq!(quantity(-6.781_23, "°"), "-6.781 °");
        assert_eq!(quantity(0.001_234_5, ""), "0.001234");
        assert_eq!(quantity(0.0, ""), "0.000000000");
        assert_eq!(quantity(-0.000_004, "N"), "0.00 mN");
        assert_eq!(quantity(-0.000_006, "N"), "-0.01 mN");
    }
}

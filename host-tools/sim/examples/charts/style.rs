//! What the charts share.

use plotters::style::RGBColor;

/// Okabe and Ito's colours, which the colour-blind tell apart.
pub const COLOURS: [RGBColor; 4] =
    [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];
pub const GREY: RGBColor = RGBColor(110, 110, 110);
pub const FAINT: RGBColor = RGBColor(225, 225, 225);
pub const FONT: &str = "sans-serif";

/// A power of ten as people write it.
pub fn power_of_ten(value: f64) -> String {
    let raised = |c: char| match c.to_digit(10) {
        Some(digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(digit as usize).unwrap_or(c),
        None => '⁻',
    };
    let exponent = (value.log10().round() as i32).to_string();
    format!("10{}", exponent.chars().map(raised).collect::<String>())
}

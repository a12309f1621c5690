//! What the charts share.

use plotters::coord::Shift;
use plotters::prelude::*;

/// What drawing comes to.
pub(crate) type Done = Result<(), Box<dyn std::error::Error>>;

/// A picture as text, so that it is written whole or not at all.
pub(crate) fn svg(
    size: (u32, u32),
    draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, Shift>) -> Done,
) -> anyhow::Result<String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        area.fill(&WHITE)
            .map_err(Into::into)
            .and_then(|()| draw(&area))
            .and_then(|()| Ok(area.present()?))
            .map_err(|error| anyhow::anyhow!("drawing: {error}"))?;
    }
    Ok(text)
}

/// Okabe and Ito's colours, which the colour-blind tell apart.
pub(crate) const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];
pub(crate) const GREY: RGBColor = RGBColor(110, 110, 110);
pub(crate) const FAINT: RGBColor = RGBColor(225, 225, 225);
pub(crate) const FONT: &str = "sans-serif";

/// A power of ten as people write it.
pub(crate) fn power_of_ten(value: f64) -> String {
    let raised = |c: char| match c.to_digit(10) {
        Some(digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(digit as usize).unwrap_or(c),
        None => '⁻',
    };
    let exponent = (value.log10().round() as i32).to_string();
    format!("10{}", exponent.chars().map(raised).collect::<String>())
}

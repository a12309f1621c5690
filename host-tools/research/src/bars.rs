//! Horizontal bar chart: a name above each bar and its figures next to it.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::picture::{COLOURS, Done, FONT, GREY, Picture};

/// A bar with its texts.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Bar {
    pub name: String,
    /// Length of the bar in any unit; `None` draws no bar.
    pub long: Option<f64>,
    /// Figures next to the bar.
    pub figures: String,
    /// True for the project's own bar, which has another colour.
    pub own: bool,
}

const WIDTH: u32 = 900;
/// Height of a bar and its gap in pixels.
const ROW: i32 = 52;

/// Draws the bars under a title.
pub(crate) fn draw(title: &str, bars: &[Bar]) -> anyhow::Result<Picture> {
    let height = u32::try_from(ROW)? * u32::try_from(bars.len())? + 44;
    Picture::draw((WIDTH, height), |area, _| drawn(area, title, bars))
}

fn drawn(area: &DrawingArea<SVGBackend<'_>, Shift>, title: &str, bars: &[Bar]) -> Done {
    let font = |size: i32| (FONT, size).into_font();
    let middle = Pos::new(HPos::Left, VPos::Center);
    area.draw(&Text::new(title.to_owned(), (16, 10), font(16)))?;
    let most = bars.iter().filter_map(|bar| bar.long).fold(f64::MIN_POSITIVE, f64::max);
    for (i, bar) in (0..).zip(bars) {
        let y = 40 + ROW * i;
        area.draw(&Text::new(bar.name.clone(), (16, y + 8), font(14).color(&BLACK).pos(middle)))?;
        let mut from = 16;
        if let Some(long) = bar.long {
            let long = (500.0 * long / most) as i32;
            let colour = if bar.own { COLOURS[0] } else { COLOURS[4] };
            area.draw(&Rectangle::new([(16, y + 18), (16 + long, y + 38)], colour.filled()))?;
            from = 24 + long;
        }
        let style = font(14).color(if bar.long.is_some() { &BLACK } else { &GREY }).pos(middle);
        area.draw(&Text::new(bar.figures.clone(), (from, y + 28), style))?;
    }
    Ok(())
}

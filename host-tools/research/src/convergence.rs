//! Error of superposed point loads against closed forms, over the number of points.

use plotters::coord::Shift;
use plotters::prelude::*;
use taxel_sim::contact::convergence::{Case, OFF_AXIS, ON_AXIS};
use taxel_sim::contact::{HalfSpace, SILICONE_YOUNG_MPA};

use crate::picture::{COLOURS, Done, FAINT, FONT, GREY, Picture, power_of_ten};

const POINTS: [usize; 12] = [2, 3, 4, 6, 8, 12, 16, 20, 24, 32, 48, 64];
/// Lower end of the error axis, near round-off.
const LEAST: f64 = 1e-15;
const MOST: f64 = 10.0;
/// Largest allowed error against a closed form.
const REQUIRED: f64 = 1e-3;

pub(crate) fn draw() -> anyhow::Result<Picture> {
    Picture::draw((900, 430), |area, _| drawn(area))
}

fn drawn(area: &DrawingArea<SVGBackend<'_>, Shift>) -> Done {
    let panels = area.split_evenly((1, 2));
    let places: [(&str, &[[f64; 2]]); 2] = [("on the axis", &ON_AXIS), ("off the axis", &OFF_AXIS)];
    for (panel, (title, places)) in panels.iter().zip(places) {
        let mut chart = ChartBuilder::on(panel)
            .caption(format!("Superposed point loads, {title}"), (FONT, 17))
            .margin(10)
            .margin_right(16)
            .x_label_area_size(42)
            .y_label_area_size(62)
            .build_cartesian_2d((2f64..64f64).log_scale().base(2.0), (LEAST..MOST).log_scale())?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(FAINT)
            .x_labels(6)
            .x_label_formatter(&|n| format!("{n:.0}"))
            .y_label_formatter(&|error| power_of_ten(*error))
            .label_style((FONT, 14))
            .x_desc("points each way")
            .y_desc("relative error, worst of σ_zz and ε_zz")
            .axis_desc_style((FONT, 14))
            .draw()?;
        for (order, label) in [(2, "n⁻²"), (4, "n⁻⁴"), (8, "n⁻⁸")] {
            let slope = |n: f64| (n / 2.0).powi(-order);
            chart.draw_series(LineSeries::new(
                [2.0, 64.0].map(|n| (n, slope(n).max(LEAST))),
                GREY.stroke_width(1),
            ))?;
            let at = (46.0, slope(46.0) * 6.0);
            chart.draw_series([Text::new(label, at, (FONT, 14).into_font().color(&GREY))])?;
        }
        chart.draw_series(DashedLineSeries::new(
            [2.0, 64.0].map(|n| (n, REQUIRED)),
            6,
            4,
            BLACK.stroke_width(1),
        ))?;
        let at = (2.1, REQUIRED / 2.0);
        chart.draw_series([Text::new("required", at, (FONT, 14).into_font())])?;
        let skin = HalfSpace::new(SILICONE_YOUNG_MPA, 0.5);
        for (case, colour) in Case::ALL.into_iter().zip(COLOURS) {
            let worst =
                |n| places.iter().fold(LEAST, |e, place| case.error(&skin, *place, n).max(e));
            let line: Vec<(f64, f64)> =
                POINTS.into_iter().map(|n| (n as f64, worst(n).min(MOST))).collect();
            chart
                .draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?
                .label(format!("{case:?}").to_lowercase())
                .legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2))
                });
            chart.draw_series(line.into_iter().map(|at| Circle::new(at, 3, colour.filled())))?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .background_style(WHITE)
            .border_style(FAINT)
            .label_font((FONT, 14))
            .draw()?;
    }
    Ok(())
}

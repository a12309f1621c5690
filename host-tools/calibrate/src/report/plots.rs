//! Plots as inline SVG.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::coverage::{CELLS, Coverage};
use super::series::{Series, extent, fine, split_unit};

/// Colours; reference and estimate also differ in width, for readers without colour vision.
const REFERENCE: RGBColor = RGBColor(0x9a, 0xa5, 0xb1);
const ESTIMATE: RGBColor = RGBColor(0x0b, 0x6b, 0xcb);
const RISING: RGBColor = RGBColor(0x0b, 0x6b, 0xcb);
const FALLING: RGBColor = RGBColor(0xd9, 0x6c, 0x06);
/// Most points of a line; more are not visible.
const LINE: usize = 1000;
/// Most dots of a scatter plot.
const DOTS: usize = 500;

type Area<'s> = DrawingArea<SVGBackend<'s>, Shift>;
/// Result of drawing; drawing into a string cannot fail, and an error leaves the plot out.
type Drawn = Result<(), Box<dyn std::error::Error>>;

fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> String {
    let mut text = String::new();
    let drawn = {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(&area).and_then(|()| Ok(area.present()?))
    };
    if drawn.is_ok() { text } else { String::new() }
}

/// Range a little wider than the values; 0 to 1 without values.
fn padded(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = extent(values);
    let pad = (0.05 * (high - low)).max(1e-6);
    if low <= high { low - pad..high + pad } else { 0.0..1.0 }
}

fn label(name: &str) -> String {
    match split_unit(name) {
        (quantity, "") => quantity.to_owned(),
        (quantity, unit) => format!("{quantity} / {unit}"),
    }
}

/// Plots reference and estimate over time.
pub(crate) fn over_time(series: &Series) -> String {
    svg((640, 240), |area| {
        area.fill(&WHITE)?;
        let said = || series.estimate.iter().flatten();
        let y = padded(series.reference.iter().chain(said()).copied());
        let x = 0.0..series.time.last().copied().unwrap_or(1.0).max(1e-3);
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(58)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .label_style(("sans-serif", 13))
            .axis_desc_style(("sans-serif", 14))
            .light_line_style(TRANSPARENT)
            .x_labels(8)
            .y_labels(5)
            .x_desc(if series.timed { "time / s" } else { "row" })
            .y_desc(label(&series.kind.name()))
            .draw()?;
        let step = (series.time.len() / LINE).max(1);
        let rows = || (0..series.time.len()).step_by(step);
        let reference = rows().map(|i| (series.time[i], series.reference[i]));
        chart.draw_series(LineSeries::new(reference, REFERENCE.stroke_width(4)))?;
        // The line ends where there is no estimate.
        let estimates: Vec<(f64, Option<f64>)> =
            rows().map(|i| (series.time[i], series.estimate[i])).collect();
        for run in estimates.chunk_by(|a, b| a.1.is_some() == b.1.is_some()) {
            let line = run.iter().filter_map(|(t, e)| Some((*t, (*e)?)));
            chart.draw_series(LineSeries::new(line, ESTIMATE.stroke_width(1)))?;
        }
        Ok(())
    })
}

/// Plots error over reference, with rising and falling reference in different colours.
pub(crate) fn over_reference(series: &Series) -> String {
    svg((380, 240), |area| {
        area.fill(&WHITE)?;
        let (times, unit) = fine(series.kind.unit());
        let y = padded(series.errors().map(|(_, error)| times * error).chain([0.0]));
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(58)
            .build_cartesian_2d(padded(series.reference.iter().copied()), y)?;
        chart
            .configure_mesh()
            .label_style(("sans-serif", 13))
            .axis_desc_style(("sans-serif", 14))
            .light_line_style(TRANSPARENT)
            .x_labels(5)
            .y_labels(5)
            .x_desc(label(&series.kind.name()))
            .y_desc(if unit.is_empty() { "error".into() } else { format!("error / {unit}") })
            .draw()?;
        let step = (series.time.len() / DOTS).max(1);
        let points = (step..series.time.len()).step_by(step).filter_map(|i| {
            let moved = series.reference[i] - series.reference[i - step];
            let error = series.estimate[i]? - series.reference[i];
            Some((moved, (series.reference[i], times * error)))
        });
        let still = 1e-3 * series.span();
        chart.draw_series(points.map(|(moved, at)| {
            let colour = match moved {
                moved if moved > still => RISING,
                moved if moved < -still => FALLING,
                _ => REFERENCE,
            };
            Circle::new(at, 2, colour.filled())
        }))?;
        Ok(())
    })
}

/// Draws a map of the number of rows; empty cells stay white.
pub(crate) fn map(coverage: &Coverage) -> String {
    let [x0, x1] = coverage.x_range;
    let [y0, y1] = coverage.y_range;
    let most = coverage.rows.iter().flatten().copied().max().unwrap_or(0).max(1) as f64;
    svg((330, 300), |area| {
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(x0..x1, y0..y1)?;
        chart
            .configure_mesh()
            .label_style(("sans-serif", 13))
            .axis_desc_style(("sans-serif", 14))
            .disable_mesh()
            .x_labels(6)
            .y_labels(6)
            .x_desc(label(&coverage.x))
            .y_desc(label(&coverage.y))
            .draw()?;
        let side = |low: f64, high: f64, i: usize| low + (high - low) * i as f64 / CELLS as f64;
        let cells = coverage.rows.iter().enumerate().flat_map(|(j, row)| {
            row.iter().enumerate().filter(|(_, n)| **n > 0).map(move |(i, n)| (i, j, *n))
        });
        chart.draw_series(cells.map(|(i, j, n)| {
            // Shade by the logarithm, so that one row is visible next to a thousand.
            let depth = (1.0 + n as f64).ln() / (1.0 + most).ln();
            let corners =
                [(side(x0, x1, i), side(y0, y1, j)), (side(x0, x1, i + 1), side(y0, y1, j + 1))];
            Rectangle::new(corners, ESTIMATE.mix(0.12 + 0.88 * depth).filled())
        }))?;
        Ok(())
    })
}

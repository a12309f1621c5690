//! Failure maps as SVG: error over claimed accuracy of every method, a panel for each sweep.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::counts::{FAILS, Map, Point, TRUSTED};
use crate::picture::{COLOURS, Done, FAINT, FONT, GREY, Note, Picture};

type Area<'p> = DrawingArea<SVGBackend<'p>, Shift>;

/// Size of one panel in pixels.
const SIZE: (u32, u32) = (300, 200);
const ACROSS: usize = 3;
/// Height of a line of the legend in pixels.
const ROW: u32 = 20;
/// Range of the axis of error over claimed accuracy.
const RATIOS: [f64; 2] = [0.05, 200.0];
/// Ratio between neighbouring lanes above the axis.
///
/// Each method has its own lane for the marks of its silent failures.
const LANE: f64 = 1.4;

/// Removes repeated names and keeps the order.
fn once(all: impl Iterator<Item = &'static str>) -> Vec<&'static str> {
    let mut names = Vec::new();
    for name in all {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// Returns the error over claimed accuracy, limited to the axis.
fn ratio(point: &Point) -> Option<f64> {
    point.count.over_stated().map(|ratio| ratio.clamp(RATIOS[0], RATIOS[1]))
}

pub(crate) fn draw(maps: &[&Map]) -> anyhow::Result<Picture> {
    let methods = once(maps.iter().map(|map| map.method));
    let sweeps = once(maps.iter().map(|map| map.sweep));
    let down = sweeps.len().div_ceil(ACROSS);
    let legend_height = ROW * (methods.len().div_ceil(ACROSS) as u32 + 2);
    let size = (SIZE.0 * ACROSS as u32, SIZE.1 * down as u32 + legend_height);
    Picture::draw(size, |area, notes| {
        let (top, rest) = area.split_vertically(legend_height);
        legend(&top, &methods)?;
        for (area, sweep) in rest.split_evenly((down, ACROSS)).iter().zip(&sweeps) {
            let of: Vec<&Map> = maps.iter().copied().filter(|map| map.sweep == *sweep).collect();
            panel(area, sweep, &of, &methods, notes)?;
        }
        Ok(())
    })
}

fn legend(area: &Area<'_>, methods: &[&str]) -> Done {
    for (i, (name, colour)) in methods.iter().zip(COLOURS).enumerate() {
        let [x, y] =
            [20 + SIZE.0 as i32 * (i % ACROSS) as i32, 16 + ROW as i32 * (i / ACROSS) as i32];
        area.draw(&PathElement::new([(x, y), (x + 20, y)], colour.stroke_width(2)))?;
        area.draw(&Text::new((*name).to_owned(), (x + 26, y - 7), (FONT, 14).into_font()))?;
    }
    let y = ROW as i32 * methods.len().div_ceil(ACROSS) as i32 + 18;
    let write = |note: String, x| area.draw(&Text::new(note, (x, y - 7), (FONT, 14).into_font()));
    for (flagged, note, x) in
        [(true, "most values flagged or withheld", 20), (false, "most not", 275)]
    {
        dot(area, (x + 8, y), BLACK, flagged)?;
        write(note.into(), x + 20)?;
    }
    area.draw(&withheld((360, y), BLACK))?;
    write("all withheld".into(), 372)?;
    area.draw(&silent((474, y), BLACK))?;
    write(format!("silent failures above {} %, a lane a method", 100.0 * TRUSTED), 486)?;
    area.draw(&Rectangle::new([(784, y - 6), (804, y + 6)], FAINT.filled()))?;
    write("working range".into(), 810)?;
    Ok(())
}

/// Mark on the axis for a point without any value.
fn withheld<C>(at: C, colour: RGBColor) -> TriangleMarker<C, i32> {
    TriangleMarker::new(at, 5, colour.filled())
}

/// Mark for a point with more than [`TRUSTED`] undetected errors.
fn silent<C>(at: C, colour: RGBColor) -> Cross<C, i32> {
    Cross::new(at, 3, colour.stroke_width(2))
}

fn dot(area: &Area<'_>, at: (i32, i32), colour: RGBColor, flagged: bool) -> Done {
    area.draw(&Circle::new(at, 4, WHITE.filled()))?;
    let style = if flagged { colour.filled() } else { colour.stroke_width(2) };
    area.draw(&Circle::new(at, 4, style))?;
    Ok(())
}

fn panel(
    area: &Area<'_>,
    sweep: &str,
    maps: &[&Map],
    methods: &[&str],
    notes: &mut Vec<Note>,
) -> Done {
    let Some(first) = maps.first() else { return Ok(()) };
    // Values are sorted and evenly spaced, because some sweeps span decades.
    let mut values: Vec<f64> = first.points.iter().map(|point| point.value).collect();
    values.sort_by(f64::total_cmp);
    let at = |value: f64| values.iter().position(|v| *v == value).unwrap_or_default() as f64;
    let last = values.len().saturating_sub(1) as f64;
    let lane = |method: usize| RATIOS[1] * LANE.powf(method as f64 + 0.9);
    let top = lane(methods.len());
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .margin_right(12)
        .x_label_area_size(36)
        .y_label_area_size(46)
        .build_cartesian_2d(-0.5..last + 0.5, (RATIOS[0]..top).log_scale())?;
    let within = |point: &&Point| point.within;
    chart.draw_series(first.points.iter().filter(within).map(|point| {
        let x = at(point.value);
        Rectangle::new([(x - 0.5, RATIOS[0]), (x + 0.5, top)], FAINT.filled())
    }))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(values.len().min(9))
        .x_label_formatter(&|x| {
            let whole = (x - x.round()).abs() < 1e-6 && *x >= 0.0;
            let value = whole.then(|| values.get(x.round() as usize)).flatten();
            value.map_or_else(String::new, |value| short(*value))
        })
        .y_labels(5)
        .y_label_formatter(&|ratio| {
            if *ratio <= RATIOS[1] { format!("{ratio}") } else { String::new() }
        })
        .label_style((FONT, 11))
        .x_desc(sweep)
        .y_desc("error / stated")
        .axis_desc_style((FONT, 13))
        .draw()?;
    chart.draw_series(DashedLineSeries::new(
        [(-0.5, FAILS), (last + 0.5, FAILS)],
        5,
        4,
        GREY.stroke_width(1),
    ))?;
    for map in maps {
        let number = methods.iter().position(|name| *name == map.method).unwrap_or_default();
        let colour = COLOURS.get(number).copied().unwrap_or(BLACK);
        let mut points: Vec<&Point> = map.points.iter().collect();
        points.sort_by(|a, b| a.value.total_cmp(&b.value));
        // The line breaks where no value is given.
        for said in points.chunk_by(|a, b| ratio(a).is_some() == ratio(b).is_some()) {
            let places = said.iter().filter_map(|point| Some((at(point.value), ratio(point)?)));
            chart.draw_series(LineSeries::new(places, colour.stroke_width(2)))?;
        }
        for point in points {
            let height = ratio(point).unwrap_or(RATIOS[0]);
            let at_mark = chart.backend_coord(&(at(point.value), height));
            let text = format!("{}, {sweep} {}: {}", map.method, point.value, figures(point));
            notes.push(Note { at: at_mark, text });
            match ratio(point) {
                Some(ratio) => {
                    let place = (at(point.value), ratio);
                    chart.draw_series([Circle::new(place, 4, WHITE.filled())])?;
                    let style =
                        if point.flagged() { colour.filled() } else { colour.stroke_width(2) };
                    chart.draw_series([Circle::new(place, 4, style)])?;
                }
                None => {
                    chart.draw_series([withheld((at(point.value), RATIOS[0]), colour)])?;
                }
            }
            if point.silent() {
                chart.draw_series([silent((at(point.value), lane(number)), colour)])?;
            }
        }
    }
    Ok(())
}

/// Formats the figures of a point for its note.
fn figures(point: &Point) -> String {
    let count = &point.count;
    let error =
        count.error().map_or_else(|| "no value".into(), |error| format!("error {error:.4}"));
    let [flagged, silent] =
        [count.flagged, count.silent].map(|frames| format!("{:.2} %", 100.0 * count.share(frames)));
    let within = if point.within { "; in the working range" } else { "" };
    format!("{error}, stated {:.4}; flagged {flagged}, silent {silent}{within}", count.stated())
}

/// Formats a number briefly for an axis.
fn short(value: f64) -> String {
    if value.abs() >= 1e4 { format!("{value:.0e}") } else { format!("{value}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_numbers_are_short() {
        assert_eq!([1e8, 1000.0, 0.005, -30.0].map(short), ["1e8", "1000", "0.005", "-30"]);
    }
}

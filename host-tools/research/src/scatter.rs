//! Error over cost as SVG: a panel for each quantity and scene, with the Pareto front.
//!
//! Labels never overlap.

use plotters::coord::Shift;
use plotters::coord::combinators::LogCoord;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::costs::Cost;
use crate::methods::Group;
use crate::picture::{COLOURS, Done, FAINT, FONT, GREY, Note, Picture, thousands};
use crate::results::{Quantity, Row, Title, front};

type Panel<'p> = DrawingArea<SVGBackend<'p>, Shift>;
type Chart<'p> = ChartContext<'p, SVGBackend<'p>, Cartesian2d<LogCoord<f64>, LogCoord<f64>>>;

/// Size of one panel in pixels.
const SIZE: (u32, u32) = (450, 340);
/// Height of the legend in pixels.
const LEGEND: u32 = 76;
/// Height of a label's letters in pixels.
const LETTERS: i32 = 13;

/// Groups with their names in the legend.
const GROUPS: [(Group, &str); 9] = [
    (Group::Model, "the firmware's, of the matrix"),
    (Group::Paper, "of the papers"),
    (Group::Polynomial, "polynomial"),
    (Group::Net, "tanh net"),
    (Group::Quantised, "the same in 16 bits"),
    (Group::Skip, "with a linear path"),
    (Group::QuantisedSkip, "the same in 16 bits"),
    (Group::Sensors, "force sensors"),
    (Group::Finger, "matrix and sensors"),
];

/// Returns the colour of a group.
fn colour(group: Group) -> RGBColor {
    match group {
        Group::Model | Group::Finger => COLOURS[5],
        Group::Paper => COLOURS[1],
        Group::Polynomial => COLOURS[2],
        Group::Net | Group::Quantised => COLOURS[4],
        Group::Skip | Group::QuantisedSkip => COLOURS[0],
        Group::Sensors => COLOURS[3],
    }
}

/// Draws the panels, two in a row.
pub(crate) fn draw(rows: &[Row], panels: &[Title<'_>]) -> anyhow::Result<Picture> {
    let down = panels.len().div_ceil(2);
    let size = (2 * SIZE.0, u32::try_from(down)? * SIZE.1 + LEGEND);
    Picture::draw(size, |area, notes| drawn(area, rows, panels, down, notes))
}

fn drawn(
    area: &Panel<'_>,
    rows: &[Row],
    panels: &[Title<'_>],
    down: usize,
    notes: &mut Vec<Note>,
) -> Done {
    let (legend, charts) = area.split_vertically(LEGEND);
    self::legend(&legend)?;
    for (panel, (scene, quantity)) in charts.split_evenly((down, 2)).iter().zip(panels) {
        let of = |row: &&Row| row.scene == *scene && row.quantity == *quantity;
        let shown: Vec<&Row> = rows.iter().filter(of).collect();
        let title = format!("{}, scene “{scene}”", quantity.name());
        self::panel(panel, &title, *quantity, &shown, notes)?;
    }
    Ok(())
}

fn legend(area: &Panel<'_>) -> Done {
    let (mut x, mut y) = (24, 18);
    for (group, name) in GROUPS {
        let wide = 34 + i32::try_from(name.chars().count())? * 7;
        if x + wide > i32::try_from(2 * SIZE.0)? {
            (x, y) = (24, y + 22);
        }
        mark(area, (x, y), group)?;
        area.draw(&Text::new(name, (x + 12, y - 7), (FONT, 14).into_font()))?;
        x += wide;
    }
    let y = y + 22;
    area.draw(&PathElement::new([(18, y), (38, y)], GREY.stroke_width(2)))?;
    area.draw(&Text::new("Pareto front", (44, y - 7), (FONT, 14).into_font()))?;
    let note = "that of the optical matrix; the force sensors are other hardware. Numbers at nets: hidden units.";
    area.draw(&Text::new(note, (134, y - 7), (FONT, 13).into_font().color(&GREY)))?;
    Ok(())
}

/// Draws a mark whose shape and colour show the group.
fn mark(area: &Panel<'_>, at: (i32, i32), group: Group) -> Done {
    let style = colour(group).filled();
    match group {
        Group::Model | Group::Finger => {
            let (x, y) = at;
            let diamond = [(x, y - 8), (x + 8, y), (x, y + 8), (x - 8, y)];
            if group == Group::Model {
                area.draw(&Polygon::new(diamond, style))?;
            } else {
                let round = diamond.into_iter().chain([(x, y - 8)]);
                let outline = colour(group).stroke_width(2);
                area.draw(&PathElement::new(round.collect::<Vec<_>>(), outline))?;
            }
        }
        Group::Paper => area.draw(&TriangleMarker::new(at, 7, style))?,
        Group::Polynomial => {
            let (x, y) = at;
            area.draw(&Rectangle::new([(x - 5, y - 5), (x + 5, y + 5)], style))?;
        }
        Group::Net => area.draw(&Circle::new(at, 5, colour(group).stroke_width(2)))?,
        Group::Skip => area.draw(&Circle::new(at, 5, style))?,
        Group::Quantised | Group::QuantisedSkip => {
            let (x, y) = at;
            let style =
                if group == Group::QuantisedSkip { style } else { colour(group).stroke_width(2) };
            area.draw(&Rectangle::new([(x - 4, y - 4), (x + 4, y + 4)], style))?;
        }
        Group::Sensors => area.draw(&Cross::new(at, 5, colour(group).stroke_width(3)))?,
    }
    Ok(())
}

/// Returns round numbers below and above all values, on a scale of 1, 2, 5.
fn around(values: impl Iterator<Item = f64> + Clone) -> [f64; 2] {
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(0.0, f64::max);
    if !(low > 0.0 && low <= high) {
        return [0.1, 1.0];
    }
    let rounded = |value: f64, up: bool| {
        let ten = 10f64.powf(value.log10().floor());
        let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * ten);
        let below = steps.iter().rev().find(|step| **step <= value * (1.0 + 1e-9));
        let above = steps.iter().find(|step| **step >= value * (1.0 - 1e-9));
        if up { above } else { below }.copied().unwrap_or(value)
    };
    let [from, to] = [rounded(low * 0.85, false), rounded(high * 1.15, true)];
    // Only powers of ten carry a number, so the axis shows at least two of them.
    let within = to.log10().floor() - from.log10().ceil() >= 1.0 - 1e-9;
    if within {
        [from, to]
    } else {
        [from.log10().floor(), to.log10().ceil()].map(|n| 10f64.powf(n))
    }
}

fn panel(
    area: &Panel<'_>,
    title: &str,
    quantity: Quantity,
    rows: &[&Row],
    notes: &mut Vec<Note>,
) -> Done {
    let [left, right] = around(rows.iter().map(|row| row.cost.cycles()));
    let (unit, scale) = quantity.shown();
    let error = |row: &Row| row.rmse * scale;
    let [bottom, top] = around(rows.iter().map(|row| error(row)));
    let mut chart: Chart<'_> = ChartBuilder::on(area)
        .caption(title, (FONT, 16))
        .margin(8)
        .margin_right(18)
        .x_label_area_size(40)
        .y_label_area_size(64)
        .build_cartesian_2d((left..right).log_scale(), (bottom..top).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FAINT)
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|cycles| thousands(*cycles))
        .y_label_formatter(&|error| format!("{error}"))
        .label_style((FONT, 13))
        .x_desc("modelled Cortex-M4F cycles an estimate")
        .y_desc(format!("RMSE / {unit}"))
        .axis_desc_style((FONT, 14))
        .draw()?;
    let front = front(rows);
    let corner = |row: &&Row| (row.cost.cycles(), error(row));
    chart.draw_series(LineSeries::new(front.iter().map(corner), GREY.stroke_width(2)))?;
    let place = |row: &Row| chart.backend_coord(&(row.cost.cycles(), error(row)));
    let (base_x, base_y) = area.get_base_pixel();
    let place = |row: &Row| {
        let (x, y) = place(row);
        (x - base_x, y - base_y)
    };
    // Boxes along the front and around each mark keep labels away; each label then adds its box.
    let corners: Vec<(i32, i32)> = front.iter().map(|row| place(row)).collect();
    let mut taken: Vec<[i32; 4]> = corners.windows(2).flat_map(along).collect();
    for row in rows {
        let (x, y) = place(row);
        mark(area, (x, y), row.group)?;
        notes.push(Note { at: (x + base_x, y + base_y), text: figures(row, quantity) });
        taken.push([x - 6, y - 6, x + 6, y + 6]);
    }
    let (width, height) = area.dim_in_pixel();
    let inside = [76, 28, i32::try_from(width)? - 4, i32::try_from(height)? - 52];
    let important = |row: &&&Row| front.contains(*row) || !numbered(row.group);
    for row in rows.iter().filter(important) {
        let name = label(row);
        let wide = i32::try_from(name.chars().count())? * LETTERS / 2 + 2;
        let (x, y) = place(row);
        // A row of the front gets a label even far away, with a line to it. Other labels stay near.
        let places: &[i32] = if front.contains(row) { &[9, 20, 34, 48, 62] } else { &[9, 20] };
        let around = places.iter().flat_map(|away| {
            [
                [x + away, y - 8],
                [x - away - wide, y - 8],
                [x - wide / 2, y - away - 12],
                [x - wide / 2, y + away - 3],
                [x + away, y - 8 - away],
                [x + away, y - 8 + away],
                [x - away - wide, y - 8 - away],
                [x - away - wide, y - 8 + away],
            ]
        });
        let boxes = around.map(|[x, y]| [x, y, x + wide, y + LETTERS + 1]);
        let Some(free) =
            boxes.into_iter().find(|b| within(b, &inside) && !taken.iter().any(|t| meet(b, t)))
        else {
            continue;
        };
        let [left, above, right, below] = free;
        let end = (x.clamp(left, right), y.clamp(above, below));
        if (end.0 - x).abs().max((end.1 - y).abs()) > 16 {
            area.draw(&PathElement::new([(x, y), end], GREY.stroke_width(1)))?;
        }
        taken.push(free);
        // Text widths are estimates, so the text starts at the box's side next to the mark.
        let (at, side) = if right <= x { (right, HPos::Right) } else { (left, HPos::Left) };
        let style = (FONT, LETTERS).into_font().color(&BLACK).pos(Pos::new(side, VPos::Top));
        area.draw(&Text::new(name, (at, above), style))?;
    }
    Ok(())
}

/// Formats the figures of a row for its note.
fn figures(row: &Row, quantity: Quantity) -> String {
    let (Cost { instructions, cycles_low, cycles_high }, (unit, scale)) =
        (row.cost, quantity.shown());
    let error = row.rmse * scale;
    format!(
        "{}: {error:.3} {unit}; {cycles_low} to {cycles_high} cycles, {instructions} instructions",
        row.name
    )
}

/// Returns whether marks of a group show their width, and only on the front.
fn numbered(group: Group) -> bool {
    matches!(group, Group::Net | Group::Quantised | Group::QuantisedSkip)
}

/// Returns the label of a mark: a net's width, or the name.
fn label(row: &Row) -> String {
    let mut parts = row.name.split('-');
    match (parts.nth(1), parts.next()) {
        (Some(width), Some(_)) if numbered(row.group) || row.group == Group::Skip => {
            width.to_owned()
        }
        _ => row.name.trim_start_matches("net ").to_owned(),
    }
}

/// Returns small boxes along a line between two positions.
fn along(ends: &[(i32, i32)]) -> Vec<[i32; 4]> {
    let &[(ax, ay), (bx, by)] = ends else { return Vec::new() };
    let steps = ((bx - ax).abs().max((by - ay).abs()) / 4).max(1);
    let at = |i| (ax + (bx - ax) * i / steps, ay + (by - ay) * i / steps);
    (0..=steps).map(at).map(|(x, y)| [x - 2, y - 2, x + 2, y + 2]).collect()
}

fn within([a, b, c, d]: &[i32; 4], [l, t, r, m]: &[i32; 4]) -> bool {
    a >= l && b >= t && c <= r && d <= m
}

fn meet(a: &[i32; 4], b: &[i32; 4]) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_span_all_values_between_round_numbers() {
        assert_eq!(around([26.0, 90.0, 800.0].into_iter()), [20.0, 1000.0]);
        // The axis spans at least two powers of ten.
        let [low, high] = around([0.0034, 0.004].into_iter());
        assert!((low - 0.001).abs() < 1e-12 && (high - 0.01).abs() < 1e-12);
        assert_eq!(around(std::iter::empty()), [0.1, 1.0]);
    }

    #[test]
    fn label_across_the_front_overlaps_it() {
        let boxes = along(&[(0, 0), (100, 50)]);
        assert!(boxes.iter().any(|line| meet(&[40, 18, 70, 32], line)));
        assert!(!boxes.iter().any(|line| meet(&[40, 60, 70, 74], line)));
    }

    #[test]
    fn boxes_with_a_shared_edge_do_not_overlap() {
        assert!(meet(&[0, 0, 10, 10], &[9, 9, 12, 12]));
        assert!(!meet(&[0, 0, 10, 10], &[10, 0, 20, 10]));
    }
}

//! Pictures of coverage by disturbance, and of the error over the share of values that is given.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{CONDITIONS, Covered, PARTS, QUANTITIES, Risk, WIDTHS};
use crate::picture::{Area, COLOURS, Done, FAINT, GREY, Picture, write};

const WIDTH: i32 = 1000;
/// Height of the legend, of a line and of the axes in pixels.
const TOP: i32 = 84;
const LINE: i32 = 40;
const AXES: i32 = 40;
/// Left end of the first panel of coverages, width of a panel and its distance to the next.
const LEFT: i32 = 220;
const PANEL: i32 = 230;
const GAP: i32 = 24;
/// Least coverage of each panel in per cent; the most is 100.
const LEAST: [f64; 3] = [40.0, 80.0, 94.0];
/// Distance of two quantities within a line in pixels.
const APART: i32 = 3;
/// Names and colours of the parts.
const NAMES: [&str; 2] = ["matrix alone", "matrix and force sensors"];
const SHADES: [RGBColor; 2] = [COLOURS[1], COLOURS[0]];

/// Draws the coverages: a line for each condition, a panel for each width.
///
/// # Errors
/// The file cannot be written.
pub fn write_coverage(rows: &[Covered], path: &Path) -> anyhow::Result<()> {
    let lines = i32::try_from(CONDITIONS.len())?;
    let (bottom, size) = (TOP + LINE * lines, TOP + LINE * lines + AXES);
    let picture = Picture::draw((WIDTH as u32, size as u32), |area, _| {
        legend(area, "Coverage of the stated uncertainty, reference finger, simulated", bottom)?;
        for (panel, (width, normal, off)) in WIDTHS.into_iter().enumerate() {
            let left = LEFT + (PANEL + GAP) * panel as i32;
            let least = LEAST[panel];
            let at = |share: f64| {
                let part = ((share - least) / (100.0 - least)).clamp(0.0, 1.0);
                left + (f64::from(PANEL) * part).round() as i32
            };
            let aim = [(at(normal - off), TOP), (at((normal + off).min(100.0)), bottom)];
            area.draw(&Rectangle::new(aim, FAINT.filled()))?;
            let title = format!("within {width} σ, %");
            write(area, &title, (left + PANEL / 2, TOP - 14), HPos::Center, 13, BLACK)?;
            axis(area, [left, bottom], least, &at)?;
            for (line, condition) in (0..).zip(&CONDITIONS) {
                let of = |part: &str| {
                    let own = rows.iter().filter(|row| row.condition == condition.name);
                    own.filter(|row| row.part == part).collect::<Vec<_>>()
                };
                for (p, ((_, part), shade)) in (0..).zip(PARTS.into_iter().zip(SHADES)) {
                    for (q, row) in (0..).zip(of(part)) {
                        let y = TOP + LINE * line + 4 + 17 * p + APART * q;
                        let [share, low, high] = row.within()[panel].map(at);
                        area.draw(&PathElement::new([(low, y), (high, y)], shade))?;
                        area.draw(&Circle::new((share, y), 2, shade.filled()))?;
                    }
                }
            }
        }
        Ok(())
    })?;
    picture.save(path)
}

fn legend(area: &Area<'_>, title: &str, bottom: i32) -> Done {
    let words = format!(
        "{} from above; whiskers: 95 % of resampled presses; at the left edge: less; grey: the aim",
        QUANTITIES.join(", ")
    );
    head(area, title, &words)?;
    for (line, condition) in (0..).zip(&CONDITIONS) {
        let y = TOP + LINE * line;
        area.draw(&PathElement::new([(16, y), (WIDTH - 16, y)], FAINT))?;
        write(area, condition.name, (16, y + LINE / 2), HPos::Left, 13, BLACK)?;
    }
    area.draw(&PathElement::new([(16, bottom), (WIDTH - 16, bottom)], GREY))?;
    Ok(())
}

/// Title, names of the parts and a note.
fn head(area: &Area<'_>, title: &str, note: &str) -> Done {
    write(area, title, (16, 18), HPos::Left, 16, BLACK)?;
    let mut x = 16;
    for (name, shade) in NAMES.into_iter().zip(SHADES) {
        area.draw(&Circle::new((x + 4, 44), 4, shade.filled()))?;
        write(area, name, (x + 14, 44), HPos::Left, 13, BLACK)?;
        x += 40 + 7 * i32::try_from(name.len())?;
    }
    write(area, note, (x, 44), HPos::Left, 12, GREY)
}

fn axis(area: &Area<'_>, [left, bottom]: [i32; 2], least: f64, at: &dyn Fn(f64) -> i32) -> Done {
    area.draw(&PathElement::new([(left, TOP), (left, bottom)], GREY))?;
    for mark in 0..=4 {
        let share = least + (100.0 - least) * f64::from(mark) / 4.0;
        let x = at(share);
        area.draw(&PathElement::new([(x, bottom), (x, bottom + 4)], GREY))?;
        write(area, &format!("{share}"), (x, bottom + 14), HPos::Center, 11, GREY)?;
    }
    Ok(())
}

/// Draws the error over the share of values that is given, smallest stated uncertainty first.
///
/// # Errors
/// The file cannot be written.
pub fn write_risk(risks: &[Risk], path: &Path) -> anyhow::Result<()> {
    let picture = Picture::draw((WIDTH as u32, 404), |area, _| {
        let title =
            "Error of the values with the smallest stated uncertainty, reference finger, simulated";
        head(
            area,
            title,
            "solid: smallest stated uncertainty first; dashed: smallest error first",
        )?;
        let (_, rest) = area.split_vertically(60);
        for (panel, quantity) in rest.split_evenly((1, 5)).iter().zip(QUANTITIES) {
            let of = |part: &str| -> Vec<&Risk> {
                risks.iter().filter(|r| r.part == part && r.quantity == quantity).collect()
            };
            risk_panel(panel, quantity, [of("matrix"), of("both")])?;
        }
        Ok(())
    })?;
    picture.save(path)
}

fn risk_panel(area: &Area<'_>, quantity: &str, parts: [Vec<&Risk>; 2]) -> Done {
    let length = quantity.len() == 1;
    let scale = if length { 1.0 } else { 1e3 };
    let unit = if length { "mm" } else { "mN" };
    let most = parts.iter().flatten().fold(0.0, |most: f64, risk| most.max(scale * risk.rmse));
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .margin_right(14)
        .x_label_area_size(36)
        .y_label_area_size(44)
        .caption(format!("{quantity}, {unit}"), ("sans-serif", 14))
        .build_cartesian_2d(0.0..100.0, 0.0..1.05 * most.max(1e-9))?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FAINT)
        .x_labels(3)
        .x_label_formatter(&|share| format!("{share:.0}"))
        .y_labels(6)
        .x_desc("share given, %")
        .draw()?;
    for (risks, shade) in parts.into_iter().zip(SHADES) {
        let line = |of: fn(&Risk) -> f64| {
            risks.iter().map(move |risk| (risk.given as f64, scale * of(risk))).collect::<Vec<_>>()
        };
        chart.draw_series(LineSeries::new(line(|risk| risk.rmse), shade.stroke_width(2)))?;
        let best = line(|risk| risk.best);
        chart.draw_series(DashedLineSeries::new(best, 3, 3, shade.stroke_width(1)))?;
    }
    Ok(())
}

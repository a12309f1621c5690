//! Chart of limit-surface forms, error over cost: `limit-surface.csv`.
//!
//! Tests of `taxel-calibrate` hold the errors in the table, and `cargo xtask cycles` the costs.

use std::path::Path;

use anyhow::Context;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use taxel_files::save;

use crate::picture::{COLOURS, Done, FAINT, FONT, Note, Picture, save_page, thousands};

const COMMITTED: &str = include_str!("../../calibrate/data/limit-surface.csv");
const TITLE: &str = "What a contact bears before it slides: worst error over cost";
const CYCLES: &str = "modelled Cortex-M4F cycles a call";
const ERROR: &str = "worst error / %";
const SIZE: (u32, u32) = (560, 320);
/// Ranges of both axes in cycles and per cent, with room for the names.
const AXES: [[f64; 2]; 2] = [[100.0, 1e5], [0.1, 100.0]];

/// Form of the limit surface with its cost and error.
struct Form {
    name: String,
    error_percent: f64,
    cycles: f64,
}

/// Writes table, picture and page into `folder`.
///
/// # Errors
/// One of them cannot be written, or the committed table is none.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let forms = parse(COMMITTED).context("host-tools/calibrate/data/limit-surface.csv")?;
    save(folder.join("limit-surface.csv"), COMMITTED)?;
    let picture = Picture::draw(SIZE, |area, notes| drawn(area, &forms, notes))?;
    picture.save(folder.join("limit-surface.svg"))?;
    let lead = "The ellipse, the table that the firmware has, and the sweep over the centre of rotation [Ospina2017], each \
                against the integral over a pressure by a power law.";
    save_page(folder.join("limit-surface.html"), "The limit surface", lead, &[&picture])
}

fn parse(table: &str) -> anyhow::Result<Vec<Form>> {
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let rows = reader.deserialize().map(|row| {
        let (name, error_percent, cycles) = row?;
        Ok(Form { name, error_percent, cycles })
    });
    rows.collect()
}

fn drawn(area: &DrawingArea<SVGBackend<'_>, Shift>, forms: &[Form], notes: &mut Vec<Note>) -> Done {
    let [x, y] = AXES.map(|[from, to]| (from..to).log_scale());
    let mut chart = ChartBuilder::on(area)
        .caption(TITLE, (FONT, 16))
        .margin(8)
        .margin_right(18)
        .x_label_area_size(40)
        .y_label_area_size(58)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FAINT)
        .x_label_formatter(&|cycles| thousands(*cycles))
        .y_label_formatter(&|error| format!("{error}"))
        .label_style((FONT, 13))
        .x_desc(CYCLES)
        .y_desc(ERROR)
        .axis_desc_style((FONT, 14))
        .draw()?;
    let style = (FONT, 14).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Bottom));
    for Form { name, error_percent, cycles } in forms {
        let place = (*cycles, *error_percent);
        chart.draw_series([Circle::new(place, 5, COLOURS[0].filled())])?;
        let text = format!("{name}: {cycles:.0} cycles, {error_percent} %");
        notes.push(Note { at: chart.backend_coord(&place), text });
        let beside = (cycles * 1.1, error_percent * 1.15);
        chart.draw_series([Text::new(name.clone(), beside, style.clone())])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn committed_forms_lie_inside_the_axes() {
        let forms = parse(COMMITTED).unwrap();
        assert_eq!(forms.len(), 3);
        let [cycles, errors] = AXES;
        for form in forms {
            assert!((cycles[0]..cycles[1]).contains(&form.cycles), "{}", form.name);
            assert!((errors[0]..errors[1]).contains(&form.error_percent), "{}", form.name);
        }
    }
}

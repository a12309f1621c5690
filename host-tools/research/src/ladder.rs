//! Error over computing time of every fidelity level of the simulator, a panel for each scene.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use taxel_sim::cost::Cost;

use crate::picture::{COLOURS, Done, FAINT, FONT, GREY, Note, Picture};

/// Range of the time axis in µs.
const TIMES: [f64; 2] = [0.5, 50_000.0];
/// Range of the error axis in per cent.
const ERRORS: [f64; 2] = [7e-5, 200.0];
/// Height of the reference level in per cent; its error is zero.
const REFERENCE: f64 = 1e-4;
/// Default tolerance of a scene in per cent.
const TOLERANCE: f64 = 1.0;

pub(crate) fn draw(costs: &[Cost]) -> anyhow::Result<Picture> {
    Picture::draw((900, 380), |area, notes| drawn(area, costs, notes))
}

fn drawn(area: &DrawingArea<SVGBackend<'_>, Shift>, costs: &[Cost], notes: &mut Vec<Note>) -> Done {
    let mut scenes: Vec<&str> = costs.iter().map(|cost| cost.scene).collect();
    scenes.dedup();
    let panels = area.split_evenly((1, scenes.len()));
    for ((panel, scene), colour) in panels.iter().zip(scenes).zip(COLOURS) {
        let mut chart = ChartBuilder::on(panel)
            .caption(scene, (FONT, 17))
            .margin(10)
            .x_label_area_size(42)
            .y_label_area_size(74)
            .build_cartesian_2d(
                (TIMES[0]..TIMES[1]).log_scale(),
                (ERRORS[0]..ERRORS[1]).log_scale(),
            )?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(FAINT)
            .x_labels(5)
            .y_labels(8)
            .x_label_formatter(&|us| format!("{us}"))
            .y_label_formatter(&|error| match *error > 2.0 * REFERENCE {
                true => format!("{error} %"),
                false => "reference".to_owned(),
            })
            .label_style((FONT, 13))
            .x_desc("µs per frame in contact")
            .y_desc("worst error of a facet")
            .axis_desc_style((FONT, 14))
            .draw()?;
        chart.draw_series(DashedLineSeries::new(
            TIMES.map(|us| (us, TOLERANCE)),
            6,
            4,
            GREY.stroke_width(1),
        ))?;
        let right = Pos::new(HPos::Right, VPos::Bottom);
        let grey = (FONT, 13).into_font().color(&GREY).pos(right);
        chart.draw_series([Text::new("tolerance", (TIMES[1] * 0.8, TOLERANCE * 1.1), grey)])?;
        let of_scene: Vec<&Cost> = costs.iter().filter(|cost| cost.scene == scene).collect();
        let place = |cost: &Cost| (cost.us_per_frame, (100.0 * cost.error).max(REFERENCE));
        chart.draw_series(LineSeries::new(
            of_scene.iter().map(|cost| place(cost)),
            colour.stroke_width(2),
        ))?;
        for cost in of_scene {
            let (us, error) = place(cost);
            chart.draw_series([Circle::new((us, error), 4, colour.filled())])?;
            if cost.auto {
                chart.draw_series([Circle::new((us, error), 8, BLACK.stroke_width(2))])?;
            }
            let auto = if cost.auto { " ← auto" } else { "" };
            // Labels stand right of the falling line, except for the level that takes milliseconds.
            let (side, away, above) =
                if us > 1000.0 { (HPos::Center, 1.0, 3.0) } else { (HPos::Left, 1.9, 1.4) };
            let text = (FONT, 14).into_font().color(&BLACK).pos(Pos::new(side, VPos::Bottom));
            let label = format!("{}{auto}", cost.rung);
            chart.draw_series([Text::new(label, (us * away, error * above), text)])?;
            let text = format!("{}: {us:.1} µs, {:.4} %", cost.rung, 100.0 * cost.error);
            notes.push(Note { at: chart.backend_coord(&(us, error)), text });
        }
    }
    Ok(())
}

//! Error of each shear component over the distance from the pad's middle: `edge.csv`.
//!
//! The failure maps press straight down off the middle and judge the force as a whole. Here every
//! press shears by the same share of its friction, in all directions. Presses lie on the x axis: x
//! points to the edge, y along it.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use plotters::coord::Shift;
use plotters::prelude::*;
use taxel_files::save;

use crate::device::Device;
use crate::effort::{Effort, Waiting, on_all_cores};
use crate::methods::{calibrated, firmwares};
use crate::picture::{COLOURS, Done, FAINT, FONT, GREY, Note, Picture, save_page};
use crate::runs::{Recorded, Run, off_middle, run};
use crate::truth::LEAST_N;

/// Distances from the middle in millimetres.
///
/// They span the shear calibration, the centres of the outer taxels and the edge of the pad.
const DISTANCES: [f64; 11] = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.75, 4.2, 4.6, 5.0];
/// Largest distance in millimetres with shear in the calibration recordings.
const CALIBRATED: f64 = 2.0;
/// Distance of the outer taxels' centres in millimetres.
const OUTER: f64 = 3.75;
/// Specification at the middle in newtons: 1.5 % of 2 N.
const ASKED: f64 = 0.03;
/// Share of friction that every press uses.
const SHEAR: f64 = 0.5;
/// Range of the error axis in millinewtons.
const ERRORS: [f64; 2] = [0.5, 500.0];
const SIZE: (u32, u32) = (900, 380);
const AXES: [&str; 2] = ["F_x, towards the edge", "F_y, along the edge"];

/// Errors of one method at one distance.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    method: String,
    distance: f64,
    /// RMS errors of F_x and F_y in newtons; `None` without any value.
    rmse: [Option<f64>; 2],
    /// Share of frames with a value.
    given: f64,
}

/// Squared errors of both components, with the numbers of values and of frames.
#[derive(Clone, Copy, Default)]
struct Sum {
    squares: [f64; 2],
    valued: usize,
    frames: usize,
}

/// Judges net, model and whole finger at every distance, one thread for each device.
///
/// # Errors
/// A fit failed, or it was stopped.
pub fn measure(effort: &Effort, waiting: Waiting<'_>) -> anyhow::Result<Vec<Row>> {
    let done = AtomicUsize::new(0);
    let of = effort.devices.len() * DISTANCES.len();
    let step = || {
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        (waiting.progress)(done as f64 / of as f64, "towards the edge");
    };
    let devices = on_all_cores(&effort.devices, |seed| judged(*seed, effort, waiting.stop, &step))?;
    let count = devices.len() as f64;
    let mut devices = devices.into_iter();
    let Some(mut rows) = devices.next() else { return Ok(Vec::new()) };
    for device in devices {
        for (row, own) in rows.iter_mut().zip(device) {
            row.given += own.given;
            for (sum, own) in row.rmse.iter_mut().zip(own.rmse) {
                *sum = sum.zip(own).map(|(sum, own)| sum + own);
            }
        }
    }
    for row in &mut rows {
        row.given /= count;
        row.rmse.iter_mut().flatten().for_each(|sum| *sum /= count);
    }
    Ok(rows)
}

fn judged(
    seed: u64,
    effort: &Effort,
    stop: &AtomicBool,
    step: &impl Fn(),
) -> anyhow::Result<Vec<Row>> {
    let device = Device::new(seed)?;
    let calibration = calibrated(&device, effort, stop)?;
    let mut rows = Vec::new();
    for distance in DISTANCES {
        anyhow::ensure!(!stop.load(Ordering::Relaxed), "stopped");
        let acts = off_middle(distance, SHEAR);
        let Recorded { samples, .. } =
            run(seed, &Run { acts: &acts, seconds: 11.0, ..Run::default() })?;
        // Each run needs new methods, because a finger keeps state.
        for mut method in firmwares(&calibration) {
            let mut sum = Sum::default();
            for sample in &samples {
                let moment = device.moment(*sample, Default::default());
                let ([x, y, _], truth) = ((method.says)(&moment).force, sample.truth.force);
                let [Some(tx), Some(ty), Some(tz)] = truth else { continue };
                if tz < LEAST_N {
                    continue;
                }
                sum.frames += 1;
                if let Some((x, y)) = x.zip(y) {
                    sum.valued += 1;
                    let errors = [x - tx, y - ty];
                    sum.squares
                        .iter_mut()
                        .zip(errors)
                        .for_each(|(sum, error)| *sum += error * error);
                }
            }
            let of = |squares: f64| (sum.valued > 0).then(|| (squares / sum.valued as f64).sqrt());
            rows.push(Row {
                method: method.name,
                distance,
                rmse: sum.squares.map(of),
                given: sum.valued as f64 / sum.frames.max(1) as f64,
            });
        }
        step();
    }
    Ok(rows)
}

/// Formats the table `edge.csv`.
#[must_use]
pub fn csv(rows: &[Row]) -> String {
    let mut table = String::from("method,distance_mm,fx_rmse_n,fy_rmse_n,given\n");
    for Row { method, distance, rmse, given } in rows {
        let [x, y] = rmse.map(|rmse| rmse.map(|rmse| format!("{rmse:.5}")).unwrap_or_default());
        // Writing into a string cannot fail.
        let _ = writeln!(table, "{method},{distance},{x},{y},{given:.4}");
    }
    table
}

/// Writes table, picture and page into `folder`.
///
/// # Errors
/// One of them cannot be written.
pub fn write(rows: &[Row], folder: &Path) -> anyhow::Result<()> {
    save(folder.join("edge.csv"), csv(rows))?;
    let picture = Picture::draw(SIZE, |area, notes| drawn(area, rows, notes))?;
    picture.save(folder.join("edge.svg"))?;
    let lead = "Root mean square error of each component of a shear of half of what friction holds, over the distance \
                of the contact from the middle of the pad along x.";
    save_page(folder.join("edge.html"), "Shear towards the edge", lead, &[&picture])
}

/// Lists each method once with its errors in millinewtons over the distance.
fn lines(rows: &[Row], axis: usize) -> Vec<(&str, Vec<(f64, f64)>)> {
    let mut lines: Vec<(&str, Vec<(f64, f64)>)> = Vec::new();
    for row in rows {
        if !lines.iter().any(|(method, _)| *method == row.method) {
            lines.push((&row.method, Vec::new()));
        }
        let line = lines.iter_mut().find(|(method, _)| *method == row.method);
        if let (Some((_, line)), Some(Some(rmse))) = (line, row.rmse.get(axis)) {
            line.push((row.distance, 1e3 * rmse));
        }
    }
    lines
}

fn drawn(area: &DrawingArea<SVGBackend<'_>, Shift>, rows: &[Row], notes: &mut Vec<Note>) -> Done {
    for (axis, (panel, title)) in area.split_evenly((1, 2)).iter().zip(AXES).enumerate() {
        let mut chart = ChartBuilder::on(panel)
            .caption(title, (FONT, 17))
            .margin(10)
            .margin_right(16)
            .x_label_area_size(42)
            .y_label_area_size(58)
            .build_cartesian_2d(-0.1..5.1f64, (ERRORS[0]..ERRORS[1]).log_scale())?;
        chart.draw_series([Rectangle::new(
            [(-0.1, ERRORS[0]), (CALIBRATED, ERRORS[1])],
            FAINT.mix(0.6).filled(),
        )])?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(WHITE.mix(0.0))
            .bold_line_style(FAINT)
            .x_labels(6)
            .x_label_formatter(&|mm| format!("{mm:.0}"))
            .y_label_formatter(&|error| format!("{error}"))
            .label_style((FONT, 13))
            .x_desc("distance from the middle / mm")
            .y_desc("RMSE / mN")
            .axis_desc_style((FONT, 14))
            .draw()?;
        let grey = (FONT, 12).into_font().color(&GREY);
        let least = ERRORS[0];
        for (line, label, at) in [
            (
                [(-0.1, 1e3 * ASKED), (CALIBRATED, 1e3 * ASKED)],
                "specification: 1.5 % of 2 N",
                (0.0, 28.0),
            ),
            ([(OUTER, least), (OUTER, ERRORS[1])], "outer taxels", (OUTER + 0.05, 0.75)),
        ] {
            chart.draw_series(DashedLineSeries::new(line, 6, 4, GREY.stroke_width(1)))?;
            chart.draw_series([Text::new(label, at, grey.clone())])?;
        }
        chart.draw_series([Text::new("calibrated with shear", (0.0, 0.75), grey.clone())])?;
        for ((method, line), colour) in lines(rows, axis).into_iter().zip(COLOURS) {
            chart
                .draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?
                .label(method)
                .legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2))
                });
            for (mm, error) in line {
                chart.draw_series([Circle::new((mm, error), 3, colour.filled())])?;
                let text = format!("{method} at {mm} mm: {error:.2} mN");
                notes.push(Note { at: chart.backend_coord(&(mm, error)), text });
            }
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE)
            .border_style(FAINT)
            .label_font((FONT, 14))
            .draw()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_has_a_point_for_each_given_error() {
        let row = |method: &str, distance, x| Row {
            method: method.into(),
            distance,
            rmse: [x, Some(0.002)],
            given: 1.0,
        };
        let rows = [row("a", 0.0, Some(0.001)), row("b", 0.0, None), row("a", 1.0, Some(0.003))];
        assert_eq!(lines(&rows, 0), [("a", vec![(0.0, 1.0), (1.0, 3.0)]), ("b", vec![])]);
        assert_eq!(csv(&rows[1..2]).lines().last(), Some("b,0,,0.00200,1.0000"));
    }
}

//! Chart of detection as SVG: a line for each kind of fault, from the most demanding class down.
//!
//! Four panels: share of cases named in time, time to the name, share of frames that are off
//! without a flag, and their error.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::bench::PHASES;
use super::table::{Fault, LIMITS, Row, faults};
use crate::faults::Class;
use crate::picture::{Area, COLOURS, Done, FAINT, GREY, Note, Picture, power_of_ten, write};

const WIDTH: i32 = 980;
/// Height of the legend, of a line and of a class's heading in pixels.
const TOP: i32 = 96;
const LINE: i32 = 17;
const HEADING: i32 = 30;
/// Right end of the names, and left end of the cells.
const NAMES: i32 = 300;
/// Width of a cell in pixels; a cell for each phase.
const CELL: i32 = 44;
/// Left and right end of the other two panels in pixels, with the powers of ten of their axes.
const TIME: Axis = Axis { ends: [470, 618], powers: [-1, 3] };
const ERROR: Axis = Axis { ends: [764, 956], powers: [-1, 4] };
/// Left end of the cells of frames that are off without a flag; a cell for each finger.
const SILENT: i32 = 650;
/// Colours of the fingers.
const FINGERS: [RGBColor; 2] = [COLOURS[1], COLOURS[0]];

/// Logarithmic axis.
struct Axis {
    ends: [i32; 2],
    powers: [i32; 2],
}

impl Axis {
    fn at(&self, value: f64) -> i32 {
        let ([left, right], [low, high]) = (self.ends, self.powers.map(f64::from));
        let share = (value.max(1e-9).log10() - low) / (high - low);
        left + (f64::from(right - left) * share.clamp(0.0, 1.0)).round() as i32
    }
}

fn title(class: Class) -> &'static str {
    match class {
        Class::Total => "No signal is left: named in the first frame",
        Class::Sudden => "Stuck, swapped, wrong bit, noise, floating: named within 10 ms",
        Class::Row => "LED row that loses a twentieth of its light: named within 50 ms",
        Class::Gradual => "Gain, offset, drift: no aim for the time, the error is bounded",
    }
}

pub(super) fn draw(rows: &[Row]) -> anyhow::Result<Picture> {
    let faults = faults(rows);
    let height = TOP + HEADING * 4 + LINE * i32::try_from(faults.len())? + 40;
    Picture::draw((WIDTH as u32, u32::try_from(height)?), |area, notes| {
        legend(area)?;
        let mut y = TOP;
        for class in Class::ALL {
            let of = |fault: &&Fault<'_>| fault.rows.iter().any(|row| row.class == class.name());
            let lines: Vec<&Fault<'_>> = faults.iter().filter(of).collect();
            let bottom = y + HEADING + LINE * i32::try_from(lines.len())?;
            grid(area, [y + HEADING - 2, bottom], class)?;
            write(area, title(class), (16, y + HEADING - 11), HPos::Left, 14, BLACK)?;
            y += HEADING;
            for line in lines {
                self::line(area, line, y + LINE / 2, notes)?;
                y += LINE;
            }
        }
        axes(area, y)
    })
}

fn legend(area: &Area<'_>) -> Done {
    write(area, "Simulated faults of the reference finger", (16, 18), HPos::Left, 16, BLACK)?;
    let mut x = 330;
    for (((name, _), colour), words) in
        LIMITS.iter().zip(FINGERS).zip(["matrix alone", "matrix and force sensors"])
    {
        dot(area, (x, 18), colour, name)?;
        write(area, words, (x + 10, 18), HPos::Left, 13, BLACK)?;
        x += 40 + 7 * i32::try_from(words.len())?;
    }
    let middle = NAMES + 8 + CELL * 3 / 2;
    write(area, "named right in time, %", (middle, 52), HPos::Center, 13, BLACK)?;
    for (i, phase) in (0..).zip(PHASES) {
        let at = (NAMES + 8 + CELL * i + CELL / 2, 72);
        write(area, phase.name(), at, HPos::Center, 10, GREY)?;
    }
    let centre = |axis: &Axis| (axis.ends[0] + axis.ends[1]) / 2;
    for (axis, title, note) in [
        (&TIME, "time to the name, ms", "dot: half of those named; line: to the last"),
        (
            &ERROR,
            "error of force without a flag, mN",
            "dot: 99 of 100 frames; line: to the largest",
        ),
    ] {
        write(area, title, (centre(axis), 52), HPos::Center, 13, BLACK)?;
        write(area, note, (centre(axis), 72), HPos::Center, 10, GREY)?;
    }
    write(area, "off without a flag, %", (SILENT + CELL, 52), HPos::Center, 13, BLACK)?;
    for (i, words) in (0..).zip(["matrix", "sensors"]) {
        let at = (SILENT + CELL * i + CELL / 2, 72);
        write(area, words, at, HPos::Center, 10, GREY)?;
    }
    Ok(())
}

fn dot(area: &Area<'_>, at: (i32, i32), colour: RGBColor, finger: &str) -> Done {
    let style = if finger == "matrix" { colour.stroke_width(2) } else { colour.filled() };
    area.draw(&Circle::new(at, 4, WHITE.filled()))?;
    area.draw(&Circle::new(at, 4, style))?;
    Ok(())
}

/// Draws the lines of the axes behind a class, with the aims.
fn grid(area: &Area<'_>, [top, bottom]: [i32; 2], class: Class) -> Done {
    let vertical = |x: i32, style: ShapeStyle| -> Done {
        area.draw(&PathElement::new([(x, top), (x, bottom)], style))?;
        Ok(())
    };
    for axis in [&TIME, &ERROR] {
        for power in axis.powers[0]..=axis.powers[1] {
            vertical(axis.at(10f64.powi(power)), FAINT.stroke_width(1))?;
        }
    }
    if let Some(aim) = class.aim_ms() {
        vertical(TIME.at(aim), BLACK.stroke_width(1))?;
    }
    for (colour, (_, limit)) in FINGERS.iter().zip(LIMITS) {
        vertical(ERROR.at(limit), colour.stroke_width(1))?;
    }
    Ok(())
}

fn axes(area: &Area<'_>, y: i32) -> Done {
    for axis in [&TIME, &ERROR] {
        for power in axis.powers[0]..=axis.powers[1] {
            let raised = power_of_ten(10f64.powi(power));
            let text = match power == axis.powers[0] {
                true if axis.ends == TIME.ends => "first frame".into(),
                true => format!("≤ {raised}"),
                false => raised,
            };
            write(area, &text, (axis.at(10f64.powi(power)), y + 12), HPos::Center, 11, GREY)?;
        }
    }
    let note = "Vertical lines: the aims, for the time and for the largest error, 50 mN for the matrix alone \
                and 20 mN with force sensors. Off: by more than that.";
    write(area, note, (16, y + 30), HPos::Left, 12, GREY)
}

fn line(area: &Area<'_>, line: &Fault<'_>, y: i32, notes: &mut Vec<Note>) -> Done {
    let name = format!("{}: {}", line.place, line.kind);
    write(area, &name, (NAMES, y), HPos::Right, 12, BLACK)?;
    for (i, phase) in (0..).zip(PHASES) {
        let of = line.rows.iter().filter(|row| row.phase == phase.name());
        let sum = |count: fn(&Row) -> u64| of.clone().map(|row| count(row)).sum::<u64>();
        let (cases, in_time) = (sum(|row| row.cases), sum(|row| row.in_time));
        if cases == 0 {
            continue;
        }
        let left = NAMES + 8 + CELL * i;
        cell(area, (left, y), in_time as f64 / cases as f64, COLOURS[0])?;
    }
    for (i, ((finger, _), colour)) in (0..).zip(LIMITS.iter().zip(FINGERS)) {
        if let Some(silent) = line.silent_of(finger) {
            cell(area, (SILENT + CELL * i, y), 1e-2 * silent, COLOURS[1])?;
        }
        let y = y - 3 + 6 * i;
        let most = |of: fn(&Row) -> Option<f64>| line.most(finger, of);
        let spans = [
            (&TIME, most(|row| row.median_ms), most(|row| row.worst_ms)),
            (&ERROR, most(|row| row.p99_mn), most(|row| row.max_mn)),
        ];
        for (axis, usual, most) in spans {
            let Some((usual, most)) = usual.zip(most) else { continue };
            let (from, to) = (axis.at(usual), axis.at(most));
            area.draw(&PathElement::new([(from, y), (to, y)], colour.stroke_width(1)))?;
            dot(area, (from, y), colour, finger)?;
            let text = format!("{name}, {finger}: {usual:.2}, at most {most:.2}");
            notes.push(Note { at: (from, y), text });
        }
    }
    Ok(())
}

/// Draws a share in per cent on a cell of its shade.
fn cell(area: &Area<'_>, (left, y): (i32, i32), share: f64, full: RGBColor) -> Done {
    let corners = [(left, y - LINE / 2 + 1), (left + CELL - 2, y + LINE / 2)];
    area.draw(&Rectangle::new(corners, shade(share, full).filled()))?;
    let colour = if share > 0.6 { WHITE } else { BLACK };
    write(area, &percent(share), (left + CELL / 2 - 1, y), HPos::Center, 11, colour)
}

/// Colour of a share: light for none, `full` for all.
fn shade(share: f64, full: RGBColor) -> RGBColor {
    let RGBColor(red, green, blue) = full;
    let mix = |to: u8| (242.0 + (f64::from(to) - 242.0) * share.clamp(0.0, 1.0)).round() as u8;
    RGBColor(mix(red), mix(green), mix(blue))
}

/// Formats a share in per cent; only all is 100.
fn percent(share: f64) -> String {
    if 0.0 < share && share < 0.005 {
        "<1".into()
    } else if share < 1.0 {
        format!("{:.0}", (100.0 * share).min(99.0))
    } else {
        format!("{:.0}", 100.0 * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_all_cases_are_a_hundred_per_cent() {
        assert_eq!([0.0, 0.001, 0.5, 0.9999, 1.0].map(percent), ["0", "<1", "50", "99", "100"]);
    }

    #[test]
    fn axis_ends_at_its_powers() {
        assert_eq!(TIME.at(0.0), TIME.ends[0]);
        assert_eq!([0.1, 1e3, 1e9].map(|ms| TIME.at(ms)), [470, 618, 618]);
        assert!(ERROR.at(20.0) < ERROR.at(50.0));
    }

    #[test]
    fn chart_has_a_line_for_each_kind() {
        let row = |kind: &str, phase: &str| Row {
            kind: kind.into(),
            place: "taxel".into(),
            class: "total".into(),
            phase: phase.into(),
            finger: "matrix".into(),
            cases: 2,
            in_time: 1,
            ..Row::default()
        };
        let rows = [row("at zero", "unloaded"), row("at zero", "loaded"), row("off", "loaded")];
        let lines = faults(&rows);
        assert_eq!(lines.iter().map(|line| line.rows.len()).collect::<Vec<_>>(), [2, 1]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("chart.svg");
        draw(&rows).unwrap().save(&path).unwrap();
        let svg = std::fs::read_to_string(path).unwrap();
        assert!(svg.contains("taxel: at zero") && svg.contains("taxel: off"));
    }
}

//! Chart of slip as SVG: warnings in time and delays of gross slip, over their false alarms.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::{FRICTIONS, PARTS, Slips};
use crate::picture::{Area, COLOURS, Done, FAINT, GREY, Note, Picture, letters, write};

const SIZE: (u32, u32) = (960, 430);
/// Top and bottom of both panels in pixels.
const DOWN: [i32; 2] = [96, 366];
/// Left and right ends of the panels in pixels: warnings, and gross slips.
const ACROSS: [[i32; 2]; 2] = [[64, 556], [640, 930]];
/// Width of the lane of the points without a false alarm in pixels, beside an axis of the others.
const LANE: i32 = 216;
const LANE_GAP: i32 = 12;
/// Step of the axis of delays in milliseconds.
const TICK_MS: usize = 200;
/// Distance of the parts within a friction coefficient in pixels.
const APART: i32 = 15;
/// Colour and name of each of [`PARTS`].
const STYLES: [(RGBColor, &str); PARTS.len()] = [
    (COLOURS[1], "matrix alone"),
    (COLOURS[0], "force sensors alone"),
    (COLOURS[5], "matrix and force sensors"),
];

/// Axis of false alarms a minute: a lane for none, in which friction spreads the points, and an
/// axis of the others if there are any.
struct Alarms {
    ends: [i32; 2],
    /// Right end of the lane.
    lane: i32,
    /// Largest number a minute on the axis; `None` without an axis.
    most: Option<f64>,
}

impl Alarms {
    fn new(ends: [i32; 2], all: impl Iterator<Item = f64>) -> Self {
        let most = all.fold(0.0, f64::max);
        let most = (most > 0.0).then(|| most.ceil() + 1.0);
        Self { ends, lane: most.map_or(ends[1], |_| ends[0] + LANE), most }
    }

    /// Gap between the lane and the axis.
    fn gap(&self) -> i32 {
        self.most.map_or(0, |_| LANE_GAP)
    }

    /// Place of a friction coefficient in the lane.
    fn none(&self, friction: usize) -> i32 {
        let width = (self.lane - self.gap() - self.ends[0]) / FRICTIONS.len() as i32;
        self.ends[0] + width * friction as i32 + width / 2
    }

    /// Place of a number of alarms a minute.
    fn at(&self, a_minute: f64) -> i32 {
        let share = self.most.map_or(0.0, |most| a_minute / most);
        self.lane + (share * f64::from(self.ends[1] - self.lane)).round() as i32
    }

    /// Place of a part at a friction coefficient with this number of alarms.
    fn place(&self, part: usize, friction: usize, a_minute: f64) -> i32 {
        if a_minute > 0.0 {
            self.at(a_minute)
        } else {
            self.none(friction) + APART * (part as i32 - 1)
        }
    }
}

/// Row of the table with its place among [`PARTS`] and [`FRICTIONS`].
struct Place<'r> {
    row: &'r Slips,
    part: usize,
    friction: usize,
    colour: RGBColor,
    /// Beginning of its notes.
    name: String,
}

impl<'r> Place<'r> {
    fn new(row: &'r Slips) -> Option<Self> {
        let part = PARTS.iter().position(|(_, name)| *name == row.part)?;
        let friction = FRICTIONS.iter().position(|friction| *friction == row.friction)?;
        let (colour, words) = *STYLES.get(part)?;
        Some(Self {
            row,
            part,
            friction,
            colour,
            name: format!("{words}, friction {}", row.friction),
        })
    }
}

impl Slips {
    fn a_minute(&self, alarms: usize) -> f64 {
        60.0 * alarms as f64 / f64::from(self.grasped_s.max(1))
    }
}

pub(super) fn draw(rows: &[Slips]) -> anyhow::Result<Picture> {
    let places: Vec<Place<'_>> = rows.iter().filter_map(Place::new).collect();
    Picture::draw(SIZE, |area, notes| {
        legend(area)?;
        warnings(area, &places, notes)?;
        slips(area, &places, notes)
    })
}

fn line(area: &Area<'_>, ends: [(i32, i32); 2], style: ShapeStyle) -> Done {
    Ok(area.draw(&PathElement::new(ends, style))?)
}

/// Draws a dot: filled, or a wider ring, which shows around a filled one at the same place.
fn dot(area: &Area<'_>, at: (i32, i32), colour: RGBColor, filled: bool) -> Done {
    if filled {
        return Ok(area.draw(&Circle::new(at, 4, colour.filled()))?);
    }
    Ok(area.draw(&Circle::new(at, 6, colour.stroke_width(2)))?)
}

fn legend(area: &Area<'_>) -> Done {
    let mut x = 330;
    write(area, "Simulated slip of three reference fingers", (16, 18), HPos::Left, 16, BLACK)?;
    for (colour, words) in STYLES {
        area.draw(&Rectangle::new([(x, 12), (x + 16, 24)], colour.filled()))?;
        write(area, words, (x + 22, 18), HPos::Left, 14, BLACK)?;
        x += 52 + 7 * i32::try_from(words.len())?;
    }
    Ok(())
}

/// Draws titles, axes and lines of a panel.
fn frame(area: &Area<'_>, alarms: &Alarms, titles: [&str; 4], ticks: &[(i32, String)]) -> Done {
    let [[left, right], [top, bottom]] = [alarms.ends, DOWN];
    let [title, marks, upwards, along] = titles;
    write(area, title, (left - 48, 48), HPos::Left, 15, BLACK)?;
    write(area, marks, (left - 48, 70), HPos::Left, 12, GREY)?;
    let style = letters(HPos::Center, 13, BLACK).transform(FontTransform::Rotate270);
    area.draw(&Text::new(upwards.to_owned(), (left - 48, (top + bottom) / 2), style))?;
    for (y, label) in ticks {
        line(area, [(left, *y), (right, *y)], FAINT.stroke_width(1))?;
        write(area, label, (left - 6, *y), HPos::Right, 12, BLACK)?;
    }
    let tick = |text: &str, x: i32, y: i32| write(area, text, (x, y), HPos::Center, 12, BLACK);
    for (i, friction) in FRICTIONS.iter().enumerate() {
        tick(&format!("{friction}"), alarms.none(i), bottom + 14)?;
    }
    tick("none, at this friction", (left + alarms.lane) / 2, bottom + 30)?;
    line(area, [(left, bottom), (alarms.lane - alarms.gap(), bottom)], BLACK.stroke_width(1))?;
    if let Some(most) = alarms.most {
        line(area, [(alarms.lane, bottom), (right, bottom)], BLACK.stroke_width(1))?;
        for alarm in (2..).step_by(2).take_while(|alarm| f64::from(*alarm) <= most) {
            let x = alarms.at(f64::from(alarm));
            line(area, [(x, bottom), (x, bottom + 4)], BLACK.stroke_width(1))?;
            tick(&alarm.to_string(), x, bottom + 14)?;
        }
    }
    write(area, along, ((left + right) / 2, bottom + 52), HPos::Center, 13, BLACK)
}

/// Height of a share of the y axis; dots at its ends do not touch the panel's ends.
fn height(share: f64) -> i32 {
    let [top, bottom] = [DOWN[0] + 8, DOWN[1] - 10];
    bottom - (share * f64::from(bottom - top)).round() as i32
}

fn warnings(area: &Area<'_>, places: &[Place<'_>], notes: &mut Vec<Note>) -> Done {
    let a_minute = |place: &Place<'_>| place.row.a_minute(place.row.false_warnings);
    let alarms = Alarms::new(ACROSS[0], places.iter().map(a_minute));
    let titles = [
        "Slides warned of 20 ms ahead",
        "dot: first slide on a new material; ring: later slides on it; number: friction",
        "share of the slides / %",
        "false warnings a minute of grasps",
    ];
    let ticks = (0..=4).map(|i| (height(0.25 * f64::from(i)), format!("{}", 25 * i)));
    frame(area, &alarms, titles, &ticks.collect::<Vec<_>>())?;
    for place in places {
        let Place { row, part, friction, colour, name } = place;
        let x = alarms.place(*part, *friction, a_minute(place));
        let of = |all: usize, warned: usize| height(warned as f64 / all.max(1) as f64);
        let (first, later) = (of(row.first, row.first_warned), of(row.later, row.later_warned));
        line(area, [(x, first), (x, later)], colour.stroke_width(1))?;
        dot(area, (x, first), *colour, true)?;
        dot(area, (x, later), *colour, false)?;
        if a_minute(place) > 0.0 {
            let beside = (x + 10, first);
            write(area, &row.friction.to_string(), beside, HPos::Left, 12, *colour)?;
        }
        let text = format!(
            "{name}: warned of {} of {} first and {} of {} later slides; {:.2} false warnings a minute",
            row.first_warned,
            row.first,
            row.later_warned,
            row.later,
            a_minute(place)
        );
        notes.push(Note { at: (x, first), text });
    }
    Ok(())
}

fn slips(area: &Area<'_>, places: &[Place<'_>], notes: &mut Vec<Note>) -> Done {
    let a_minute = |place: &Place<'_>| place.row.a_minute(place.row.false_slips);
    let alarms = Alarms::new(ACROSS[1], places.iter().map(a_minute));
    let titles = [
        "Delay until gross slip is told",
        "ring: half of those told; dot: 95 of 100; number: told, if not all",
        "delay / ms",
        "false gross slips a minute of grasps",
    ];
    let most = places.iter().map(|place| place.row.most_ms).max().unwrap_or_default();
    let most = most.div_ceil(TICK_MS).max(1) * TICK_MS;
    let at = |ms: usize| height(ms as f64 / most as f64);
    let ticks = (0..=most).step_by(TICK_MS).map(|ms| (at(ms), ms.to_string()));
    frame(area, &alarms, titles, &ticks.collect::<Vec<_>>())?;
    for place in places {
        let Place { row, part, friction, colour, name } = place;
        let x = alarms.place(*part, *friction, a_minute(place));
        let slides = row.first + row.later;
        let (half, most) = (at(row.half_ms), at(row.most_ms));
        line(area, [(x, half), (x, most)], colour.stroke_width(1))?;
        dot(area, (x, half), *colour, false)?;
        dot(area, (x, most), *colour, true)?;
        if row.told < slides {
            let beside = (x + 8, most);
            let told = format!("{} of {slides}", row.told);
            write(area, &told, beside, HPos::Left, 12, *colour)?;
        }
        let text = format!(
            "{name}: {} of {slides} told, half within {} ms, 95 of 100 within {} ms; {:.2} false ones \
             a minute",
            row.told,
            row.half_ms,
            row.most_ms,
            a_minute(place)
        );
        notes.push(Note { at: (x, most), text });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &str = include_str!("../../data/slip.csv");
    const PICTURE: &str = include_str!("../../../../docs/images/slip.svg");

    fn svg(rows: &[Slips]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("slip.svg");
        draw(rows).unwrap().save(&path).unwrap();
        std::fs::read_to_string(path).unwrap()
    }

    #[test]
    fn page_has_the_picture_of_slip_csv() {
        let rows = crate::table::parse(TABLE).unwrap();
        assert!(svg(&rows) == PICTURE, "docs/images/slip.svg: `taxel-research slip --draw`");
    }

    #[test]
    fn rows_without_false_alarms_lie_in_the_lane() {
        let alarms = Alarms::new([0, 400], [0.0, 2.5].into_iter());
        assert_eq!((alarms.lane, alarms.most), (LANE, Some(4.0)));
        assert!(alarms.place(2, FRICTIONS.len() - 1, 0.0) < alarms.place(0, 0, 0.01));
        assert_eq!(alarms.place(1, 0, 4.0), 400);
        let none = Alarms::new([0, 400], [0.0].into_iter());
        assert_eq!((none.lane, none.most, none.place(1, 0, 0.0)), (400, None, 50));
    }
}

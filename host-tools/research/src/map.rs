//! Heat map of failures as SVG: a row for each method, a column for each cause.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use crate::counts::{Map, Of, Point};
use crate::picture::{Area, Done, GREY, Note, Picture, letters, write};

/// Heights of the legend and of the causes' names in pixels.
const LEGEND: i32 = 64;
const NAMES: i32 = 122;
/// Width of the methods' names in pixels.
const METHODS: i32 = 140;
/// Size of a cell with its gap in pixels.
const CELL: (i32, i32) = (26, 22);
/// Length of the mark in a cell's corner in pixels.
const MARK: i32 = 7;
/// Number of letters from which a cause's name takes two lines.
const LINE: usize = 18;
/// Steps of the share of undetected errors: the largest share of each, its colour and its words.
///
/// Lightness falls from step to step, so that the colours also differ without their hue.
const STEPS: [(f64, RGBColor, &str); 5] = [
    (0.0, RGBColor(233, 238, 242), "none"),
    (0.001, RGBColor(253, 224, 138), "up to 0.1 %"),
    (0.01, RGBColor(248, 160, 60), "up to 1 %"),
    (0.1, RGBColor(200, 76, 20), "up to 10 %"),
    (1.0, RGBColor(84, 12, 20), "more"),
];
/// First step on which white letters are easier to read than black ones.
const DARK: usize = 3;
const GROUPS: [(Of, &str); 2] =
    [(Of::Finger, "Matrix and force sensors"), (Of::Matrix, "Matrix alone")];

/// Verdict on a method over the values of one cause.
#[derive(Clone, Debug, PartialEq)]
struct Verdict {
    /// Index into [`STEPS`] of the worst value.
    step: usize,
    /// True where most values are flagged or missing at the worst value or at the last one.
    flagged: bool,
    /// Last trusted value, if that is not the sweep's last one.
    text: String,
    /// All figures in words.
    note: String,
}

/// Removes repeated names and keeps the order.
fn once<'m>(all: impl Iterator<Item = &'m str>) -> Vec<&'m str> {
    let mut names = Vec::new();
    for name in all {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

impl Verdict {
    fn new(map: &Map) -> Option<Self> {
        let silent = |point: &Point| point.count.share(point.count.silent);
        // The most severe of equally bad values counts.
        let worst = map.points.iter().max_by(|a, b| silent(a).total_cmp(&silent(b)))?;
        let last = map.points.last()?;
        let text = match map.boundary() {
            Some(value) if value == last.value => String::new(),
            Some(value) => short(value),
            None => "–".into(),
        };
        let trusted = match text.as_str() {
            "" => format!("trusted to the end, {}", last.value),
            "–" => "trusted at no value".into(),
            value => format!("trusted up to {value}"),
        };
        let percent = |of: usize, point: &Point| 100.0 * point.count.share(of);
        let note = format!(
            "{}, {}: {trusted}; at {} {:.2} % undetected errors, {:.1} % flagged or withheld; at {} \
             {:.1} % flagged or withheld",
            map.method,
            map.sweep,
            worst.value,
            percent(worst.count.silent, worst),
            percent(worst.count.flagged, worst),
            last.value,
            percent(last.count.flagged, last)
        );
        let step = STEPS.iter().position(|(most, ..)| silent(worst) <= *most).unwrap_or_default();
        Some(Self { step, flagged: worst.flagged() || last.flagged(), text, note })
    }
}

pub(crate) fn draw(maps: &[Map]) -> anyhow::Result<Picture> {
    let sweeps = once(maps.iter().map(|map| map.sweep));
    let groups = GROUPS.map(|(of, name)| {
        let own: Vec<&Map> = maps.iter().filter(|map| map.of == of).collect();
        (name, once(own.iter().map(|map| map.method)), own)
    });
    // Each group has a heading; above them are the lines of the working range and of the last value.
    let lines: usize = 2 + groups.iter().map(|(_, methods, _)| 1 + methods.len()).sum::<usize>();
    let width = METHODS + CELL.0 * i32::try_from(sweeps.len())? + 10;
    let height = LEGEND + NAMES + CELL.1 * i32::try_from(lines)? + 10;
    Picture::draw((u32::try_from(width)?, u32::try_from(height)?), |area, notes| {
        legend(area)?;
        let mut y = LEGEND + NAMES;
        for (i, sweep) in (0..).zip(&sweeps) {
            let points = maps.iter().find(|map| map.sweep == *sweep).map(|map| &map.points[..]);
            cause(area, sweep, points.unwrap_or_default(), METHODS + CELL.0 * i + CELL.0 / 2)?;
        }
        for name in ["working range to", "examined to"] {
            write(area, name, (METHODS - 6, y + CELL.1 / 2), HPos::Right, 12, GREY)?;
            y += CELL.1;
        }
        for (name, methods, own) in &groups {
            let mut bold = letters(HPos::Left, 13, BLACK);
            bold.font = bold.font.style(FontStyle::Bold);
            area.draw(&Text::new(*name, (8, y + CELL.1 / 2), bold))?;
            y += CELL.1;
            for method in methods {
                let named = method.split(" / ").next().unwrap_or(method);
                write(area, named, (METHODS - 6, y + CELL.1 / 2), HPos::Right, 12, BLACK)?;
                for map in own.iter().filter(|map| map.method == *method) {
                    let column = (0..).zip(&sweeps).find(|(_, sweep)| **sweep == map.sweep);
                    let Some(((i, _), verdict)) = column.zip(Verdict::new(map)) else { continue };
                    let Verdict { step, flagged, text, note } = verdict;
                    let x = METHODS + CELL.0 * i;
                    cell(area, (x, y), step, flagged, &text)?;
                    notes.push(Note { at: (x + CELL.0 / 2, y + CELL.1 / 2), text: note });
                }
                y += CELL.1;
            }
        }
        Ok(())
    })
}

fn legend(area: &Area<'_>) -> Done {
    let black = |text: &str, at| write(area, text, at, HPos::Left, 13, BLACK);
    black("Simulated undetected errors at the worst value:", (8, 18))?;
    let mut x = 330;
    for (step, (.., words)) in STEPS.iter().enumerate() {
        cell(area, (x, 8), step, false, "")?;
        black(words, (x + 32, 18))?;
        x += 62 + 7 * i32::try_from(words.len())?;
    }
    for (x, flagged, text, words) in [
        (8, true, "", "most values flagged or withheld, at the worst or the last value"),
        (430, false, "2", "trusted up to this value (–: to none); no number: to the last"),
    ] {
        cell(area, (x, 36), 0, flagged, text)?;
        black(words, (x + 32, 46))?;
    }
    black("no cell: not judged", (850, 46))
}

/// Draws the name of a cause upwards, and below it the ends of the working range and of its values.
fn cause(area: &Area<'_>, sweep: &str, points: &[Point], x: i32) -> Done {
    let style = letters(HPos::Left, 11, BLACK).transform(FontTransform::Rotate270);
    let lines = wrapped(sweep.strip_suffix(" / 1").unwrap_or(sweep));
    for (i, line) in (0..).zip(&lines) {
        let across = x + if lines.len() == 1 { 0 } else { 12 * i - 6 };
        area.draw(&Text::new(line.clone(), (across, LEGEND + NAMES - 4), style.clone()))?;
    }
    let working = points.iter().rfind(|point| point.within);
    for (i, point) in (0..).zip([working, points.last()]) {
        let value = point.map_or_else(|| "–".into(), |point| short(point.value));
        let y = LEGEND + NAMES + CELL.1 * i + CELL.1 / 2;
        write(area, &value, (x, y), HPos::Center, 10, GREY)?;
    }
    Ok(())
}

fn cell(area: &Area<'_>, (x, y): (i32, i32), step: usize, flagged: bool, text: &str) -> Done {
    let Some((_, colour, _)) = STEPS.get(step) else { return Ok(()) };
    let (right, bottom) = (x + CELL.0 - 1, y + CELL.1 - 1);
    area.draw(&Rectangle::new([(x, y), (right, bottom)], colour.filled()))?;
    let ink = if step < DARK { BLACK } else { WHITE };
    if flagged {
        let corners = [(right - MARK, y), (right, y), (right, y + MARK)];
        area.draw(&Polygon::new(corners, ink.filled()))?;
    }
    write(area, text, (x + CELL.0 / 2, y + CELL.1 / 2 + 3), HPos::Center, 10, ink)
}

/// Splits a long name into two lines of about the same length; a unit follows its stroke.
fn wrapped(name: &str) -> Vec<String> {
    let spaces = name.match_indices(' ').map(|(at, _)| name.split_at(at));
    let best = spaces
        .filter(|(one, _)| name.len() > LINE && !one.ends_with('/'))
        .min_by_key(|(one, other)| one.len().abs_diff(other.len()));
    match best {
        Some((one, other)) => vec![one.to_owned(), other.trim_start().to_owned()],
        None => vec![name.to_owned()],
    }
}

/// Formats a number briefly for a cell.
fn short(value: f64) -> String {
    if value.abs() >= 1e4 { format!("{value:.0e}") } else { format!("{value}") }
}

#[cfg(test)]
mod tests {
    use crate::counts::Count;

    use super::*;

    #[test]
    fn cell_numbers_are_short() {
        assert_eq!([1e8, 1000.0, 0.005, -30.0].map(short), ["1e8", "1000", "0.005", "-30"]);
    }

    #[test]
    fn long_name_takes_two_lines() {
        assert_eq!(wrapped("load / N"), ["load / N"]);
        assert_eq!(wrapped("distance from the middle / mm"), ["distance from", "the middle / mm"]);
        assert_eq!(wrapped("bias drift / 16-bit codes"), ["bias drift", "/ 16-bit codes"]);
    }

    /// Map with these values: of a hundred frames, the undetected errors and the flagged ones.
    fn map(of: Of, method: &'static str, points: &[(f64, usize, usize)]) -> Map {
        let points = points.iter().map(|(value, silent, flagged)| {
            let mut count = Count::default();
            (0..100).for_each(|i| {
                let error = if i < *silent { 9.0 } else { 0.1 };
                count.add(Some(error), 1.0, i >= 100 - *flagged);
            });
            Point { value: *value, within: *value < 2.0, count, working: Count::default() }
        });
        Map { of, method, sweep: "load / N", points: points.collect() }
    }

    #[test]
    fn cell_has_the_worst_value() {
        let cell = |points| {
            let Verdict { step, flagged, text, .. } =
                Verdict::new(&map(Of::Finger, "force / N", points)).unwrap();
            (step, flagged, text)
        };
        assert_eq!(cell(&[(1.0, 0, 0), (2.0, 0, 0)]), (0, false, String::new()));
        assert_eq!(cell(&[(1.0, 0, 0), (2.0, 1, 0)]), (2, false, String::new()));
        assert_eq!(cell(&[(1.0, 0, 0), (2.0, 2, 0), (4.0, 0, 90)]), (3, true, "1".into()));
        assert_eq!(cell(&[(1.0, 30, 0), (2.0, 5, 40)]), (4, false, "–".into()));
    }

    #[test]
    fn picture_has_a_row_for_each_method() {
        let points = [(1.0, 0, 0), (2.0, 2, 0)];
        let maps = [(Of::Finger, "force / N"), (Of::Matrix, "centroid / mm")];
        let picture = draw(&maps.map(|(of, method)| map(of, method, &points))).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.svg");
        picture.save(&path).unwrap();
        let svg = std::fs::read_to_string(path).unwrap();
        for text in ["force", "centroid", "load / N", "Matrix alone"] {
            assert!(svg.lines().any(|line| line == text), "{text}");
        }
    }
}

//! Base of every chart: colours, and a picture whose page shows notes under the mouse.

use std::fmt::Write as _;
use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use taxel_files::save;

/// Area of a picture in pixels.
pub(crate) type Area<'p> = DrawingArea<SVGBackend<'p>, Shift>;
/// Result of drawing.
pub(crate) type Done = Result<(), Box<dyn std::error::Error>>;

/// A chart as SVG with a note for each mark.
pub(crate) struct Picture {
    svg: String,
    notes: Vec<Note>,
}

/// Text of a mark, shown while the mouse is on it.
pub(crate) struct Note {
    /// Position of the mark in pixels of the whole picture.
    pub at: (i32, i32),
    pub text: String,
}

/// Radius in pixels within which the mouse finds a mark.
const MARK_RADIUS: i32 = 8;

impl Picture {
    /// Draws in memory, because a file must be written whole or not at all.
    pub(crate) fn draw(
        size: (u32, u32),
        draw: impl FnOnce(&Area<'_>, &mut Vec<Note>) -> Done,
    ) -> anyhow::Result<Self> {
        let (mut svg, mut notes) = (String::new(), Vec::new());
        {
            let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
            area.fill(&WHITE)
                .map_err(Into::into)
                .and_then(|()| draw(&area, &mut notes))
                .and_then(|()| Ok(area.present()?))
                .map_err(|error| anyhow::anyhow!("drawing: {error}"))?;
        }
        Ok(Self { svg, notes })
    }

    /// Writes the picture alone.
    pub(crate) fn save(&self, path: impl AsRef<Path>) -> anyhow::Result<()> {
        Ok(save(path, &self.svg)?)
    }

    /// Appends the picture to a page; each note becomes the tooltip of its mark.
    fn append_to(&self, page: &mut String) {
        page.push_str(self.svg.trim_end().trim_end_matches("</svg>"));
        for Note { at: (x, y), text } in &self.notes {
            let text = escaped(text);
            // Writing into a string cannot fail.
            let _ = writeln!(
                page,
                "<circle cx=\"{x}\" cy=\"{y}\" r=\"{MARK_RADIUS}\" fill=\"transparent\"><title>{text}</title></circle>"
            );
        }
        page.push_str("</svg>\n");
    }
}

/// Writes a self-contained page of pictures, one below the other.
pub(crate) fn save_page(
    path: impl AsRef<Path>,
    title: &str,
    lead: &str,
    pictures: &[&Picture],
) -> anyhow::Result<()> {
    let [title, lead] = [title, lead].map(escaped);
    let mut page = format!(
        "<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title>\n\
         <body style=\"font-family:sans-serif;max-width:60em;margin:auto\"><h1>{title}</h1>\n\
         <p>{lead}</p>\n"
    );
    if pictures.iter().any(|picture| !picture.notes.is_empty()) {
        page.push_str("<p>The mouse on a mark shows its figures.</p>\n");
    }
    pictures.iter().for_each(|picture| picture.append_to(&mut page));
    Ok(save(path, page + "</body></html>\n")?)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Colours of Okabe and Ito, which colour-blind people can tell apart.
pub(crate) const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];
pub(crate) const GREY: RGBColor = RGBColor(110, 110, 110);
pub(crate) const FAINT: RGBColor = RGBColor(225, 225, 225);
pub(crate) const FONT: &str = "sans-serif";

/// Style of a text whose `side` is at its place, at half of its height.
pub(crate) fn letters(side: HPos, size: i32, colour: RGBColor) -> TextStyle<'static> {
    (FONT, size).into_font().color(&colour).pos(Pos::new(side, VPos::Center))
}

/// Writes a text in [`letters`].
pub(crate) fn write(
    area: &Area<'_>,
    text: &str,
    at: (i32, i32),
    side: HPos,
    size: i32,
    colour: RGBColor,
) -> Done {
    Ok(area.draw(&Text::new(text.to_owned(), at, letters(side, size, colour)))?)
}

/// Formats a number of cycles for an axis: `1k`, `100k`.
pub(crate) fn thousands(cycles: f64) -> String {
    if cycles >= 1e3 { format!("{}k", cycles / 1e3) } else { format!("{cycles}") }
}

/// Formats a power of ten with a raised exponent.
pub(crate) fn power_of_ten(value: f64) -> String {
    let raised = |c: char| match c.to_digit(10) {
        Some(digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(digit as usize).unwrap_or(c),
        None => '⁻',
    };
    let exponent = (value.log10().round() as i32).to_string();
    format!("10{}", exponent.chars().map(raised).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_shows_a_note_for_each_mark() {
        let picture = Picture::draw((40, 30), |_, notes| {
            notes.push(Note { at: (7, 9), text: "a < b".into() });
            Ok(())
        });
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page.html");
        save_page(&path, "Title", "Lead.", &[&picture.unwrap()]).unwrap();
        let page = std::fs::read_to_string(path).unwrap();
        assert!(page.contains("cx=\"7\" cy=\"9\"") && page.contains("<title>a &lt; b</title>"));
        assert_eq!(page.matches("</svg>").count(), 1);
    }

    #[test]
    fn axis_cycles_are_short() {
        assert_eq!([200.0, 1e3, 1e5].map(thousands), ["200", "1k", "100k"]);
    }
}

//! Timing diagrams of the scan as SVG for the boards' pages.
//!
//! The plan and the emulated pins use the same drawing.

use std::fmt::Write;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Subject of a bar, which sets its colour.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// Lit row, settling.
    Light,
    /// Waiting.
    Wait,
    /// Conversion of the columns.
    Columns,
    /// Conversion of the bridges.
    Bridges,
    /// Conversion of reference and temperature.
    Internal,
    /// Computation of the core.
    Compute,
}

impl Kind {
    fn colour(self) -> &'static str {
        match self {
            Self::Light => "#f6c244",
            Self::Wait => "#e3e3e3",
            Self::Columns => "#7fb2e5",
            Self::Bridges => "#8fcf9b",
            Self::Internal => "#d3b3e6",
            Self::Compute => "#f2a08c",
        }
    }
}

/// Bar over a stretch of time.
#[derive(Clone, Debug)]
pub struct Bar {
    /// Begin in nanoseconds.
    pub from: u64,
    /// End in nanoseconds.
    pub to: u64,
    /// Text in the bar; may be empty.
    pub label: String,
    /// Subject of the bar.
    pub kind: Kind,
}

/// Row of bars.
#[derive(Clone, Debug)]
pub struct Lane {
    /// Text on the left.
    pub name: &'static str,
    /// Bars of the lane.
    pub bars: Vec<Bar>,
}

/// Lanes over a common time axis.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Text above the panel.
    pub title: String,
    /// Nanoseconds from edge to edge.
    pub length: u64,
    /// Nanoseconds from tick to tick.
    pub tick: u64,
    /// Lanes from top to bottom.
    pub lanes: Vec<Lane>,
    /// Instants drawn through all lanes, with their names.
    pub marks: Vec<(u64, &'static str)>,
}

const LEFT: u64 = 130;
const WIDTH: u64 = 760;
const LANE: u64 = 34;
const HEAD: u64 = 58;
const FOOT: u64 = 44;

/// Draws all panels, one below the other, as SVG.
#[must_use]
pub fn svg(panels: &[Panel]) -> String {
    let whole: u64 = panels.iter().map(height).sum();
    let width = LEFT + WIDTH + 20;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {whole}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\">\n\
         <rect width=\"{width}\" height=\"{whole}\" fill=\"white\"/>\n"
    );
    let mut top = 0;
    for panel in panels {
        // Writing into a string cannot fail.
        let _ = draw(&mut out, panel, top);
        top += height(panel);
    }
    out + "</svg>\n"
}

fn height(panel: &Panel) -> u64 {
    HEAD + LANE * panel.lanes.len() as u64 + FOOT
}

fn draw(out: &mut String, panel: &Panel, top: u64) -> std::fmt::Result {
    let x = |ns: u64| LEFT as f64 + ns as f64 * WIDTH as f64 / panel.length as f64;
    let (first, last) = (top + HEAD, top + HEAD + LANE * panel.lanes.len() as u64);
    writeln!(
        out,
        "<text x=\"{LEFT}\" y=\"{}\" font-size=\"14\" font-weight=\"bold\">{}</text>",
        top + 20,
        panel.title
    )?;
    for ns in (0..=panel.length).step_by(panel.tick as usize) {
        let at = x(ns);
        writeln!(
            out,
            "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{first}\" y2=\"{}\" stroke=\"#d8d8d8\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#555\">{}</text>",
            last + 4,
            last + 18,
            ns / 1000
        )?;
    }
    writeln!(
        out,
        "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#555\">time / µs</text>",
        x(panel.length / 2),
        last + 34
    )?;
    for (i, lane) in panel.lanes.iter().enumerate() {
        let y = first + LANE * i as u64;
        writeln!(out, "<text x=\"8\" y=\"{}\">{}</text>", y + 21, lane.name)?;
        for bar in &lane.bars {
            let (from, to) = (x(bar.from), x(bar.to));
            writeln!(
                out,
                "<rect x=\"{from:.1}\" y=\"{}\" width=\"{:.1}\" height=\"{}\" fill=\"{}\" \
                 stroke=\"#444\" stroke-width=\"0.6\"/>",
                y + 4,
                to - from,
                LANE - 8,
                bar.kind.colour()
            )?;
            if !bar.label.is_empty() {
                writeln!(
                    out,
                    "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                    (from + to) / 2.0,
                    y + 21,
                    bar.label
                )?;
            }
        }
    }
    for (ns, name) in &panel.marks {
        let at = x(*ns);
        writeln!(
            out,
            "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{}\" y2=\"{last}\" stroke=\"#c22\" \
             stroke-dasharray=\"4 3\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#c22\">{name}</text>",
            first - 6,
            first - 10
        )?;
    }
    Ok(())
}

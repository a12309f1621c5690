//! Line chart with logarithmic axes, as SVG.

use std::fmt::Write as _;

/// Axis with its ticks, the first and the last at its ends.
pub struct Axis {
    /// Text beside the axis.
    pub name: &'static str,
    /// Values of the ticks.
    pub ticks: &'static [f64],
}

/// Line of a chart.
pub struct Series {
    /// Text beside the line's end.
    pub name: &'static str,
    /// Points from left to right.
    pub points: Vec<(f64, f64)>,
}

/// Chart of several lines.
pub struct Chart {
    /// Text above the chart.
    pub title: &'static str,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Lines.
    pub series: Vec<Series>,
}

const LEFT: f64 = 70.0;
const TOP: f64 = 40.0;
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 330.0;
/// Colours that colour-blind readers tell apart (Okabe and Ito).
const COLOURS: [&str; 7] =
    ["#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"];

impl Chart {
    /// Draws the chart.
    #[must_use]
    pub fn svg(&self) -> String {
        let place = |axis: &Axis, value: f64| {
            let (low, high) = (axis.ticks[0], axis.ticks[axis.ticks.len() - 1]);
            (value / low).ln() / (high / low).ln()
        };
        let x = |value: f64| LEFT + WIDTH * place(&self.x, value);
        let y = |value: f64| TOP + HEIGHT * (1.0 - place(&self.y, value));
        let (bottom, right) = (TOP + HEIGHT, LEFT + WIDTH);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 900 430\" font-family=\"Helvetica, \
             Arial, sans-serif\" font-size=\"12\">\n<rect width=\"900\" height=\"430\" fill=\"white\"/>\n\
             <text x=\"{LEFT}\" y=\"22\" font-size=\"14\" font-weight=\"bold\">{}</text>\n",
            self.title
        );
        let mut line = |text: String| {
            let _ = writeln!(out, "{text}");
        };
        for tick in self.x.ticks {
            let at = x(*tick);
            line(format!(
                "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{bottom}\" stroke=\"#d8d8d8\"/>"
            ));
            line(format!(
                "<text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#555\">{tick}</text>",
                bottom + 18.0
            ));
        }
        for tick in self.y.ticks {
            let at = y(*tick);
            line(format!(
                "<line x1=\"{LEFT}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#d8d8d8\"/>"
            ));
            line(format!(
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#555\">{tick}</text>",
                LEFT - 6.0,
                at + 4.0
            ));
        }
        line(format!(
            "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            LEFT + WIDTH / 2.0,
            bottom + 40.0,
            self.x.name
        ));
        let middle = TOP + HEIGHT / 2.0;
        line(format!(
            "<text x=\"18\" y=\"{middle}\" text-anchor=\"middle\" transform=\"rotate(-90 18 {middle})\">{}</text>",
            self.y.name
        ));
        for (i, (series, colour)) in self.series.iter().zip(COLOURS).enumerate() {
            let points = series.points.iter().map(|(a, b)| format!("{:.1},{:.1}", x(*a), y(*b)));
            let points = points.collect::<Vec<_>>().join(" ");
            line(format!(
                "<polyline points=\"{points}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>"
            ));
            // A line ends at its fastest scan.
            if let Some((a, b)) = series.points.last() {
                line(format!(
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\" fill=\"{colour}\"/>",
                    x(*a),
                    y(*b)
                ));
            }
            let at = TOP + 16.0 + 20.0 * i as f64;
            line(format!(
                "<circle cx=\"{}\" cy=\"{}\" r=\"4\" fill=\"{colour}\"/>",
                right + 20.0,
                at - 4.0
            ));
            line(format!("<text x=\"{}\" y=\"{at}\">{}</text>", right + 30.0, series.name));
        }
        out + "</svg>\n"
    }
}

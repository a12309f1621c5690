//! The charts as pages that answer the mouse; they need no other file and no network.

use std::fmt::Write as _;

use plotly::common::{DashType, Line, Marker, MarkerSymbol, Mode};
use plotly::layout::{Axis, AxisType};
use plotly::{Layout, Plot, Scatter};
use plotters::style::RGBColor;

use taxel_sim::cost::Cost;

use crate::bars::Bar;
use crate::estimators::{Row, front};
use crate::failures::{FAILS, Map, Point, TRUSTED};
use crate::map::once;
use crate::methods::Group;
use crate::scatter::{GROUPS, Title, colour};
use crate::style::{COLOURS, GREY};

const WIDTH: usize = 860;
const HEIGHT: usize = 460;
/// With room for the names of all methods.
const HIGH: usize = 620;

/// A page of plots, one below the other.
pub(crate) fn page(title: &str, lead: &str, plots: impl Iterator<Item = Plot>) -> String {
    let mut page = format!(
        "<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title>\
         <body style=\"font-family:sans-serif;max-width:60em;margin:auto\"><h1>{title}</h1><p>{lead}</p>{}",
        Plot::offline_js_sources()
    );
    for (i, plot) in plots.enumerate() {
        // Writing into a string cannot fail.
        let _ = writeln!(page, "{}", plot.to_inline_html(Some(&format!("plot{i}"))));
    }
    page + "</body></html>\n"
}

/// The layout that all plots share.
pub(crate) fn layout(title: &str, x: &str, y: &str) -> Layout {
    let axis = |name: &str| Axis::new().title(name.to_owned()).type_(AxisType::Log);
    Layout::new()
        .title(title.to_owned())
        .width(WIDTH)
        .height(HEIGHT)
        .x_axis(axis(x))
        .y_axis(axis(y))
}

/// A colour as the web writes it.
pub(crate) fn hex(RGBColor(r, g, b): RGBColor) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Error over cost, a plot a quantity of a scene.
pub(crate) fn estimators(rows: &[Row], panels: &[Title<'_>]) -> String {
    let plots = panels.iter().map(|(scene, quantity)| {
        let of = |row: &&Row| row.scene == *scene && row.quantity == *quantity;
        let shown: Vec<&Row> = rows.iter().filter(of).collect();
        let mut plot = Plot::new();
        let front = front(&shown);
        let [x, y] = axes(&front);
        plot.add_trace(
            Scatter::new(x, y)
                .name("Pareto front of the matrix")
                .mode(Mode::Lines)
                .line(Line::new().color(hex(GREY))),
        );
        for (group, name) in GROUPS {
            let of: Vec<&Row> = shown.iter().copied().filter(|row| row.group == group).collect();
            if of.is_empty() {
                continue;
            }
            let [x, y] = axes(&of);
            let marker = Marker::new().size(10).color(hex(colour(group))).symbol(symbol(group));
            let names = of.iter().map(|row| told(row)).collect();
            plot.add_trace(
                Scatter::new(x, y).name(name).mode(Mode::Markers).marker(marker).text_array(names),
            );
        }
        let title = format!("{}, scene “{scene}”", quantity.name());
        let error = format!("RMSE / {}", quantity.unit());
        plot.set_layout(layout(&title, "modelled Cortex-M4F cycles an estimate", &error));
        plot
    });
    page(
        "Error over cost",
        "Root mean square error on runs that the fits have not seen, the mean over the devices, over the \
         modelled cycles of one estimate from conditioned signals. The front is that of what one can have out of the \
         optical matrix; crosses and open diamonds need the force sensors as well.",
        plots,
    )
}

/// Error over stated accuracy, a plot a sweep and a line a method; the mouse tells the figures of a point.
pub(crate) fn failures(maps: &[Map]) -> String {
    let plots = once(maps.iter().map(|map| map.sweep)).into_iter().map(|sweep| {
        let mut plot = Plot::new();
        let of = maps.iter().filter(|map| map.sweep == sweep);
        // Methods are more than colours: the second round is dashed, the third dotted.
        let looks = [DashType::Solid, DashType::Dash, DashType::Dot];
        let looks = looks.iter().flat_map(|dash| COLOURS.map(|colour| (dash.clone(), colour)));
        for (map, (dash, colour)) in of.zip(looks) {
            let mut points: Vec<&Point> = map.points.iter().collect();
            points.sort_by(|a, b| a.value.total_cmp(&b.value));
            let trace = |points: &[&Point]| {
                Scatter::new(
                    points.iter().map(|point| point.value.to_string()).collect(),
                    // No error at all has no place on this axis.
                    points.iter().map(|p| p.count.over_stated().filter(|of| *of > 0.0)).collect(),
                )
                .name(map.method.trim_end_matches(" / 1"))
                .legend_group(map.method)
                .text_array(points.iter().map(|point| figures(point)).collect::<Vec<String>>())
            };
            let line = Line::new().color(hex(colour)).dash(dash);
            plot.add_trace(trace(&points).mode(Mode::Lines).line(line));
            let marks: [Marked; 3] = [
                (MarkerSymbol::X, Point::silent),
                (MarkerSymbol::Circle, |point| !point.silent() && point.flagged()),
                (MarkerSymbol::CircleOpen, |point| !point.silent() && !point.flagged()),
            ];
            for (symbol, of) in marks {
                let marked: Vec<&Point> =
                    points.iter().copied().filter(|point| of(point)).collect();
                let marker = Marker::new().size(9).color(hex(colour)).symbol(symbol);
                plot.add_trace(
                    trace(&marked).mode(Mode::Markers).marker(marker).show_legend(false),
                );
            }
        }
        let x = Axis::new().title(sweep.to_owned()).type_(AxisType::Category);
        let y = Axis::new().title("error over stated accuracy").type_(AxisType::Log);
        plot.set_layout(
            Layout::new()
                .title(format!("Over {sweep}"))
                .width(WIDTH)
                .height(HIGH)
                .x_axis(x)
                .y_axis(y),
        );
        plot
    });
    let lead = format!(
        "RMS error of the values that were given over the accuracy that the finger states for them. Filled: most \
         values are flagged or withheld. A cross: more than {} % of the values are off by more than {FAILS} \
         times what is stated, and nothing says so. Where a method made no error at all it has no mark.",
        100.0 * TRUSTED
    );
    page("Where each method fails", &lead, plots)
}

/// A mark and the points that have it.
type Marked = (MarkerSymbol, fn(&Point) -> bool);

/// What the mouse is told of a point.
fn figures(point: &Point) -> String {
    let count = &point.count;
    let error =
        count.error().map_or_else(|| "no value".into(), |error| format!("error {error:.4}"));
    let [flagged, silent] =
        [count.flagged, count.silent].map(|frames| format!("{:.2} %", 100.0 * count.share(frames)));
    let within = if point.within { "; in the working range" } else { "" };
    format!("{error}, stated {:.4}; flagged {flagged}, silent {silent}{within}", count.stated())
}

/// A plot of bars.
pub(crate) fn bars(title: &str, lead: &str, bars: &[Bar]) -> String {
    let mut plot = Plot::new();
    for (own, colour) in [(true, COLOURS[0]), (false, COLOURS[4])] {
        let shown: Vec<&Bar> =
            bars.iter().filter(|bar| bar.long.is_some() && bar.own == own).collect();
        let long = shown.iter().filter_map(|bar| bar.long).collect::<Vec<f64>>();
        // What stands behind a comma has no room below a bar.
        let name = |bar: &&Bar| bar.name.split(", ").next().unwrap_or_default().to_owned();
        let told = shown.iter().map(|bar| format!("{}: {}", bar.name, bar.told)).collect();
        plot.add_trace(
            plotly::Bar::new(shown.iter().map(name).collect(), long)
                .hover_text_array(told)
                .marker(Marker::new().color(hex(colour)))
                .show_legend(false),
        );
    }
    plot.set_layout(Layout::new().title(title.to_owned()).width(WIDTH).height(HEIGHT));
    let told: String =
        bars.iter().map(|bar| format!("<li>{}: {}</li>", bar.name, bar.told)).collect();
    page(title, &format!("{lead}<ul>{told}</ul>"), std::iter::once(plot))
}

/// Error over time of a frame, a plot a scene.
pub(crate) fn simulator(costs: &[Cost]) -> String {
    let mut scenes: Vec<&str> = costs.iter().map(|cost| cost.scene).collect();
    scenes.dedup();
    let plots = scenes.into_iter().map(|scene| {
        // The rung that the others are measured against has no error, and no place on this axis.
        let of = costs.iter().filter(|cost| cost.scene == scene && cost.error > 0.0);
        let rungs: Vec<&Cost> = of.collect();
        let mut plot = Plot::new();
        let name = |cost: &&Cost| format!("{}{}", cost.rung, if cost.auto { ", auto" } else { "" });
        let trace = Scatter::new(
            rungs.iter().map(|cost| cost.us_per_frame).collect(),
            rungs.iter().map(|cost| cost.error).collect(),
        );
        plot.add_trace(
            trace
                .mode(Mode::LinesMarkers)
                .line(Line::new().color(hex(COLOURS[0])))
                .text_array(rungs.iter().map(name).collect::<Vec<String>>()),
        );
        let title = format!("Scene “{scene}”");
        plot.set_layout(layout(&title, "µs per frame in contact", "worst error of a facet"));
        plot
    });
    page(
        "What the simulator's rungs cost",
        "Worst error of a facet, a share of the largest displacement, over the time of a frame in contact.",
        plots,
    )
}

fn axes(rows: &[&Row]) -> [Vec<f64>; 2] {
    [rows.iter().map(|row| row.cost.cycles()).collect(), rows.iter().map(|row| row.rmse).collect()]
}

fn told(row: &Row) -> String {
    let cost = row.cost;
    format!(
        "{}: {} to {} cycles, {} instructions",
        row.name, cost.cycles_low, cost.cycles_high, cost.instructions
    )
}

fn symbol(group: Group) -> MarkerSymbol {
    match group {
        Group::Model => MarkerSymbol::Diamond,
        Group::Finger => MarkerSymbol::DiamondOpen,
        Group::Paper => MarkerSymbol::TriangleUp,
        Group::Polynomial => MarkerSymbol::Square,
        Group::Net => MarkerSymbol::CircleOpen,
        Group::Skip => MarkerSymbol::Circle,
        Group::Quantised => MarkerSymbol::SquareOpen,
        Group::QuantisedSkip => MarkerSymbol::Square,
        Group::Sensors => MarkerSymbol::X,
    }
}

//! The scan's timing, read off the pins, as a table for a spreadsheet or a plot.

use std::fmt::Write as _;

use super::finger::{Moment, Source};
use super::time::{HZ, Tick};

/// A line a moment: nanoseconds since the first of them, what happened, rows or input.
pub fn csv(timing: &[(Tick, Moment)]) -> String {
    let begin = timing.first().map_or(0, |(at, _)| *at);
    let mut text = "t_ns,event,rows,sensor,input\n".to_owned();
    for (at, moment) in timing {
        let ns = (at - begin) as f64 * 1e9 / HZ as f64;
        let line = match moment {
            Moment::Pattern(rows, sensor) => format!("{ns:.1},pattern,{rows:04b},{sensor},"),
            Moment::Sample(source) => format!("{ns:.1},sample,,,{}", input(*source)),
        };
        // Writing to a string does not fail.
        let _ = writeln!(text, "{line}");
    }
    text
}

fn input(source: Source) -> String {
    match source {
        Source::Pin(pin) => pin.to_owned(),
        Source::Amplifier(which) => format!("OPAMP{}", which + 2),
        Source::Temperature => "temperature".to_owned(),
        Source::Reference => "reference".to_owned(),
    }
}

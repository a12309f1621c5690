//! Timing diagram of the board's page, drawn from events on the emulated pins.

use super::finger::Moment;
use super::time::{HZ, Tick};
use scan_plan::drawing::{self, Bar, Kind, Lane, Panel};

/// Number of steps in a frame.
const STEPS: usize = 5;
/// Names of the LED rows' lanes.
const ROWS: [&str; 4] = ["PB9, row 0", "PB10, row 1", "PB11, row 2", "PB12, row 3"];

/// One step of the scan, from a pattern to the next; times in nanoseconds from its begin.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Step {
    /// Lit rows, one bit each.
    pub rows: u32,
    /// Sensor that the multiplexer connects.
    pub sensor: usize,
    /// Length of the step.
    pub length: u64,
    /// ADC1 on temperature and reference: from its trigger to the last result.
    pub internal: (u64, u64),
    /// ADC1 on the columns.
    pub columns: (u64, u64),
    /// ADC2 on the amplifiers' first inputs.
    pub first: (u64, u64),
    /// ADC2 on the bias, while the amplifiers settle on their second inputs.
    pub bias: (u64, u64),
    /// ADC2 on the amplifiers' second inputs.
    pub second: (u64, u64),
    /// Switch of the amplifiers to their second inputs.
    pub turned: u64,
}

/// Complete steps in `timing`.
pub fn steps(timing: &[(Tick, Moment)]) -> Vec<Step> {
    let is_pattern = |(_, moment): &(Tick, Moment)| matches!(moment, Moment::Pattern(..));
    let begins: Vec<usize> =
        timing.iter().enumerate().filter(|(_, at)| is_pattern(at)).map(|(i, _)| i).collect();
    begins
        .windows(2)
        .filter_map(|pair| {
            let (begin, Moment::Pattern(rows, sensor)) = timing[pair[0]] else { return None };
            let ns = |at: Tick| ((at - begin) as f64 * 1e9 / HZ as f64).round() as u64;
            let within = &timing[pair[0] + 1..pair[1]];
            let moments = |wanted: Moment| -> Vec<u64> {
                within.iter().filter(|(_, m)| *m == wanted).map(|(at, _)| ns(*at)).collect()
            };
            let (triggers, results) = (moments(Moment::Trigger(0)), moments(Moment::Result(0)));
            let [slow, columns] = triggers[..] else { return None };
            let [_, internal, _, _, _, last] = results[..] else { return None };
            let [bridges] = moments(Moment::Trigger(1))[..] else { return None };
            let [_, first, bias, _, second] = moments(Moment::Result(1))[..] else { return None };
            let turned = within.iter().find_map(|(at, moment)| match moment {
                Moment::Turn(0, 1) => Some(ns(*at)),
                _ => None,
            });
            Some(Step {
                rows,
                sensor,
                length: ns(timing[pair[1]].0),
                internal: (slow, internal),
                columns: (columns, last),
                first: (bridges, first),
                bias: (first, bias),
                second: (bias, second),
                turned: turned?,
            })
        })
        .collect()
}

/// Diagram as SVG with a lit step and a whole frame; `None` without a whole frame.
pub fn svg(timing: &[(Tick, Moment)]) -> Option<String> {
    let steps = steps(timing);
    let dark = steps.iter().position(|step| step.rows == 0)?;
    let frames = steps.get(dark..=dark + STEPS)?;
    Some(drawing::svg(&[step_panel(&frames[1]), frame_panel(frames)]))
}

fn bar((from, to): (u64, u64), label: &str, kind: Kind) -> Bar {
    Bar { from, to, label: label.to_owned(), kind }
}

fn step_panel(step: &Step) -> Panel {
    let lanes = vec![
        Lane {
            name: "LED row, mux",
            bars: vec![
                bar((0, step.columns.0), "light settles", Kind::Wait),
                bar((step.columns.0, step.length), "settled", Kind::Light),
            ],
        },
        Lane {
            name: "ADC1",
            bars: vec![
                bar(step.internal, "temp., ref.", Kind::Internal),
                bar(step.columns, "columns 0–3", Kind::Columns),
            ],
        },
        Lane {
            name: "amplifiers",
            bars: vec![
                bar((0, step.first.0), "settle", Kind::Wait),
                bar((step.first.0, step.turned), "on A and C", Kind::Bridges),
                bar((step.turned, step.second.0), "settle", Kind::Wait),
                bar((step.second.0, step.second.1), "on B and D", Kind::Bridges),
            ],
        },
        Lane {
            name: "ADC2",
            bars: vec![
                bar(step.first, "A, C", Kind::Bridges),
                bar(step.bias, "bias", Kind::Internal),
                bar(step.second, "B, D", Kind::Bridges),
            ],
        },
    ];
    Panel {
        title: format!("One step of {:.1} µs, from its pattern on", step.length as f64 / 1e3),
        length: step.length,
        tick: 5_000,
        lanes,
        marks: vec![(step.internal.0, "both ADCs"), (step.columns.0, "ADC1")],
    }
}

fn frame_panel(frames: &[Step]) -> Panel {
    let begins: Vec<u64> = frames
        .iter()
        .scan(0, |sum, step| {
            let begin = *sum;
            *sum += step.length;
            Some(begin)
        })
        .collect();
    let lane = |name, bars: &dyn Fn(&Step, u64) -> Vec<Bar>| Lane {
        name,
        bars: frames.iter().zip(&begins).flat_map(|(step, begin)| bars(step, *begin)).collect(),
    };
    let shifted = |(from, to): (u64, u64), begin: u64| (from + begin, to + begin);
    let rows = ROWS.iter().enumerate().map(|(row, name)| {
        lane(name, &|step, begin| {
            let lit = step.rows >> row & 1 == 1;
            lit.then(|| bar((begin, begin + step.length), "lit", Kind::Light)).into_iter().collect()
        })
    });
    let mut lanes: Vec<Lane> = rows.collect();
    lanes.push(lane("multiplexer", &|step, begin| {
        let sensor = format!("sensor {}", step.sensor);
        vec![bar((begin, begin + step.length), &sensor, Kind::Wait)]
    }));
    lanes.push(lane("ADC1", &|step, begin| {
        vec![
            bar(shifted(step.internal, begin), "", Kind::Internal),
            bar(shifted(step.columns, begin), "columns", Kind::Columns),
        ]
    }));
    lanes.push(lane("ADC2", &|step, begin| {
        vec![
            bar(shifted(step.first, begin), "A, C", Kind::Bridges),
            bar(shifted(step.bias, begin), "", Kind::Internal),
            bar(shifted(step.second, begin), "B, D", Kind::Bridges),
        ]
    }));
    let length = frames.iter().map(|step| step.length).sum();
    let title = "One frame: dark and four rows, and the next one's dark step".to_owned();
    let marks = begins.get(STEPS).map(|begin| (*begin, "next frame")).into_iter().collect();
    Panel { title, length, tick: 50_000, lanes, marks }
}

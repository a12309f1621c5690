//! Tests of the boards' pages: pins and timing must match the tables and plans of the firmware.
//!
//! `TAXEL_DRAW=1 cargo test --package scan-plan` draws the pictures and the rows of times again.

use std::path::{Path, PathBuf};

use scan_plan::pins::{F411, G431, Pin};
use scan_plan::{STEPS, Step};

use crate::{f411, g431};
use scan_plan::drawing::{Bar, Kind, Lane, Panel, svg};

/// Longest time for USB full speed to fetch a frame, nanoseconds.
const USB_NS: u64 = 150_000;
/// Longest time from a result to memory, core cycles.
///
/// Three DMA channels request at once, and each takes 5 cycles.
const DMA_CYCLES: u32 = 3 * 5;

pub fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/boards")
}

pub fn page(board: &str) -> String {
    std::fs::read_to_string(docs().join(board).with_extension("md")).unwrap()
}

#[test]
fn pages_match_the_firmwares_pin_tables() {
    let pages =
        [("stm32g431", &G431[..]), ("stm32f411", &F411[..]), ("weact-stm32g431", &G431[..])];
    for (board, pins) in pages {
        let page = page(board);
        // A page may add columns behind those of the pin table.
        let three = |line: &str| line.splitn(5, '|').take(4).collect::<Vec<_>>().join("|") + "|";
        let names_pin =
            |line: &&str| line.starts_with("| P") && line.as_bytes()[4].is_ascii_digit();
        let rows: Vec<_> = page.lines().filter(names_pin).map(three).collect();
        let row = |pin: &Pin| {
            let port = char::from(b'A' + pin.port);
            format!("| P{port}{} | {} | {} |", pin.number, pin.function, pin.role)
        };
        let expected: Vec<_> = pins.iter().map(row).collect();
        assert_eq!(rows, expected, "{board}");
    }
}

#[test]
fn pages_match_the_plans_times_and_drawings() {
    let product = product();
    let black_pill = black_pill();
    for (board, timing) in [("stm32g431", product), ("stm32f411", black_pill)] {
        let mut page = page(board);
        let us = |ns: u64| ns as f64 / 1000.0;
        let rows = timing.table.iter().map(|(what, from, to)| {
            (*what, format!("| {what} | {:.2} µs | {:.2} µs |", us(*from), us(*to)))
        });
        let drawn = svg(&timing.panels);
        let path = docs().join(format!("{board}-timing.svg"));
        if std::env::var_os("TAXEL_DRAW").is_some() {
            std::fs::write(&path, &drawn).unwrap();
            for (what, row) in rows.clone() {
                let begin = format!("| {what} | ");
                let its = page.lines().find(|line| line.starts_with(&begin)).map(str::to_owned);
                page = its.map_or(page.clone(), |its| page.replace(&its, &row));
            }
            std::fs::write(docs().join(board).with_extension("md"), &page).unwrap();
        }
        let missing: Vec<_> =
            rows.filter(|(_, row)| !page.contains(row)).map(|(_, row)| row).collect();
        let there = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(there == drawn, "{} is not the plan's: draw it with TAXEL_DRAW=1", path.display());
        assert!(missing.is_empty(), "not on the page of {board}:\n{}", missing.join("\n"));
    }
}

/// Number of cycles in a row of a board's page.
///
/// The emulator's tests compare the rows with the emulated board.
fn cycles(board: &str, row: &str) -> u32 {
    let page = page(board);
    let line = page.lines().find(|line| line.starts_with(&format!("| {row} |")));
    let cell = line.unwrap_or_else(|| panic!("{board}: no row `{row}`")).split('|').nth(2).unwrap();
    cell.chars().filter(char::is_ascii_digit).collect::<String>().parse().unwrap()
}

const FRAME_OF_ESTIMATES: &str = "**a frame of estimates**";

struct Timing {
    /// Rows of label, begin and end: nanoseconds within a step, or within two frames.
    table: Vec<(&'static str, u64, u64)>,
    panels: Vec<Panel>,
}

fn bar(from: u64, to: u64, label: &str, kind: Kind) -> Bar {
    Bar { from, to, label: label.to_owned(), kind }
}

fn product() -> Timing {
    let plan = scan_plan::g431::plan(g431::DEFAULT).unwrap();
    let step = plan.step;
    let line = g431::line(&plan);
    // The time line counts half ticks.
    let span = |conversions: &[g431::Conversion]| {
        let (first, last) = (conversions.first().unwrap(), conversions.last().unwrap());
        let ns = |halves: u64| u64::from(step.ns((halves / 2) as u32));
        (ns(first.samples.first().unwrap().start), ns(last.end))
    };
    let [light, slow] = [step.light, step.slow].map(|ticks| u64::from(step.ns(ticks)));
    let internal = span(&line.internal);
    let columns = span(&line.columns);
    let [first, bias, second] =
        [&line.bridges[..2], &line.bridges[2..3], &line.bridges[3..]].map(span);
    let table = vec![
        ("settle time of the light", light, u64::from(step.ns(step.columns))),
        ("amplifiers settle behind the multiplexer", light, slow),
        ("ADC2: midpoints A, C, 8 samples each", first.0, first.1),
        ("ADC1: temperature, reference", internal.0, internal.1),
        ("ADC2: bias, while the amplifiers turn to B, D", bias.0, bias.1),
        ("ADC2: midpoints B, D, 8 samples each", second.0, second.1),
        ("ADC1: four columns, 8 samples each", columns.0, columns.1),
        (
            "spare, after the last sample",
            u64::from(step.ns(step.done)),
            u64::from(step.ns(step.top + 1)),
        ),
    ];
    let lanes = vec![
        light_lane(&step),
        Lane {
            name: "ADC1",
            bars: vec![
                bar(internal.0, internal.1, "temp., ref.", Kind::Internal),
                bar(columns.0, columns.1, "columns 0–3", Kind::Columns),
            ],
        },
        Lane {
            name: "amplifiers",
            bars: vec![
                bar(light, slow, "", Kind::Wait),
                bar(slow, first.1, "on A and C", Kind::Bridges),
                bar(bias.0, bias.1, "settle", Kind::Wait),
                bar(bias.1, second.1, "on B and D", Kind::Bridges),
            ],
        },
        Lane {
            name: "ADC2",
            bars: vec![
                bar(first.0, first.1, "A, C", Kind::Bridges),
                bar(bias.0, bias.1, "bias", Kind::Internal),
                bar(second.0, second.1, "B, D", Kind::Bridges),
            ],
        },
    ];
    let after = After::new("stm32g431", &step, columns.1.max(second.1));
    let panels = vec![
        step_panel(&step, lanes),
        frame_panel(&after, [("ADC1 → DMA", columns), ("ADC2 → DMA", (first.0, second.1))]),
    ];
    let table = [table, after.rows()].concat();
    Timing { table, panels }
}

fn black_pill() -> Timing {
    let plan = scan_plan::f411::plan(f411::DEFAULT).unwrap();
    let step = plan.step;
    let span = |conversions: Vec<(crate::common::Span, u64)>| {
        let ns = |ticks: u64| u64::from(step.ns(ticks as u32));
        (ns(conversions.first().unwrap().0.start), ns(conversions.last().unwrap().1))
    };
    let inputs = f411::regular(&plan);
    let all = f411::conversions(&plan, &inputs, plan.timer.ccr2);
    let (columns, midpoints) = (span(all[..4].to_vec()), span(all[4..].to_vec()));
    // Temperature and reference alternate and take equally long.
    let internal = span(f411::conversions(&plan, &f411::injected(&plan)[..1], plan.timer.ccr3));
    let table = vec![
        (
            "settle time of the light",
            u64::from(step.ns(step.light)),
            u64::from(step.ns(step.columns)),
        ),
        ("temperature or reference", internal.0, internal.1),
        ("four columns", columns.0, columns.1),
        ("midpoints A, B, C, D", midpoints.0, midpoints.1),
        (
            "spare, after the last sample",
            u64::from(step.ns(step.done)),
            u64::from(step.ns(step.top + 1)),
        ),
    ];
    let lanes = vec![
        light_lane(&step),
        Lane {
            name: "ADC1",
            bars: vec![
                bar(internal.0, internal.1, "temp. or ref.", Kind::Internal),
                bar(columns.0, columns.1, "col.", Kind::Columns),
                bar(midpoints.0, midpoints.1, "A–D", Kind::Bridges),
            ],
        },
    ];
    let after = After::new("stm32f411", &step, midpoints.1);
    let panels = vec![
        step_panel(&step, lanes),
        frame_panel(&after, [("columns → DMA", columns), ("bridges → DMA", midpoints)]),
    ];
    let table = [table, after.rows()].concat();
    Timing { table, panels }
}

fn light_lane(step: &Step) -> Lane {
    let [light, columns, end] =
        [step.light, step.columns, step.top + 1].map(|ticks| u64::from(step.ns(ticks)));
    Lane {
        name: "LED row, mux",
        bars: vec![
            bar(light, columns, "light settles", Kind::Wait),
            bar(columns, end, "settled", Kind::Light),
        ],
    }
}

fn step_panel(step: &Step, lanes: Vec<Lane>) -> Panel {
    let ns = |ticks| u64::from(step.ns(ticks));
    Panel {
        title: format!("One step of {} µs", ns(step.top + 1) / 1000),
        length: ns(step.top + 1),
        tick: 5_000,
        lanes,
        marks: vec![(ns(step.light), "A"), (ns(step.slow), "C"), (ns(step.columns), "B")],
    }
}

/// Times of a frame's processing during the next scan, in nanoseconds.
struct After {
    period: u64,
    converted: u64,
    complete: u64,
    computed: u64,
    fetched: u64,
}

impl After {
    /// Computes the times; `converted` is the end of a step's last conversion.
    fn new(board: &str, step: &Step, converted: u64) -> Self {
        let period = u64::from(step.ns(step.top + 1));
        let converted = (u64::from(STEPS) - 1) * period + converted;
        let complete = converted + u64::from(step.ns(DMA_CYCLES));
        let computed = complete + u64::from(step.ns(cycles(board, FRAME_OF_ESTIMATES)));
        Self { period, converted, complete, computed, fetched: computed + USB_NS }
    }

    fn rows(&self) -> Vec<(&'static str, u64, u64)> {
        vec![
            ("five steps, and the last result", 0, self.converted),
            ("DMA: the last reading to memory", self.converted, self.complete),
            ("compute: interrupt, estimates, sending", self.complete, self.computed),
            ("USB: the host fetches it, at most", self.computed, self.fetched),
        ]
    }
}

/// Diagram of a frame, and of its processing during the next scan.
fn frame_panel(after: &After, converted: [(&'static str, (u64, u64)); 2]) -> Panel {
    let After { period, complete, computed, fetched, .. } = *after;
    let steps = u64::from(STEPS);
    let names = ["dark", "row 0", "row 1", "row 2", "row 3"];
    let rows = (0..2 * steps).map(|i| {
        let name = names[(i % steps) as usize];
        bar(
            i * period,
            (i + 1) * period,
            name,
            if i % steps == 0 { Kind::Wait } else { Kind::Light },
        )
    });
    let mut lanes = vec![Lane { name: "step", bars: rows.collect() }];
    for ((name, (from, to)), kind) in converted.into_iter().zip([Kind::Columns, Kind::Bridges]) {
        let bars = (0..2 * steps).map(|i| bar(i * period + from, i * period + to, "", kind));
        lanes.push(Lane { name, bars: bars.collect() });
    }
    lanes.push(Lane {
        name: "CPU, at most",
        bars: vec![bar(complete, computed, "read, estimate, send", Kind::Compute)],
    });
    lanes.push(Lane {
        name: "USB, at most",
        bars: vec![bar(computed, fetched, "host fetches it", Kind::Internal)],
    });
    Panel {
        title: "One frame of five steps, and what becomes of it during the next".to_owned(),
        length: fetched.max(2 * steps * period),
        tick: 50_000,
        lanes,
        marks: vec![(complete, "frame complete")],
    }
}

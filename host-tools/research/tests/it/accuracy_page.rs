//! Checks that `docs/accuracy.md` quotes the tables next to its pictures.

use std::collections::HashMap;

use taxel_research::detection;
use taxel_research::failures::{self, Of};
use taxel_research::throughput::{FLOORS, PLAINLY};

const PAGE: &str = include_str!("../../../../docs/accuracy.md");
const EMULATOR: &str = include_str!("../../../../docs/emulator.md");
const ESTIMATORS: &str = include_str!("../../../../docs/images/estimators.csv");
const BOUNDARIES: &str = include_str!("../../../../docs/images/boundaries.csv");
const COSTS: &str = include_str!("../../../emulator/data/cycles.csv");
const DETECTION: &str = include_str!("../../data/detection.csv");
const EDGE: &str = include_str!("../../../../docs/images/edge.csv");
const PEERS: &str = include_str!("../../../../docs/images/peers.csv");
const SEEK: &str = include_str!("../../../../docs/images/seek.csv");
const THROUGHPUT: &str = include_str!("../../../../docs/images/throughput.csv");

fn rows(table: &str) -> Vec<HashMap<String, String>> {
    csv::Reader::from_reader(table.as_bytes()).deserialize().map(Result::unwrap).collect()
}

fn number(row: &HashMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column} of {row:?}"))
}

fn cycles(row: &HashMap<String, String>) -> f64 {
    (number(row, "cycles_low") + number(row, "cycles_high")) / 2.0
}

/// Fails with the lines that the page lacks.
fn assert_page_has(lines: &[String]) {
    let missing: Vec<&String> = lines.iter().filter(|line| !PAGE.contains(*line)).collect();
    assert!(missing.is_empty(), "docs/accuracy.md lacks, with today's figures:\n{missing:#?}");
}

#[test]
fn methods_table_quotes_estimators_csv() {
    let table = rows(ESTIMATORS);
    let methods = [
        "arg-min",
        "centroid",
        "q15 net 16-12-1",
        "net 16-12-1",
        "q15 net 16-16-3",
        "net 16-16-3",
        "skip 16-16-3",
        "model",
        "four sensors",
        "four sensors' wrench",
        "four sensors' wrench by 6x12",
        "finger",
    ];
    let lines: Vec<String> = methods
        .into_iter()
        .map(|name| {
            let of = |scene: &str, quantity: &str| {
                let mut found = table.iter().filter(|row| row["name"] == name);
                found.find(|row| row["scene"] == scene && row["quantity"] == quantity)
            };
            let cell = |scene, quantity, times: f64, unit| match of(scene, quantity) {
                Some(row) if unit == "mN" => format!("{:.1} mN", times * number(row, "rmse")),
                Some(row) => format!("{:.2} {unit}", times * number(row, "rmse")),
                None => "–".into(),
            };
            let mut costs: Vec<String> = table
                .iter()
                .filter(|row| row["name"] == name)
                .map(|row| format!("{:.1}k", cycles(row) / 1e3))
                .collect();
            // The finger's cost depends on the kind of scene.
            costs.sort_unstable();
            costs.dedup();
            format!(
                "| {name} | {} | {} | {} | {} | {} |",
                cell("presses", "normal force", 1e3, "mN"),
                cell("shear", "shear force", 1e3, "mN"),
                cell("presses", "contact point", 1.0, "mm"),
                cell("shear", "contact point", 1.0, "mm"),
                costs.join(" to ")
            )
        })
        .collect();
    assert_page_has(&lines);
}

#[test]
fn scene_costs_quote_cycles_csv() {
    let table = rows(COSTS);
    for (kind, seldom) in [
        ("no contact", "no frame due"),
        ("normal contact", "frames at 1 kHz"),
        ("shear", "frames at 1 kHz"),
        ("two contacts", "frames at 1 kHz"),
    ] {
        let row = |frames: &str| {
            let stage = format!("finger: {kind}, {frames}");
            table.iter().find(|row| row["name"] == stage).unwrap()
        };
        let mean =
            |row: &_| (number(row, "mean_cycles_low") + number(row, "mean_cycles_high")) / 2e3;
        let (often, seldom) = (row("estimates"), row(seldom));
        let worst = cycles(often).max(cycles(seldom)) / 1e3;
        let figures = format!("| {:.1}k | {:.1}k | {worst:.1}k |", mean(seldom), mean(often));
        let line = PAGE.lines().find(|line| line.starts_with(&format!("| {kind} | ")));
        let line = line.unwrap_or_else(|| panic!("docs/accuracy.md has no row `{kind}`"));
        assert!(line.ends_with(&figures), "docs/accuracy.md: {line}\nshould end: {figures}");
    }
}

#[test]
fn shear_error_growth_quotes_edge_csv() {
    let table = rows(EDGE);
    let lines: Vec<String> = ["net", "model", "finger"]
        .into_iter()
        .map(|method| {
            let at = |distance: f64| {
                let mut own = table.iter().filter(|row| row["method"] == method);
                let row = own.find(|row| number(row, "distance_mm") == distance).unwrap();
                let cell = |column| match row[column].parse::<f64>() {
                    Ok(rmse) => format!("{:.1}", 1e3 * rmse),
                    Err(_) => "–".into(),
                };
                format!("{} / {}", cell("fx_rmse_n"), cell("fy_rmse_n"))
            };
            format!("| {method} | {} | {} | {} | {} |", at(0.0), at(2.0), at(3.75), at(5.0))
        })
        .collect();
    assert_page_has(&lines);
}

#[test]
fn other_sensors_table_quotes_estimators_csv() {
    let table = rows(ESTIMATORS);
    let papers = ["DeMaria2011", "Ohka2004", "Ohka2005", "Ospina2017"];
    let own = table.iter().filter(|row| papers.iter().any(|key| row["name"].starts_with(key)));
    let lines: Vec<String> = own
        .map(|row| {
            let (unit, rmse) = (row["unit"].as_str(), number(row, "rmse"));
            let error = match unit {
                "N" => format!("{:.2} mN", 1e3 * rmse),
                "°" => format!("{rmse:.1}°"),
                _ => format!("{rmse:.3} {unit}"),
            };
            let (name, scene, quantity) = (&row["name"], &row["scene"], &row["quantity"]);
            format!("| {name} | `{scene}` | {quantity} | {error} | {:.0} |", cycles(row))
        })
        .collect();
    assert!(lines.len() > 10, "{lines:?}");
    assert_page_has(&lines);
}

#[test]
fn silent_failures_table_quotes_boundaries_csv() {
    let alone: Vec<&str> = failures::methods(Of::Matrix).collect();
    let table = rows(BOUNDARIES);
    let line = |label: &str, of: &dyn Fn(&str) -> bool| {
        let sum = |column| -> f64 {
            let rows = table.iter().filter(|row| of(&row["method"]));
            rows.map(|row| number(row, column)).sum()
        };
        let share = |part, whole| {
            let whole = sum(whole);
            if whole > 0.0 { format!("{:.3} %", 100.0 * sum(part) / whole) } else { "–".into() }
        };
        format!(
            "| {label} | {} | {} | {} | {:.1} million |",
            share("silent", "frames"),
            share("silent_within_range", "within_range"),
            share("flagged_within_range", "within_range"),
            sum("frames") / 1e6
        )
    };
    let mut lines = Vec::new();
    let mut named: Vec<&str> = table.iter().map(|row| row["method"].as_str()).collect();
    named.sort_unstable();
    named.dedup();
    for name in named {
        lines.push(line(name.split(" / ").next().unwrap(), &|method| method == name));
    }
    lines.push(line("**the finger, together**", &|method| !alone.contains(&method)));
    lines.push(line("**the matrix alone, together**", &|method| alone.contains(&method)));
    lines.push(line("everything", &|_| true));
    assert_page_has(&lines);
}

#[test]
fn net_ratios_quote_peers_csv() {
    let table = rows(PEERS);
    let library = |row: &HashMap<String, String>| row["name"].split(',').next().unwrap().to_owned();
    let find = |name: &str| table.iter().find(|row| library(row) == name).unwrap();
    let bounds = |row: &_| {
        format!("{:.0} to {:.0}", number(row, "cycles_least"), number(row, "cycles_most"))
    };
    let own = |name: &str| find(if name.contains("q15") { "taxel q15" } else { "taxel" });
    let ratio = |name: &str| cycles(find(name)) / cycles(own(name));
    let mut lines: Vec<String> = table
        .iter()
        .filter(|row| !row["cycles_low"].is_empty())
        .map(|row| {
            let name = library(row);
            let ratio = match name.starts_with("taxel") {
                true => "1".into(),
                false => format!("{:.2}", ratio(&name)),
            };
            let (cycles, error) = (cycles(row), &row["max_error"]);
            format!("| {name} | {cycles:.0} | {} | {ratio} | {error} N |", bounds(row))
        })
        .collect();
    assert!(lines.len() > 6 && table[0]["name"] == "taxel", "{lines:?}");
    for library in ["CMSIS-DSP", "emlearn"] {
        assert!(number(own(library), "max_error") <= number(find(library), "max_error"));
    }
    lines.push(format!(
        "{:.2} times fewer cycles than CMSIS-DSP (aim: 2.8) and {:.2} times fewer than emlearn (aim: 3.5)",
        ratio("CMSIS-DSP"),
        ratio("emlearn")
    ));
    lines.push(format!(
        "{:.2} and {:.2} times fewer",
        ratio("CMSIS-DSP with taxel's tanh"),
        ratio("emlearn with taxel's tanh")
    ));
    assert_page_has(&lines);
    let [low, high] = ["cycles_low", "cycles_high"].map(|column| number(&table[0], column));
    let bounds = bounds(&table[0]);
    let line = format!("net takes {bounds} cycles, and the table says {low:.0} to {high:.0}.");
    assert!(EMULATOR.contains(&line), "docs/emulator.md lacks, with today's figures: {line}");
}

#[test]
fn host_throughput_quotes_throughput_csv() {
    let table = rows(THROUGHPUT);
    let us = |stage: &str| {
        let row = table.iter().find(|row| row["stage"] == stage);
        row.map(|row| number(row, "us_per_frame"))
    };
    let mut lines = Vec::new();
    for stage in table.iter().map(|row| &row["stage"]).filter(|stage| !stage.ends_with(PLAINLY)) {
        let own = us(stage).unwrap();
        let other = us(&format!("{stage}{PLAINLY}"));
        let other = other.map(|other| format!("{other:.1} µs | {:.1}", other / own));
        lines.push(format!("| {stage} | {own:.1} µs | {} |", other.as_deref().unwrap_or("| ")));
    }
    for (stage, floor) in FLOORS {
        let ratio = us(&format!("{stage}{PLAINLY}")).unwrap() / us(stage).unwrap();
        assert!(ratio >= floor, "throughput.csv: {stage}: {ratio:.2} times, at least {floor}");
    }
    let read = us("read a trace (CSV)").unwrap();
    let replay = us("replay a trace into frames (CSV)").unwrap();
    lines.push(format!(
        "{:.0} 000 rows a second are read, {:.0} 000 frames a second replayed",
        1e3 / read,
        1e3 / replay
    ));
    assert_page_has(&lines);
}

#[test]
fn seeking_quotes_seek_csv() {
    let lines: Vec<String> = rows(SEEK)
        .iter()
        .map(|row| {
            let [whole, index] = ["whole_ms", "index_ms"].map(|column| number(row, column));
            format!(
                "| {} | {:.1} s | {index:.0} ms | {:.0} |",
                row["format"],
                whole / 1e3,
                whole / index
            )
        })
        .collect();
    assert_eq!(lines.len(), 2, "MCAP and Parquet have an index: {lines:?}");
    assert_page_has(&lines);
}

/// Lists panels, as `quantity of scene`, in which a cheaper row of `among` errs no more than `own`.
fn beaten(own: &str, among: impl Fn(&str) -> bool) -> Vec<String> {
    let table = rows(ESTIMATORS);
    let beats = |own: &HashMap<String, String>, row: &HashMap<String, String>| {
        among(&row["name"])
            && row["scene"] == own["scene"]
            && row["quantity"] == own["quantity"]
            && cycles(row) < cycles(own)
            && number(row, "rmse") <= number(own, "rmse")
    };
    let shown = table.iter().filter(|row| row["name"] == own);
    let behind = shown.filter(|own| table.iter().any(|row| beats(own, row)));
    behind.map(|own| format!("{} of `{}`", own["quantity"], own["scene"])).collect()
}

fn of_matrix(name: &str) -> bool {
    let sensors = ["four sensors", "finger", "slip: both", "slip: force sensors"];
    !sensors.iter().any(|begin| name.starts_with(begin))
}

/// Checks the page's line about panels in which `own` is not on the front.
fn assert_front_line(own: &str, beaten: &[String]) {
    let label = format!("  - `{own}` is not on the front for ");
    let line = PAGE.lines().find(|line| line.starts_with(&label)).unwrap_or_default();
    let expected = format!("{label}{}", beaten.join(", "));
    assert!(
        if beaten.is_empty() { line.is_empty() } else { line == expected },
        "docs/accuracy.md should say: {expected}"
    );
}

/// The firmware's default methods: of the matrix alone, and of the finger.
///
/// A method that needs force sensors does not compete with the matrix, because it needs other
/// hardware.
#[test]
fn page_lists_panels_with_default_off_the_front() {
    for own in ["model", "slip: matrix"] {
        assert_front_line(own, &beaten(own, of_matrix));
    }
    // A finger with both parts can choose from every method.
    for own in ["finger", "slip: both"] {
        assert_front_line(own, &beaten(own, |_| true));
    }
}

#[test]
fn faults_of_channels_quote_detection_csv() {
    let section = detection::section(&detection::parse(DETECTION).unwrap());
    assert!(section.lines().count() > 30, "{section}");
    assert!(
        PAGE.contains(&section),
        "docs/accuracy.md: draw it with `taxel-research detection --draw`"
    );
}

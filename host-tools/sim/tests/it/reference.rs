//! `docs/scenes.md` against the parser: its example runs, and its tables match the parser.
//!
//! The tables must have every key, default and limit of the parser.

use std::collections::BTreeSet;

use taxel_sim::{Scene, Simulator};

const PAGE: &str = include_str!("../../../../docs/scenes.md");

/// Row of a table.
#[derive(Debug)]
struct Row {
    key: &'static str,
    /// Kinds of the table that have the key; empty where all have it.
    kinds: Vec<&'static str>,
    default: &'static str,
    allowed: &'static str,
}

/// Table of keys: its header in a scene, and its rows.
struct Section {
    header: &'static str,
    rows: Vec<Row>,
}

/// Texts between backticks.
fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

fn row(line: &'static str) -> Option<Row> {
    let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
    let [key, _, default, allowed, _] = cells[..] else { return None };
    let names = quoted(key);
    let (key, kinds) = names.split_first()?;
    Some(Row { key, kinds: kinds.to_vec(), default, allowed })
}

fn sections() -> Vec<Section> {
    let (_, keys) = PAGE.split_once("## Keys").unwrap();
    let sections = keys.split("\n### ").skip(1).map(|text| {
        let header = text.lines().next().unwrap();
        let header = quoted(header).first().copied().unwrap_or("");
        Section { header, rows: text.lines().filter_map(row).collect() }
    });
    sections.filter(|section| !section.rows.is_empty()).collect()
}

/// Required keys of a table, with an allowed value each.
fn required(header: &str, kind: Option<&str>) -> Vec<(&'static str, &'static str)> {
    let at = ("at_s", "1");
    let place = [("x_mm", "0"), ("y_mm", "0"), ("fz_n", "1")];
    let way = [("from_mm", "[0, 0]"), ("to_mm", "[1, 1]"), ("fz_n", "1")];
    let spread = [("x_mm", "[0, 1]"), ("y_mm", "[0, 1]")];
    let pulse = |middle| [("rise_s", "0.1"), (middle, "1"), ("fall_s", "0.1")];
    match header {
        "[scan]" => vec![("rate_hz", "1000"), ("duration_s", "10")],
        "[bench]" => vec![("sensor", "0")],
        "[[press]]" => [&[at], &place[..], &pulse("hold_s")].concat(),
        "[[slide]]" | "[[roll]]" => [&[at], &way[..], &pulse("travel_s")].concat(),
        "[[tap]]" => [&[at], &place[..], &[("width_s", "0.1")]].concat(),
        "[[random]]" => {
            [&[at], &spread[..], &[("presses", "3"), ("each_s", "1"), ("fz_n", "[0, 1]")]].concat()
        }
        "[[grid]]" => {
            let more = [("columns", "2"), ("rows", "2"), ("each_s", "1"), ("force_n", "1")];
            [&[at], &spread[..], &more].concat()
        }
        "[[plate]]" => [&[at, ("fz_n", "0.4")], &pulse("travel_s")[..]].concat(),
        "[[fault]]" if kind == Some("supply-dip") => vec![at, ("ratio", "0.8")],
        "[[fault]]" => vec![at, ("kind", "'dead-led'"), ("channel", "'r0c0'")],
        "spring" => vec![("stiffness_n_mm", "1"), ("mass_g", "10")],
        _ => vec![],
    }
}

/// Text of a scene with the required keys of `header` and `kind`, except the key `without`.
///
/// `first` stands before all other keys.
fn scene(header: &str, kind: Option<&str>, without: &str, first: &[(&str, &str)]) -> String {
    let kind = kind.map(|kind| ("kind", format!("'{kind}'")));
    let mut keys: Vec<(&str, String)> = first.iter().map(|(k, v)| (*k, (*v).to_owned())).collect();
    keys.extend(kind.clone());
    for (key, value) in required(header, kind.as_ref().map(|(_, k)| k.trim_matches('\''))) {
        if !keys.iter().any(|(there, _)| *there == key) {
            keys.push((key, value.to_owned()));
        }
    }
    let first: Vec<&str> = first.iter().map(|(key, _)| *key).collect();
    let lines = keys.into_iter().filter(|(key, _)| *key != without || first.contains(key));
    let lines: Vec<String> = lines.map(|(key, value)| format!("{key} = {value}")).collect();
    let whole = |header: &str| {
        let scan = scene_of_scan(header);
        let device = if header == "[[plate]]" { "[device]\nkind = 'ohka-column'\n" } else { "" };
        format!("{scan}{device}{header}\n{}\n", lines.join("\n"))
    };
    match header {
        "" => format!("{}\n{}", lines.join("\n"), scene_of_scan("")),
        "spring" => {
            let slide: String = required("[[slide]]", None)
                .iter()
                .map(|(key, value)| format!("{key} = {value}\n"))
                .collect();
            let spring = lines.join(", ");
            format!("{}[[slide]]\n{slide}spring = {{ {spring} }}\n", scene_of_scan(""))
        }
        header => whole(header),
    }
}

fn scene_of_scan(header: &str) -> &'static str {
    if header == "[scan]" { "" } else { "[scan]\nrate_hz = 1000\nduration_s = 10\n" }
}

/// Message of the parser; empty for a valid scene.
fn said(text: &str) -> String {
    Scene::parse("scene.toml", text).err().map(|error| error.to_string()).unwrap_or_default()
}

/// Names that a message lists as allowed.
fn allowed(message: &str) -> Vec<&str> {
    message.split_once("allowed are ").map(|(_, names)| quoted(names)).unwrap_or_default()
}

/// Kinds that have the key, or `None` where all have it.
fn kinds(row: &Row) -> Vec<Option<&'static str>> {
    let named = row.kinds.iter().copied().map(Some);
    if row.kinds.is_empty() { vec![None] } else { named.collect() }
}

#[test]
fn documented_example_runs_with_all_events() {
    let (_, example) = PAGE.split_once("```toml\n").unwrap();
    let (example, _) = example.split_once("```").unwrap();
    let scene = Scene::parse("docs/scenes.md", example).unwrap();
    let samples: Vec<_> = Simulator::new(&scene, 1).collect();
    assert_eq!(samples.len() as u64, scene.frames());
    assert!(samples.iter().any(|sample| sample.truth.contact == Some(true)));
    assert!(samples.iter().any(|sample| sample.truth.slip == Some(true)));
    let warm = |i: usize| samples[i].scan.codes.temperature.unwrap();
    assert!(warm(samples.len() - 1) > warm(0));
}

#[test]
fn page_lists_exactly_the_parser_keys() {
    let sections = sections();
    let mut tables = BTreeSet::new();
    for Section { header, rows } in &sections {
        let message = said(&scene(header, None, "", &[("no_such_key", "1")]));
        let parsers: BTreeSet<&str> = allowed(&message).into_iter().collect();
        let mut pages: BTreeSet<&str> = rows.iter().map(|row| row.key).collect();
        if header.is_empty() {
            tables = parsers.difference(&pages).map(|name| (*name).to_owned()).collect();
            pages.extend(tables.iter().map(String::as_str));
        }
        assert_eq!(parsers, pages, "{header}: {message}");
    }
    let pages = sections.iter().map(|s| s.header).filter(|h| h.starts_with('['));
    let pages: BTreeSet<String> = pages.map(|h| h.trim_matches(['[', ']']).to_owned()).collect();
    assert_eq!(pages, tables);
    let message = said(&scene("", None, "", &[("effects", "['no-such']")]));
    let (_, effects) = PAGE.split_once("### Effects").unwrap();
    let (effects, _) = effects.split_once("\n### ").unwrap();
    let rows = effects.lines().filter(|line| line.starts_with("| `"));
    let pages: Vec<&str> = rows.map(|line| quoted(line)[0]).collect();
    assert_eq!(allowed(&message), pages);
}

/// Whether the message names the range, for example "1 to 2" or "-1 to 2" but not "1 to 20".
fn names_range(message: &str, range: &str) -> bool {
    message.match_indices(range).any(|(at, _)| {
        let part = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
        let (before, after) = (&message[..at], &message[at + range.len()..]);
        !before.ends_with(part) && !after.starts_with(|c: char| c.is_ascii_digit())
    })
}

#[test]
fn documented_limits_match_the_parser() {
    let mut checked = 0;
    for Section { header, rows } in sections() {
        for row in &rows {
            let (count, range) = match row.allowed.split_once(" of ") {
                Some((count, range)) => (count.parse().unwrap_or(0), range),
                None => (1, row.allowed),
            };
            let (range, whole) = (range.trim_end_matches(", whole"), range.ends_with(", whole"));
            let Some((low, high)) = range.split_once(" to ") else { continue };
            let (Ok(low_number), Ok(high_number)) = (low.parse::<f64>(), high.parse::<f64>())
            else {
                continue;
            };
            let value = |number: &str| match count {
                1 => number.to_owned(),
                _ => format!("[{}]", vec![number; count].join(", ")),
            };
            let beyond = |number: f64, by: f64| {
                if whole {
                    format!("{}", number + by)
                } else {
                    format!("{:.7}", number + by * 1e-5 * number.abs().max(0.1))
                }
            };
            for kind in kinds(row) {
                let with =
                    |number: &str| said(&scene(header, kind, "", &[(row.key, &value(number))]));
                for within in [low, high] {
                    let message = with(within);
                    let refused = ["out of range", "off the pad", "found"];
                    assert!(
                        !refused.iter().any(|word| message.contains(word)),
                        "{header}: {message}"
                    );
                }
                for outside in [beyond(low_number, -1.0), beyond(high_number, 1.0)] {
                    if outside.len() > 18 {
                        continue; // no whole number of TOML
                    }
                    let message = with(&outside);
                    assert!(message.contains(row.key), "{header} {outside}: {message}");
                    assert!(names_range(&message, range), "{header} {outside}: {message}");
                }
                checked += 1;
            }
        }
    }
    assert!(checked > 80, "{checked}");
}

#[test]
fn documented_choices_match_the_parser() {
    let mut checked = 0;
    for Section { header, rows } in sections() {
        for row in &rows {
            let choices = quoted(row.allowed);
            let listed = choices.iter().map(|c| format!("`{c}`")).collect::<Vec<_>>().join(", ");
            if choices.is_empty() || listed != row.allowed || choices[0] == "true" {
                continue;
            }
            let numbers = choices[0].parse::<u32>().is_ok();
            let value = |c: &str| if numbers { c.to_owned() } else { format!("'{c}'") };
            let message = said(&scene(header, None, "", &[(row.key, &value("3"))]));
            if numbers {
                assert!(message.ends_with(&format!("one of {}", choices.join(", "))), "{message}");
            } else {
                assert_eq!(allowed(&message), choices, "{message}");
            }
            for choice in &choices {
                let message = said(&scene(header, None, "", &[(row.key, &value(choice))]));
                assert!(
                    !message.contains("is not known") && !message.contains("found"),
                    "{message}"
                );
            }
            checked += 1;
        }
    }
    assert_eq!(checked, 9);
}

/// Values that a scene derives from keys that were left out.
fn made_of_left_out(scene: &Scene) -> String {
    format!(
        "{:?} {} {:?} {} {} {}",
        scene.fidelity(),
        scene.tolerance(),
        scene.indenter(),
        scene.friction.mu_kinetic(),
        scene.oversampling(),
        scene.time_constant_us()
    )
}

/// Debug text of the scene without its positions in the text.
fn without_places(scene: &Scene) -> String {
    let text = format!("{scene:?}");
    let parts = text.split("span: ").enumerate();
    let kept = parts.map(|(i, part)| if i == 0 { part } else { part.split_once(", ").unwrap().1 });
    kept.collect()
}

#[test]
fn documented_defaults_match_the_parser() {
    const LEFT_OUT: [&str; 7] =
        ["fidelity", "tolerance", "radius_mm", "width_mm", "length_mm", "turn_deg", "slope"];
    let mut checked = 0;
    for Section { header, rows } in sections() {
        for row in &rows {
            let names = quoted(row.default);
            let default = match names[..] {
                [code] if row.default == format!("`{code}`") => code,
                _ => row.default,
            };
            if toml::from_str::<toml::Table>(&format!("x = {default}")).is_err() {
                continue;
            }
            for kind in kinds(row) {
                let parse = |first: &[(&str, &str)]| {
                    let text = scene(header, kind, "", first);
                    Scene::parse("scene.toml", &text).unwrap_or_else(|e| panic!("{e}\n{text}"))
                };
                let (left_out, written) = (parse(&[]), parse(&[(row.key, default)]));
                assert_eq!(
                    made_of_left_out(&left_out),
                    made_of_left_out(&written),
                    "{header} {}",
                    row.key
                );
                if !LEFT_OUT.contains(&row.key) {
                    assert_eq!(without_places(&left_out), without_places(&written), "{}", row.key);
                }
                checked += 1;
            }
        }
    }
    assert!(checked > 50, "{checked}");
}

#[test]
fn documented_required_keys_are_required() {
    let mut checked = 0;
    for Section { header, rows } in sections() {
        for row in rows.iter().filter(|row| row.default == "required") {
            for kind in kinds(row) {
                let message = said(&scene(header, kind, row.key, &[]));
                let asks = message.contains("is missing here") || message.contains("needs");
                assert!(asks && message.contains(row.key), "{header} {}: {message}", row.key);
                checked += 1;
            }
        }
    }
    assert!(checked > 45, "{checked}");
}

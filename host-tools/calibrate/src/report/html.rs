//! Report as a self-contained HTML page.

mod figures;
mod judged;
mod text;

use std::fmt::Write as _;

use super::judge::Report;
use super::plots;
pub use text::escaped;

const STYLE: &str = include_str!("report.css");

/// Beginning of a page in the reports' style, up to its first heading; `title` is markup.
#[must_use]
pub fn head(title: &str) -> String {
    format!(
        "<!doctype html><html lang=en><meta charset=utf-8>\
         <meta name=viewport content=\"width=device-width\">\
         <meta name=color-scheme content=\"light dark\">\
         <title>{title}</title><style>{STYLE}</style>\
         <h1>{title}</h1>"
    )
}

/// Renders the page; `made` is the date of the report, `of` that of the calibration, as text.
#[must_use]
pub fn page(report: &Report, made: &str, of: &str) -> String {
    let about = &report.about;
    let of_whom = match about.serial.as_str() {
        "" => "Calibration without a serial number".to_owned(),
        serial => format!("Calibration of {}", escaped(serial)),
    };
    let mut page = head(&of_whom);
    judged::verdict(&mut page, report);
    let _ = write!(
        page,
        "<p class=lead>Calibrated {of}, judged {made}. Error is estimate − reference; the estimates \
         are those of the code that runs on the finger.</p>",
        of = escaped(of),
        made = escaped(made),
    );
    judged::warnings(&mut page, &report.warnings);
    judged::needs(&mut page, &report.verdict.needs);
    judged::errors(&mut page, &report.errors);
    judged::stated(&mut page, &report.stated);
    judged::channels(&mut page, &report.channels);
    figures::overview(&mut page, &report.trials);
    figures::parts(&mut page, report);
    for trial in &report.trials {
        figures::section(&mut page, trial);
    }
    if !report.coverage.is_empty() {
        page += "<h2>Where the recordings are</h2><p>Rows a cell, darker for more; white is where there \
                 are none, and where the calibration only guesses.</p><div class=plots>";
        for map in &report.coverage {
            let _ = write!(page, "<figure>{}", plots::map(map));
            if let Some(percent) = map.beyond_percent {
                let _ = write!(
                    page,
                    "<figcaption>{percent:.1} % of the judged rows lie more than two \
                     cells from any of these</figcaption>"
                );
            }
            page += "</figure>";
        }
        page += "</div>";
    }
    figures::papers(&mut page, &report.papers, &report.trials);
    figures::requirements(&mut page, &report.requirements);
    page += figures::NOTES;
    page += "</html>\n";
    page
}

#[cfg(test)]
mod tests {
    use super::super::judge::{About, Trial, assemble};
    use super::super::series::{Kind, Row, Series};
    use super::super::verdict::{HeldOut, of_finger};
    use super::*;
    use crate::finger::Channel;

    /// Series of 40 presses of ten rows around the pad, off by up to `error`.
    fn series(kind: Kind, error: f64) -> Series {
        let mut series = Series::empty(kind);
        for row in 0..800_usize {
            let (press, loaded) = (row / 20, row % 20 < 10);
            let place = [press % 4, press / 4 % 3].map(|cell| 2.5 * cell as f64 - 3.75);
            let reference = match series.kind {
                Kind::Point(axis) => place[axis],
                _ => 0.2 * (row % 10) as f64,
            };
            // A row at the right edge errs three times as much as one in the middle.
            let off = error * (row % 10) as f64 / 9.0 * if press % 4 == 3 { 3.0 } else { 1.0 };
            let press = loaded.then_some(press);
            series.time.push(row as f64 * 1e-2);
            series.reference.push(if loaded { reference } else { 0.0 });
            series.estimate.push(Some(if loaded { reference + off } else { 0.0 }));
            series.sigma.push(loaded.then_some(error));
            let (flagged, place) = (row == 5, loaded.then_some(place));
            series.rows.push(Row { press, flagged, place, ..Row::default() });
        }
        series
    }

    /// Text of a page, a line for each block.
    fn text(page: &str) -> String {
        let mut text = String::new();
        for part in page.split('<').skip(1) {
            let Some((tag, words)) = part.split_once('>') else { continue };
            match tag.split(' ').next() {
                Some("h1" | "h2" | "p" | "li" | "tr" | "figcaption") => text.push('\n'),
                Some("td" | "th") => text.push_str(" | "),
                Some("small" | "span") => text.push(' '),
                Some("style") => continue,
                _ => {}
            }
            text += words.trim_start_matches('\n');
        }
        text.lines().map(|line| line.trim_start_matches(" | ").to_owned() + "\n").collect()
    }

    #[test]
    fn page_begins_with_verdict_map_and_channels() {
        let series = [(Kind::Force(2), 0.012), (Kind::Point(0), 0.07), (Kind::Point(1), 0.04)]
            .map(|(kind, error)| series(kind, error));
        let trial = Trial::new("unseen.csv".into(), 8.0, 800, series.to_vec());
        let quantities = of_finger();
        let about = About { serial: "F-1".into(), date: 0, parts: vec![] };
        let report = assemble(about, vec![], vec![trial], vec![], (&quantities, HeldOut::Yes));
        let used = |columns: &str, used: &[&str], why: &str| Channel {
            columns: columns.into(),
            used: used.iter().map(|used| (*used).to_owned()).collect(),
            why: why.into(),
        };
        let channels = vec![
            used("lit_*, dark_* (16 taxels)", &["net"], "r2c1 dark"),
            used("slip", &[], "this page judges no slip"),
        ];
        let simulated = vec!["unseen.csv is simulated: press".into()];
        let page = page(&Report { channels, simulated, ..report }, "today", "yesterday");
        let text = text(&page);
        let end = text.find("\nThe record\n").unwrap();
        assert_eq!(text[..end].trim(), include_str!("page.txt").trim());
    }
}

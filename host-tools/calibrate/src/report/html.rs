//! Report as a self-contained HTML page.

use std::fmt::Write as _;

use super::figures::Figures;
use super::judge::{Report, Trial};
use super::map::{ErrorMap, counted};
use super::papers::{ANGLE_DEG, Printed, Requirement};
use super::plots;
use super::series::{fine, split_unit};
use super::stated::{self, Stated};
use super::verdict::{
    GIVEN, Judged, NOISE, PRESSES, REACH, SHARE, TABLE_ROWS, Verdict, amount, at_rest,
};
use crate::finger::Channel;

const STYLE: &str = include_str!("report.css");

/// Renders the page; `made` is the date of the report, `of` that of the calibration, as text.
#[must_use]
pub fn page(report: &Report, made: &str, of: &str) -> String {
    let mut page = String::new();
    let about = &report.about;
    let of_whom = match about.serial.as_str() {
        "" => "Calibration without a serial number".to_owned(),
        serial => format!("Calibration of {}", escaped(serial)),
    };
    let _ = write!(
        page,
        "<!doctype html><html lang=en><meta charset=utf-8>\
         <meta name=viewport content=\"width=device-width\">\
         <meta name=color-scheme content=\"light dark\">\
         <title>{of_whom}</title><style>{STYLE}</style>\
         <h1>{of_whom}</h1>",
    );
    verdict(&mut page, report);
    let _ = write!(
        page,
        "<p class=lead>Calibrated {of}, judged {made}. Error is estimate − reference; the estimates \
         are those of the code that runs on the finger.</p>",
        of = escaped(of),
        made = escaped(made),
    );
    warnings(&mut page, &report.warnings);
    needs(&mut page, &report.verdict.needs);
    errors(&mut page, &report.errors);
    stated(&mut page, &report.stated);
    channels(&mut page, &report.channels);
    overview(&mut page, &report.trials);
    parts(&mut page, report);
    for trial in &report.trials {
        section(&mut page, trial);
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
    papers(&mut page, &report.papers, &report.trials);
    requirements(&mut page, &report.requirements);
    page += NOTES;
    page += "</html>\n";
    page
}

/// Writes the uses that the calibration is good for, and those that it is not.
fn verdict(page: &mut String, report: &Report) {
    let Verdict { good_for, not_for, not_judged, doubts, tested, .. } = &report.verdict;
    *page += "<section class=verdict>";
    if !report.simulated.is_empty() {
        *page += "<p class=simulated><b>Simulated.</b> These figures are of a simulation, not of a \
                  real finger.";
        for origin in &report.simulated {
            let _ = write!(page, " {}.", escaped(origin));
        }
        *page += "</p>";
    }
    for doubt in doubts {
        let _ = write!(page, "<p class=simulated>{}.</p>", escaped(&sentence(doubt)));
    }
    let lists = [("Good for", "good", good_for), ("Not for", "bad", not_for)];
    for (title, class, uses) in lists.into_iter().chain([("Not judged", "open", not_judged)]) {
        if uses.is_empty() && class == "open" {
            continue;
        }
        let _ = write!(page, "<h2 class={class}>{title}</h2><ul>");
        for told in uses {
            let _ = write!(page, "<li>{}</li>", escaped(told));
        }
        if uses.is_empty() {
            *page += "<li>none of the uses that were judged</li>";
        }
        *page += "</ul>";
    }
    let _ = write!(page, "<p>{}</p></section>", escaped(tested));
}

/// Writes every need with the error found, and the rule of the verdict.
fn needs(page: &mut String, needs: &[Judged]) {
    let _ = write!(
        page,
        "<h2>Needs and errors</h2><p>A need is met if, in every recording, {:.0} % of the loaded \
         rows err by no more than it, in the worst component. At least {:.0} % of those rows must \
         have a value that is not flagged, and the labels must span {REACH:.0} times the need. It \
         takes {PRESSES} presses (a long one counts again each second), or {TABLE_ROWS} rows of a \
         table. Where {NOISE:.0} standard deviations of the labels' own noise may explain the \
         excess, a need is not judged.</p><table>\
         <tr><th class=text>need<th class=text>use<th>found<th class=text>verdict</tr>",
        100.0 * SHARE,
        100.0 * GIVEN
    );
    for need in needs {
        let (class, verdict) = match need.met {
            Some(true) => ("good", "met"),
            Some(false) => ("bad", "not met"),
            None => ("open", "not judged"),
        };
        let why = if need.why.is_empty() { String::new() } else { format!(": {}", need.why) };
        let _ = write!(
            page,
            "<tr><th class=text>{}<td class=text>{}<td>{}<td class=text>\
             <b class={class}>{verdict}</b>{}</tr>",
            escaped(&need.wanted()),
            need.purpose,
            need.found
                .map_or("–".into(), |found| amount(found, need.unit) + at_rest(need.at_rest)),
            escaped(&why)
        );
    }
    *page += "</table>";
}

/// Writes the errors over the pad, coloured by the needs that they meet.
fn errors(page: &mut String, maps: &[ErrorMap]) {
    if maps.is_empty() {
        return;
    }
    let _ = write!(
        page,
        "<h2>Errors over the pad</h2><p>Each cell is the region around a taxel, x to the right, y \
         up. Upper number: error that {:.0} % of its loaded rows do not exceed; lower: presses. \
         Colour: the most demanding need that it meets.</p><div class=maps>",
        100.0 * SHARE
    );
    for map in maps {
        let _ = write!(
            page,
            "<figure><figcaption>{} / {}{}</figcaption><table class=map>",
            escaped(&map.quantity),
            in_words(map.unit),
            at_rest(map.at_rest)
        );
        for (row, cells) in map.cells.iter().enumerate().rev() {
            let _ = write!(page, "<tr><th>r{row}");
            for cell in cells {
                let Some(region) = cell else {
                    *page += "<td class=none>–";
                    continue;
                };
                let presses = region.presses;
                let Some(error) = region.error else {
                    let _ =
                        write!(page, "<td class=need0>no value<small>{}</small>", counted(presses));
                    continue;
                };
                let told = amount(error, map.unit);
                let number = told.split(' ').next().unwrap_or_default();
                let _ = write!(
                    page,
                    "<td class=need{}>{number}<small>{presses}</small>",
                    map.needs.iter().filter(|need| error <= **need).count(),
                );
            }
            *page += "</tr>";
        }
        *page += "<tr><th><th>c0<th>c1<th>c2<th>c3</tr></table><p class=legend>";
        for (met, need) in map.needs.iter().enumerate().rev() {
            let _ =
                write!(page, "<span class=need{}>≤ {}</span>", met + 1, amount(*need, map.unit));
        }
        *page += "<span class=need0>more</span></p></figure>";
    }
    *page += "</div>";
}

/// Unit that [`amount`] says.
fn in_words(unit: &str) -> &str {
    if unit == "N" { "mN" } else { unit }
}

/// Writes the shares of values within one, two and three stated standard deviations.
fn stated(page: &mut String, all: &[Stated]) {
    *page += "<h2>Stated errors</h2>";
    if all.is_empty() {
        *page += "<p>No error is stated for what the labels tell.</p>";
        return;
    }
    let [one, two, three] = stated::NORMAL.map(|share| 100.0 * share);
    let _ = write!(
        page,
        "<p>Share of the unflagged values within one, two and three of the standard deviations \
         that they state; a normal distribution has {one:.1}, {two:.1} and {three:.1} %. Noise of \
         the labels is added to the stated one.</p><table><tr><th>quantity<th>stated σ, median<th>labels' noise\
         <th>within 1 σ<th>2 σ<th>3 σ<th>values<th>flagged</tr>"
    );
    for found in all {
        let _ = write!(
            page,
            "<tr><th>{}<td>{}<td>{}",
            short(&found.target),
            amount(found.median, found.unit),
            if found.label_noise > 0.0 {
                amount(found.label_noise, found.unit)
            } else {
                "–".into()
            }
        );
        for share in found.within {
            let _ = write!(page, "<td>{:.1} %", 100.0 * share);
        }
        let _ = write!(page, "<td>{}<td>{}</tr>", found.rows, found.flagged);
    }
    *page += "</table>";
}

/// Writes the columns of the recordings with their use.
fn channels(page: &mut String, channels: &[Channel]) {
    *page += "<h2>Channels</h2><table><tr><th class=text>columns<th class=text>use</tr>";
    for Channel { columns, used, why } in channels {
        let used = match (&used[..], why.as_str()) {
            ([], why) => format!("<b class=open>not used</b>: {}", escaped(why)),
            (used, "") => escaped(&used.join(", ")),
            (used, why) => {
                format!("{}; <b class=bad>{}</b>", escaped(&used.join(", ")), escaped(why))
            }
        };
        let _ = write!(page, "<tr><th class=text>{}<td class=text>{used}</tr>", escaped(columns));
    }
    *page += "</table>";
}

fn warnings(page: &mut String, warnings: &[String]) {
    if warnings.is_empty() {
        *page += "<p class=good>The recordings give no reason for a warning.</p>";
        return;
    }
    *page += "<ul class=warnings>";
    for warning in warnings {
        let _ = write!(page, "<li>{}</li>", escaped(warning));
    }
    *page += "</ul>";
}

/// Writes one line for each quantity over all recordings: the best and the worst.
fn overview(page: &mut String, trials: &[Trial]) {
    let rows: Vec<(&Trial, &Figures)> =
        trials.iter().flat_map(|t| t.figures.iter().map(move |f| (t, f))).collect();
    if trials.len() < 2 {
        return;
    }
    *page += "<h2>At a glance</h2><table><tr><th>quantity<th>best RMSE<th>worst RMSE\
              <th class=text>worst in</tr>";
    let mut seen: Vec<&str> = Vec::new();
    for (_, figures) in &rows {
        if seen.contains(&figures.target.as_str()) {
            continue;
        }
        seen.push(&figures.target);
        let same = || rows.iter().filter(|(_, other)| other.target == figures.target);
        let best = same().map(|(_, f)| f.rmse).fold(f64::INFINITY, f64::min);
        let worst = same().max_by(|a, b| a.1.rmse.total_cmp(&b.1.rmse));
        let Some((trial, worst)) = worst else { continue };
        let _ = write!(
            page,
            "<tr><th>{}<td>{}<td>{}<td class=text>{}</tr>",
            escaped(&figures.target),
            quantity(best, worst.unit),
            quantity(worst.rmse, worst.unit),
            escaped(&trial.recording)
        );
    }
    *page += "</table>";
}

fn parts(page: &mut String, report: &Report) {
    *page += "<h2>The record</h2><table><tr><th>part<th class=text>model<th>RMS error\
              <th>noise of a channel / ppm<th>condition of S<th>condition of the data</tr>";
    for part in &report.about.parts {
        let residual: Vec<String> =
            part.residual.iter().zip(&part.units).map(|(r, unit)| quantity(*r, unit)).collect();
        let _ = write!(
            page,
            "<tr><th>{}<td class=text>{}<td>{}<td>{}<td>{}<td>{}</tr>",
            escaped(&part.name),
            escaped(&part.model),
            if residual.is_empty() { "–".into() } else { residual.join(", ") },
            optional(part.noise.map(|noise| 1e6 * noise), 0),
            optional(part.condition, 2),
            optional(part.condition_of_data, 0)
        );
    }
    *page += "</table><p>RMS error as the record states it. For a finger's net and array it is that on rows \
              left out of the fit; for a net alone, one sensor with its own reference and a table that of the fit.</p>";
}

fn section(page: &mut String, trial: &Trial) {
    let _ = write!(
        page,
        "<h2>{}</h2><p>{}</p><table><tr><th>quantity<th>bias<th>σ<th>RMSE<th>max\
         <th>% of span<th>span<th>hysteresis / %<th class=text>cross-talk / %<th>noise<th>resolution\
         <th>dynamic range<th>rows<th>withheld</tr>",
        escaped(&trial.recording),
        match trial.rate_hz {
            rate if rate > 0.0 => format!("{:.1} s at {rate:.0} Hz.", trial.seconds),
            _ => "The recording has no times (no column t_s or t_us).".into(),
        }
    );
    for found in &trial.figures {
        let crosstalk: Vec<String> = found
            .crosstalk_percent
            .iter()
            // Prints `+0.0`, never `-0.0`.
            .map(|(of, percent)| (short(of), (10.0 * percent).round() / 10.0 + 0.0))
            .map(|(of, percent)| format!("{of} {percent:+.1}"))
            .collect();
        let _ = write!(
            page,
            "<tr><th>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{:.2} {}<td>{}<td class=text>{}<td>{}<td>{}\
             <td>{}<td>{}<td>{}</tr>",
            in_unit(&found.target, found.unit),
            fixed(found.bias, found.unit),
            fixed(found.sigma, found.unit),
            fixed(found.rmse, found.unit),
            fixed(found.max, found.unit),
            optional(found.percent, 2),
            found.span,
            found.unit,
            optional(found.hysteresis_percent, 2),
            if crosstalk.is_empty() { "–".into() } else { crosstalk.join(", ") },
            found.noise.map_or("–".into(), |noise| fixed(noise, found.unit)),
            found.resolution.map_or("–".into(), |r| fixed(r, found.unit)),
            found.dynamic_range.map_or("–".into(), |range| format!("{range:.0} : 1")),
            found.rows,
            found.withheld
        );
    }
    *page += "</table>";
    if let Some(angle) = &trial.angle {
        let _ = write!(
            page,
            "<p>Direction of the force, where it is 0.3 N or more ({} rows): RMS {:.2}°, max {:.2}° \
             ([DeMaria2011], 4×1 trial set: max {ANGLE_DEG:.0}°).</p>",
            angle.rows, angle.rms_deg, angle.max_deg
        );
    }
    *page += "<p class=key><span class=reference>reference</span> <span class=estimate>estimate</span> \
              over time; error while the reference <span class=rising>rises</span> and \
              <span class=falling>falls</span> or \
              <span class=reference>stands still</span></p>";
    for series in &trial.series {
        let _ = write!(
            page,
            "<div class=plots><figure>{}</figure><figure>{}</figure></div>",
            plots::over_time(series),
            plots::over_reference(series)
        );
    }
}

/// Writes the papers' tables with the worst figures found here for the same quantities.
fn papers(page: &mut String, papers: &[Printed], trials: &[Trial]) {
    *page += "<h2>Compared with the papers</h2><table><tr><th>quantity<th class=text>where<th>bias\
              <th>σ<th>max<th>here: bias<th>σ<th>max</tr>";
    for paper in papers {
        let cell = |value: Option<f64>| value.map_or("–".into(), |v| quantity(v, paper.unit));
        let here = ours(paper, trials);
        let _ = write!(
            page,
            "<tr><th>{}<td class=text>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}</tr>",
            paper.quantity,
            escaped(paper.source),
            cell(paper.bias),
            cell(paper.sigma),
            cell(paper.max),
            cell(here.map(|found| found.bias)),
            cell(here.map(|found| found.sigma)),
            cell(here.map(|found| found.max)),
        );
    }
    *page += "</table>";
}

/// Figures with the largest σ of a paper's quantity, among the finger and its sensors.
fn ours<'t>(paper: &Printed, trials: &'t [Trial]) -> Option<&'t Figures> {
    let same = |found: &&Figures| {
        let name = split_unit(&found.target).0;
        let name = name.rsplit_once('_').map_or(name, |(_, component)| component);
        found.unit == paper.unit && paper.quantity.split(", ").any(|quantity| quantity == name)
    };
    let all = trials.iter().flat_map(|trial| &trial.figures);
    all.filter(same).max_by(|a, b| a.sigma.total_cmp(&b.sigma))
}

fn requirements(page: &mut String, requirements: &[Requirement]) {
    *page += "<h2>Harmon's requirements ([TactileEnc])</h2><table><tr><th>required<th class=text>found, the worst\
              <th></tr>";
    for requirement in requirements {
        let verdict = match requirement.met {
            Some(true) => "met",
            Some(false) => "not met",
            None => "not judged",
        };
        let _ = write!(
            page,
            "<tr><td class=text>{}<td class=text>{}<td class=text>{verdict}</tr>",
            requirement.required,
            escaped(requirement.found.as_deref().unwrap_or("–"))
        );
    }
    *page += "</table>";
}

const NOTES: &str = "<h2>What the figures mean</h2><dl>\
<dt>% of span<dd>RMSE over the largest reference less the smallest of this recording.\
<dt>hysteresis<dd>largest difference of the mean error between rising and falling reference within a \
twentieth of the span, in percent of the span. A lag in time counts as one.\
<dt>cross-talk<dd>how much of the other components of the same force shows up in this one, fitted to the \
error with the component itself.\
<dt>noise<dd>standard deviation from row to row, from second differences: slow changes are left out.\
<dt>resolution<dd>three times the noise, at the rate of the recording.\
<dt>dynamic range<dd>span over resolution: no more than the recording shows.\
<dt>condition<dd>largest over smallest singular value: of S, and of the signals under load. A large one \
means that some direction was hardly loaded or hardly measured.\
<dt>withheld<dd>rows without a value, for which the finger gives a reason.</dl>";

/// A number with the unit of its errors.
fn quantity(value: f64, unit: &'static str) -> String {
    format!("{} {}", fixed(value, unit), fine(unit).1).trim_end().to_owned()
}

/// Two decimals in thousandths of the unit; otherwise four significant digits.
fn fixed(value: f64, unit: &'static str) -> String {
    let (times, told) = fine(unit);
    if told != unit {
        return rounded(times * value, 2);
    }
    let digits = 3 - value.abs().max(1e-6).log10().floor() as i32;
    rounded(value, usize::try_from(digits).unwrap_or(0))
}

/// Rounds to decimals, without a sign on zero.
fn rounded(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|b| matches!(b, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}

fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".into(), |value| rounded(value, digits))
}

/// A quantity with the unit of its errors: `fx / mN`.
fn in_unit(name: &str, unit: &'static str) -> String {
    match fine(unit).1 {
        "" => short(name),
        unit => format!("{} / {unit}", short(name)),
    }
}

/// Name of a column without its unit.
fn short(name: &str) -> String {
    escaped(split_unit(name).0)
}

/// Text with its first letter in upper case.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::super::judge::{About, assemble};
    use super::super::series::{Kind, Row, Series};
    use super::super::verdict::{HeldOut, of_finger};
    use super::*;

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

    #[test]
    fn page_escapes_markup_from_files() {
        assert_eq!(escaped("<b> & \"c\""), "&lt;b&gt; &amp; &quot;c&quot;");
        assert_eq!(short("s0_fx_n"), "s0_fx");
        assert_eq!(short("mass_total"), "mass_total");
    }

    #[test]
    fn quantity_uses_mn_or_significant_digits() {
        assert_eq!(quantity(0.012_345, "N"), "12.35 mN");
        assert_eq!(quantity(0.5, "mm"), "500.00 µm");
        assert_eq!(quantity(-6.781_23, "°"), "-6.781 °");
        assert_eq!(quantity(0.001_234_5, ""), "0.001234");
        assert_eq!(quantity(0.0, ""), "0.000000000");
        assert_eq!(quantity(-0.000_004, "N"), "0.00 mN");
        assert_eq!(quantity(-0.000_006, "N"), "-0.01 mN");
    }
}

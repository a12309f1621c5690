//! The report as a page that needs nothing but itself.

use std::fmt::Write as _;

use crate::figures::Figures;
use crate::papers::{ANGLE_DEG, Printed, Requirement};
use crate::plots;
use crate::report::{Report, Trial};

const STYLE: &str = include_str!("report.css");

/// The page. `made` is when, as a person writes it; `of` is the calibration's date likewise.
#[must_use]
pub fn page(report: &Report, made: &str, of: &str) -> String {
    let mut page = String::new();
    let about = &report.about;
    let serial = if about.serial.is_empty() { "without a serial number" } else { &about.serial };
    let _ = write!(
        page,
        "<!doctype html><html lang=en><meta charset=utf-8>\
         <meta name=viewport content=\"width=device-width\">\
         <title>Calibration of {serial}</title><style>{STYLE}</style>\
         <h1>Calibration of {serial}</h1>\
         <p class=lead>Calibrated {of}, judged {made}. Error is estimate − reference; the estimates are \
         those of the code that runs on the finger.</p>",
        serial = escaped(serial),
        of = escaped(of),
        made = escaped(made),
    );
    warnings(&mut page, &report.warnings);
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
    papers(&mut page, &report.papers);
    requirements(&mut page, &report.requirements);
    page += NOTES;
    page += "</html>\n";
    page
}

fn warnings(page: &mut String, warnings: &[String]) {
    if warnings.is_empty() {
        *page += "<p class=good>Nothing in the recordings speaks against this calibration.</p>";
        return;
    }
    *page += "<ul class=warnings>";
    for warning in warnings {
        let _ = write!(page, "<li>{}</li>", escaped(warning));
    }
    *page += "</ul>";
}

/// One line for each quantity over all recordings: the worst.
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
    *page += "<h2>The record</h2><table><tr><th>part<th class=text>model<th>RMS error of the fit / mN\
              <th>noise of a channel / ppm<th>condition of S<th>condition of the data</tr>";
    for part in &report.about.parts {
        let residual: Vec<String> =
            part.residual_n.iter().map(|newtons| format!("{:.2}", 1e3 * newtons)).collect();
        let _ = write!(
            page,
            "<tr><th>{}<td class=text>{}<td>{}<td>{:.0}<td>{}<td>{}</tr>",
            escaped(&part.name),
            escaped(&part.model),
            residual.join(", "),
            1e6 * part.noise,
            optional(part.condition, 2),
            optional(part.condition_of_data, 0)
        );
    }
    *page += "</table>";
}

fn section(page: &mut String, trial: &Trial) {
    let _ = write!(
        page,
        "<h2>{}</h2><p>{:.1} s at {:.0} Hz.</p><table><tr><th>quantity<th>bias<th>σ<th>RMSE<th>max\
         <th>% of span<th>span<th>hysteresis / %<th class=text>cross-talk / %<th>noise<th>resolution\
         <th>dynamic range<th>rows<th>withheld</tr>",
        escaped(&trial.recording),
        trial.seconds,
        trial.rate_hz
    );
    for found in &trial.figures {
        let crosstalk: Vec<String> = found
            .crosstalk_percent
            .iter()
            .map(|(of, percent)| format!("{} {percent:+.1}", axis(of)))
            .collect();
        let _ = write!(
            page,
            "<tr><th>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{:.2} {}<td>{}<td class=text>{}<td>{}<td>{}\
             <td>{}<td>{}<td>{}</tr>",
            short(&found.target),
            milli(found.bias),
            milli(found.sigma),
            milli(found.rmse),
            quantity(found.max, found.unit),
            optional(found.percent, 2),
            found.span,
            found.unit,
            optional(found.hysteresis_percent, 2),
            if crosstalk.is_empty() { "–".into() } else { crosstalk.join(", ") },
            found.noise.map_or("–".into(), milli),
            found.resolution.map_or("–".into(), |r| quantity(r, found.unit)),
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
             (002, 4×1 trial set: max {ANGLE_DEG:.0}°).</p>",
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

fn papers(page: &mut String, papers: &[Printed]) {
    *page += "<h2>What the papers print</h2><table><tr><th>quantity<th class=text>where<th>bias<th>σ\
              <th>max</tr>";
    for paper in papers {
        let cell = |value: Option<f64>| value.map_or("–".into(), |v| quantity(v, paper.unit));
        let _ = write!(
            page,
            "<tr><th>{}<td class=text>{}<td>{}<td>{}<td>{}</tr>",
            paper.quantity,
            escaped(paper.source),
            cell(paper.bias),
            cell(paper.sigma),
            cell(paper.max)
        );
    }
    *page += "</table>";
}

fn requirements(page: &mut String, requirements: &[Requirement]) {
    *page += "<h2>Harmon's requirements (004)</h2><table><tr><th>asked for<th class=text>found, the worst\
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
            requirement.asked,
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
<dt>noise<dd>standard deviation from row to row, from second differences: what moves slowly is left out.\
<dt>resolution<dd>three times the noise, at the rate of the recording.\
<dt>dynamic range<dd>span over resolution: no more than the recording shows.\
<dt>condition<dd>largest over smallest singular value: of S, and of the signals under load. A large one \
says that some direction was hardly loaded or hardly seen.\
<dt>withheld<dd>rows for which the finger says why it has no value instead of giving one.</dl>";

fn quantity(value: f64, unit: &str) -> String {
    let unit = if unit == "N" { "mN" } else { "µm" };
    format!("{} {unit}", milli(value))
}

fn milli(value: f64) -> String {
    format!("{:.2}", 1e3 * value)
}

fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".into(), |value| format!("{value:.digits$}"))
}

/// The last letter of a column's name without its unit.
fn axis(name: &str) -> String {
    short(name).chars().last().into_iter().collect()
}

/// A column's name without its unit.
fn short(name: &str) -> String {
    escaped(name.rsplit_once('_').map_or(name, |(name, _)| name))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_from_a_file_is_text_and_never_markup() {
        assert_eq!(escaped("<b> & \"c\""), "&lt;b&gt; &amp; &quot;c&quot;");
        assert_eq!(short("s0_fx_n"), "s0_fx");
        assert_eq!(axis("s0_fx_n"), "x");
    }
}

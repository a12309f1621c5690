//! Sections for whoever looks closer: the record, figures of each recording, papers, requirements.

use std::fmt::Write as _;

use super::text::{escaped, fixed, in_unit, optional, quantity, short};
use crate::report::figures::Figures;
use crate::report::judge::{Report, Trial};
use crate::report::papers::{ANGLE_DEG, Printed, Requirement};
use crate::report::plots;
use crate::report::series::split_unit;

/// Writes one line for each quantity over all recordings: the best and the worst.
pub(super) fn overview(page: &mut String, trials: &[Trial]) {
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

pub(super) fn parts(page: &mut String, report: &Report) {
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

pub(super) fn section(page: &mut String, trial: &Trial) {
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
pub(super) fn papers(page: &mut String, papers: &[Printed], trials: &[Trial]) {
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

pub(super) fn requirements(page: &mut String, requirements: &[Requirement]) {
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

pub(super) const NOTES: &str = "<h2>What the figures mean</h2><dl>\
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

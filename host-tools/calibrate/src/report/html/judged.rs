//! Sections for whoever decides: verdict, needs, errors over the pad, stated errors, channels.

use std::fmt::Write as _;

use super::text::{escaped, sentence, short};
use crate::finger::Channel;
use crate::report::judge::Report;
use crate::report::map::{ErrorMap, counted};
use crate::report::stated::{self, Stated};
use crate::report::verdict::{
    GIVEN, Judged, NOISE, PRESSES, REACH, SHARE, TABLE_ROWS, Verdict, amount, at_rest,
};

/// Writes the uses that the calibration is good for, and those that it is not.
pub(super) fn verdict(page: &mut String, report: &Report) {
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
pub(super) fn needs(page: &mut String, needs: &[Judged]) {
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
pub(super) fn errors(page: &mut String, maps: &[ErrorMap]) {
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
pub(super) fn stated(page: &mut String, all: &[Stated]) {
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
pub(super) fn channels(page: &mut String, channels: &[Channel]) {
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

pub(super) fn warnings(page: &mut String, warnings: &[String]) {
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

//! Page on a judged form.

use std::fmt::{Display, Write as _};

use taxel_calibrate::report::html::{escaped, head};
use taxel_files::bench::{self, Step};

use super::judge::{Judged, JudgedStep, Verdict};

/// Renders the page.
pub fn page(judged: &Judged) -> String {
    let mut title = format!("Bench of {}", given(judged, "board"));
    if !given(judged, "serial").is_empty() {
        let _ = write!(title, ", serial {}", escaped(given(judged, "serial")));
    }
    let mut page = head(&title);
    verdict(&mut page, judged);
    lead(&mut page, judged);
    gaps(&mut page, judged);
    steps(&mut page, "The board", judged, false);
    steps(&mut page, "The finger", judged, true);
    page += RULES;
    page += "</html>\n";
    page
}

/// Value of a line at the top of the form.
fn given<'j>(judged: &'j Judged, key: &str) -> &'j str {
    bench::given(&judged.head, key)
}

fn verdict(page: &mut String, judged: &Judged) {
    let (done, missed) = (judged.done(), judged.count(Verdict::Missed));
    let class = match (done, missed) {
        (0, _) => "open",
        (_, 0) if done == judged.steps.len() => "good",
        (_, 0) => "open",
        _ => "bad",
    };
    let _ = write!(page, "<section class=verdict><h2 class={class}>{}</h2>", judged.verdict());
    *page += "<ul>";
    for verdict in [Verdict::Met, Verdict::Missed, Verdict::NotJudged, Verdict::NotMeasured] {
        let count = judged.count(verdict);
        if count > 0 || verdict != Verdict::NotJudged {
            let _ = write!(page, "<li>{count} {}", verdict.words());
        }
    }
    *page += "</ul>";
    if missed > 0 {
        *page += "<p>Missed:</p><ul>";
        for missed in judged.with(Verdict::Missed) {
            let JudgedStep { step, why, .. } = missed;
            let _ = write!(
                page,
                "<li><b class=bad>{} {}</b>: {}{}; expected: {}",
                step.step,
                escaped(&step.check),
                if step.found.measured.is_empty() { String::new() } else { found(missed) + ", " },
                coded(why),
                expected(step),
            );
        }
        *page += "</ul><p>The protocol stops at a missed step: those below it in the same table may \
                  be worthless.</p>";
    }
    *page += "</section>";
}

/// Says who measured what, and on which kind of finger.
fn lead(page: &mut String, judged: &Judged) {
    if judged.done() + judged.count(Verdict::NotJudged) == 0 {
        *page += "<p class=lead>For values measured on hardware; the form has none.</p>";
    } else {
        *page += "<p class=lead>Measured on hardware, not simulated.</p>";
    }
    *page += "<table><tr><th class=text>on the form<th class=text>value</tr>";
    let names = ["board", "serial number", "firmware", "commit", "force sensors", "date", "by"];
    for (name, value) in names.iter().zip(&judged.head) {
        let value = match value.as_str() {
            "" => "<b class=open>not given</b>".to_owned(),
            value => escaped(value),
        };
        let _ = write!(page, "<tr><th class=text>{name}<td class=text>{value}</tr>");
    }
    *page += "</table>";
}

/// Warns of what makes a measurement hard to repeat.
fn gaps(page: &mut String, judged: &Judged) {
    let measured = judged.done() > 0;
    let missing = ["serial", "firmware", "date", "by"];
    let missing: Vec<&str> =
        missing.into_iter().filter(|key| given(judged, key).is_empty()).collect();
    let mut warnings = Vec::new();
    if measured && !missing.is_empty() {
        warnings.push(format!(
            "Not given: {}. Nobody can repeat a measurement without it.",
            missing.join(", ")
        ));
    }
    let finger = |step: &&JudgedStep| is_finger(step) && step.step.found.value.is_some();
    if given(judged, "force_sensors").is_empty() && judged.steps.iter().any(|s| finger(&s)) {
        warnings.push(
            "The number of force sensors is not given: the finger is judged as one that has them."
                .to_owned(),
        );
    }
    if warnings.is_empty() {
        return;
    }
    *page += "<ul class=warnings>";
    for warning in warnings {
        let _ = write!(page, "<li>{warning}");
    }
    *page += "</ul>";
}

fn is_finger(step: &JudgedStep) -> bool {
    step.step.step.starts_with('F')
}

fn steps(page: &mut String, title: &str, judged: &Judged, finger: bool) {
    let _ = write!(page, "<h2>{title}</h2>");
    if finger {
        let which = if judged.matrix_alone {
            "The matrix alone, without force sensors."
        } else {
            "With force sensors."
        };
        let _ = write!(
            page,
            "<p>{which} Expected figures are those of the <b>simulated</b> reference finger; a \
             limit is half as much again, and for creep what noise adds. What was measured is of a \
             real one.</p>"
        );
    }
    *page += "<table><tr><th class=text>step<th class=text>verdict<th class=text>measured\
              <th class=text>limits<th class=text>expected<th class=text>note</tr>";
    for judged in judged.steps.iter().filter(|step| is_finger(step) == finger) {
        let JudgedStep { step, range, verdict, why } = judged;
        let class = match verdict {
            Verdict::Met => "good",
            Verdict::Missed => "bad",
            Verdict::NotJudged | Verdict::NotMeasured => "open",
        };
        let limits = match range {
            Some([min, max]) if min == max => format!("exactly {}", unit(min, judged)),
            Some([min, max]) => format!("{min} to {}", unit(max, judged)).replace('-', "−"),
            None => "by eye".to_owned(),
        };
        let _ = write!(
            page,
            "<tr><th class=text>{} {}<td class=text><b class={class}>{}</b>{}<td class=text>{}\
             <td class=text>{limits}<td class=text>{}<td class=text>{}</tr>",
            step.step,
            escaped(&step.check),
            verdict.words(),
            joined(": ", why),
            found(judged),
            expected(step),
            escaped(&step.found.note),
        );
    }
    *page += "</table>";
}

/// Measured value with its unit, or the words of the form.
fn found(judged: &JudgedStep) -> String {
    let found = &judged.step.found;
    match found.value {
        Some(_) => escaped(&unit(&found.measured, judged)),
        None if found.measured.is_empty() => "–".to_owned(),
        None => coded(&found.measured),
    }
}

fn unit(value: impl Display, judged: &JudgedStep) -> String {
    format!("{value} {}", judged.unit()).replace('-', "−")
}

/// Expectation without the marks of a manual's emphasis.
fn expected(step: &Step) -> String {
    coded(&step.expected.replace('*', ""))
}

fn joined(mark: &str, why: &str) -> String {
    if why.is_empty() { String::new() } else { format!("{mark}{}", coded(why)) }
}

/// Text with its spans between backticks as code.
fn coded(text: &str) -> String {
    let parts = text.split('`').enumerate().map(|(at, part)| {
        let part = escaped(part);
        if at % 2 == 1 { format!("<code>{part}</code>") } else { part }
    });
    parts.collect()
}

const RULES: &str = "<h2>How it is judged</h2><p>A number is met within its limits, both included. \
    Where a step has none, the person at the bench judged by eye. A step without a value is not \
    measured, even if the form says passed; a failure counts without one. The steps and how to do \
    them: <code>docs/bench-protocol.md</code>.</p>";

#[cfg(test)]
mod tests;

//! Verdicts on the steps of a form.

use serde_json::{Value, json};
use taxel_files::bench::{Form, HEAD, Step};

/// Verdict on a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Met,
    Missed,
    /// Something was found, but nobody said whether it is as expected.
    NotJudged,
    NotMeasured,
}

impl Verdict {
    pub fn words(self) -> &'static str {
        match self {
            Self::Met => "met",
            Self::Missed => "missed",
            Self::NotJudged => "not judged",
            Self::NotMeasured => "not measured",
        }
    }
}

/// Step with its verdict.
pub struct JudgedStep {
    pub step: Step,
    /// Lowest and highest value for this finger.
    pub range: Option<[f64; 2]>,
    pub verdict: Verdict,
    /// Reason of the verdict; may be empty.
    pub why: String,
}

impl JudgedStep {
    fn new(step: Step, matrix_alone: bool) -> Self {
        let range = step.limits.as_ref().map(|limits| {
            let matrix_max = limits.matrix_max.filter(|_| matrix_alone);
            [limits.min, matrix_max.unwrap_or(limits.max)]
        });
        let (verdict, why) = match range {
            Some(range) => by_number(&step, range),
            None => by_words(&step),
        };
        Self { step, range, verdict, why }
    }

    pub fn unit(&self) -> &str {
        self.step.limits.as_ref().map_or("", |limits| &limits.unit)
    }
}

/// Compares the measured number with its limits. The person's word can only make it worse.
fn by_number(step: &Step, [min, max]: [f64; 2]) -> (Verdict, String) {
    let unit = step.limits.as_ref().map_or("", |limits| &limits.unit);
    let Some(value) = step.found.value else { return without_value(step) };
    let off = match value {
        value if value > max => format!("over the limit by {} {unit}", short(value - max)),
        value if value < min => format!("under the limit by {} {unit}", short(min - value)),
        _ if step.found.passed == Some(false) => {
            return (Verdict::Missed, "within the limits, but the form says failed".to_owned());
        }
        _ => return (Verdict::Met, String::new()),
    };
    let against = if step.found.passed == Some(true) { "; the form says passed" } else { "" };
    (Verdict::Missed, off + against)
}

/// Takes the person's word on what was found.
fn by_words(step: &Step) -> (Verdict, String) {
    match step.found.passed {
        _ if step.found.measured.is_empty() => without_value(step),
        Some(true) => (Verdict::Met, String::new()),
        Some(false) => (Verdict::Missed, "the form says failed".to_owned()),
        None => (Verdict::NotJudged, "`passed` is empty".to_owned()),
    }
}

/// A failure needs no value; a pass does.
fn without_value(step: &Step) -> (Verdict, String) {
    match step.found.passed {
        Some(false) => (Verdict::Missed, "the form says failed, without a value".to_owned()),
        Some(true) => {
            (Verdict::NotMeasured, "the form says passed, but `measured` is empty".to_owned())
        }
        None => (Verdict::NotMeasured, String::new()),
    }
}

/// Number with at most four significant digits, without zeros at its end.
fn short(value: f64) -> String {
    let rounded: f64 = format!("{value:.3e}").parse().unwrap_or(value);
    rounded.to_string()
}

/// Form with a verdict on every step.
pub struct Judged {
    pub head: [String; HEAD.len()],
    pub matrix_alone: bool,
    pub steps: Vec<JudgedStep>,
}

impl Judged {
    pub fn new(form: Form) -> Self {
        let matrix_alone = form.is_matrix_alone();
        let judge = |step| JudgedStep::new(step, matrix_alone);
        Self { matrix_alone, steps: form.steps.into_iter().map(judge).collect(), head: form.head }
    }

    /// Steps with a verdict, in the order of the form.
    pub fn with(&self, verdict: Verdict) -> impl Iterator<Item = &JudgedStep> {
        self.steps.iter().filter(move |step| step.verdict == verdict)
    }

    pub fn count(&self, verdict: Verdict) -> usize {
        self.with(verdict).count()
    }

    /// Steps that are met or missed.
    pub fn done(&self) -> usize {
        self.count(Verdict::Met) + self.count(Verdict::Missed)
    }

    /// Verdict on the form, in one sentence.
    pub fn verdict(&self) -> String {
        let (all, done, missed) = (self.steps.len(), self.done(), self.count(Verdict::Missed));
        match (done, missed) {
            (0, _) => format!("Nothing measured yet: none of {all} steps"),
            (_, 0) if done == all => format!("All {all} steps are met"),
            (_, 0) => format!("None missed so far, {done} of {all} steps done"),
            (_, missed) => format!("{missed} missed, {done} of {all} steps done"),
        }
    }

    /// Counts, head and steps for scripts.
    pub fn json(&self) -> Value {
        let steps = self.steps.iter().map(|judged| {
            let JudgedStep { step, range, verdict, why } = judged;
            json!({
                "step": step.step, "check": step.check, "expected": step.expected,
                "min": range.map(|[min, _]| min), "max": range.map(|[_, max]| max),
                "unit": judged.unit(), "measured": step.found.measured,
                "value": step.found.value, "verdict": verdict.words(), "why": why,
                "note": step.found.note,
            })
        });
        let mut all = json!({
            "done": self.done(), "met": self.count(Verdict::Met),
            "missed": self.count(Verdict::Missed), "not_judged": self.count(Verdict::NotJudged),
            "not_measured": self.count(Verdict::NotMeasured), "steps": steps.collect::<Vec<_>>(),
        });
        for (key, value) in HEAD.iter().zip(&self.head) {
            all[*key] = json!(value);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use taxel_files::bench::{Found, Limits};

    use super::*;

    fn judged(limits: Option<Limits>, measured: &str, passed: Option<bool>) -> (Verdict, String) {
        let value = limits.as_ref().and_then(|_| measured.parse().ok());
        let found = Found { measured: measured.to_owned(), value, passed, note: String::new() };
        let [step, check, expected] = ["B1", "supply", "as said"].map(str::to_owned);
        let step = JudgedStep::new(Step { step, check, expected, limits, found }, false);
        (step.verdict, step.why)
    }

    fn limits() -> Option<Limits> {
        Some(Limits { min: 0.0, max: 53.0, matrix_max: None, unit: "mA".to_owned() })
    }

    #[test]
    fn number_is_judged_by_its_limits() {
        for (measured, passed, verdict, why) in [
            ("53", None, Verdict::Met, ""),
            ("0", Some(true), Verdict::Met, ""),
            ("53.1", None, Verdict::Missed, "over the limit by 0.1 mA"),
            ("-2", None, Verdict::Missed, "under the limit by 2 mA"),
            ("60", Some(true), Verdict::Missed, "over the limit by 7 mA; the form says passed"),
            ("44", Some(false), Verdict::Missed, "within the limits, but the form says failed"),
        ] {
            assert_eq!(judged(limits(), measured, passed), (verdict, why.to_owned()), "{measured}");
        }
    }

    #[test]
    fn words_are_judged_by_the_person() {
        assert_eq!(judged(None, "blinks", Some(true)).0, Verdict::Met);
        assert_eq!(judged(None, "dark", Some(false)).0, Verdict::Missed);
        assert_eq!(judged(None, "blinks", None).0, Verdict::NotJudged);
    }

    #[test]
    fn step_without_value_is_never_met() {
        for limits in [limits(), None] {
            assert_eq!(judged(limits.clone(), "", None), (Verdict::NotMeasured, String::new()));
            let (verdict, why) = judged(limits.clone(), "", Some(true));
            assert_eq!(verdict, Verdict::NotMeasured);
            assert_eq!(why, "the form says passed, but `measured` is empty");
            assert_eq!(judged(limits, "", Some(false)).0, Verdict::Missed);
        }
    }

    #[test]
    fn finger_without_force_sensors_has_its_own_limit() {
        let limits = Limits { min: 0.0, max: 10.6, matrix_max: Some(71.2), unit: "mN".to_owned() };
        let found = Found { measured: "50".to_owned(), value: Some(50.0), ..Found::default() };
        let step = |found| {
            let [step, check, expected] = ["F6a", "accuracy", "F_x"].map(str::to_owned);
            Step { step, check, expected, limits: Some(limits.clone()), found }
        };
        let verdict = |alone| JudgedStep::new(step(found.clone()), alone).verdict;
        assert_eq!([true, false].map(verdict), [Verdict::Met, Verdict::Missed]);
    }
}

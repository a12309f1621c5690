//! Table of the recorded channels: which parts of the record each of them serves, or why none.

use serde::Serialize;
use taxel::scan::SENSORS;
use taxel_files::trace::Sample;

use super::Fitted;
use crate::recording::Recording;

/// A group of recorded columns and its use.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Channel {
    /// Columns of the recordings, as in a trace.
    pub columns: String,
    /// Parts of the calibration that use them; empty if none does.
    pub used: Vec<String>,
    /// Reason why no part uses them, or their faults; empty otherwise.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub why: String,
}

impl Channel {
    /// Makes the entry of a group of columns; `why` counts only if nothing uses them.
    #[must_use]
    pub fn new(columns: &str, used: Vec<String>, why: &str) -> Self {
        let why = if used.is_empty() { why.to_owned() } else { String::new() };
        Self { columns: columns.into(), used, why }
    }
}

/// Reasons of the fit for leaving out a force sensor.
pub(super) type Reasons = [Option<String>; SENSORS];

/// Lists every group of columns in the recordings.
pub(super) fn channels(
    fitted: &Fitted,
    recordings: &[Recording],
    reasons: &Reasons,
) -> Vec<Channel> {
    let has = |of: &dyn Fn(&Sample) -> bool| recordings.iter().any(|r| r.samples.iter().any(of));
    let calibration = &fitted.calibration;
    let part = |begins: &str| -> Vec<String> {
        let names = fitted.parts.iter().map(|part| &part.name);
        names.filter(|name| name.starts_with(begins)).cloned().collect()
    };
    let optical: Vec<String> =
        ["net", "skip", "linear", "model of"].iter().flat_map(|name| part(name)).collect();
    let array = part("array");
    let sensors: Vec<String> = (0..SENSORS).flat_map(|i| part(&format!("s{i}"))).collect();
    let mut list = Vec::new();
    if has(&|s| s.scan.codes.taxels.is_some()) {
        let why = "no recording of a load on the finger";
        list.push(Channel::new("lit_*, dark_*", optical.clone(), why));
    }
    for (i, reason) in reasons.iter().enumerate() {
        if has(&|s| s.scan.codes.bridges[i].is_some()) {
            let mut used = part(&format!("s{i}"));
            if calibration.sensors[i].is_some() {
                used.extend(array.clone());
            }
            let why = reason.as_deref().unwrap_or("no recording of a load on it");
            list.push(Channel::new(&format!("bridge_s{i}_*"), used, why));
        }
    }
    if has(&|s| s.scan.codes.temperature.is_some()) {
        let used = calibration.warmth.map(|_| "temperature compensation".to_owned());
        let why = "a recording with loads lacks it";
        list.push(Channel::new("aux_temp", used.into_iter().collect(), why));
    }
    if has(&|s| s.scan.codes.reference.is_some()) {
        let why = "codes are fractions of the same reference";
        list.push(Channel::new("aux_vref", Vec::new(), why));
    }
    if has(&|s| s.truth.force.iter().any(Option::is_some)) {
        let used = [&optical[..], &array[..]].concat();
        let used = if used.is_empty() { sensors } else { used };
        list.push(Channel::new("fx_n, fy_n, fz_n", used, "no part was fitted to the total force"));
    }
    if has(&|s| s.truth.point.iter().any(Option::is_some)) {
        let mut used = part("model of");
        used.extend(part("array of sensors 6x"));
        used.extend(array.iter().filter(|name| *name == "array of sensors").cloned());
        list.push(Channel::new(
            "x_mm, y_mm",
            used,
            "neither model of the skin nor array was fitted",
        ));
    }
    if has(&|s| s.truth.torsion.is_some()) {
        let known = array.iter().filter(|name| !name.contains(" 3x")).cloned().collect();
        list.push(Channel::new("torsion_nmm", known, "it needs contact points and an array"));
    }
    for (i, reason) in reasons.iter().enumerate() {
        if has(&|s| s.truth.sensors[i].iter().any(Option::is_some)) {
            let columns = format!("s{i}_fx_n, s{i}_fy_n, s{i}_fz_n");
            let why = reason.as_deref().unwrap_or("its matrix S was not fitted");
            list.push(Channel::new(&columns, part(&format!("s{i}")), why));
        }
    }
    list
}

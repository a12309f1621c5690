//! Table of the recorded channels: which parts of the record each of them serves, or why none.

use serde::Serialize;
use taxel::scan::SENSORS;
use taxel_files::trace::{Sample, sensor_truth_names};

use super::Fitted;
use crate::evaluate::POINT;
use crate::recording::Recording;
use taxel_regress::shear::FORCES;

/// Reason why nothing uses the channel of the supply.
pub(crate) const SUPPLY: &str = "codes are fractions of the same reference";

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

/// Group of recorded columns.
#[derive(Clone, Copy)]
pub(crate) enum Columns {
    Taxels,
    Bridge(usize),
    Temperature,
    Supply,
    Force,
    Point,
    Torsion,
    /// Force on a sensor.
    Sensor(usize),
    Contact,
    Slip,
}

impl Columns {
    /// Names of the columns, as in a trace.
    fn names(self) -> String {
        match self {
            Self::Taxels => "lit_*, dark_*".to_owned(),
            Self::Bridge(i) => format!("bridge_s{i}_*"),
            Self::Temperature => "aux_temp".to_owned(),
            Self::Supply => "aux_vref".to_owned(),
            Self::Force => FORCES.join(", "),
            Self::Point => POINT.join(", "),
            Self::Torsion => "torsion_nmm".to_owned(),
            Self::Sensor(i) => sensor_truth_names(i).join(", "),
            Self::Contact => "contact".to_owned(),
            Self::Slip => "slip".to_owned(),
        }
    }

    fn is_in(self, Sample { scan, truth, .. }: &Sample) -> bool {
        let known = |values: &[Option<f64>]| values.iter().any(Option::is_some);
        match self {
            Self::Taxels => scan.codes.taxels.is_some(),
            Self::Bridge(i) => scan.codes.bridges[i].is_some(),
            Self::Temperature => scan.codes.temperature.is_some(),
            Self::Supply => scan.codes.reference.is_some(),
            Self::Force => known(&truth.force),
            Self::Point => known(&truth.point),
            Self::Torsion => truth.torsion.is_some(),
            Self::Sensor(i) => known(&truth.sensors[i]),
            Self::Contact => truth.contact.is_some(),
            Self::Slip => truth.slip.is_some(),
        }
    }
}

/// List of the groups of columns that the recordings have.
pub(crate) struct List<'r> {
    recordings: &'r [Recording],
    channels: Vec<Channel>,
}

impl<'r> List<'r> {
    pub(crate) fn new(recordings: &'r [Recording]) -> Self {
        Self { recordings, channels: Vec::new() }
    }

    /// Adds a group of columns if a recording has it, with the names of the parts that use it.
    ///
    /// Returns its entry. `why` counts only if nothing uses it.
    pub(crate) fn add(
        &mut self,
        columns: Columns,
        used: Vec<String>,
        why: &str,
    ) -> Option<&mut Channel> {
        let mut samples = self.recordings.iter().flat_map(|recording| &recording.samples);
        if !samples.any(|sample| columns.is_in(sample)) {
            return None;
        }
        let names = match columns {
            Columns::Force => self.forces(true),
            columns => columns.names(),
        };
        self.channels.push(Channel::new(&names, used, why));
        self.channels.last_mut()
    }

    /// Adds the shear if the normal force alone is recorded.
    fn add_unknown_shear(&mut self) {
        let unknown = self.forces(false);
        if unknown == FORCES[..2].join(", ") {
            let why = "not recorded: shear and slip are not known, and given as not estimated";
            self.channels.push(Channel::new(&unknown, Vec::new(), why));
        }
    }

    /// Names of the components of the total force that are recorded, or of those that are not.
    fn forces(&self, recorded: bool) -> String {
        let samples = self.recordings.iter().flat_map(|recording| &recording.samples);
        let known = |axis: &usize| samples.clone().any(|s| s.truth.force[*axis].is_some());
        let names = (0..3).filter(|axis| known(axis) == recorded).map(|axis| FORCES[axis]);
        names.collect::<Vec<_>>().join(", ")
    }

    pub(crate) fn done(self) -> Vec<Channel> {
        self.channels
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
    let calibration = &fitted.calibration;
    let part = |begins: &str| -> Vec<String> {
        let names = fitted.parts.iter().map(|part| &part.name);
        names.filter(|name| name.starts_with(begins)).cloned().collect()
    };
    let optical: Vec<String> =
        ["net", "skip", "linear", "model of"].iter().flat_map(|name| part(name)).collect();
    let array = part("array");
    let sensors: Vec<String> = (0..SENSORS).flat_map(|i| part(&format!("s{i}"))).collect();
    let mut list = List::new(recordings);
    list.add(Columns::Taxels, optical.clone(), "no recording of a load on the finger");
    for (i, reason) in reasons.iter().enumerate() {
        let mut used = part(&format!("s{i}"));
        if calibration.sensors[i].is_some() {
            used.extend(array.clone());
        }
        let why = reason.as_deref().unwrap_or("no recording of a load on it");
        list.add(Columns::Bridge(i), used, why);
    }
    let used = calibration.warmth.map(|_| "temperature compensation".to_owned());
    let why = "a recording with loads lacks it";
    list.add(Columns::Temperature, used.into_iter().collect(), why);
    list.add(Columns::Supply, Vec::new(), SUPPLY);
    let used = [&optical[..], &array[..]].concat();
    let used = if used.is_empty() { sensors } else { used };
    list.add(Columns::Force, used, "no part was fitted to the total force");
    list.add_unknown_shear();
    let mut used = part("model of");
    used.extend(part("array of sensors 6x"));
    used.extend(array.iter().filter(|name| *name == "array of sensors").cloned());
    list.add(Columns::Point, used, "neither model of the skin nor array was fitted");
    let known = array.iter().filter(|name| !name.contains(" 3x")).cloned().collect();
    list.add(Columns::Torsion, known, "it needs contact points and an array");
    for (i, reason) in reasons.iter().enumerate() {
        let why = reason.as_deref().unwrap_or("its matrix S was not fitted");
        list.add(Columns::Sensor(i), part(&format!("s{i}")), why);
    }
    list.done()
}

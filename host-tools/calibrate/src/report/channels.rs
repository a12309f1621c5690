//! List of channels: which columns of the recordings the report uses, and for what.

use taxel::calibration::Calibration;
use taxel::condition::Health;
use taxel::scan::{COLS, SENSORS, TAXELS};
use taxel_files::trace::Sample;

use crate::finger::Channel;
use crate::recording::Recording;

/// Lists the columns of the recordings with the parts of the calibration that use them.
pub(crate) fn channels(calibration: &Calibration, recordings: &[Recording]) -> Vec<Channel> {
    let samples = || recordings.iter().flat_map(|recording| &recording.samples);
    let has = |of: &dyn Fn(&Sample) -> bool| samples().any(of);
    let part = |known: bool, name: &str| known.then(|| name.to_owned());
    let faults = Faults::of(calibration, recordings);
    let mut list = Vec::new();
    if has(&|s| s.scan.codes.taxels.is_some()) {
        let used = [
            part(calibration.model.is_some(), "model of the skin"),
            part(calibration.net.is_some(), "net"),
            part(calibration.taxels.is_some(), "contact"),
        ];
        let used: Vec<String> = used.into_iter().flatten().collect();
        let why = if used.is_empty() { "the record has no part for the matrix" } else { "" };
        let (columns, why) = ("lit_*, dark_* (16 taxels)".into(), faults.of_taxels(why));
        list.push(Channel { columns, used, why });
    }
    for i in 0..SENSORS {
        if has(&|s| s.scan.codes.bridges[i].is_some()) {
            let known = calibration.sensors[i].is_some();
            let used = [
                part(known && calibration.array.is_some(), "array of sensors"),
                part(known, &format!("force on s{i}")),
            ];
            let why = if known { "" } else { "the record has no matrix for it" };
            let (used, why) = (used.into_iter().flatten().collect(), faults.of_sensor(i, why));
            list.push(Channel { columns: format!("bridge_s{i}_* (force sensor)"), used, why });
        }
    }
    let mut add = |known: bool, columns: &str, used: Option<String>, why: &str| {
        if known {
            list.push(Channel::new(columns, used.into_iter().collect(), why));
        }
    };
    let warmth = part(calibration.warmth.is_some(), "temperature compensation");
    let why = "the record has no temperature compensation";
    add(has(&|s| s.scan.codes.temperature.is_some()), "aux_temp", warmth, why);
    let why = "codes are fractions of the same reference";
    add(has(&|s| s.scan.codes.reference.is_some()), "aux_vref", None, why);
    let labels = || Some("labels that this page judges by".to_owned());
    add(has(&|s| s.truth.force.iter().any(Option::is_some)), "fx_n, fy_n, fz_n", labels(), "");
    let placed = calibration.taxels.is_some() || calibration.array.is_some();
    let why = "the record gives no contact point";
    let points = labels().filter(|_| placed);
    add(has(&|s| s.truth.point.iter().any(Option::is_some)), "x_mm, y_mm", points, why);
    for i in 0..SENSORS {
        let columns = format!("s{i}_fx_n, s{i}_fy_n, s{i}_fz_n");
        let used = labels().filter(|_| calibration.sensors[i].is_some());
        let why = "the record has no matrix for that sensor";
        add(has(&|s| s.truth.sensors[i].iter().any(Option::is_some)), &columns, used, why);
    }
    let loaded = Some("rows in contact".to_owned());
    add(has(&|s| s.truth.contact.is_some()), "contact", loaded, "");
    let why = "this page judges no torsion";
    add(has(&|s| s.truth.torsion.is_some()), "torsion_nmm", None, why);
    add(has(&|s| s.truth.slip.is_some()), "slip", None, "this page judges no slip");
    list
}

/// Number of rows in which each channel is at fault.
#[derive(Default)]
struct Faults {
    rows: usize,
    taxels: [usize; TAXELS],
    sensors: [usize; SENSORS],
}

impl Faults {
    fn of(calibration: &Calibration, recordings: &[Recording]) -> Self {
        let mut found = Self::default();
        let bias = calibration.bias();
        for signals in recordings.iter().flat_map(|recording| recording.signals(&bias, None)) {
            let Health { saturated, dead, bridge_faults } = signals.health;
            found.rows += 1;
            let count = |(i, rows): (usize, &mut usize), bits: u32| {
                *rows += usize::from(bits >> i & 1 == 1);
            };
            let clipped = u32::from(saturated | dead);
            found.taxels.iter_mut().enumerate().for_each(|taxel| count(taxel, clipped));
            let faults = u32::from(bridge_faults);
            found.sensors.iter_mut().enumerate().for_each(|sensor| count(sensor, faults));
        }
        found
    }

    fn percent(&self, rows: usize) -> String {
        format!("at fault in {:.1} % of the rows", 100.0 * rows as f64 / self.rows.max(1) as f64)
    }

    /// Adds the taxels at fault to a reason.
    fn of_taxels(&self, why: &str) -> String {
        let faults = self.taxels.iter().enumerate().filter(|(_, rows)| **rows > 0);
        let faults = faults.map(|(k, rows)| {
            format!("r{}c{} dark or clipped, {}", k / COLS, k % COLS, self.percent(*rows))
        });
        let why = (!why.is_empty()).then(|| why.to_owned());
        why.into_iter().chain(faults).collect::<Vec<_>>().join("; ")
    }

    /// Adds the faults of a sensor to a reason.
    fn of_sensor(&self, sensor: usize, why: &str) -> String {
        match self.sensors[sensor] {
            0 => why.to_owned(),
            rows if why.is_empty() => self.percent(rows),
            rows => format!("{why}; {}", self.percent(rows)),
        }
    }
}

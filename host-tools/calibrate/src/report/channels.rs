//! List of channels: which columns of the recordings the report uses, and for what.

use taxel::calibration::Calibration;
use taxel::condition::Health;
use taxel::scan::{COLS, SENSORS, TAXELS};

use crate::finger::{Channel, Columns, List, SUPPLY};
use crate::recording::Recording;

/// Lists the columns of the recordings with the parts of the calibration that use them.
pub(crate) fn channels(calibration: &Calibration, recordings: &[Recording]) -> Vec<Channel> {
    let part = |known: bool, name: &str| known.then(|| name.to_owned());
    let faults = Faults::of(calibration, recordings);
    let mut list = List::new(recordings);
    let used = [
        part(calibration.model.is_some(), "model of the skin"),
        part(calibration.net.is_some(), "net"),
        part(calibration.taxels.is_some(), "contact"),
    ];
    let why = "the record has no part for the matrix";
    if let Some(taxels) = list.add(Columns::Taxels, used.into_iter().flatten().collect(), why) {
        taxels.columns += " (16 taxels)";
        taxels.why = faults.of_taxels(&taxels.why);
    }
    for i in 0..SENSORS {
        let known = calibration.sensors[i].is_some();
        let used = [
            part(known && calibration.array.is_some(), "array of sensors"),
            part(known, &format!("force on s{i}")),
        ];
        let used = used.into_iter().flatten().collect();
        let sensor = list.add(Columns::Bridge(i), used, "the record has no matrix for it");
        if let Some(sensor) = sensor {
            sensor.columns += " (force sensor)";
            sensor.why = faults.of_sensor(i, &sensor.why);
        }
    }
    let mut add = |columns, used: Option<String>, why| {
        list.add(columns, used.into_iter().collect(), why);
    };
    let warmth = part(calibration.warmth.is_some(), "temperature compensation");
    add(Columns::Temperature, warmth, "the record has no temperature compensation");
    add(Columns::Supply, None, SUPPLY);
    let labels = |known| part(known, "labels that this page judges by");
    add(Columns::Force, labels(true), "");
    let placed = calibration.taxels.is_some() || calibration.array.is_some();
    add(Columns::Point, labels(placed), "the record gives no contact point");
    for i in 0..SENSORS {
        let known = calibration.sensors[i].is_some();
        add(Columns::Sensor(i), labels(known), "the record has no matrix for that sensor");
    }
    add(Columns::Contact, Some("rows in contact".to_owned()), "");
    add(Columns::Torsion, None, "this page judges no torsion");
    add(Columns::Slip, None, "this page judges no slip");
    list.done()
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

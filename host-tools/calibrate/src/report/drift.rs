//! Drift: the difference between two calibrations of one finger.

use crate::recording::Recording;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use taxel::calibration::{Calibration, SensorCalibration};
use taxel::estimate::quantised::Net;
use taxel::scan::{SENSORS, TAXELS};
use taxel_regress::table::{TableModel, TableRecording};

use super::figures::figures;
use super::series::{self, Series, fine, split_unit};
use super::table;

/// Changes of a finger between two calibrations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// Seconds from the first to the second; negative if the second is older.
    pub seconds: i64,
    /// Warnings, in full sentences.
    pub warnings: Vec<String>,
    /// Changes of every quantity.
    pub changes: Vec<Change>,
    /// Errors of both calibrations on recordings with references.
    pub met: Vec<Met>,
}

/// One quantity before and after.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// Part of the record.
    pub part: String,
    /// Quantity.
    pub what: String,
    /// Amount of the change.
    pub by: f64,
    /// Unit of the change.
    pub unit: &'static str,
}

/// RMSE of one reference column with either calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Met {
    /// Name of the recording.
    pub recording: String,
    /// Reference column.
    pub target: String,
    /// Unit of the column.
    pub unit: &'static str,
    /// RMSE with the first calibration.
    pub before: f64,
    /// RMSE with the second calibration.
    pub after: f64,
}

/// Compares two calibrations, also on `recordings` with references.
#[must_use]
pub fn compare(first: &Calibration, second: &Calibration, recordings: &[Recording]) -> Drift {
    let mut drift = Drift {
        seconds: second.date.cast_signed() - first.date.cast_signed(),
        warnings: Vec::new(),
        changes: Vec::new(),
        met: recordings
            .iter()
            .flat_map(|r| {
                let [first, second] = [first, second].map(|of| series::run(of, r, &mut |_| true));
                met(&r.name, &first, &second)
            })
            .collect(),
    };
    drift.warnings.extend(strangers("fingers", &first.serial, &second.serial));
    taxels(&mut drift, first, second);
    for i in 0..SENSORS {
        let name = format!("s{i}");
        match (&first.sensors[i], &second.sensors[i]) {
            (Some(a), Some(b)) => sensor(&mut drift, &name, a, b),
            (a, b) => only_one(&mut drift, &name, a.is_some(), b.is_some()),
        }
    }
    let parts = |of: &Calibration| {
        [of.model.is_some(), of.slip.is_some(), of.warmth.is_some(), of.array.is_some()]
    };
    let names = ["the model of the skin", "slip", "warmth", "the array of sensors"];
    for (part, (a, b)) in names.into_iter().zip(parts(first).into_iter().zip(parts(second))) {
        only_one(&mut drift, part, a, b);
    }
    drift
}

/// Compares two models of one table.
///
/// The changes are those of the outputs in the middle of the first model's range, and from end to
/// end of each input's range. The errors on `recordings` are compared as well.
#[must_use]
pub fn compare_tables(
    first: &TableModel,
    second: &TableModel,
    recordings: &[TableRecording],
) -> Drift {
    let mut drift = Drift {
        seconds: second.date.cast_signed() - first.date.cast_signed(),
        warnings: strangers("sensors", &first.serial, &second.serial).into_iter().collect(),
        changes: Vec::new(),
        met: recordings
            .iter()
            .flat_map(|r| met(&r.name(), &table::series(first, r), &table::series(second, r)))
            .collect(),
    };
    let middle: Vec<f32> = first.range.iter().map(|[low, high]| 0.5 * (low + high)).collect();
    for (k, target) in first.targets.iter().enumerate() {
        let (times, unit) = fine(split_unit(target).1);
        let by = |x: &[f32]| {
            let said =
                |model: &TableModel| model.estimate(x).get(k).copied().map_or(0.0, f64::from);
            times * (said(second) - said(first))
        };
        drift.push(target, "in the middle of the range".into(), by(&middle), unit);
        for ((i, input), [low, high]) in first.inputs.iter().enumerate().zip(&first.range) {
            let at = |end: f32| {
                let mut x = middle.clone();
                x[i] = end;
                by(&x)
            };
            drift.push(target, format!("{input} from end to end"), at(*high) - at(*low), unit);
        }
    }
    drift
}

fn strangers(of: &str, first: &str, second: &str) -> Option<String> {
    (first != second).then(|| {
        format!(
            "they are of different {of} (`{first}` and `{second}`): their changes are not drift"
        )
    })
}

fn only_one(drift: &mut Drift, part: &str, first: bool, second: bool) {
    match (first, second) {
        (true, false) => drift.warnings.push(format!("{part} is only in the first")),
        (false, true) => drift.warnings.push(format!("{part} is only in the second")),
        _ => {}
    }
}

fn taxels(drift: &mut Drift, first: &Calibration, second: &Calibration) {
    let (Some(a), Some(b)) = (&first.taxels, &second.taxels) else {
        only_one(drift, "the optical matrix", first.taxels.is_some(), second.taxels.is_some());
        return;
    };
    let changes: [f64; TAXELS] = std::array::from_fn(|k| {
        let (before, after) = (f64::from(a.bias.level[k]), f64::from(b.bias.level[k]));
        100.0 * (after - before) / before.abs().max(f64::MIN_POSITIVE)
    });
    let rms = (changes.iter().map(|c| c * c).sum::<f64>() / TAXELS as f64).sqrt();
    let worst = (0..TAXELS).max_by(|i, j| changes[*i].abs().total_cmp(&changes[*j].abs()));
    drift.push("taxels", "unloaded light, RMS".into(), rms, "%");
    if let Some(k) = worst {
        drift.push("taxels", format!("unloaded light, r{}c{}", k / 4, k % 4), changes[k], "%");
    }
    drift.push("taxels", "noise".into(), ratio(a.bias.noise, b.bias.noise), "%");
    let told = !drift.met.is_empty();
    match [first, second].map(|calibration| calibration.net.as_ref()) {
        [Some(a), Some(b)] => {
            let form = |net: &Net| if matches!(net, Net::Float(_)) { "f32" } else { "16 bits" };
            if form(a) != form(b) {
                let (a, b) = (form(a), form(b));
                drift
                    .warnings
                    .push(format!("the net is in {a} in the first, in {b} in the second"));
            }
            if a != b && !told {
                drift.warnings.push(
                    "the nets differ; give a recording with references (--data) to compare them in newtons"
                        .into(),
                );
            }
        }
        [a, b] => only_one(drift, "the net", a.is_some(), b.is_some()),
    }
}

/// Adds the second sensor's changes relative to the first: G·f + offset, G = S₂S₁⁻¹.
fn sensor(drift: &mut Drift, name: &str, a: &SensorCalibration, b: &SensorCalibration) {
    let s = |of: &SensorCalibration| {
        Matrix3::from_fn(|row, column| f64::from(of.sensitivity.0[row][column]))
    };
    let level = |of: &SensorCalibration| Vector3::from(of.bias.level.map(f64::from));
    let offset = s(a) * (level(b) - level(a));
    for (axis, offset) in ["x", "y", "z"].iter().zip(&offset) {
        drift.push(name, format!("offset {axis}"), 1e3 * offset, "mN");
    }
    let Some(inverse) = s(a).try_inverse() else {
        drift.warnings.push(format!("{name}: the first S cannot be inverted; gains not compared"));
        return;
    };
    let gain = s(b) * inverse;
    for (i, axis) in ["x", "y", "z"].iter().enumerate() {
        drift.push(name, format!("gain {axis}"), 100.0 * (gain[(i, i)] - 1.0), "%");
    }
    let largest = (0..3)
        .flat_map(|i| (0..3).map(move |j| (i, j)))
        .filter(|(i, j)| i != j)
        .map(|at| gain[at])
        .fold(0.0, |most: f64, g| if g.abs() > most.abs() { g } else { most });
    drift.push(name, "largest cross-talk".into(), 100.0 * largest, "%");
    drift.push(name, "noise".into(), ratio(a.bias.noise, b.bias.noise), "%");
}

/// Relative growth in percent.
fn ratio(before: f32, after: f32) -> f64 {
    100.0 * (f64::from(after) / f64::from(before).max(f64::MIN_POSITIVE) - 1.0)
}

impl Drift {
    fn push(&mut self, part: &str, what: String, by: f64, unit: &'static str) {
        self.changes.push(Change { part: part.into(), what, by, unit });
    }
}

fn met(recording: &str, before: &[Series], after: &[Series]) -> Vec<Met> {
    before
        .iter()
        .filter_map(|before| {
            let after = after.iter().find(|after| after.kind == before.kind)?;
            let (a, b) = (figures(before, &[])?, figures(after, &[])?);
            Some(Met {
                recording: recording.into(),
                target: a.target,
                unit: a.unit,
                before: a.rmse,
                after: b.rmse,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::condition::BridgeBias;
    use taxel::estimate::sensitivity::Sensitivity;

    fn calibration(s: [[f32; 3]; 3], level: [f32; 3]) -> Calibration {
        let mut calibration = Calibration::default();
        calibration.sensors[0] = Some(SensorCalibration {
            bias: BridgeBias { level, noise: 1e-4 },
            sensitivity: Sensitivity(s),
            range: [[-1.0, 1.0]; 3],
            residual: [1e-3; 3],
        });
        calibration
    }

    fn by(drift: &Drift, what: &str) -> f64 {
        drift.changes.iter().find(|change| change.what == what).unwrap().by
    }

    #[test]
    fn drift_reports_offset_in_mn_and_gain_in_percent() {
        let first = calibration([[7.0, 0.0, 0.0], [0.0, 7.0, 0.0], [0.0, 0.0, 5.0]], [0.0; 3]);
        let second =
            calibration([[7.7, 0.0, 0.0], [0.0, 7.0, 0.0], [0.0, 0.35, 5.0]], [0.0, 0.0, 0.002]);
        let drift = compare(&first, &second, &[]);
        assert!((by(&drift, "offset z") - 10.0).abs() < 1e-3, "{drift:?}");
        assert!((by(&drift, "gain x") - 10.0).abs() < 1e-3);
        assert!(by(&drift, "gain y").abs() < 1e-3);
        // A force of 1 N in y now shows 0.05 N in z.
        assert!((by(&drift, "largest cross-talk") - 5.0).abs() < 1e-3);
        assert_eq!(
            compare(&first, &first, &[]).changes.iter().map(|c| c.by).fold(0.0, f64::max),
            0.0
        );
    }

    #[test]
    fn drift_warns_of_other_finger_and_missing_parts() {
        let first = calibration([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0; 3]);
        let second = Calibration { serial: "other".try_into().unwrap(), ..Calibration::default() };
        let warnings = compare(&first, &second, &[]).warnings.join("\n");
        assert!(
            warnings.contains("different fingers") && warnings.contains("s0 is only in the first")
        );
    }
}

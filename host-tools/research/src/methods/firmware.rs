//! Methods of the firmware under the fitted calibration record: matrix, force sensors, both.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use anyhow::Context;
use taxel::calibration::Calibration;
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::vibration::VibrationDetector;
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::units::Micros;
use taxel_calibrate::array;
use taxel_calibrate::finger::{FitOptions, Subject};
use taxel_regress::model::Family;
use taxel_regress::network::NetOptions;

use super::{Group, Method, Said};
use crate::device::{Device, Moment};
use crate::effort::Effort;

/// Stage of the skin model with shear, which it fits unless the force sensors exclude shear.
const MODEL: &str = "model, with shear";
/// Stages of the array as a sum of its sensors' forces.
const SUM: [&str; 3] =
    ["sum of four sensors", "array: wrench as a sum", "array: contact on a plane"];
/// Stages of the array with its full matrix, without the forces of single sensors.
const FULL: [&str; 2] = ["array: wrench by 6x12", "array: contact on a plane"];
/// Stage that detects gross slip by its vibration.
const EAR: &str = "slip: by its vibration";

/// Lists the methods under the calibration record of `device`.
///
/// # Errors
/// The full matrix of its sensors cannot be fitted.
pub(super) fn all(device: &Device, calibration: &Calibration) -> anyhow::Result<Vec<Method>> {
    let matrix = Calibration { array: None, sensors: Default::default(), ..calibration.clone() };
    let sensors = Calibration { taxels: None, net: None, model: None, ..calibration.clone() };
    let full = array::matrix(&device.recordings, calibration)?
        .context("the recordings do not determine the array's full matrix")?;
    let full = Array { method: WrenchMethod::Matrix(full), ..sensors.array.unwrap_or_default() };
    let full = Calibration { array: Some(full), ..sensors.clone() };
    let mut methods = vec![
        whole("model", Group::Model, &[MODEL], matrix.clone()),
        whole("four sensors' wrench", Group::Sensors, &SUM, sensors.clone()),
        whole("four sensors' wrench by 6x12", Group::Sensors, &FULL, full),
        whole("finger", Group::Finger, &[], calibration.clone()).at_the_cost_of_all(),
        slip("slip: matrix", Group::Model, &[MODEL], matrix),
        slip("slip: force sensors", Group::Sensors, &SUM, sensors),
        slip("slip: both", Group::Finger, &[], calibration.clone()).at_the_cost_of_all(),
        slides(),
    ];
    methods.push(forces(calibration.clone()));
    Ok(methods)
}

/// Lists the force methods of the firmware: net, model, whole finger.
pub(crate) fn firmwares(calibration: &Calibration) -> [Method; 3] {
    let matrix = Calibration { array: None, sensors: Default::default(), ..calibration.clone() };
    let net = Calibration { model: None, ..matrix.clone() };
    [
        whole("net", Group::Net, &[], net),
        whole("model", Group::Model, &[], matrix),
        whole("finger", Group::Finger, &[], calibration.clone()),
    ]
}

/// Calibration records by device seed and training steps.
///
/// All charts share them, because every chart needs records of the same devices.
static RECORDS: Mutex<BTreeMap<(u64, usize), Calibration>> = Mutex::new(BTreeMap::new());

/// Fits the device's calibration record as the tools do, once for each program run.
pub(crate) fn calibrated(
    device: &Device,
    effort: &Effort,
    stop: &AtomicBool,
) -> anyhow::Result<Calibration> {
    let key = (device.seed, effort.steps);
    let records = || RECORDS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(record) = records().get(&key) {
        return Ok(record.clone());
    }
    let options = FitOptions {
        subject: Subject::Finger,
        family: Family::Skip,
        hidden: Some(16),
        net: NetOptions { seed: 0, starts: 1, steps: effort.steps },
        ..FitOptions::default()
    };
    let recordings = [&device.recordings[..], std::slice::from_ref(&device.warm_up)].concat();
    let fitted = taxel_calibrate::finger::fit(&recordings, &options, &mut |_| {}, stop)
        .context("the finger's own calibration")?;
    anyhow::ensure!(!stop.load(Ordering::Relaxed), "stopped");
    records().insert(key, fitted.calibration.clone());
    Ok(fitted.calibration)
}

/// Returns an estimator that keeps state from scan to scan and uses all parts of the record. It starts
/// with each run, as a finger that is switched on.
fn finger(record: Calibration) -> impl FnMut(&Moment) -> Estimate {
    let [blind, numb] = [record.taxels.is_none(), record.array.is_none()];
    let (finger, new) = Finger::new(Some(record));
    let (mut state, mut last) = (new.clone(), Micros(0));
    move |moment| {
        let mut scan = moment.sample.scan;
        if scan.time < last {
            state = new.clone();
        }
        last = scan.time;
        if blind {
            scan.codes.taxels = None;
        }
        if numb {
            scan.codes.bridges = Default::default();
        }
        finger.estimate(&mut state, &scan)
    }
}

/// Method for force, contact point and torsion.
fn whole(name: &str, group: Group, stages: &[&str], record: Calibration) -> Method {
    let mut finger = finger(record);
    Method::new(name, group, stages, move |moment| {
        let estimate = finger(moment);
        let force = [estimate.force.x, estimate.force.y, estimate.force.z];
        let point = estimate.point.ok().map(|point| [point.x.0, point.y.0].map(f64::from));
        Said {
            force: force.map(|f| f.ok().map(|f| f64::from(f.0))),
            point,
            torsion: estimate.torsion.ok().map(|torsion| f64::from(torsion.0)),
            ..Said::default()
        }
    })
}

/// Method for slip from force and position, at the cost of `stages`.
fn slip(name: &str, group: Group, stages: &[&str], record: Calibration) -> Method {
    let stages = [stages, &["slip: verdict", "slip: by its way", EAR]].concat();
    let mut finger = finger(record);
    Method::new(name, group, &stages, move |moment| {
        let estimate = finger(moment);
        let margin = estimate.slip.ok().map(|verdict| f64::from(verdict.margin));
        let slides = Some(estimate.status.contains(Status::SLIDES));
        Said { margin, slides, ..Said::default() }
    })
}

/// Method for gross slip from vibration alone.
fn slides() -> Method {
    let mut listener = VibrationDetector::default();
    Method::new("slip: vibration", Group::Model, &[EAR], move |moment| {
        let slides = Some(listener.update(moment.sample.scan.time, &moment.signals));
        Said { slides, ..Said::default() }
    })
}

/// Method that sums f = S(u − b) over the force sensors ([Ospina2017]).
fn forces(record: Calibration) -> Method {
    let mut finger = finger(record);
    Method::new("four sensors", Group::Sensors, &["sum of four sensors"], move |moment| {
        let mut force = [Some(0.0); 3];
        for sensor in &finger(moment).sensors {
            for (sum, component) in force.iter_mut().zip([sensor.x, sensor.y, sensor.z]) {
                *sum = sum.zip(component.ok()).map(|(sum, f)| sum + f64::from(f.0));
            }
        }
        Said { force, ..Said::default() }
    })
}

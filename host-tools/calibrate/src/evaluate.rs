//! Errors of a calibrated finger against the reference columns of a recording.

use taxel::calibration::Calibration;
use taxel::estimate::Force;
use taxel::finger::{Estimate, Finger};
use taxel::frame::Status;
use taxel::measured::NoValue;
use taxel::scan::{Codes, SENSORS};
use taxel_files::frames;
use taxel_files::trace::{Truth, sensor_truth_names};

use crate::recording::Recording;
use taxel_regress::metrics::{Errors, TargetMetrics};
use taxel_regress::shear::FORCES;

pub(crate) const POINT: [&str; 2] = ["x_mm", "y_mm"];

/// Status bits that flag a fault.
pub const FLAGS: [Status; 10] = [
    Status::UNCALIBRATED,
    Status::SATURATED,
    Status::DEAD_TAXEL,
    Status::BRIDGE_FAULT,
    Status::OUT_OF_RANGE,
    Status::STUCK_CHANNEL,
    Status::NOT_SINGLE,
    Status::DISAGREE,
    Status::TEMPERATURE,
    Status::NOISY,
];

/// Part of the finger that is evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Only {
    /// Matrix and force sensors together.
    #[default]
    Both,
    /// Optical matrix, as if the finger had no force sensors.
    Matrix,
    /// Force sensors, as if the finger had no matrix.
    Array,
}

impl Only {
    /// Removes the other part's channels and coefficients.
    #[must_use]
    pub fn of(self, calibration: &Calibration, recording: &Recording) -> (Calibration, Recording) {
        let mut recording = recording.clone();
        recording.samples.iter_mut().for_each(|sample| self.keep_codes(&mut sample.scan.codes));
        (self.record(calibration), recording)
    }

    /// Removes the other part's coefficients.
    pub(crate) fn record(self, calibration: &Calibration) -> Calibration {
        let mut calibration = calibration.clone();
        match self {
            Self::Both => {}
            Self::Matrix => (calibration.array, calibration.sensors) = (None, Default::default()),
            Self::Array => {
                (calibration.taxels, calibration.net, calibration.model) = (None, None, None);
            }
        }
        calibration
    }

    /// Removes the other part's channels.
    pub(crate) fn keep_codes(self, codes: &mut Codes) {
        match self {
            Self::Both => {}
            Self::Matrix => codes.bridges = [None; SENSORS],
            Self::Array => codes.taxels = None,
        }
    }
}

/// Runs the recording through the core's finger and compares every row with its reference.
///
/// `fx_n`, `fy_n`, `fz_n` are compared with the finger's force if the calibration has one,
/// otherwise with the only calibrated sensor's. `x_mm`, `y_mm` are compared with the contact point
/// while something touches the finger, and `s0_fx_n` … with their sensor. Columns missing in the
/// recording, and quantities that the calibration cannot estimate at all, are left out.
#[must_use]
pub fn finger(calibration: &Calibration, recording: &Recording) -> Vec<TargetMetrics> {
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let against = against(calibration);
    let mut forces: [Errors; 3] = Default::default();
    let mut point: [Errors; 2] = Default::default();
    let mut sensors: [[Errors; 3]; SENSORS] = Default::default();
    for sample in &recording.samples {
        let estimate = finger.estimate(&mut state, &sample.scan);
        let truth = &sample.truth;
        let stated = estimate.uncertainty.as_ref().ok();
        if let Some((force, against)) =
            against.and_then(|against| Some((against.force(&estimate)?, against)))
        {
            let stated = stated.filter(|_| against == Against::Finger);
            let sigma = stated.map(|stated| components(&stated.force).map(Result::ok));
            compare(&mut forces, truth.force, (components(force), sigma.unwrap_or_default()));
        }
        if calibration.taxels.is_some() && touched(truth, &estimate) {
            let found = match estimate.point {
                Ok(point) => [Ok(point.x.0), Ok(point.y.0)],
                Err(reason) => [Err(reason); 2],
            };
            let sigma = stated.and_then(|stated| stated.point.as_ref().ok());
            let label = truth.point_sigma.unwrap_or_default() as f32;
            let sigma = sigma.map(|sigma| [sigma.x.0, sigma.y.0].map(|s| Some(s.hypot(label))));
            compare(&mut point, truth.point, (found, sigma.unwrap_or_default()));
        }
        for i in (0..SENSORS).filter(|i| calibration.sensors[*i].is_some()) {
            let found = components(&estimate.sensors[i]);
            compare(&mut sensors[i], truth.sensors[i], (found, [None; 3]));
        }
    }
    let forces = forces.into_iter().zip(FORCES.map(str::to_owned));
    let point = point.into_iter().zip(POINT.map(str::to_owned));
    let sensors = sensors
        .into_iter()
        .enumerate()
        .flat_map(|(i, errors)| errors.into_iter().zip(sensor_truth_names(i)));
    forces
        .chain(point)
        .chain(sensors)
        .filter(|(errors, _)| errors.rows() > 0)
        .map(|(errors, name)| errors.into_metrics(name))
        .collect()
}

/// Estimate compared with the columns `fx_n` ….
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Against {
    Finger,
    Sensor(usize),
}

impl Against {
    pub(crate) fn force(self, estimate: &Estimate) -> Option<&Force> {
        match self {
            Self::Finger => Some(&estimate.force),
            Self::Sensor(i) => estimate.sensors.get(i),
        }
    }
}

pub(crate) fn against(calibration: &Calibration) -> Option<Against> {
    if calibration.net.is_some() || calibration.model.is_some() || calibration.array.is_some() {
        return Some(Against::Finger);
    }
    let mut calibrated = (0..SENSORS).filter(|i| calibration.sensors[*i].is_some());
    match (calibrated.next(), calibrated.next()) {
        (Some(sensor), None) => Some(Against::Sensor(sensor)),
        _ => None,
    }
}

fn touched(truth: &Truth, estimate: &Estimate) -> bool {
    truth.contact.unwrap_or_else(|| estimate.status.contains(Status::CONTACT))
}

pub(crate) fn components(force: &Force) -> [Result<f32, NoValue>; 3] {
    [force.x, force.y, force.z].map(|component| component.map(|newtons| newtons.0))
}

/// Squared error of a component of a force, the square of which is `size`.
///
/// Without an estimate the component is off by the size of the force: a component of zero would
/// reward a finger that says nothing.
pub(crate) fn square(found: Option<f64>, known: f64, size: impl FnOnce() -> f64) -> f64 {
    found.map_or_else(size, |found| (found - known).powi(2))
}

/// Adds the errors of a row's estimates, with the standard deviations that it states.
fn compare<const N: usize>(
    errors: &mut [Errors; N],
    truth: [Option<f64>; N],
    (found, sigma): ([Result<f32, NoValue>; N], [Option<f32>; N]),
) {
    for (((errors, truth), found), sigma) in errors.iter_mut().zip(truth).zip(found).zip(sigma) {
        match (truth, found) {
            (None, _) | (_, Err(NoValue::NotEstimated)) => {}
            (Some(truth), Ok(found)) => {
                let error = f64::from(found) - truth;
                match sigma {
                    Some(sigma) => errors.add_stated(error, f64::from(sigma)),
                    None => errors.add(error),
                }
            }
            (Some(_), Err(reason)) => errors.withhold(frames::reason(reason)),
        }
    }
}

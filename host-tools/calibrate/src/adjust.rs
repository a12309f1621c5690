//! In-place recalibration: new bias and gains from a few presses with known weights.
//!
//! Ageing changes the light of the LEDs, the gain of the phototransistors and the softness of the
//! skin; the form of the response stays. Each taxel therefore gets one gain g_k, and its signal is
//! divided by it:
//!
//! - Light and phototransistor scale a taxel's unloaded reading by the same gain as its signal. The
//!   unloaded light is therefore the first guess of g_k, with a standard deviation of [`OWN`].
//! - The skin scales all signals by one factor, which only a known weight shows: standard deviation
//!   [`COMMON`].
//!
//! The gains are the most probable ones under these priors (Gauss–Newton), each press counting once
//! at any duration. A sensor's S gets one gain a row, from the presses with a known force on that
//! sensor. Gains are folded into the coefficients of all estimators of the taxels. The record's
//! form stays, and a frame costs the finger no more time.

mod taxels;

use nalgebra::{Matrix3, RowVector3};
use taxel::calibration::{Calibration, SensorCalibration};
use taxel::condition::{Bias, Signals};
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::wrench::WrenchMatrix;
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel::scan::{SENSORS, TAXELS};

use crate::recording::Recording;
use taxel_regress::error::FitError;
use taxel_regress::metrics::surely_less;

/// Standard deviation of the common gain of all taxels, or of a row of S.
const COMMON: f64 = 0.2;
/// Fewest presses: one is left out to judge the others, and two must remain.
const LEAST_PRESSES: usize = 3;
/// Most rows of a press after thinning.
const ROWS: usize = 16;
/// Largest relative change of a gain that counts as ageing; a larger one has another cause.
const AGED: f64 = 0.5;
/// Share of a press left out at either end, while the weight moves.
const SETTLING: f64 = 0.2;

/// Result of an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Adjusted {
    /// The calibration with new bias and gains.
    pub calibration: Calibration,
    /// Number of presses found.
    pub presses: usize,
    /// Gain of each taxel; empty without a net or skin model, or without presses of known force.
    pub taxels: Vec<f64>,
    /// Error of f_z of each taxel estimator, before and after.
    pub helped: Vec<Helped>,
    /// Gain of each row of S; `None` without presses of known force on the sensor.
    pub sensors: [Option<[f64; 3]>; SENSORS],
    /// Warnings for the user, in full sentences.
    pub warnings: Vec<String>,
}

/// RMS error of f_z over the presses, newtons.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Helped {
    /// Name of the estimator: `net` or `model of the skin`.
    pub estimator: &'static str,
    /// RMS error with the new bias alone.
    pub before: f64,
    /// RMS error on each press with the gains from all other presses.
    pub after: f64,
}

/// A row under load.
struct Row {
    c: Option<[f32; TAXELS]>,
    u: [Option<[f32; 3]>; SENSORS],
    force: [Option<f64>; 3],
    sensors: [[Option<f64>; 3]; SENSORS],
}

type Press = Vec<Row>;

/// Sets the force of every contact in `recording` to `newtons` straight down.
///
/// The beginning and end of each contact keep their reference.
///
/// # Errors
///
/// There is no unloaded stretch.
pub fn weigh(
    calibration: &Calibration,
    recording: &mut Recording,
    newtons: f64,
) -> Result<(), FitError> {
    for rows in
        contacts(&renewed(calibration, &recording.bias(calibration.warmth.as_ref())?), recording)
    {
        let settling = (SETTLING * rows.len() as f64) as usize;
        for row in rows.start + settling..rows.end - settling {
            recording.samples[row].truth.force = [Some(0.0), Some(0.0), Some(newtons)];
        }
    }
    Ok(())
}

/// Adjusts `calibration` to recordings of presses with known reference columns.
///
/// `date` is the new record's, in seconds since 1970-01-01 UTC.
///
/// # Errors
///
/// Data that the recordings lack, or an invalid result.
pub fn adjust(
    calibration: &Calibration,
    recordings: &[Recording],
    date: u64,
) -> Result<Adjusted, FitError> {
    let first = recordings.first().ok_or(FitError::NoRecording)?;
    let warmth = calibration.warmth.as_ref();
    let mut adjusted = Adjusted {
        calibration: Calibration { date, ..renewed(calibration, &first.bias(warmth)?) },
        presses: 0,
        taxels: Vec::new(),
        helped: Vec::new(),
        sensors: [None; SENSORS],
        warnings: Vec::new(),
    };
    let mut presses = Vec::new();
    for recording in recordings {
        let bias = recording.bias(warmth)?;
        let own = renewed(calibration, &bias);
        let signals = recording.compensated(&bias, calibration);
        presses.extend(contacts(&own, recording).map(|rows| press(&signals, recording, rows)));
    }
    presses.retain(|press: &Press| !press.is_empty());
    adjusted.presses = presses.len();
    if presses.len() < LEAST_PRESSES {
        return Err(FitError::TooFewRows {
            part: "presses with a known force".into(),
            rows: presses.len(),
            least: LEAST_PRESSES,
        });
    }
    taxels::adjust(&mut adjusted, calibration, &presses)?;
    sensors(&mut adjusted, &presses);
    adjusted.calibration.validate().map_err(FitError::Record)?;
    Ok(adjusted)
}

/// Returns the calibration with another bias, for the parts that have one.
fn renewed(calibration: &Calibration, bias: &Bias) -> Calibration {
    let mut calibration = calibration.clone();
    if let (Some(taxels), Some(bias)) = (&mut calibration.taxels, bias.taxels) {
        taxels.bias = bias;
    }
    for (sensor, bias) in calibration.sensors.iter_mut().zip(bias.bridges) {
        if let (Some(sensor), Some(bias)) = (sensor, bias) {
            sensor.bias = bias;
        }
    }
    calibration
}

/// Rows of each contact, found with the finger's own gate.
fn contacts(
    calibration: &Calibration,
    recording: &Recording,
) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let touched: Vec<bool> = recording
        .samples
        .iter()
        .map(|s| finger.estimate(&mut state, &s.scan).status.contains(Status::CONTACT))
        .collect();
    let mut begin = 0;
    let runs: Vec<_> = touched
        .chunk_by(|a, b| a == b)
        .filter_map(|run| {
            let rows = begin..begin + run.len();
            begin = rows.end;
            run[0].then_some(rows)
        })
        .collect();
    runs.into_iter()
}

/// Rows of a contact with a known force, thinned.
fn press(signals: &[Signals], recording: &Recording, rows: std::ops::Range<usize>) -> Press {
    let known: Vec<Row> = recording.samples[rows.clone()]
        .iter()
        .zip(&signals[rows])
        .filter_map(|(sample, signals)| {
            let healthy = signals.health.dead == 0 && signals.health.saturated == 0;
            let row = Row {
                c: signals.taxels.filter(|_| healthy),
                u: signals.bridges,
                force: sample.truth.force,
                sensors: sample.truth.sensors,
            };
            let known = row.force[2].is_some() || row.sensors.iter().any(|s| s[2].is_some());
            known.then_some(row)
        })
        .collect();
    let step = known.len().div_ceil(ROWS).max(1);
    known.into_iter().step_by(step).collect()
}

/// Fits one gain a row of S, judged on each press with the gains from all others.
fn sensors(adjusted: &mut Adjusted, presses: &[Press]) {
    let bench = adjusted.calibration.net.is_none()
        && adjusted.calibration.sensors.iter().flatten().count() == 1;
    for i in 0..SENSORS {
        let Some(sensor) = &mut adjusted.calibration.sensors[i] else { continue };
        let presses: Vec<SensorPress> =
            presses.iter().map(|press| said(sensor, i, press, bench)).collect();
        if !presses.iter().flatten().flatten().any(Option::is_some) {
            adjusted.warnings.push(format!(
                "s{i}: no press has a known force on it alone; its bias is new, its gains stay"
            ));
            continue;
        }
        let (mut gains, mut unhelped) = ([1.0; 3], Vec::new());
        for (axis, gain) in gains.iter_mut().enumerate() {
            let sigma = f64::from(sensor.residual[axis]).max(1e-3);
            let name = ["x", "y", "z"][axis];
            let known: Vec<Vec<[f64; 2]>> = presses
                .iter()
                .map(|press| press.iter().filter_map(|row| row[axis]).collect::<Vec<_>>())
                .filter(|press| !press.is_empty())
                .collect();
            let Some(found) = gain_of(known.iter(), sigma) else {
                adjusted.warnings.push(format!(
                    "s{i}: in {name} the force has the opposite sign of S's estimate: is the reference's sign right? \
                     that gain stays"
                ));
                continue;
            };
            if (found - 1.0).abs() > AGED {
                let percent = 100.0 * (found - 1.0);
                adjusted.warnings.push(format!(
                    "s{i}: the gain in {name} would change by {percent:.0} %, which is more than ageing; it \
                     stays"
                ));
            } else if helps(&known, sigma) {
                *gain = found;
            } else {
                unhelped.push(name);
            }
        }
        if !unhelped.is_empty() {
            adjusted.warnings.push(format!(
                "s{i}: in {} gains from all but one press do not reliably improve that one; they stay, the bias \
                 is new",
                unhelped.join(", ")
            ));
        }
        let old = sensor.sensitivity;
        for (row, gain) in sensor.sensitivity.0.iter_mut().zip(gains) {
            *row = row.map(|s| (f64::from(s) * gain) as f32);
        }
        let new = sensor.sensitivity;
        if let Some(Array { method: WrenchMethod::Matrix(matrix), .. }) =
            &mut adjusted.calibration.array
        {
            fold(matrix, i, [old, new].map(|s| Matrix3::from_fn(|j, k| f64::from(s.0[j][k]))));
        }
        adjusted.sensors[i] = Some(gains);
    }
}

/// Measured and true force in each row of a press, for each axis with a known force.
type SensorPress = Vec<[Option<[f64; 2]>; 3]>;

fn said(sensor: &SensorCalibration, i: usize, press: &Press, bench: bool) -> SensorPress {
    let rows = press.iter().filter_map(|row| {
        let found = sensor.sensitivity.force(row.u[i]?);
        let truth = if bench { row.force } else { row.sensors[i] };
        Some(std::array::from_fn(|axis| Some([f64::from(found[axis]), truth[axis]?])))
    });
    rows.collect()
}

/// Gain of a row of S, each press counting once; `None` if measured and true force disagree in
/// sign.
///
/// The force measured by S is regressed on the true force and the slope inverted. The noise is in
/// the measured force; the opposite regression would draw the gain towards zero.
fn gain_of<'p>(presses: impl Iterator<Item = &'p Vec<[f64; 2]>>, sigma: f64) -> Option<f64> {
    let (mut product, mut square) = (COMMON.powi(-2), COMMON.powi(-2));
    for press in presses {
        let weight = 1.0 / (press.len() as f64 * sigma.powi(2));
        for [found, truth] in press {
            product += weight * found * truth;
            square += weight * truth * truth;
        }
    }
    (product > 0.0).then(|| square / product)
}

/// Whether the gain from all presses but one surely helps with that one.
fn helps(presses: &[Vec<[f64; 2]>], sigma: f64) -> bool {
    let square = |press: &[[f64; 2]], gain: f64| {
        press.iter().map(|[found, truth]| (gain * found - truth).powi(2)).sum::<f64>()
            / press.len() as f64
    };
    let judged = presses.iter().enumerate().map(|(i, press)| {
        let others = presses.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, press)| press);
        let gain = gain_of(others, sigma).unwrap_or(1.0);
        (square(press, gain), square(press, 1.0))
    });
    let (after, before): (Vec<f64>, Vec<f64>) = judged.unzip();
    presses.len() >= LEAST_PRESSES && surely_less(&after, &before)
}

/// Folds a new S into the sensor's columns of the matrix.
///
/// The wrench of aged signals is then that of young ones before.
fn fold(matrix: &mut WrenchMatrix, sensor: usize, [old, new]: [Matrix3<f64>; 2]) {
    let Some(once) = old.try_inverse().map(|back| back * new) else { return };
    for row in &mut matrix.0 {
        let folded = RowVector3::from(row[sensor].map(f64::from)) * once;
        row[sensor] = std::array::from_fn(|axis| folded[axis] as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nine presses of ten rows; S gives `share` of the true force.
    ///
    /// The noise is a millinewton, within a press and from press to press.
    fn presses(share: f64) -> Vec<Vec<[f64; 2]>> {
        let noise = |i: usize| 1e-3 * (12.9898 * (i * i) as f64).sin();
        let press = |p: usize| {
            let truth = 0.3 + 0.1 * p as f64;
            (0..10)
                .map(|row| [share * truth + noise(p) + noise(100 + 10 * p + row), truth])
                .collect()
        };
        (0..9).map(press).collect()
    }

    #[test]
    fn gain_helps_only_an_aged_sensor() {
        let aged = presses(0.9);
        let gain = gain_of(aged.iter(), 1e-3).unwrap();
        assert!((gain * 0.9 - 1.0).abs() < 2e-3 && helps(&aged, 1e-3), "{gain}");
        let young = presses(1.0);
        assert!(!helps(&young, 1e-3), "{:?}", gain_of(young.iter(), 1e-3));
        assert!(!helps(&aged[..2], 1e-3));
    }

    #[test]
    fn folded_array_matrix_keeps_its_wrench() {
        let old = Matrix3::new(9.0, 0.3, -0.4, 0.2, 11.0, 0.1, -0.3, 0.5, 7.0);
        let new = Matrix3::from_diagonal(&[1.2, 0.9, 1.1].into()) * old;
        let young = nalgebra::Vector3::new(0.01, -0.02, 0.03);
        let aged = new.try_inverse().unwrap() * old * young;
        let mut matrix = WrenchMatrix([[[1.0, -2.0, 0.5]; SENSORS]; 6]);
        let [signals, after] = [young, aged].map(|u| {
            let u: [f32; 3] = std::array::from_fn(|axis| u[axis] as f32);
            [[0.0; 3], u, [0.0; 3], [0.0; 3]]
        });
        let wanted = matrix.wrench(&signals);
        fold(&mut matrix, 1, [old, new]);
        let found = matrix.wrench(&after);
        for (found, wanted) in found.force.iter().zip(wanted.force) {
            assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
        }
        assert_eq!(matrix.0[0][0], [1.0, -2.0, 0.5]);
    }
}

//! Fit of the force sensors as one array: sum over their positions, or full 6×3n matrix.
//!
//! The matrix ([Ospina2017]) is used where it is more accurate.

use nalgebra::{DMatrix, SVD};
use taxel::calibration::{Calibration, SensorCalibration};
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::wrench::{SensorPlaces, Wrench, WrenchMatrix};
use taxel::scan::SENSORS;

use crate::prepared::Prepared;
use crate::recording::Recording;
use taxel_regress::error::FitError;

/// Fewest loaded rows for the residual of the array.
const LEAST_ROWS: usize = 100;
/// Largest ratio of the matrix's residual to the sum's; the matrix has 72 numbers, the sum has
/// none.
const BETTER: f64 = 0.7;
/// Least singular value of the twelve signals, as a share of the largest; weaker ones are noise.
///
/// Four sensors under a rigid plate show six motions.
const WEAK: f64 = 1e-3;
/// Least residual: a tenth of a millinewton, and as much at a millimetre's arm.
const LEAST_RESIDUAL: f64 = 1e-4;

/// Signals, forces and true wrench of one row of a recording.
struct Row {
    signals: [[f32; 3]; SENSORS],
    forces: [[f32; 3]; SENSORS],
    /// True force F and moment M about the middle of the skin.
    wrench: [f64; 6],
}

/// Fits the array of four calibrated sensors under a flat skin.
///
/// `None` if the recordings lack force and contact point, or if a sensor is not calibrated.
pub(crate) fn fit(
    recordings: &[&Prepared<'_>],
    sensors: &[Option<SensorCalibration>; SENSORS],
) -> Option<(Array, usize)> {
    let rows: Vec<Row> = recordings.iter().flat_map(|r| rows(r, sensors)).collect();
    if rows.len() < LEAST_ROWS {
        return None;
    }
    let sum = WrenchMethod::Sum(SensorPlaces::default());
    let mut best = (sum, residual(&sum, &rows));
    if let Some(matrix) = least_squares(&rows).map(WrenchMethod::Matrix) {
        let left = residual(&matrix, &rows);
        let total = |left: &[f64; 6]| left.iter().map(|r| r * r).sum::<f64>().sqrt();
        if total(&left) < BETTER * total(&best.1) {
            best = (matrix, left);
        }
    }
    let (method, left) = best;
    let of = |value: f64| value.max(LEAST_RESIDUAL) as f32;
    let array = Array {
        method,
        residual: [of(left[0]), of(left[1]), of(left[2])],
        moment_residual: of(left[3].max(left[4])),
        surface: Surface::Plane,
    };
    Some((array, rows.len()))
}

fn rows(prepared: &Prepared<'_>, sensors: &[Option<SensorCalibration>; SENSORS]) -> Vec<Row> {
    let samples = prepared.recording.samples.iter().zip(&prepared.signals);
    samples
        .filter_map(|(sample, signals)| {
            let ([fx, fy, fz], [x, y]) = (sample.truth.force, sample.truth.point);
            let ([fx, fy, fz], [x, y]) = ([fx?, fy?, fz?], [x?, y?]);
            if fz <= 0.0 || signals.health.bridge_faults != 0 {
                return None;
            }
            let mut row = Row {
                signals: [[0.0; 3]; SENSORS],
                forces: [[0.0; 3]; SENSORS],
                wrench: [fx, fy, fz, y * fz, -x * fz, x * fy - y * fx + sample.truth.torsion?],
            };
            let known = signals.bridges.iter().zip(sensors);
            for ((u, force), (signal, sensor)) in
                row.signals.iter_mut().zip(&mut row.forces).zip(known)
            {
                *u = (*signal)?;
                *force = sensor.as_ref()?.sensitivity.force(*u);
            }
            Some(row)
        })
        .collect()
}

fn wrench(method: &WrenchMethod, row: &Row) -> [f64; 6] {
    let Wrench { force: [fx, fy, fz], moment: [mx, my, mz] } = match method {
        WrenchMethod::Sum(places) => places.wrench(&row.forces),
        WrenchMethod::Matrix(matrix) => matrix.wrench(&row.signals),
    };
    [fx, fy, fz, mx, my, mz].map(f64::from)
}

/// RMS error of each component.
fn residual(method: &WrenchMethod, rows: &[Row]) -> [f64; 6] {
    let mut squares = [0.0; 6];
    for row in rows {
        let found = wrench(method, row);
        for ((sum, found), known) in squares.iter_mut().zip(found).zip(row.wrench) {
            *sum += (found - known).powi(2);
        }
    }
    squares.map(|sum| (sum / rows.len() as f64).sqrt())
}

/// Full 6×3n matrix of a finger with calibrated sensors, whether or not it beats the sum.
///
/// `None` if the recordings lack force and contact point.
///
/// # Errors A recording has no unloaded stretch.
pub fn matrix(
    recordings: &[Recording],
    calibration: &Calibration,
) -> Result<Option<WrenchMatrix>, FitError> {
    let mut known = Vec::new();
    for recording in recordings {
        let (prepared, _) = Prepared::new(recording, calibration.warmth.as_ref())?;
        known.extend(rows(&prepared, &calibration.sensors));
    }
    Ok(if known.len() < LEAST_ROWS { None } else { least_squares(&known) })
}

/// Least-squares solution, the shortest one if several fit.
fn least_squares(rows: &[Row]) -> Option<WrenchMatrix> {
    let columns = 3 * SENSORS;
    let signal = |row: &Row, j: usize| f64::from(row.signals[j / 3][j % 3]);
    let mut inner = DMatrix::<f64>::zeros(columns, columns);
    let mut right = DMatrix::<f64>::zeros(columns, 6);
    for row in rows {
        for j in 0..columns {
            (0..columns).for_each(|k| inner[(j, k)] += signal(row, j) * signal(row, k));
            (0..6).for_each(|k| right[(j, k)] += signal(row, j) * row.wrench[k]);
        }
    }
    let svd = SVD::new(inner, true, true);
    // Singular values of the normal equations are the squares of the signals'.
    let solution = svd.solve(&right, WEAK * WEAK * svd.singular_values.max()).ok()?;
    Some(WrenchMatrix(std::array::from_fn(|i| {
        std::array::from_fn(|s| std::array::from_fn(|axis| solution[(3 * s + axis, i)] as f32))
    })))
}

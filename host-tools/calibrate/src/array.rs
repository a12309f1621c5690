//! Fit of the force sensors as one array: sum over their positions, or full 6×3n matrix.
//!
//! The force on each sensor is rarely known, the total force is. A weighted least-squares fit from
//! all bridge signals to it gives the matrix ([Ospina2017]); its moments need contact points. With
//! a known force on each sensor the plain sum serves, unless the matrix is clearly better.

use taxel::calibration::{Calibration, SensorCalibration};
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::intrinsic::Surface;
use taxel::estimate::sensitivity::Sensitivity;
use taxel::estimate::wrench::{SensorPlaces, Wrench, WrenchMatrix};
use taxel::scan::SENSORS;

use crate::prepared::{self, Prepared};
use crate::recording::Recording;
use taxel_regress::error::FitError;
use taxel_regress::evidence;
use taxel_regress::outliers::Outliers;
use taxel_regress::quantile::quantile;
use taxel_regress::range::trained_range;
use taxel_regress::shear::NO_SHEAR;
use taxel_regress::training::Recorded;

/// Fewest loaded rows for the residual of the array.
const LEAST_ROWS: usize = 100;
/// Largest ratio of the matrix's residual to the sum's; the matrix has 72 numbers, the sum has
/// none.
const BETTER: f64 = 0.7;
/// Least residual: a tenth of a millinewton, and as much at a millimetre's arm.
const LEAST_RESIDUAL: f64 = 1e-4;
/// Residual of moments that no recording showed, N·mm: no force gives a contact point then.
pub(crate) const NO_MOMENT: f32 = 999.0;
/// Largest angle between the shear axes of reference and force sensors, degrees.
///
/// Good recordings have up to 7, exchanged axes 90.
const MOST_TURNED: f64 = 30.0;
/// Least RMS shear over RMS normal force that tells the axes of the reference.
const LEAST_SHEAR: f64 = 0.03;
/// Share of the errors that three stated standard deviations cover, as of the model of the skin.
const COVERED: f64 = 0.99;
/// Least share of the noise-free error in an error on noisy references.
///
/// Whatever their noise, an estimate is not stated to be better than a fifth of what was seen.
const LEAST_SHARE: f64 = 0.2;

/// A fitted array.
pub(crate) struct Fitted {
    pub array: Array,
    /// RMS error of the force on rows left out, newtons.
    pub held_out: [f32; 3],
    /// Sensors without an own reference: blocks of the matrix, whose sum is the total force.
    pub sensors: [Option<SensorCalibration>; SENSORS],
    /// Number of loaded rows.
    pub rows: usize,
    /// Name of the method.
    pub name: String,
    /// Warning about the axes of the reference, in a full sentence.
    pub turned: Option<String>,
}

/// Signals and known load of one row.
struct Row {
    signals: [[f32; 3]; SENSORS],
    force: [f64; 3],
    /// Moment about the middle of the skin, if the contact point is known.
    moment: Option<[f64; 3]>,
    /// Standard deviation of its first two components, N·mm.
    moment_noise: f64,
}

/// Fits the array of the `live` sensors to the recordings of the finger.
///
/// `None` if no recording has the total force and the signals of a live sensor.
pub(crate) fn fit(
    recordings: &[&Prepared<'_>],
    live: [bool; SENSORS],
    calibrated: &[Option<SensorCalibration>; SENSORS],
) -> Option<Fitted> {
    let rows: Vec<Vec<Row>> = recordings.iter().map(|r| rows(r, live)).collect();
    let count = rows.iter().map(Vec::len).sum::<usize>();
    if count < LEAST_ROWS {
        return None;
    }
    let [x, y, z] = prepared::reference_noise(recordings);
    let moment = moment_noise(&rows);
    let noise = [x, y, z, moment, moment];
    let (matrix, mut residual) = least_squares(&rows, live)?;
    // Fewer sensors miss a share of the force that grows with load and distance.
    let covered = live.contains(&false).then(|| covered(&matrix, &rows));
    for (residual, noise) in residual.iter_mut().zip(noise) {
        let least = LEAST_SHARE * *residual;
        *residual = (*residual * *residual - noise * noise).max(least * least).sqrt();
    }
    // A component without a load is not known, however small its residual.
    let peak = |axis: usize| {
        rows.iter().flatten().fold(0.0, |most: f64, row| most.max(row.force[axis].abs()))
    };
    let most = (0..3).map(peak).fold(0.0, f64::max);
    let loaded = |axis: usize| peak(axis) >= NO_SHEAR * most;
    let turned = if sheared(&rows) { turned(&matrix) } else { None };
    for (axis, residual) in residual.iter_mut().enumerate().take(3) {
        if !loaded(axis) {
            *residual = most;
        }
    }
    let sensors_of = live.iter().filter(|live| **live).count();
    let moments = residual.len() > 3;
    let mut best = (
        WrenchMethod::Matrix(matrix),
        residual,
        format!("array of sensors {}x{}", if moments { 6 } else { 3 }, 3 * sensors_of),
    );
    if moments && calibrated.iter().all(Option::is_some) {
        let places = SensorPlaces::default();
        let left = sum_residual(&places, &rows, calibrated);
        let total = |left: &[f64]| left.iter().map(|r| r * r).sum::<f64>().sqrt();
        if BETTER * total(&left) <= total(&best.1) {
            best = (WrenchMethod::Sum(places), left.to_vec(), "array of sensors".into());
        }
    }
    let (method, left, name) = best;
    let of = |value: f64| value.max(LEAST_RESIDUAL) as f32;
    let held_out = [of(left[0]), of(left[1]), of(left[2])];
    let covered = covered.map_or(held_out, |covered| covered.map(of));
    let array = Array {
        method,
        residual: std::array::from_fn(|axis| held_out[axis].max(covered[axis])),
        moment_residual: left.get(3..5).map_or(NO_MOMENT, |m| of(m[0].max(m[1]))),
        surface: Surface::Plane,
    };
    let sensors = std::array::from_fn(|i| {
        if calibrated[i].is_some() || !live[i] {
            return None;
        }
        let bias = recordings.iter().find_map(|r| r.bias.bridges[i])?;
        let column = |j: usize| rows.iter().flatten().map(move |row| row.signals[i][j]);
        Some(SensorCalibration {
            bias,
            sensitivity: Sensitivity(std::array::from_fn(|axis| matrix.0[axis][i])),
            range: std::array::from_fn(|j| trained_range(column(j), bias.noise)),
            residual: array.residual,
        })
    });
    Some(Fitted { array, held_out, sensors, rows: count, name, turned })
}

/// Standard deviation of each force component of which three cover [`COVERED`] of the rows.
fn covered(matrix: &WrenchMatrix, rows: &[Vec<Row>]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let error = |row: &Row| {
            (f64::from(matrix.wrench(&row.signals).force[axis]) - row.force[axis]).abs()
        };
        quantile(rows.iter().flatten().map(error).collect(), COVERED) / 3.0
    })
}

/// Whether the rows have shear in x and in y, apart from each other and from the normal force.
///
/// Shear that a reference shows of normal presses goes with them, and tells nothing of its axes.
fn sheared(rows: &[Vec<Row>]) -> bool {
    let all = || rows.iter().flatten().map(|row| row.force);
    let product = |i: usize, j: usize| all().map(|force| force[i] * force[j]).sum::<f64>();
    let normal = product(2, 2);
    // Mean square of a component without its part in proportion to the normal force.
    let left = |i: usize| product(i, i) - product(i, 2).powi(2) / normal.max(f64::MIN_POSITIVE);
    [0, 1].into_iter().all(|axis| left(axis) > LEAST_SHEAR.powi(2) * normal)
}

/// Warns of a reference whose shear axes are not those of the force sensors.
///
/// A matrix explains exchanged or turned axes as well as the right ones; the model of the skin does
/// not.
fn turned(matrix: &WrenchMatrix) -> Option<String> {
    let sum = |force: usize, signal: usize| -> f64 {
        matrix.0[force].iter().map(|weights| f64::from(weights[signal])).sum()
    };
    // Added zero turns −0, which would be printed, into 0.
    let degrees = |sine: f64, cosine: f64| sine.atan2(cosine).to_degrees().round() + 0.0;
    let (x, y) = (degrees(sum(0, 1), sum(0, 0)), degrees(-sum(1, 0), sum(1, 1)));
    (x.abs().max(y.abs()) > MOST_TURNED).then(|| {
        format!(
            "array of sensors: fx_n and fy_n of the reference stand at {x}° and {y}° to the sensors' axes where \
             0° is expected; look whether the load cell's x and y are exchanged, turned or reversed: x runs along a row"
        )
    })
}

/// Loaded rows with a known total force and sound bridges.
fn rows(prepared: &Prepared<'_>, live: [bool; SENSORS]) -> Vec<Row> {
    let touched = prepared.recording.touched().unwrap_or_default();
    let samples = prepared.recording.samples.iter().zip(&prepared.signals).zip(touched);
    let faults = (0..SENSORS).fold(0, |bits, i| bits | u8::from(live[i]) << i);
    samples
        .filter(|(_, touched)| *touched)
        .filter_map(|((sample, signals), _)| {
            let [fx, fy, fz] = sample.truth.force;
            let [fx, fy, fz] = [fx?, fy?, fz?];
            if signals.health.bridge_faults & faults != 0 {
                return None;
            }
            let mut row = Row {
                signals: [[0.0; 3]; SENSORS],
                force: [fx, fy, fz],
                moment: None,
                moment_noise: 0.0,
            };
            for (i, u) in row.signals.iter_mut().enumerate().filter(|(i, _)| live[*i]) {
                *u = signals.bridges[i]?;
            }
            if let [Some(x), Some(y)] = sample.truth.point {
                let torsion = sample.truth.torsion.unwrap_or_default();
                row.moment_noise = sample.truth.point_sigma.map_or(0.0, |sigma| sigma * fz);
                row.moment = Some([y * fz, -x * fz, x * fy - y * fx + torsion]);
            }
            Some(row)
        })
        .collect()
}

/// Fits the matrix and returns it with its error on stretches left out: of the force, and of the
/// moment if the rows know it.
fn least_squares(rows: &[Vec<Row>], live: [bool; SENSORS]) -> Option<(WrenchMatrix, Vec<f64>)> {
    let used: Vec<usize> = (0..SENSORS).filter(|i| live[*i]).collect();
    let signals = |row: &Row| -> Vec<f64> {
        used.iter().flat_map(|i| row.signals[*i]).map(f64::from).collect()
    };
    let recorded = |target: &dyn Fn(&Row) -> Option<[f64; 3]>| -> Vec<Recorded> {
        let pairs = |rows: &Vec<Row>| {
            rows.iter().filter_map(|row| Some((signals(row), target(row)?.to_vec()))).unzip()
        };
        rows.iter().map(pairs).collect()
    };
    let mut matrix = WrenchMatrix::default();
    let mut residual = Vec::new();
    let mut put = |first: usize, line: evidence::Line| {
        for k in 0..3 {
            for (at, i) in used.iter().enumerate() {
                for axis in 0..3 {
                    matrix.0[first + k][*i][axis] = line.weights[(k, 3 * at + axis)] as f32;
                }
            }
        }
        residual.extend(line.held_out);
    };
    let mut forces = recorded(&|row| Some(row.force));
    // The net's fit names the wrong rows.
    let names = vec![String::new(); forces.len()];
    Outliers::find(&forces, &names, None).ok()?.remove_from(&mut forces);
    put(0, evidence::fit(&forces)?);
    let pointed = rows.iter().flatten().filter(|row| row.moment.is_some()).count();
    if pointed >= LEAST_ROWS
        && let Some(moment) = evidence::fit(&recorded(&|row| row.moment))
    {
        put(3, moment);
    }
    Some((matrix, residual))
}

/// RMS noise of the known moments, N·mm.
fn moment_noise(rows: &[Vec<Row>]) -> f64 {
    let pointed = || rows.iter().flatten().filter(|row| row.moment.is_some());
    let squares: f64 = pointed().map(|row| row.moment_noise.powi(2)).sum();
    (squares / pointed().count().max(1) as f64).sqrt()
}

/// RMS error of each component of the sum.
fn sum_residual(
    places: &SensorPlaces,
    rows: &[Vec<Row>],
    calibrated: &[Option<SensorCalibration>; SENSORS],
) -> [f64; 6] {
    let (mut squares, mut count) = ([0.0; 6], 0.0);
    for (row, moment) in rows.iter().flatten().filter_map(|row| Some((row, row.moment?))) {
        let forces = std::array::from_fn(|i| {
            let own = calibrated[i].as_ref();
            own.map_or([0.0; 3], |own| own.sensitivity.force(row.signals[i]))
        });
        let Wrench { force, moment: found } = places.wrench(&forces);
        let known = row.force.into_iter().chain(moment);
        let found = force.into_iter().chain(found);
        for ((sum, found), known) in squares.iter_mut().zip(found).zip(known) {
            *sum += (f64::from(found) - known).powi(2);
        }
        count += 1.0;
    }
    squares.map(|sum| (sum / f64::max(count, 1.0)).sqrt())
}

/// Full 6×3n matrix of a finger with calibrated sensors, whether or not it beats the sum.
///
/// `None` if the recordings lack force and contact point.
///
/// # Errors
///
/// A recording has no unloaded stretch.
pub fn matrix(
    recordings: &[Recording],
    calibration: &Calibration,
) -> Result<Option<WrenchMatrix>, FitError> {
    let live = calibration.sensors.each_ref().map(Option::is_some);
    let mut known = Vec::new();
    for recording in recordings {
        let (prepared, _) = Prepared::new(recording, calibration.warmth.as_ref())?;
        known.push(rows(&prepared, live));
    }
    let fitted = least_squares(&known, live).filter(|(_, residual)| residual.len() == 6);
    Ok(fitted.map(|(matrix, _)| matrix))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_presses_tell_nothing_of_the_shear_axes() {
        let rows = |shear: f64| -> Vec<Vec<Row>> {
            let row = |i: usize| {
                let turn = i as f64;
                let fz = 1.0 + turn.sin();
                let force = [0.02 * fz + shear * turn.cos(), shear * (1.7 * turn).sin(), fz];
                Row { signals: [[0.0; 3]; SENSORS], force, moment: None, moment_noise: 0.0 }
            };
            vec![(0..200).map(row).collect()]
        };
        assert!(!sheared(&rows(0.006)) && sheared(&rows(0.2)));
    }

    #[test]
    fn turned_reference_is_told_and_small_angle_is_not() {
        let of = |[xx, xy, yx, yy]: [f32; 4]| {
            let mut matrix = WrenchMatrix::default();
            matrix.0[0] = [[xx, xy, 0.0]; SENSORS];
            matrix.0[1] = [[yx, yy, 0.0]; SENSORS];
            turned(&matrix)
        };
        assert_eq!(of([20.0, 1.0, -1.0, 18.0]), None);
        for (name, axes) in [
            ("90° and -90°", [0.0, 20.0, 20.0, 0.0]),
            ("90° and 90°", [0.0, 20.0, -20.0, 0.0]),
            ("180° and 0°", [-20.0, 0.0, 0.0, 20.0]),
        ] {
            let told = of(axes).unwrap();
            assert!(told.contains(name), "{told}");
        }
    }
}

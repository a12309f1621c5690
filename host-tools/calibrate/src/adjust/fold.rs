//! Ageing folded into a record: its form stays, and a frame costs the finger no more time.

use nalgebra::{Matrix3, RowVector3};
use taxel::calibration::{Calibration, TaxelCalibration};
use taxel::estimate::array::{Array, WrenchMethod};
use taxel::estimate::inverse::Inverse;
use taxel::estimate::net::ForceNet;
use taxel::estimate::quantised::Net;
use taxel::estimate::wrench::WrenchMatrix;
use taxel::scan::{SENSORS, TAXELS};

use crate::inverse::neighbours;
use crate::quantise;
use taxel_regress::error::FitError;

/// Folds the gain of each taxel into a record: its signal is divided by the gain.
///
/// # Errors
///
/// The 16-bit net cannot hold them.
pub(super) fn light(calibration: &mut Calibration, gains: &[f64; TAXELS]) -> Result<(), FitError> {
    if let Some(model) = &mut calibration.model {
        curves(model, gains);
    }
    let Some(taxels) = &mut calibration.taxels else { return Ok(()) };
    for (range, gain) in taxels.range.iter_mut().zip(gains) {
        *range = range.map(|end| (f64::from(end) * gain) as f32);
    }
    change_net(&mut calibration.net, taxels, |net| {
        let units = net.units.iter_mut().map(|unit| &mut unit.weights);
        for row in units.chain(net.skip.iter_mut().flatten()) {
            row.iter_mut().zip(gains).for_each(|(w, gain)| *w = (f64::from(*w) / gain) as f32);
        }
    })
}

/// Folds the stiffness of the skin, as a multiple of that in calibration, into a record.
///
/// The displacements depend on the place and on forces over Young's modulus alone (Hertz and
/// Cattaneo), so every force is a multiple of the one before.
///
/// # Errors
///
/// The 16-bit net cannot hold it.
pub(super) fn stiffness(calibration: &mut Calibration, times: f64) -> Result<(), FitError> {
    if let Some(Inverse { field, error, .. }) = &mut calibration.model {
        // The size s² of a contact grows with the force to the power ⅔.
        let size = times.powf(-2.0 / 3.0);
        for radial in [&mut field.normal, &mut field.shear] {
            radial.depth[1] = (f64::from(radial.depth[1]) * size) as f32;
            for term in &mut radial.terms {
                let powers = [1.0, size, size * size];
                for (coefficient, power) in term.iter_mut().zip(powers) {
                    *coefficient = (f64::from(*coefficient) * power / times) as f32;
                }
            }
        }
        error[1] = (f64::from(error[1]) / times).min(0.99) as f32;
    }
    if let Some(slip) = &mut calibration.slip {
        let [c, gamma] = &mut slip.surface.radius;
        *c = (f64::from(*c) * times.powf(-f64::from(*gamma))) as f32;
    }
    let Some(taxels) = &calibration.taxels else { return Ok(()) };
    change_net(&mut calibration.net, taxels, |net| {
        let outputs = net.units.iter_mut().flat_map(|unit| &mut unit.output);
        let skip = net.skip.iter_mut().flatten().flatten();
        outputs
            .chain(skip)
            .chain(&mut net.output_bias)
            .for_each(|w| *w = (f64::from(*w) * times) as f32);
    })
}

/// Folds the gains in x, y, z of a sensor into its S, and so into its columns of the matrix.
pub(super) fn sensor(calibration: &mut Calibration, i: usize, gains: [f64; 3]) {
    let Some(sensor) = &mut calibration.sensors[i] else { return };
    let old = sensor.sensitivity;
    scale(&mut sensor.sensitivity.0, gains);
    let new = sensor.sensitivity;
    if let Some(Array { method: WrenchMethod::Matrix(matrix), .. }) = &mut calibration.array {
        columns(matrix, i, [old, new].map(|s| Matrix3::from_fn(|j, k| f64::from(s.0[j][k]))));
    }
}

/// Folds the gains in x, y, z of the force sensors together into the array.
///
/// A place is a moment over the normal force, and keeps.
pub(super) fn array(calibration: &mut Calibration, gains: [f64; 3]) {
    let blocks: [bool; SENSORS] = std::array::from_fn(|i| is_block(calibration, i));
    let Some(Array { method, .. }) = &mut calibration.array else { return };
    let sum = matches!(method, WrenchMethod::Sum(_));
    if let WrenchMethod::Matrix(matrix) = method {
        let [x, y, z] = gains;
        for (row, gain) in matrix.0.iter_mut().zip([x, y, z, z, z, 0.5 * (x + y)]) {
            scale(row, [gain; SENSORS]);
        }
    }
    for (sensor, block) in calibration.sensors.iter_mut().zip(blocks) {
        if let Some(sensor) = sensor.as_mut().filter(|_| sum || block) {
            scale(&mut sensor.sensitivity.0, gains);
        }
    }
}

/// Whether the S of a sensor is its block of the array's matrix, because it has no own reference.
pub(super) fn is_block(calibration: &Calibration, i: usize) -> bool {
    let Some(Array { method: WrenchMethod::Matrix(matrix), .. }) = &calibration.array else {
        return false;
    };
    let sensor = calibration.sensors[i].as_ref();
    sensor.is_some_and(|s| matrix.0.iter().zip(&s.sensitivity.0).all(|(row, s)| row[i] == *s))
}

fn scale<const N: usize>(rows: &mut [[f32; 3]], gains: [f64; N]) {
    for (row, gain) in rows.iter_mut().zip(gains) {
        *row = row.map(|s| (f64::from(s) * gain) as f32);
    }
}

/// Folds a new S into the sensor's columns of the matrix.
///
/// The wrench of aged signals is then that of young ones before.
fn columns(matrix: &mut WrenchMatrix, sensor: usize, [old, new]: [Matrix3<f64>; 2]) {
    let Some(once) = old.try_inverse().map(|back| back * new) else { return };
    for row in &mut matrix.0 {
        let folded = RowVector3::from(row[sensor].map(f64::from)) * once;
        row[sensor] = std::array::from_fn(|axis| folded[axis] as f32);
    }
}

/// Changes a net in f32; one in 16 bits is converted and rounded again.
fn change_net(
    net: &mut Option<Net>,
    taxels: &TaxelCalibration,
    change: impl FnOnce(&mut ForceNet),
) -> Result<(), FitError> {
    match net {
        Some(Net::Float(net)) => change(net),
        Some(Net::Quantised(net)) => {
            let mut float = quantise::float(net);
            change(&mut float);
            *net = quantise::whole(&float, taxels)?;
        }
        None => {}
    }
    Ok(())
}

/// Folds the gains into the curves of the skin model.
///
/// A curve's n-th coefficient scales with the n-th power of the signal. For stray light both the
/// receiving taxel and its source have gains.
fn curves(model: &mut Inverse, gains: &[f64; TAXELS]) {
    let steepness = |model: &Inverse| -> f64 {
        model.curves.gap.iter().map(|gap| f64::from(gap[0]).powi(2)).sum()
    };
    let before = steepness(model);
    for (k, (gap, stray)) in model.curves.gap.iter_mut().zip(&mut model.curves.stray).enumerate() {
        for (power, coefficient) in (1..).zip(gap) {
            *coefficient = (f64::from(*coefficient) / gains[k].powi(power)) as f32;
        }
        for (share, neighbour) in stray.iter_mut().zip(neighbours(k)) {
            let other = neighbour.map_or(gains[k], |neighbour| gains[neighbour]);
            *share = (f64::from(*share) * gains[k] / other) as f32;
        }
    }
    // The error floor is the displacement noise due to the signals' noise, which stays.
    let floor = (steepness(model) / before.max(f64::MIN_POSITIVE)).sqrt();
    model.error[0] = (f64::from(model.error[0]) * floor) as f32;
}

#[cfg(test)]
mod tests {
    use taxel::estimate::field::Load;

    use super::*;

    #[test]
    fn folded_gains_restore_displacements() {
        let wave = |k: usize, by: f32| by * (1.7 * k as f32).sin();
        let mut model = Inverse::default();
        for k in 0..TAXELS {
            model.curves.gap[k] = [-3.0 + wave(k, 0.5), -4.0, wave(k, 8.0), 2.0, wave(k, 5.0)];
            model.curves.stray[k] = [0.02, 0.01, 0.015 + wave(k, 0.01), 0.005];
        }
        let gains = std::array::from_fn(|k| 1.0 + 0.3 * (2.3 * k as f64).sin());
        let young: [f32; TAXELS] = std::array::from_fn(|k| wave(3 * k, 0.2));
        let old = std::array::from_fn(|k| (f64::from(young[k]) * gains[k]) as f32);
        let wanted = model.curves.displacements(&young);
        curves(&mut model, &gains);
        for (found, wanted) in model.curves.displacements(&old).iter().zip(wanted) {
            assert!((found - wanted).abs() < 1e-5, "{found} {wanted}");
        }
    }

    #[test]
    fn softer_skin_moves_as_far_at_less_force() {
        let mut model = Inverse::default();
        for radial in [&mut model.field.normal, &mut model.field.shear] {
            radial.depth = [4.0, 1.5];
            radial.terms = [[1.0, 0.3, -0.1], [0.5, -0.2, 0.1], [0.2, 0.1, 0.05], [0.1, 0.0, 0.1]];
        }
        model.field.slip = -0.3;
        let of = |times: f32| Load {
            shear: [0.3 * times, -0.2 * times],
            size: (1.2 * times).cbrt(),
            point: [0.5, -1.0],
            used: 0.4,
        };
        let facet = [1.2, 0.4];
        let wanted = model.field.around(&of(1.0)).sheared(facet).0;
        let mut record = Calibration { model: Some(model), ..Calibration::default() };
        stiffness(&mut record, 0.8).unwrap();
        let found = record.model.unwrap().field.around(&of(0.8)).sheared(facet).0;
        assert!((found - wanted).abs() < 1e-5, "{found} {wanted}");
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
        columns(&mut matrix, 1, [old, new]);
        let found = matrix.wrench(&after);
        for (found, wanted) in found.force.iter().zip(wanted.force) {
            assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
        }
        assert_eq!(matrix.0[0][0], [1.0, -2.0, 0.5]);
    }
}

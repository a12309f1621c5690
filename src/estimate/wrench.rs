//! Wrench on the finger, computed from the force sensors together ([Ospina2017], chapter 2).
//!
//! The frame is the finger's: x along a row, y along a column, z into the skin, origin in the
//! middle of the skin.

use serde::{Deserialize, Serialize};

use crate::scan::SENSORS;

/// Force and moment about the origin of the finger's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force F in newtons.
    pub force: [f32; 3],
    /// Moment M in newton millimetres.
    pub moment: [f32; 3],
}

/// Positions of the sensors in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorPlaces(pub [[f32; 3]; SENSORS]);

impl Default for SensorPlaces {
    /// Positions of the four sensors under the rigid plate, 6 mm below the skin.
    fn default() -> Self {
        Self([[-5.0, -5.0, 6.0], [5.0, -5.0, 6.0], [5.0, 5.0, 6.0], [-5.0, 5.0, 6.0]])
    }
}

impl SensorPlaces {
    /// Returns F = Σ f_i and M = Σ r_i × f_i for the forces in newtons on each sensor.
    #[must_use]
    pub fn wrench(&self, forces: &[[f32; 3]; SENSORS]) -> Wrench {
        let mut wrench = Wrench::default();
        for (place, force) in self.0.iter().zip(forces) {
            let moment = cross(*place, *force);
            wrench.force.iter_mut().zip(force).for_each(|(sum, f)| *sum += f);
            wrench.moment.iter_mut().zip(moment).for_each(|(sum, m)| *sum += m);
        }
        wrench
    }
}

/// Full calibration matrix, 6×3n: every signal of every sensor may contribute to every component.
///
/// Rows are F_x, F_y, F_z (N per full scale), M_x, M_y, M_z (N·mm per full scale); columns are the
/// sensors' u − b.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WrenchMatrix(pub [[[f32; 3]; SENSORS]; 6]);

impl WrenchMatrix {
    /// Returns the wrench for the signals u − b of every sensor; an absent one counts as zero.
    #[must_use]
    pub fn wrench(&self, signals: &[[f32; 3]; SENSORS]) -> Wrench {
        let [fx, fy, fz, mx, my, mz] = self.0.each_ref().map(|row| weighted(row, signals));
        Wrench { force: [fx, fy, fz], moment: [mx, my, mz] }
    }
}

/// Returns Σ m·u. Not inlined, so that its code exists once and not six times.
#[inline(never)]
fn weighted(row: &[[f32; 3]; SENSORS], signals: &[[f32; 3]; SENSORS]) -> f32 {
    let sensors = row.iter().zip(signals);
    sensors.fold(0.0, |sum, ([a, b, c], [x, y, z])| sum + a * x + b * y + c * z)
}

/// Returns the cross product a × b.
#[must_use]
pub(super) fn cross([ax, ay, az]: [f32; 3], [bx, by, bz]: [f32; 3]) -> [f32; 3] {
    [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
}

/// Returns the dot product a · b.
#[must_use]
pub(super) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Forces on four equal springs under a rigid plate from a force at a point, written out by
    /// hand.
    fn shares(x: f32, y: f32, [fx, fy, fz]: [f32; 3]) -> [[f32; 3]; SENSORS] {
        SensorPlaces::default().0.map(|[xi, yi, h]| {
            let torsion = x * fy - y * fx;
            [
                fx / 4.0 - torsion * yi / 200.0,
                fy / 4.0 + torsion * xi / 200.0,
                fz / 4.0 + ((x * fz + h * fx) * xi + (y * fz + h * fy) * yi) / 100.0,
            ]
        })
    }

    #[test]
    fn wrench_of_the_shares_equals_that_of_the_force() {
        let (x, y, force) = (1.5, -2.0, [0.3, -0.2, 1.1]);
        let wrench = SensorPlaces::default().wrench(&shares(x, y, force));
        let moment = cross([x, y, 0.0], force);
        for (found, expected) in
            wrench.force.iter().chain(&wrench.moment).zip(force.iter().chain(&moment))
        {
            assert!((found - expected).abs() < 1e-5, "{wrench:?}");
        }
    }

    #[test]
    fn full_matrix_can_reproduce_the_sum() {
        // Columns of unit signals through the sum, one signal at a time.
        let places = SensorPlaces::default();
        let mut matrix = WrenchMatrix([[[0.0; 3]; SENSORS]; 6]);
        for i in 0..SENSORS {
            for axis in 0..3 {
                let mut unit = [[0.0; 3]; SENSORS];
                unit[i][axis] = 1.0;
                let column = places.wrench(&unit);
                for k in 0..3 {
                    matrix.0[k][i][axis] = column.force[k];
                    matrix.0[k + 3][i][axis] = column.moment[k];
                }
            }
        }
        let forces = shares(-0.4, 2.2, [0.1, 0.5, 0.9]);
        let (sum, full) = (places.wrench(&forces), matrix.wrench(&forces));
        for (a, b) in sum.force.iter().chain(&sum.moment).zip(full.force.iter().chain(&full.moment))
        {
            assert!((a - b).abs() < 1e-5, "{sum:?} {full:?}");
        }
    }
}

//! Rigid plate on four force sensors: how a wrench divides between them ([Ospina2017] chapter 2).
//!
//! The plate stands on four equal, linear, isotropic springs. The shares therefore follow from the
//! six equations of equilibrium and the plate's six motions.

use taxel::scan::SENSORS;

/// Positions of the sensors in mm.
pub const PLACES: [[f64; 2]; SENSORS] = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]];
/// Height in mm of the skin above the sensors.
pub const HEIGHT_MM: f64 = 6.0;

/// Force in newtons and moment in newton millimetres about the middle of the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force F, z into the skin.
    pub force: [f64; 3],
    /// Moment M.
    pub moment: [f64; 3],
}

impl Wrench {
    /// Wrench of a `force` at `place`, with a `torsion` about the unit vector `normal`: F, r × F +
    /// τn.
    ///
    /// `place` is in mm with z down from the sensors, so that the skin is at −[`HEIGHT_MM`].
    #[must_use]
    pub fn at(place: [f64; 3], force: [f64; 3], torsion: f64, normal: [f64; 3]) -> Self {
        let ([x, y, z], [fx, fy, fz], [nx, ny, nz]) = (place, force, normal);
        let moment = [
            y * fz - z * fy + torsion * nx,
            z * fx - x * fz + torsion * ny,
            x * fy - y * fx + torsion * nz,
        ];
        Self { force, moment }
    }

    /// Wrench of a `force` and a `torsion` at a point of the flat skin.
    #[must_use]
    pub fn on_skin([x, y]: [f64; 2], force: [f64; 3], torsion: f64) -> Self {
        Self::at([x, y, -HEIGHT_MM], force, torsion, [0.0, 0.0, 1.0])
    }

    /// Forces on the four sensors in newtons.
    #[must_use]
    pub fn shares(&self) -> [[f64; 3]; SENSORS] {
        let ([fx, fy, fz], [mx, my, mz]) = (self.force, self.moment);
        // Sum Σ x_i² = Σ y_i² over the sensors.
        let second: f64 = PLACES.iter().map(|[x, _]| x * x).sum();
        let n = SENSORS as f64;
        PLACES.map(|[x, y]| {
            [
                fx / n - mz * y / (2.0 * second),
                fy / n + mz * x / (2.0 * second),
                fz / n + (mx * y - my * x) / second,
            ]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sensor_carries_most_of_a_force_above_it() {
        let over = Wrench::on_skin([-5.0, -5.0], [0.0, 0.0, 1.0], 0.0).shares();
        assert!((over[0][2] - 0.75).abs() < 1e-12 && (over[2][2] + 0.25).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn shares_balance_every_wrench(
            x in -5.0..5.0f64, y in -5.0..5.0f64, z in -12.0..0.0f64, torsion in -5.0..5.0f64,
            fx in -2.0..2.0f64, fy in -2.0..2.0f64, fz in 0.0..2.0f64,
            lean in -0.6..0.6f64,
        ) {
            let normal = [lean.sin(), 0.0, lean.cos()];
            let wrench = Wrench::at([x, y, z], [fx, fy, fz], torsion, normal);
            let shares = wrench.shares();
            let carried = PLACES.iter().zip(shares).fold(Wrench::default(), |sum, (place, share)| {
                let one = Wrench::at([place[0], place[1], 0.0], share, 0.0, [0.0; 3]);
                Wrench {
                    force: std::array::from_fn(|i| sum.force[i] + one.force[i]),
                    moment: std::array::from_fn(|i| sum.moment[i] + one.moment[i]),
                }
            });
            for axis in 0..3 {
                prop_assert!((carried.force[axis] - wrench.force[axis]).abs() < 1e-9);
                prop_assert!((carried.moment[axis] - wrench.moment[axis]).abs() < 1e-9);
            }
        }
    }
}

//! Force sensors under the rigid plate, from the force on the finger to midpoint voltages (003 §1.2).
//!
//! How the plate shares a force out: it is rigid and stands on four equal, linear, isotropic springs, so
//! that besides the six equations of equilibrium the shares follow from its six motions. With sensors at
//! (±5, ±5) mm and the contact 6 mm above them, f_z,i = F_z/4 + (x F_z + h F_x) x_i/100 + … and
//! f_x,i = F_x/4 − M_z y_i/200, M_z = x F_y − y F_x.
//!
//! Voltages are fractions of the bridge supply, which is also the converter's reference.

use rand_distr::{Distribution as _, Uniform};
use taxel::scan::SENSORS;

use crate::scene::{Effect, Scene};
use crate::seeds::{Purpose, stream};

/// Places of the sensors in mm.
pub const PLACES: [[f64; 2]; SENSORS] = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]];
/// Height in mm of the skin above the sensors.
pub const HEIGHT_MM: f64 = 6.0;
/// ΔR_x/R per newton: 8.5 mV/V/N (003 §1.2.2, eq. (1.4)).
const TANGENTIAL: f64 = 8.5e-3;
/// Its tolerance: ± 0.3 of 8.5 mV/V/N.
const TANGENTIAL_TOLERANCE: f64 = 0.3 / 8.5;
/// u_z per newton. 3.0 mV/V/bar, the pressure taken as acting on the disc of the membrane, 1 mm in
/// radius: 1 bar is 0.314 N.
const NORMAL: f64 = 3.0e-3 / (0.1 * core::f64::consts::PI);
/// Its tolerance: ± 0.5 of 3.0 mV/V/bar.
const NORMAL_TOLERANCE: f64 = 0.5 / 3.0;
/// Amplifier of the midpoints about half the supply. Bare, a newton would move a 12-bit code by 17
/// steps only; sixteenfold, 2 N anywhere on the pad still stay within a quarter of the supply (tested).
const GAIN: f64 = 16.0;
/// Standard deviation of one doped resistor against its neighbours.
const MISMATCH: f64 = 0.005;
/// Standard deviation of an off-diagonal term between axes, as a share of the other axis' force.
const CROSSTALK: f64 = 0.03;

/// Shares of the four sensors in a `force` (N, z into the skin) on the skin at `point` (mm).
#[must_use]
pub fn shares(point: [f64; 2], force: [f64; 3]) -> [[f64; 3]; SENSORS] {
    let [x, y] = point;
    let [fx, fy, fz] = force;
    // First moments of the sensors' normal forces; a force pointing to +x leans on the sensors at +x.
    let lean = [x * fz + HEIGHT_MM * fx, y * fz + HEIGHT_MM * fy];
    let torsion = x * fy - y * fx;
    // Σ x_i² = Σ y_i² over the sensors.
    let second: f64 = PLACES.iter().map(|[x, _]| x * x).sum();
    let n = SENSORS as f64;
    PLACES.map(|[xi, yi]| {
        [
            fx / n - torsion * yi / (2.0 * second),
            fy / n + torsion * xi / (2.0 * second),
            fz / n + (lean[0] * xi + lean[1] * yi) / second,
        ]
    })
}

/// The bridges of one sensor.
#[derive(Clone, Debug)]
pub struct Bridge {
    /// Force as the membrane of this sensor takes it, out of the force on it: sensitivity and
    /// cross-talk; the identity for a perfect one.
    taken: [[f64; 3]; 3],
    /// R1 … R8 at rest over their nominal value.
    rest: [f64; 8],
}

impl Bridge {
    /// The four sensors of the scene's device.
    #[must_use]
    pub fn of(scene: &Scene) -> [Self; SENSORS] {
        let device = scene.device.seed;
        let mut spread = stream(device, Purpose::BridgeCrosstalk);
        let mut mismatch = stream(device, Purpose::BridgeMismatch);
        core::array::from_fn(|_| {
            let mut bridge =
                Self { taken: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], rest: [1.0; 8] };
            let unit = rand_distr::StandardNormal;
            if scene.has(Effect::BridgeCrosstalk) {
                let tolerance = [TANGENTIAL_TOLERANCE, TANGENTIAL_TOLERANCE, NORMAL_TOLERANCE];
                for (axis, (row, tolerance)) in bridge.taken.iter_mut().zip(tolerance).enumerate() {
                    for (other, term) in row.iter_mut().enumerate() {
                        *term += if axis == other {
                            Uniform::new_inclusive(-tolerance, tolerance)
                                .map_or(0.0, |share| share.sample(&mut spread))
                        } else {
                            let unit: f64 = unit.sample(&mut spread);
                            CROSSTALK * unit
                        };
                    }
                }
            }
            if scene.has(Effect::BridgeMismatch) {
                for resistor in &mut bridge.rest {
                    let unit: f64 = unit.sample(&mut mismatch);
                    *resistor += MISMATCH * unit.clamp(-3.0, 3.0);
                }
            }
            bridge
        })
    }

    /// V_A, V_B, V_C, V_D behind the amplifier, under a `force` in newtons on the sensor.
    ///
    /// A positive F_x stretches R1, R3 and presses R2, R4 (003 eqs (1.2), (1.3)); F_y likewise R6, R8
    /// and R5, R7; a normal force presses R1, R4, R5, R8 and stretches R2, R3, R6, R7 (eqs (1.6), (1.7)).
    #[must_use]
    pub fn midpoints(&self, force: [f64; 3]) -> [f64; 4] {
        let taken = self.taken.map(|row| row.iter().zip(force).map(|(m, f)| m * f).sum::<f64>());
        let x = TANGENTIAL * taken[0];
        let y = TANGENTIAL * taken[1];
        // u_z = 2ΔR_z/R, eq. (1.8).
        let z = 0.5 * NORMAL * taken[2];
        let strain = [x - z, z - x, x + z, -x - z, -y - z, y + z, z - y, y - z];
        let mut r = self.rest;
        r.iter_mut().zip(strain).for_each(|(r, strain)| *r *= 1.0 + strain);
        let [r1, r2, r3, r4, r5, r6, r7, r8] = r;
        [r2 / (r1 + r2), r3 / (r3 + r4), r8 / (r7 + r8), r5 / (r5 + r6)]
            .map(|v| 0.5 + GAIN * (v - 0.5))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERFECT: Bridge =
        Bridge { taken: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], rest: [1.0; 8] };

    fn outputs([a, b, c, d]: [f64; 4]) -> [f64; 3] {
        [b - a, c - d, (a + b) - (c + d)].map(|u| u / GAIN)
    }

    #[test]
    fn a_perfect_sensor_has_the_sensitivities_of_its_data_sheet() {
        let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.314_159_265]]
            .map(|force| outputs(PERFECT.midpoints(force)));
        let near = |u: [f64; 3], expected: [f64; 3]| {
            u.iter().zip(expected).for_each(|(u, e)| assert!((u - e).abs() < 1e-8, "{u} {e}"));
        };
        near(x, [8.5e-3, 0.0, 0.0]);
        near(y, [0.0, 8.5e-3, 0.0]);
        near(z, [0.0, 0.0, 3.0e-3]);
        assert_eq!(PERFECT.midpoints([0.0; 3]), [0.5; 4]);
    }

    #[test]
    fn two_newtons_on_an_edge_stay_where_an_intact_bridge_is() {
        for share in shares([5.0, 5.0], [1.4, 1.4, 2.0]) {
            assert!(PERFECT.midpoints(share).iter().all(|v| (0.25..0.75).contains(v)));
        }
    }

    #[test]
    fn a_force_right_above_a_sensor_is_mostly_its_own() {
        let over = shares([-5.0, -5.0], [0.0, 0.0, 1.0]);
        assert!((over[0][2] - 0.75).abs() < 1e-12 && (over[2][2] + 0.25).abs() < 1e-12);
    }

    #[test]
    fn mismatch_and_crosstalk_are_the_devices_and_differ_between_sensors() {
        let scene = |seed: u32| {
            let text = format!(
                "effects = ['bridge-mismatch', 'bridge-crosstalk']\n[device]\nseed = {seed}\n\
                 [scan]\nrate_hz = 1000\nduration_s = 1\n"
            );
            Bridge::of(&Scene::parse("test.toml", &text).unwrap()).map(|b| b.midpoints([0.1; 3]))
        };
        assert_eq!(scene(4), scene(4));
        assert_ne!(scene(4), scene(5));
        assert_ne!(scene(4)[0], scene(4)[1]);
    }

    proptest! {
        #[test]
        fn shares_balance_the_force_and_all_its_moments(
            x in -5.0..5.0f64, y in -5.0..5.0f64,
            fx in -2.0..2.0f64, fy in -2.0..2.0f64, fz in 0.0..2.0f64,
        ) {
            let shares = shares([x, y], [fx, fy, fz]);
            for axis in 0..3 {
                let sum: f64 = shares.iter().map(|s| s[axis]).sum();
                prop_assert!((sum - [fx, fy, fz][axis]).abs() < 1e-12);
            }
            // Moments about the plate's centre, as r × f with z down and the contact at −h:
            // z × f of the contact is balanced by x f_z and y f_z of the sensors.
            let moment = |f: &dyn Fn([f64; 2], [f64; 3]) -> f64| -> f64 {
                PLACES.iter().zip(&shares).map(|(p, s)| f(*p, *s)).sum()
            };
            let about_x = moment(&|p, s| p[1] * s[2]);
            let about_y = moment(&|p, s| -p[0] * s[2]);
            let about_z = moment(&|p, s| p[0] * s[1] - p[1] * s[0]);
            let h = HEIGHT_MM;
            prop_assert!((about_x - (y * fz - -h * fy)).abs() < 1e-9);
            prop_assert!((about_y - (-h * fx - x * fz)).abs() < 1e-9);
            prop_assert!((about_z - (x * fy - y * fx)).abs() < 1e-9);
        }
    }
}

//! Force sensors: from the force on each to its midpoint voltages ([Ospina2017] §1.2).
//!
//! Voltages are fractions of the bridge supply, which is also the converter's reference.

use rand_distr::{Distribution as _, Uniform};
use taxel::scan::SENSORS;

use crate::scene::{Effect, REFERENCE_C, Scene, ZERO_C};
use crate::seeds::{Purpose, stream};

/// ΔR_x/R per newton: 8.5 mV/V/N ([Ospina2017] §1.2.2, eq. (1.4)).
const TANGENTIAL: f64 = 8.5e-3;
/// Tolerance of the tangential sensitivity: ± 0.3 of 8.5 mV/V/N.
const TANGENTIAL_TOLERANCE: f64 = 0.3 / 8.5;
/// Normal sensitivity: u_z per newton, from 3.0 mV/V/bar.
///
/// The pressure is taken as acting on the disc of the membrane, 1 mm in radius: 1 bar is 0.314 N.
const NORMAL: f64 = 3.0e-3 / (0.1 * core::f64::consts::PI);
/// Tolerance of the normal sensitivity: ± 0.5 of 3.0 mV/V/bar.
const NORMAL_TOLERANCE: f64 = 0.5 / 3.0;
/// Standard deviation of one doped resistor against its neighbours.
const MISMATCH: f64 = 0.005;
/// Relative rise of a doped resistor per kelvin, one standard deviation about the bridge's common
/// one.
///
/// The common one, some 0.2 %/K for p-silicon, cancels in every midpoint. Between neighbours on one
/// chip a hundredth of it is assumed to be left. The remainder makes an offset drift of 10 µV/V per
/// kelvin. [Ospina2017] keeps its temperature constant and gives none.
const TCR_MISMATCH: f64 = 2e-5;
/// Standard deviation of an off-diagonal term between axes, as a share of the other axis's force.
const CROSSTALK: f64 = 0.03;

/// Resistance of a broken resistor over an intact one.
const BROKEN: f64 = 1e9;
/// Temperature in kelvin at which the sensitivities hold.
const REFERENCE_K: f64 = REFERENCE_C + ZERO_C;

/// Bridges of one sensor.
#[derive(Clone, Debug)]
pub struct Bridge {
    /// Matrix from the force on the sensor to the force on its membrane.
    ///
    /// The matrix holds sensitivity and cross-talk, and is the identity for a perfect sensor.
    taken: [[f64; 3]; 3],
    /// Resistances R1 … R8 at rest over their nominal value.
    rest: [f64; 8],
    /// Relative rise of each resistance per kelvin above the common one; `None` without the effect.
    drift: Option<[f64; 8]>,
    /// Gain of the midpoints' amplifiers about half the supply.
    gain: f64,
}

/// Conditions of a bridge other than its load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// Kelvin above the reference temperature.
    pub warmer_k: f64,
    /// Broken resistors, R1 in the lowest bit.
    pub broken_arms: u8,
}

impl Bridge {
    /// Creates the four sensors of the scene's device.
    #[must_use]
    pub fn of(scene: &Scene) -> [Self; SENSORS] {
        let device = scene.device.seed;
        let mut spread = stream(device, Purpose::BridgeCrosstalk);
        let mut mismatch = stream(device, Purpose::BridgeMismatch);
        let mut drift = stream(device, Purpose::BridgeDrift);
        core::array::from_fn(|_| {
            let mut bridge = Self {
                taken: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                rest: [1.0; 8],
                drift: None,
                gain: scene.electronics.bridge_gain,
            };
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
            let takes = scene.device.coating.takes();
            for row in &mut bridge.taken {
                row.iter_mut().zip(takes).for_each(|(term, takes)| *term *= takes);
            }
            if scene.has(Effect::BridgeMismatch) {
                for resistor in &mut bridge.rest {
                    let unit: f64 = unit.sample(&mut mismatch);
                    *resistor += MISMATCH * unit.clamp(-3.0, 3.0);
                }
            }
            if scene.temperature().is_some() {
                bridge.drift = Some(core::array::from_fn(|_| {
                    let unit: f64 = unit.sample(&mut drift);
                    TCR_MISMATCH * unit.clamp(-3.0, 3.0)
                }));
            }
            bridge
        })
    }

    /// Midpoints V_A, V_B, V_C, V_D after the amplifiers, under a `force` in newtons on the sensor.
    ///
    /// A positive F_x stretches R1, R3 and presses R2, R4 ([Ospina2017] eqs (1.2), (1.3)); F_y
    /// likewise R6, R8 and R5, R7. A normal force presses R1, R4, R5, R8 and stretches R2, R3, R6,
    /// R7 (eqs (1.6), (1.7)).
    #[must_use]
    pub fn midpoints(&self, force: [f64; 3], around: Surroundings) -> [f64; 4] {
        let taken = self.taken.map(|row| row.iter().zip(force).map(|(m, f)| m * f).sum::<f64>());
        let x = TANGENTIAL * taken[0];
        let y = TANGENTIAL * taken[1];
        // u_z = 2ΔR_z/R, eq. (1.8).
        let z = 0.5 * NORMAL * taken[2];
        let mut strain = [x - z, z - x, x + z, -x - z, -y - z, y + z, z - y, y - z];
        let mut r = self.rest;
        if let Some(drift) = self.drift {
            // The piezoresistive effect of lightly doped silicon, whose k the thesis gives, falls
            // as 1/T (Kanda 1982).
            let weaker = REFERENCE_K / (REFERENCE_K + around.warmer_k);
            strain.iter_mut().for_each(|strain| *strain *= weaker);
            r.iter_mut().zip(drift).for_each(|(r, drift)| *r *= 1.0 + drift * around.warmer_k);
        }
        r.iter_mut().zip(strain).for_each(|(r, strain)| *r *= 1.0 + strain);
        if around.broken_arms != 0 {
            let arms = r.iter_mut().enumerate();
            arms.filter(|(i, _)| around.broken_arms >> i & 1 == 1).for_each(|(_, r)| *r *= BROKEN);
        }
        let [r1, r2, r3, r4, r5, r6, r7, r8] = r;
        [r2 / (r1 + r2), r3 / (r3 + r4), r8 / (r7 + r8), r5 / (r5 + r6)]
            .map(|v| 0.5 + self.gain * (v - 0.5))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plate::Wrench;

    const PERFECT: Bridge = Bridge {
        taken: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        rest: [1.0; 8],
        drift: None,
        gain: 16.0,
    };
    const USUAL: Surroundings = Surroundings { warmer_k: 0.0, broken_arms: 0 };

    fn outputs([a, b, c, d]: [f64; 4]) -> [f64; 3] {
        [b - a, c - d, (a + b) - (c + d)].map(|u| u / PERFECT.gain)
    }

    #[test]
    fn perfect_sensor_has_data_sheet_sensitivity() {
        let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.314_159_265]]
            .map(|force| outputs(PERFECT.midpoints(force, USUAL)));
        let near = |u: [f64; 3], expected: [f64; 3]| {
            u.iter().zip(expected).for_each(|(u, e)| assert!((u - e).abs() < 1e-8, "{u} {e}"));
        };
        near(x, [8.5e-3, 0.0, 0.0]);
        near(y, [0.0, 8.5e-3, 0.0]);
        near(z, [0.0, 0.0, 3.0e-3]);
        assert_eq!(PERFECT.midpoints([0.0; 3], USUAL), [0.5; 4]);
    }

    /// Gains α_xy = 50 and α_z = 10 with which the thesis uses its 5 V (§1.2.3).
    ///
    /// The limits of its sensor, 1 N and 15 bar, give 42.5 mV and 225 mV.
    #[test]
    fn thesis_amplifiers_use_their_range() {
        let supply = 5.0;
        let [x, ..] = outputs(PERFECT.midpoints([1.0, 0.0, 0.0], USUAL)).map(|u| u * supply);
        let fifteen_bar = [0.0, 0.0, 15.0 * 0.1 * core::f64::consts::PI];
        let [.., z] = outputs(PERFECT.midpoints(fifteen_bar, USUAL)).map(|u| u * supply);
        assert!((x - 42.5e-3).abs() < 1e-6 && (z - 225e-3).abs() < 1e-6, "{x} {z}");
        for swing in [50.0 * x, 10.0 * z] {
            assert!((0.8 * supply / 2.0..supply / 2.0).contains(&swing), "{swing}");
        }
    }

    #[test]
    fn common_resistance_drift_cancels() {
        let warm = |drift: [f64; 8]| {
            let bridge = Bridge { drift: Some(drift), ..PERFECT };
            bridge.midpoints([0.0; 3], Surroundings { warmer_k: 30.0, ..USUAL })
        };
        assert!(warm([2e-3; 8]).iter().all(|v| (v - 0.5).abs() < 1e-12));
        // A half-bridge moves by a quarter of the difference of its two resistors, times the gain.
        let [a, b, ..] = warm([1e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((a - 0.5 + 16.0 * 0.25 * 30.0 * 1e-5).abs() < 1e-6 && b == 0.5, "{a}");
    }

    #[test]
    fn sensitivity_falls_as_one_over_kelvin() {
        let bridge = Bridge { drift: Some([0.0; 8]), ..PERFECT };
        let at = |warmer_k| outputs(bridge.midpoints([0.5; 3], Surroundings { warmer_k, ..USUAL }));
        for (warm, cold) in at(29.815).into_iter().zip(at(0.0)) {
            assert!((cold / warm - 1.1).abs() < 1e-4, "{cold} {warm}");
        }
    }

    #[test]
    fn broken_arm_affects_only_its_midpoint() {
        for arm in 0..8u8 {
            let around = Surroundings { broken_arms: 1 << arm, ..USUAL };
            let midpoints = PERFECT.midpoints([0.1, 0.1, 0.5], around);
            let intact = PERFECT.midpoints([0.1, 0.1, 0.5], USUAL);
            let of = [0, 0, 1, 1, 3, 3, 2, 2][usize::from(arm)];
            for (i, (now, before)) in midpoints.into_iter().zip(intact).enumerate() {
                assert_eq!(!(0.0..=1.0).contains(&now), i == of, "R{} {i}", arm + 1);
                assert!(i == of || now == before);
            }
        }
    }

    #[test]
    fn edge_load_stays_in_intact_bridge_range() {
        for share in Wrench::on_skin([5.0, 5.0], [1.4, 1.4, 2.0], 0.0).shares() {
            assert!(PERFECT.midpoints(share, USUAL).iter().all(|v| (0.25..0.75).contains(v)));
        }
    }

    #[test]
    fn mismatch_belongs_to_device_and_sensor() {
        let scene = |seed: u32| {
            let text = format!(
                "effects = ['bridge-mismatch', 'bridge-crosstalk']\n[device]\nseed = {seed}\n\
                 [scan]\nrate_hz = 1000\nduration_s = 1\n"
            );
            Bridge::of(&Scene::parse("test.toml", &text).unwrap())
                .map(|b| b.midpoints([0.1; 3], USUAL))
        };
        assert_eq!(scene(4), scene(4));
        assert_ne!(scene(4), scene(5));
        assert_ne!(scene(4)[0], scene(4)[1]);
    }
}

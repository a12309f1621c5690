//! Estimates of the optical matrix, from the estimators of the record that the scene needs.
//!
//! ```text
//! normal contact ──▶ model, 3 unknowns ──shear──▶ model, 6 unknowns ──misfit──▶ two contacts
//! ```
//! Each step up has its hysteresis. The net gives the force if the record has no model. A method of
//! [DeMaria2011] gives the point if it was chosen, or if a faulty taxel leaves the model without
//! its signals.

use crate::calibration::{Calibration, TaxelCalibration};
use crate::condition::{Bias, Health};
use crate::estimate::contact_point::{PointMethod, arg_min, centroid};
use crate::estimate::fusion::Gaussian;
use crate::estimate::gate::{Gate, GateState};
use crate::estimate::inverse::{
    ContactFit, FrictionUtilisation, Inverse, InverseState, ShearPrior,
};
use crate::estimate::quantised::Net;
use crate::estimate::two_contacts::{Pair, PairState};
use crate::estimate::{ContactPoint, NormalContact};
use crate::finger::fusion::ArrayEstimate;
use crate::finger::no_contact::faulty;
use crate::finger::within;
use crate::frame::Status;
use crate::measured::{Measured, NoValue};
use crate::scan::TAXELS;
use crate::units::Micros;

/// Error of the methods of [DeMaria2011] in the middle of the pad, in mm. The centroid has 0.6 to
/// 1.
const CENTROID_ERROR: f32 = 0.8;
/// Gate of the shear model, in multiples of the shear that counts as none ([`UNSEEN_SHEAR`]).
///
/// The gate needs the force sensors. Without them the model always includes shear, because the
/// misfit of the normal model does not reveal shear: the contact position absorbs it first. It
/// waits for a few estimates, because a scan's noise would otherwise open it in every light touch.
const SHEAR: Gate = Gate { on: 1.0, off: 0.7, begin_frames: 3, end_frames: 20 };
/// Gate of the search for two contacts; its thresholds are misfits of a single contact.
const SEVERAL: Gate = Gate { on: 10.0, off: 5.0, begin_frames: 4, end_frames: 20 };
/// Estimates for which a believed pair is followed alone, and those with a single contact to
/// compare it with, which needs a few to converge.
const TRUSTED: u8 = 32;
const COMPARED: u8 = 4;
/// Time in microseconds, besides that of a scan, over which a contact is followed from estimate to
/// estimate; after a longer one it may have moved far.
const FOLLOWED_US: u32 = 900;
/// Relative uncertainty of the skin's stiffness, however well the model met its calibration.
///
/// Stiffness grows by a third of a per cent with each kelvin, and the first loading meets a stiffer
/// skin ([DeMaria2011] fig. 3).
pub const SKIN_ERROR: f32 = 0.05;
/// Uncertainty of a contact position in mm, beyond its covariance. Another indenter or shear
/// displaces the position by so much.
pub const PLACE_ERROR: f32 = 0.05;
/// Standard deviation of a contact position in mm from which it is withheld.
pub const UNSURE_PLACE: f32 = 0.5;
/// Shear that counts as none: a floor in newtons and a share of the normal force. In the first
/// milliseconds of a touch the force sensors, whose lag is not yet known, show 6 mN of it.
const UNSEEN_SHEAR: [f32; 2] = [0.008, 0.01];

/// Least normal force, in newtons, for the force sensors' ratio of shear to normal force.
const LEAST_FELT: f32 = 0.02;

/// State of the matrix's estimators during a contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MatrixState {
    model: InverseState,
    pair: PairState,
    sheared: GateState,
    several: GateState,
    /// Misfit of the last fit of a single contact.
    single: f32,
    /// Estimates since a believed pair began to be compared with a single contact.
    trusted: u8,
    /// Whether the contact was off the pad, and has not been found on it since.
    off: bool,
    /// Time of the last estimate.
    time: Micros,
}

impl MatrixState {
    /// Begins an estimate at `time`. Scans come every `period` microseconds, lost ones included.
    pub(super) fn begin(&mut self, time: Micros, period: u32) {
        if time.since(self.time) > period.saturating_add(FOLLOWED_US) {
            self.model.interrupt();
            self.trusted = 0;
        }
        self.time = time;
        self.model.wait(period);
    }

    /// Forgets the contact.
    pub(super) fn clear(&mut self) {
        self.model.clear();
        self.pair.clear();
        (self.sheared, self.several) = Default::default();
        (self.trusted, self.off) = (0, false);
    }

    /// Returns whether a pair is believed and followed alone in this scan.
    fn alone(&mut self) -> bool {
        let believed = self.pair.believed() && self.several.contact();
        let counts = believed && self.trusted < TRUSTED + COMPARED - 1;
        self.trusted = if counts { self.trusted + 1 } else { 0 };
        believed && self.trusted > COMPARED - 1
    }
}

/// Estimates of the optical matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OpticalEstimate {
    pub force: [Measured<Gaussian>; 3],
    pub point: Measured<[Gaussian; 2]>,
    /// Information on the friction utilisation, if the model ran with shear and friction learns.
    pub ring: Option<FrictionUtilisation>,
    pub contacts: Measured<[NormalContact; 2]>,
    /// Normalised residual of the model; that of two contacts if it found two.
    pub misfit: Measured<f32>,
}

impl OpticalEstimate {
    pub(super) const fn nothing(reason: NoValue) -> Self {
        Self {
            force: [Err(reason); 3],
            point: Err(reason),
            ring: None,
            contacts: Err(reason),
            misfit: Err(reason),
        }
    }
}

/// Inputs of the matrix's estimators for one scan.
pub(super) struct OpticalInput<'s> {
    pub record: Option<&'s Calibration>,
    pub method: PointMethod,
    pub c: &'s [f32; TAXELS],
    pub health: &'s Health,
    pub bias: &'s Bias,
    /// Estimate of the force sensors.
    pub array: &'s ArrayEstimate,
    /// Whether friction learns from the friction utilisation of this scan.
    pub learns: bool,
}

impl OpticalInput<'_> {
    pub(super) fn estimate(&self, state: &mut MatrixState, status: &mut Status) -> OpticalEstimate {
        let taxels = self.record.and_then(|record| record.taxels.as_ref());
        let net = self.record.and_then(|record| record.net.as_ref());
        let model = self.record.and_then(Calibration::model);
        let force = match taxels {
            Some(taxels) if model.is_some() || net.is_some() => self.usable(taxels, status),
            _ => Err(NoValue::Uncalibrated),
        };
        let modelled = match (force, model) {
            (Ok(()), Some(model)) => Some(self.model(model, state, status)),
            _ => None,
        };
        // A position that the model cannot tell is not left to a worse method, except for dead
        // taxels, which the centroid does without.
        let placed = model.is_some() && !matches!(force, Err(NoValue::DeadChannel));
        let mut optical = match (force, modelled) {
            (Err(reason), _) => OpticalEstimate::nothing(reason),
            (Ok(()), Some(optical)) if self.method == PointMethod::Model => optical,
            (Ok(()), modelled) => {
                let known = modelled.unwrap_or(OpticalEstimate::nothing(NoValue::NotEstimated));
                match net.zip(taxels) {
                    None => known,
                    Some((net, taxels)) => {
                        status.insert(match net {
                            Net::Float(_) => Status::RAN_NET,
                            #[cfg(feature = "quantised")]
                            Net::Quantised(_) => Status::RAN_QUANTISED,
                        });
                        let [sx, sy, sz] = taxels.residual;
                        let of = |value: f32, sigma: f32| Ok(Gaussian { value, sigma });
                        let force = match net.forces(self.c)[..] {
                            [x, y, z] => [of(x, sx), of(y, sy), of(z, sz)],
                            [z] => {
                                [Err(NoValue::NotEstimated), Err(NoValue::NotEstimated), of(z, sx)]
                            }
                            _ => [Err(NoValue::NotEstimated); 3],
                        };
                        OpticalEstimate { force, ..known }
                    }
                }
            }
        };
        if self.method != PointMethod::Model || !placed {
            optical.point = self.paper_point(status).map(|point| {
                [point.x.0, point.y.0].map(|value| Gaussian { value, sigma: CENTROID_ERROR })
            });
        }
        optical
    }

    /// Checks that no channel is faulty and that all signals lie in the calibrated range.
    fn usable(&self, taxels: &TaxelCalibration, status: &mut Status) -> Measured<()> {
        if let Some(reason) = faulty(self.health) {
            return Err(reason);
        }
        if !within(&taxels.range, self.c) {
            status.insert(Status::OUT_OF_RANGE);
            return Err(NoValue::OutOfTrainedRange);
        }
        Ok(())
    }

    fn paper_point(&self, status: &mut Status) -> Measured<ContactPoint> {
        if self.method == PointMethod::ArgMin {
            status.insert(Status::RAN_ARG_MIN);
            return arg_min(self.c, self.health.dead);
        }
        status.insert(Status::RAN_CENTROID);
        // Sixteen taxels of pure noise sum to some 6 sigma; a sum below twice that is noise.
        let noise = self.bias.taxels.map_or(0.0, |bias| bias.noise);
        centroid(self.c, self.health.dead, 12.0 * noise)
    }

    fn model(
        &self,
        model: &Inverse,
        state: &mut MatrixState,
        status: &mut Status,
    ) -> OpticalEstimate {
        status.insert(Status::RAN_MODEL);
        let u = model.curves.displacements(self.c);
        if state.alone() {
            status.insert(Status::RAN_PAIR);
            let pair = model.pair(&mut state.pair, &u, state.single, state.model.hurried());
            if let Some(pair) = pair {
                status.insert(Status::NOT_SINGLE);
                return two(&pair, model.expected_share());
            }
            // The last single contact is old, and lies between the two.
            state.model.clear();
        }
        self.single(model, &u, state, status)
    }

    /// Fits a single contact, and two if that does not explain the displacements.
    fn single(
        &self,
        model: &Inverse,
        u: &[f32; TAXELS],
        state: &mut MatrixState,
        status: &mut Status,
    ) -> OpticalEstimate {
        let array = self.array.force;
        let present = match array {
            Ok([fx, fy, fz]) => {
                let (fx, fy, none) = (fx.value, fy.value, unseen_shear(fz.value));
                SHEAR.update(&mut state.sheared, (fx * fx + fy * fy) / (none * none))
            }
            _ => true,
        };
        let sheared = model.shear && present;
        let new = state.model.searches();
        let touch = if sheared {
            status.insert(Status::RAN_SHEAR);
            state.model.need_shear(self.learns || array.is_err());
            model.sheared(&mut state.model, u, pull(&array))
        } else {
            model.pressed(&mut state.model, u)
        };
        let touch = match touch {
            Ok(touch) => touch,
            Err(reason) => return OpticalEstimate::nothing(reason),
        };
        let squared = touch.misfit * touch.misfit;
        let several = SEVERAL.update(&mut state.several, squared);
        if several {
            status.insert(Status::NOT_SINGLE);
        }
        if !several && squared <= SEVERAL.on * SEVERAL.on {
            state.pair.clear();
        } else if !new || state.pair.believed() {
            // The search begins while the gate still counts, but not in the scan of a new contact,
            // whose own search takes the time of this one.
            state.single = touch.misfit;
            let pair = model.pair(&mut state.pair, u, touch.misfit, state.model.hurried());
            if several {
                status.insert(Status::RAN_PAIR);
                if let Some(pair) = pair {
                    return two(&pair, model.expected_share());
                }
            }
        }
        let off = !touch.is_on_pad();
        if off {
            // The search begins again, and what it finds counts once it is sure.
            state.model.lose();
        }
        state.off = off || state.off && !touch.is_sure();
        if state.off {
            return OpticalEstimate::nothing(NoValue::IllConditioned);
        }
        let ring = (sheared && self.learns).then_some(touch.ring);
        OpticalEstimate { ring, ..one(&touch, sheared, model.shear) }
    }
}

/// Returns the ratio of shear to normal force of the force sensors, if the normal force suffices.
fn pull(array: &Measured<[Gaussian; 3]>) -> Option<ShearPrior> {
    let Ok([x, y, z]) = array else { return None };
    let [rx, ry] = [x, y].map(|f| f.value / z.value);
    let sigma = (x.sigma.max(y.sigma) + rx.abs().max(ry.abs()) * z.sigma) / z.value;
    (z.value > LEAST_FELT).then_some(ShearPrior { ratio: [rx, ry], sigma })
}

fn unseen_shear(normal: f32) -> f32 {
    let [floor, share] = UNSEEN_SHEAR;
    floor + share * normal.max(0.0)
}

fn one(touch: &ContactFit, sheared: bool, shear: bool) -> OpticalEstimate {
    let [fx, fy, fz] = touch.force();
    let [sx, sy, sz, px, py, _] = touch.sigma;
    let of = |value: f32, sigma: f32| Gaussian { value, sigma };
    let unseen = unseen_shear(fz);
    let [x, y] = match (shear, sheared) {
        (false, _) => [Err(NoValue::NotEstimated); 2],
        (true, false) => [Ok(of(0.0, unseen)); 2],
        (true, true) => [Ok(of(fx, sx)), Ok(of(fy, sy))],
    };
    let [at_x, at_y] = touch.load.point;
    let known = px < UNSURE_PLACE && py < UNSURE_PLACE;
    let place = [of(at_x, px + PLACE_ERROR), of(at_y, py + PLACE_ERROR)];
    OpticalEstimate {
        force: [x, y, Ok(of(fz, sz + SKIN_ERROR * fz))],
        point: if known { Ok(place) } else { Err(NoValue::IllConditioned) },
        ring: None,
        contacts: Err(NoValue::NotEstimated),
        misfit: Ok(touch.misfit),
    }
}

/// Returns the sum of two contacts, and the position where a single contact makes the same moments.
fn two(pair: &Pair, share: f32) -> OpticalEstimate {
    let [a, b] = pair.contacts.map(|load| (load.normal(), load.point));
    let sum = a.0 + b.0;
    let middle = |axis: fn([f32; 2]) -> f32| Gaussian {
        value: (a.0 * axis(a.1) + b.0 * axis(b.1)) / sum.max(f32::MIN_POSITIVE),
        sigma: CENTROID_ERROR,
    };
    let unknown = Err(NoValue::NotEstimated);
    let normal = Gaussian { value: sum, sigma: (pair.misfit.max(1.0) * share + SKIN_ERROR) * sum };
    OpticalEstimate {
        force: [unknown, unknown, Ok(normal)],
        point: Ok([middle(|[x, _]| x), middle(|[_, y]| y)]),
        ring: None,
        contacts: Ok([a, b].map(NormalContact::new)),
        misfit: Ok(pair.misfit),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::TaxelBias;
    use crate::estimate::field::Load;
    use crate::estimate::inverse::tests::{displaced, finger};

    #[test]
    fn normal_force_sigma_includes_skin_stiffness() {
        let load = Load { size: 1.0, ..Load::default() };
        let touch = ContactFit {
            load,
            sigma: [1e-3; 6],
            ring: FrictionUtilisation::default(),
            misfit: 0.5,
        };
        let Ok(fz) = one(&touch, false, true).force[2] else { panic!("a force is known") };
        // A change by 10 K changes a rubber's stiffness by 3 %.
        assert!((0.03..0.1).contains(&(fz.sigma - 1e-3)), "{fz:?}");
    }

    #[test]
    fn unsure_position_is_withheld_its_force_is_not() {
        for (sigma, known) in [([0.3, 0.3], true), ([0.3, 0.7], false), ([0.7, 0.3], false)] {
            let [x, y] = sigma;
            let touch = ContactFit {
                load: Load { size: 1.0, point: [1.0, -2.0], ..Load::default() },
                sigma: [1e-3, 1e-3, 1e-3, x, y, 0.4],
                ring: FrictionUtilisation::default(),
                misfit: 0.5,
            };
            let OpticalEstimate { point, force: [.., fz], .. } = one(&touch, false, true);
            let expected = if known { Ok([1.0, -2.0]) } else { Err(NoValue::IllConditioned) };
            assert_eq!(point.map(|at| at.map(|c| c.value)), expected, "{sigma:?}");
            assert!(fz.is_ok_and(|fz| fz.value == 1.0), "{fz:?}");
        }
    }

    #[test]
    fn friction_use_is_given_only_to_learn_from() {
        let load = Load { shear: [0.9, 0.0], size: 1.2, point: [0.3, -0.2], used: 0.9 };
        let c = displaced(&load).map(|u| -u);
        let bias = TaxelBias { level: [0.3; TAXELS], noise: 1e-4 };
        let taxels = TaxelCalibration { bias, range: [[-1.0, 1.0]; TAXELS], residual: [0.01; 3] };
        let record =
            Calibration { taxels: Some(taxels), model: Some(finger()), ..Calibration::EMPTY };
        let none = NoValue::Absent;
        let array = ArrayEstimate { force: Err(none), point: Err(none), torsion: Err(none) };
        for learns in [false, true] {
            let input = OpticalInput {
                record: Some(&record),
                method: PointMethod::Model,
                c: &c,
                health: &Health::SOUND,
                bias: &Bias::default(),
                array: &array,
                learns,
            };
            let (mut state, mut status) = (MatrixState::default(), Status::default());
            let found = (0..12).map(|_| input.estimate(&mut state, &mut status)).last().unwrap();
            let used = found.ring.map(|ring| ring.moment / ring.weight);
            assert_eq!(used.is_some(), learns, "{found:?}");
            assert!(used.is_none_or(|used| (used - load.used).abs() < 0.05), "{used:?}");
        }
    }
}

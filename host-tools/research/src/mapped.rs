//! Methods of the failure maps: every output that the firmware can give, with its error.
//!
//! They are the whole finger, and the optical matrix alone with each method that a record and a
//! setting can choose. Methods outside the firmware (sums of powers, the integral of [Ohka2005])
//! have no status to flag a failure, so charts show only their error. **To add one**: a line in a
//! list of methods.

use anyhow::Context;
use taxel::calibration::Calibration;
use taxel::estimate::NormalContact;
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::quantised::{Net, QuantisedNet};
use taxel::finger::{Estimate, Finger, FingerState, SKIN_ERROR};
use taxel::frame::Status;
use taxel::measured::Measured;
use taxel::units::Newtons;
use taxel_calibrate::evaluate::FLAGS;
use taxel_files::trace::{Sample, Truth};
use taxel_regress::range::largest;

use crate::accuracy::{Accuracy, Unseen};
use crate::counts::Of;
use crate::device::{CALIBRATION, Device};
use crate::truth::Beyond;

/// Built-in scene of two contacts.
const TWO: &str = "two-contacts";
/// Ratio of true margin to warning threshold above which a slip warning is false.
const FALSE_ALARM: f64 = 2.0;

/// Status bits that warn of a single force sensor.
const SENSOR_FLAGS: [Status; 2] = [Status::TEMPERATURE, Status::NOISY];

/// Quantity that a method gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Force,
    Point,
    Torsion,
    Sensors,
    /// Positions of two contacts.
    Pair,
    /// Slip margin.
    Margin,
    /// Slip warning or gross-slip flag.
    Warning,
}

/// Table name and quantity of a method.
type Method = (&'static str, Quantity);

/// Methods of the whole finger.
const SHIPPED: &[Method] = &[
    ("force / N", Quantity::Force),
    ("contact point / mm", Quantity::Point),
    ("torsion / N·mm", Quantity::Torsion),
    ("force sensors / N", Quantity::Sensors),
    ("two contacts / mm", Quantity::Pair),
    ("slip margin / 1", Quantity::Margin),
    ("slip warning / 1", Quantity::Warning),
];
/// Methods of the matrix alone with the model of the skin.
const MODEL: &[Method] = &[
    ("model's force / N", Quantity::Force),
    ("model's point / mm", Quantity::Point),
    ("model's slip margin / 1", Quantity::Margin),
    ("model's slip warning / 1", Quantity::Warning),
];
const NET: &[Method] = &[("net's force / N", Quantity::Force), ("centroid / mm", Quantity::Point)];
const QUANTISED: &[Method] =
    &[("q15 net's force / N", Quantity::Force), ("arg-min / mm", Quantity::Point)];

/// One finger with the settings of some methods.
#[derive(Clone)]
struct Set {
    finger: Finger,
    state: FingerState,
    methods: &'static [Method],
    /// True where the finger has force sensors.
    sensors: bool,
    /// Slip margin below which a warning is due.
    warns: f64,
}

/// Error of a value, and whether the status warns of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Said {
    /// Index into [`Fingers::methods`].
    pub method: usize,
    /// Error of the value; `None` where the finger gives none.
    pub error: Option<f64>,
    /// True where the finger detects the contact.
    pub felt: bool,
    pub warned: bool,
}

/// Fingers of one device, one for each set of methods.
#[derive(Clone)]
pub(crate) struct Fingers {
    sets: Vec<Set>,
}

impl Fingers {
    /// Creates the fingers of a calibration record.
    pub(crate) fn new(record: &Calibration) -> anyhow::Result<Self> {
        let matrix = Calibration { array: None, sensors: Default::default(), ..record.clone() };
        let net = matrix.net.as_ref().and_then(Net::float).context("the calibration has no net")?;
        let ranges = matrix.taxels.as_ref().map_or(&[][..], |taxels| &taxels.range);
        let quantised =
            QuantisedNet::new(net, largest(ranges)).context("the net has no form in 16 bits")?;
        let quantised = Calibration { net: Some(Net::Quantised(quantised)), ..matrix.clone() };
        let sets = [
            (record.clone(), PointMethod::Model, SHIPPED, true),
            (matrix.clone(), PointMethod::Model, MODEL, false),
            (matrix, PointMethod::Centroid, NET, false),
            (quantised, PointMethod::ArgMin, QUANTISED, false),
        ];
        let set = |(record, point_method, methods, sensors): (Calibration, _, _, _)| {
            let warns = record.slip.as_ref().map_or(0.0, |slip| f64::from(slip.warn));
            let (mut finger, state) = Finger::new(Some(record));
            finger.point_method = point_method;
            Set { finger, state, methods, sensors, warns }
        };
        Ok(Self { sets: sets.map(set).into() })
    }

    /// Lists the methods in the order of their indices.
    pub(crate) fn methods() -> impl Iterator<Item = (Of, &'static str)> {
        let of = |of| move |(name, _): &Method| (of, *name);
        let alone = [MODEL, NET, QUANTISED].into_iter().flatten();
        SHIPPED.iter().map(of(Of::Finger)).chain(alone.map(of(Of::Matrix)))
    }

    /// Resets the fingers' state before another run.
    pub(crate) fn restart(&mut self) {
        self.sets.iter_mut().for_each(|set| set.state = set.finger.restarted());
    }

    /// Judges every method on one scan.
    pub(crate) fn judge(&mut self, sample: &Sample, beyond: &Beyond, mut said: impl FnMut(Said)) {
        let mut method = 0;
        for Set { finger, state, methods, sensors, warns } in &mut self.sets {
            let mut scan = sample.scan;
            if !*sensors {
                scan.codes.bridges = Default::default();
            }
            let estimate = finger.estimate(state, &scan);
            for (_, quantity) in *methods {
                if sample.truth.contact == Some(true) {
                    let felt = estimate.status.contains(Status::CONTACT);
                    let warned = quantity.warned(estimate.status);
                    let truth = Truths { truth: &sample.truth, beyond, warns: *warns };
                    quantity.errors(&estimate, &truth, |error| {
                        said(Said { method, error, felt, warned })
                    });
                }
                method += 1;
            }
        }
    }

    /// Fits the claimed accuracy of each method to held-out recordings.
    ///
    /// These are of the same kind as the calibration recordings; for two contacts, of the scene of
    /// two.
    pub(crate) fn stated(&mut self, device: &Device) -> anyhow::Result<Vec<Accuracy>> {
        let methods: Vec<&Method> = self.sets.iter().flat_map(|set| set.methods).collect();
        let mut unseen: Vec<Vec<Unseen>> = methods.iter().map(|_| Vec::new()).collect();
        for scene in CALIBRATION.into_iter().chain([TWO]) {
            self.restart();
            for moment in device.unseen(scene)? {
                let load = moment.sample.truth.force[2].unwrap_or_default();
                self.judge(&moment.sample, &moment.beyond, |said| {
                    let Said { method, error, felt, .. } = said;
                    let pair = methods.get(method).is_some_and(|(_, q)| *q == Quantity::Pair);
                    if let (Some(unseen), Some(error)) = (unseen.get_mut(method), error)
                        && pair == (scene == TWO)
                    {
                        unseen.push(Unseen { load, felt, error });
                    }
                });
            }
        }
        let stated = methods.iter().zip(&unseen).zip(Self::methods());
        Ok(stated.map(|(((_, quantity), unseen), (of, _))| quantity.states(of, unseen)).collect())
    }
}

/// Truth at one moment.
struct Truths<'t> {
    truth: &'t Truth,
    beyond: &'t Beyond,
    /// Slip margin below which a warning is due.
    warns: f64,
}

impl Quantity {
    /// Fits the claimed accuracy: a force's error grows with the load, a position's or margin's
    /// falls.
    fn states(self, of: Of, unseen: &[Unseen]) -> Accuracy {
        let over = match self {
            Self::Force | Self::Torsion | Self::Sensors => |load| load,
            Self::Point | Self::Pair | Self::Margin => f64::recip,
            Self::Warning => return Accuracy::of_verdicts(),
        };
        let stated = Accuracy::of(unseen, over);
        // The matrix measures a depth: its force depends on the skin's stiffness.
        match (of, self) {
            (Of::Matrix, Self::Force) => stated.with_share(f64::from(SKIN_ERROR)),
            _ => stated,
        }
    }

    /// Passes the error of each value with a known truth to `judged`.
    fn errors(self, estimate: &Estimate, known: &Truths<'_>, mut judged: impl FnMut(Option<f64>)) {
        let Truths { truth, beyond, warns } = known;
        match self {
            Self::Force => {
                let found = [estimate.force.x, estimate.force.y, estimate.force.z];
                judged(distance(found, truth.force));
            }
            Self::Point => {
                let off = truth.point[0].zip(truth.point[1]).map(|(x, y)| {
                    let found = estimate.point.ok()?;
                    Some((f64::from(found.x.0) - x).hypot(f64::from(found.y.0) - y))
                });
                if let Some(error) = off {
                    judged(error);
                }
            }
            Self::Torsion => {
                if let Some(torsion) = truth.torsion {
                    judged(estimate.torsion.ok().map(|found| (f64::from(found.0) - torsion).abs()));
                }
            }
            Self::Sensors => {
                for (found, truth) in estimate.sensors.iter().zip(&truth.sensors) {
                    judged(distance([found.x, found.y, found.z], *truth));
                }
            }
            Self::Pair => {
                if let Some(places) = beyond.places {
                    judged(estimate.contacts.ok().map(|found| apart(found, places)));
                }
            }
            Self::Margin => {
                if let Some(margin) = beyond.margin {
                    judged(
                        estimate.slip.ok().map(|found| (f64::from(found.margin) - margin).abs()),
                    );
                }
            }
            Self::Warning => {
                if let (Some(slips), Some(margin)) = (truth.slip, beyond.margin) {
                    let warned = [Status::SLIP_WARNING, Status::SLIDES]
                        .into_iter()
                        .any(|bit| estimate.status.contains(bit));
                    let wrong = if warned { margin > FALSE_ALARM * warns } else { slips };
                    judged(estimate.slip.ok().map(|_| f64::from(u8::from(wrong))));
                }
            }
        }
    }

    /// Returns whether a status bit warns of this quantity.
    fn warned(self, status: Status) -> bool {
        let flags = if self == Self::Sensors { &SENSOR_FLAGS[..] } else { &FLAGS };
        // "Not a single contact" is no warning for the positions of two contacts.
        let said = |flag: Status| self == Self::Pair && flag == Status::NOT_SINGLE;
        flags.iter().any(|flag| status.contains(*flag) && !said(*flag))
    }
}

/// Returns the larger position error of two contacts, in the nearer of both pairings.
fn apart(found: [NormalContact; 2], places: [[f64; 2]; 2]) -> f64 {
    let [a, b] = found.map(|contact| [contact.point.x, contact.point.y].map(|at| f64::from(at.0)));
    let off = |[x, y]: [f64; 2], [tx, ty]: [f64; 2]| (x - tx).hypot(y - ty);
    let [one, other] = places;
    off(a, one).max(off(b, other)).min(off(a, other).max(off(b, one)))
}

fn distance(found: [Measured<Newtons>; 3], truth: [Option<f64>; 3]) -> Option<f64> {
    let mut squares = 0.0;
    for (found, truth) in found.into_iter().zip(truth) {
        squares += (f64::from(found.ok()?.0) - truth?).powi(2);
    }
    Some(squares.sqrt())
}

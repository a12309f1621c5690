//! What is mapped: everything that the firmware can be set to say, and how far each is off.
//!
//! The finger as it is shipped, and its optical matrix alone with each method that a record and a setting can
//! choose. Methods that the firmware does not run (sums of powers, the integral of 000) have no status to
//! say that they fail, and are charted for their error only. **To add one**: a line in a list of methods.

use anyhow::Context;
use taxel::calibration::Calibration;
use taxel::estimate::contact_point::PointMethod;
use taxel::estimate::quantised::QuantisedNet;
use taxel::finger::{Estimate, Finger, FingerState};
use taxel::frame::Status;
use taxel::measured::Measured;
use taxel::units::Newtons;
use taxel_formats::trace::{Sample, Truth};

use crate::accuracy::{Accuracy, Unseen};
use crate::device::{CALIBRATION, Device};
use crate::failures::Of;

/// Loads below this many newtons are neither stated for nor in the working range, as in `estimators.csv`.
pub(crate) const LEAST_N: f64 = 0.05;

/// Status bits that tell that something is wrong.
const FLAGS: [Status; 10] = [
    Status::UNCALIBRATED,
    Status::SATURATED,
    Status::DEAD_TAXEL,
    Status::BRIDGE_FAULT,
    Status::OUT_OF_RANGE,
    Status::STUCK_CHANNEL,
    Status::NOT_SINGLE,
    Status::DISAGREE,
    Status::TEMPERATURE,
    Status::NOISY,
];

/// Those that warn of single force sensors.
const SENSOR_FLAGS: [Status; 2] = [Status::TEMPERATURE, Status::NOISY];

/// What a finger says of a touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Force,
    Point,
    Torsion,
    Sensors,
}

/// A method: its name in the tables, and what of its finger it is.
type Method = (&'static str, Quantity);

/// Of the finger as it is shipped.
const SHIPPED: &[Method] = &[
    ("force / N", Quantity::Force),
    ("contact point / mm", Quantity::Point),
    ("torsion / N·mm", Quantity::Torsion),
    ("force sensors / N", Quantity::Sensors),
];
/// Of the matrix alone.
const MODEL: &[Method] =
    &[("model's force / N", Quantity::Force), ("model's point / mm", Quantity::Point)];
const NET: &[Method] = &[("net's force / N", Quantity::Force), ("centroid / mm", Quantity::Point)];
const QUANTISED: &[Method] =
    &[("q15 net's force / N", Quantity::Force), ("arg-min / mm", Quantity::Point)];

/// One finger, set to some methods.
#[derive(Clone)]
struct Set {
    finger: Finger,
    state: FingerState,
    methods: &'static [Method],
    /// The force sensors are there.
    sensors: bool,
}

/// An error, and whether the status warns of the value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Said {
    /// Which of [`Fingers::methods`].
    pub method: usize,
    /// `None` where the value is withheld.
    pub error: Option<f64>,
    /// The finger feels the touch.
    pub felt: bool,
    pub warned: bool,
}

/// Every finger of a device that is mapped.
#[derive(Clone)]
pub(crate) struct Fingers {
    sets: Vec<Set>,
}

impl Fingers {
    /// Those of the record.
    pub(crate) fn new(record: &Calibration) -> anyhow::Result<Self> {
        let matrix = Calibration { array: None, sensors: Default::default(), ..record.clone() };
        let net = matrix.force.as_ref().context("the calibration has no net")?;
        let ranges = matrix.taxels.as_ref().map_or(&[][..], |taxels| &taxels.range);
        let largest = ranges.as_flattened().iter().fold(0.0f32, |most, end| most.max(end.abs()));
        let quantised =
            QuantisedNet::new(net, largest).context("the net has no form in 16 bits")?;
        let quantised = Calibration { force: None, quantised: Some(quantised), ..matrix.clone() };
        let sets = [
            (record.clone(), PointMethod::Model, SHIPPED, true),
            (matrix.clone(), PointMethod::Model, MODEL, false),
            (matrix, PointMethod::Centroid, NET, false),
            (quantised, PointMethod::ArgMin, QUANTISED, false),
        ];
        let set = |(record, point_method, methods, sensors)| {
            let (mut finger, state) = Finger::new(Some(record));
            finger.point_method = point_method;
            Set { finger, state, methods, sensors }
        };
        Ok(Self { sets: sets.map(set).into() })
    }

    /// Every method, in the order of their numbers.
    pub(crate) fn methods() -> impl Iterator<Item = (Of, &'static str)> {
        let of = |of| move |(name, _): &Method| (of, *name);
        let alone = [MODEL, NET, QUANTISED].into_iter().flatten();
        SHIPPED.iter().map(of(Of::Finger)).chain(alone.map(of(Of::Matrix)))
    }

    /// Starts afresh with another run.
    pub(crate) fn restart(&mut self) {
        self.sets.iter_mut().for_each(|set| set.state = set.finger.restarted());
    }

    /// One scan: what each method says, where something touches the finger.
    pub(crate) fn judge(&mut self, sample: &Sample, mut said: impl FnMut(Said)) {
        let mut method = 0;
        for Set { finger, state, methods, sensors } in &mut self.sets {
            let mut scan = sample.scan;
            if !*sensors {
                scan.codes.bridges = Default::default();
            }
            let estimate = finger.estimate(state, &scan);
            for (_, quantity) in *methods {
                if sample.truth.contact == Some(true) {
                    let felt = estimate.status.contains(Status::CONTACT);
                    let warned = quantity.warned(estimate.status);
                    quantity.errors(&estimate, &sample.truth, |error| {
                        said(Said { method, error, felt, warned })
                    });
                }
                method += 1;
            }
        }
    }

    /// What each method states, out of recordings of the kind that the finger is calibrated on, but that
    /// the fit has not seen.
    pub(crate) fn stated(&mut self, device: &Device) -> anyhow::Result<Vec<Accuracy>> {
        let mut unseen: Vec<Vec<Unseen>> = Self::methods().map(|_| Vec::new()).collect();
        for scene in CALIBRATION {
            self.restart();
            for moment in device.unseen(scene)? {
                let load = moment.sample.truth.force[2].unwrap_or_default();
                self.judge(&moment.sample, |said| {
                    let Said { method, error, felt, .. } = said;
                    if let (Some(unseen), Some(error)) = (unseen.get_mut(method), error) {
                        unseen.push(Unseen { load, felt, error });
                    }
                });
            }
        }
        let quantities = [SHIPPED, MODEL, NET, QUANTISED].into_iter().flatten();
        Ok(quantities.zip(&unseen).map(|((_, quantity), unseen)| quantity.states(unseen)).collect())
    }
}

impl Quantity {
    /// Of a force the residual grows with the load; a place is a moment over the load.
    fn states(self, unseen: &[Unseen]) -> Accuracy {
        Accuracy::of(unseen, if self == Self::Point { f64::recip } else { |load| load })
    }

    /// Each of its values' errors, where the truth is known.
    fn errors(self, estimate: &Estimate, truth: &Truth, mut judged: impl FnMut(Option<f64>)) {
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
        }
    }

    /// Bits that withhold nothing, but warn of this quantity.
    fn warned(self, status: Status) -> bool {
        let flags = if self == Self::Sensors { &SENSOR_FLAGS[..] } else { &FLAGS };
        flags.iter().any(|flag| status.contains(*flag))
    }
}

fn distance(found: [Measured<Newtons>; 3], truth: [Option<f64>; 3]) -> Option<f64> {
    let mut squares = 0.0;
    for (found, truth) in found.into_iter().zip(truth) {
        squares += (f64::from(found.ok()?.0) - truth?).powi(2);
    }
    Some(squares.sqrt())
}

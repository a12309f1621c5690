//! Rehearsal of a record: forces without a contact, and at the threshold of the contact gate.
//!
//! Every field of a record may be plausible by itself and the finger useless: a net may say 5 N
//! without a contact, a noise may keep the gate closed up to 50 N.

use super::{Calibration, CalibrationError, SensorCalibration, section};
use crate::estimate::gate::Gate;
use crate::estimate::quantised::Net;
use crate::scan::TAXELS;

/// Largest force without a contact, and largest one at which the gate must be open, in newtons.
const MOST: f32 = 1.0;

impl Calibration {
    /// Rehearses a valid record: it must say no force without a contact, and the contact gate must
    /// open below 1 N.
    ///
    /// The matrix or one sensor that opens the gate suffices. A record without forces passes,
    /// because nothing can be told of it.
    ///
    /// # Errors
    /// [`CalibrationError::Rehearsal`]: the net says 1 N or more without a contact, or the noise of
    /// the matrix or of all sensors hides every contact of less than 1 N.
    #[cold]
    #[inline(never)]
    pub fn rehearse(&self) -> Result<(), CalibrationError> {
        // The section whose noise hides contacts, if no part notices them.
        let (mut notices, mut section) = (false, 0);
        for sensor in self.sensors.iter().flatten() {
            notices |= sensor_notices(sensor);
            section = section::SENSORS;
        }
        if let Some(taxels) = &self.taxels {
            let dent = -Gate::default().on * taxels.bias.noise;
            if let Some(model) = self.model() {
                notices |= model.notices(dent);
                section = section::TAXELS;
            }
            if let Some(net) = &self.net {
                notices |= small(net, dent);
                section = section::TAXELS;
                if !small(net, 0.0) {
                    (notices, section) = (false, section::FLOAT);
                }
            }
        }
        if notices || section == 0 { Ok(()) } else { Err(CalibrationError::Rehearsal { section }) }
    }
}

/// Returns whether a sensor opens the gate by a normal force below 1 N.
#[cold]
#[inline(never)]
fn sensor_notices(sensor: &SensorCalibration) -> bool {
    // The gate judges the root mean square of three signals, of which this force moves one.
    let [_, _, [_, _, normal]] = sensor.sensitivity.0;
    (normal * sensor.bias.noise).abs() < MOST / (1.732 * Gate::default().on)
}

/// Returns whether all forces of the net are small if every signal is `c`.
#[cold]
#[inline(never)]
fn small(net: &Net, c: f32) -> bool {
    net.forces(&[c; TAXELS]).iter().all(|force| force.abs() < MOST)
}

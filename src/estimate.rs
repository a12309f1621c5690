//! Estimators of contact, position and force from signals. Each file is one estimator with its
//! source.

pub mod array;
pub mod contact_point;
pub mod field;
pub mod fusion;
pub mod gate;
pub mod intrinsic;
pub mod inverse;
pub mod limit_surface;
mod linearised;
pub mod net;
pub mod quantised;
pub mod sensitivity;
pub mod slide;
pub mod slip;
pub mod tanh;
pub mod two_contacts;
pub mod vibration;
pub mod wrench;

use serde::{Deserialize, Serialize};

use crate::measured::Measured;
use crate::units::{Millimetres, Newtons};

/// Position of a contact on the surface of the finger.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ContactPoint {
    /// Coordinate along a row, from the middle of the matrix.
    pub x: Millimetres,
    /// Coordinate along a column, from the middle of the matrix.
    pub y: Millimetres,
}

/// One of several contacts: position and normal force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NormalContact {
    /// Contact position.
    pub point: ContactPoint,
    /// Normal force.
    pub normal: Newtons,
}

impl NormalContact {
    /// Makes a contact of `normal` newtons at x, y in mm.
    #[must_use]
    pub const fn new((normal, [x, y]): (f32, [f32; 2])) -> Self {
        Self {
            point: ContactPoint { x: Millimetres(x), y: Millimetres(y) },
            normal: Newtons(normal),
        }
    }
}

/// Standard deviations of the fused estimates, and the misfit of a single contact.
///
/// The deviations contain the noise, the residual of the calibration, and the errors that no
/// calibration removes. Skin and contact position are known to
/// [`SKIN_ERROR`](crate::finger::SKIN_ERROR) and [`PLACE_ERROR`](crate::finger::PLACE_ERROR), a
/// force sensor's gain to half a per cent. Those of the force are wider while its rate changes
/// within the lag that the calibration compensates.
///
/// A finger that has not aged or warmed since its calibration does better. The errors of such a
/// finger, divided by these standard deviations, have the following root mean squares
/// (`host-tools/calibrate/tests/it/uncertainty.rs`):
/// - shear 0.8;
/// - array: contact position 1.1, normal force 0.4;
/// - matrix: contact position 0.4, normal force 0.1, or 0.9 after the skin has softened by the
///   allowed amount.
///
/// Each value stands alone: the model's correlation of x and F_x is not reported.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Uncertainty {
    /// Standard deviations of the finger's force, by component.
    pub force: Force,
    /// Standard deviations of the contact point, along x and along y.
    pub point: Measured<ContactPoint>,
    /// Normalised residual of the skin model: about 1 for a contact like those of the calibration.
    /// The root mean square of the remaining displacements is divided by that of the calibration at
    /// this force.
    pub misfit: Measured<f32>,
}

/// Force on the finger or on one sensor; z is positive into the skin.
///
/// Components may be missing one by one, because a calibration with normal presses only knows z.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Force {
    /// Component along a row.
    pub x: Measured<Newtons>,
    /// Component along a column.
    pub y: Measured<Newtons>,
    /// Component into the skin.
    pub z: Measured<Newtons>,
}

impl Force {
    /// Makes a force without components, all for the same reason.
    #[must_use]
    pub const fn none(reason: crate::measured::NoValue) -> Self {
        Self { x: Err(reason), y: Err(reason), z: Err(reason) }
    }

    /// Makes a force of three known components in newtons.
    #[must_use]
    pub const fn known(x: f32, y: f32, z: f32) -> Self {
        Self { x: Ok(Newtons(x)), y: Ok(Newtons(y)), z: Ok(Newtons(z)) }
    }
}

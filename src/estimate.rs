//! Signals become contact, position and force. One file an estimator, each with its source.

pub mod array;
pub mod contact_point;
pub mod field;
pub mod fusion;
pub mod gate;
pub mod intrinsic;
pub mod inverse;
pub mod limit_surface;
pub mod net;
pub mod quantised;
pub mod sensitivity;
pub mod slide;
pub mod slip;
mod solve;
pub mod tanh;
pub mod two_contacts;
pub mod vibration;
pub mod wrench;

use serde::{Deserialize, Serialize};

use crate::measured::Measured;
use crate::units::{Millimetres, Newtons};

/// Where the finger is touched, on its own surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ContactPoint {
    /// Along a row, from the middle of the matrix.
    pub x: Millimetres,
    /// Along a column, from the middle of the matrix.
    pub y: Millimetres,
}

/// One of several contacts: its place and normal force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NormalContact {
    /// Where.
    pub point: ContactPoint,
    /// How hard.
    pub normal: Newtons,
}

impl NormalContact {
    /// `normal` newtons at x, y in mm.
    #[must_use]
    pub const fn new((normal, [x, y]): (f32, [f32; 2])) -> Self {
        Self {
            point: ContactPoint { x: Millimetres(x), y: Millimetres(y) },
            normal: Newtons(normal),
        }
    }
}

/// How sure the finger is of a contact: standard deviations of what it says, after matrix and force sensors
/// are weighted by them, and how well one contact accounts for the matrix's signals.
///
/// They hold the noise and what calibration left, and what no calibration takes off: skin and place are known
/// to [`SKIN_ERROR`](crate::finger::SKIN_ERROR) and [`PLACE_ERROR`](crate::finger::PLACE_ERROR), a force
/// sensor's gain to half a per cent. A finger that has not aged or warmed since its calibration does better: errors over
/// what is stated have a root mean square of 0.8 for shear, 1.1 for the array's place and 0.4 for its normal force, 0.4 for
/// the matrix's place and 0.1 for its normal force, 0.9 once the skin has become softer by what is allowed for
/// (`host-tools/calibrate/tests/it/uncertainty.rs`). Each stands alone: that the model's errors of x and F_x go together is not said.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Uncertainty {
    /// Of the finger's force, component by component.
    pub force: Force,
    /// Of the contact point, along x and along y.
    pub point: Measured<ContactPoint>,
    /// What the model leaves of the displacements, root mean square, over what calibration left at this force:
    /// about 1 for a contact such as those of its calibration.
    pub misfit: Measured<f32>,
}

/// Force on the finger or on one sensor; z is positive into the skin. Each component stands alone,
/// because a calibration with normal presses only knows z.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Force {
    /// Along a row.
    pub x: Measured<Newtons>,
    /// Along a column.
    pub y: Measured<Newtons>,
    /// Into the skin.
    pub z: Measured<Newtons>,
}

impl Force {
    /// All three components for the same reason missing.
    #[must_use]
    pub const fn none(reason: crate::measured::NoValue) -> Self {
        Self { x: Err(reason), y: Err(reason), z: Err(reason) }
    }

    /// All three components known.
    #[must_use]
    pub const fn known(x: f32, y: f32, z: f32) -> Self {
        Self { x: Ok(Newtons(x)), y: Ok(Newtons(y)), z: Ok(Newtons(z)) }
    }
}

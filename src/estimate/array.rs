//! The force sensors as one: the wrench that they feel together, and the contact that makes it.

use serde::{Deserialize, Serialize};

use super::intrinsic::{Contact, Surface};
use super::wrench::{SensorPlaces, Wrench, WrenchMatrix};
use crate::measured::Measured;
use crate::scan::SENSORS;

/// How the wrench is found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(
    clippy::large_enum_variant,
    reason = "one of them lives in a finger, and nothing is boxed"
)]
pub enum WrenchMethod {
    /// 0: F = Σ f_i, M = Σ r_i × f_i.
    Sum(SensorPlaces),
    /// 1: the full calibration, 6×3n.
    Matrix(WrenchMatrix),
}

impl Default for WrenchMethod {
    fn default() -> Self {
        Self::Sum(SensorPlaces::default())
    }
}

/// The coefficients of the sensors' array.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Array {
    /// How the wrench is found.
    pub method: WrenchMethod,
    /// Standard deviation of F's components in newtons, as left by calibration.
    pub residual: [f32; 3],
    /// Standard deviation of M_x and M_y in newton millimetres.
    pub moment_residual: f32,
    /// What is touched.
    pub surface: Surface,
}

impl Array {
    /// The wrench for the `signals` u − b of every sensor and the `forces` on it in newtons.
    #[must_use]
    pub fn wrench(&self, signals: &[[f32; 3]; SENSORS], forces: &[[f32; 3]; SENSORS]) -> Wrench {
        match &self.method {
            WrenchMethod::Sum(places) => places.wrench(forces),
            WrenchMethod::Matrix(matrix) => matrix.wrench(signals),
        }
    }

    /// The contact that makes `wrench`, and the standard deviation of its place in mm.
    ///
    /// # Errors
    /// As [`Surface::contact`]; a contact whose place is not known to a millimetre is none.
    pub fn contact(&self, wrench: &Wrench) -> Measured<(Contact, f32)> {
        // M = r × F: along the surface a place is a moment over the normal force.
        let contact = self.surface.contact(wrench, self.moment_residual)?;
        Ok((contact, self.moment_residual / contact.normal))
    }
}

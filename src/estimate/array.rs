//! Force sensors as one six-axis sensor: their common wrench, and the contact that causes it.

use serde::{Deserialize, Serialize};

use super::intrinsic::{Contact, Surface};
use super::wrench::{SensorPlaces, Wrench, WrenchMatrix};
use crate::measured::Measured;
use crate::scan::SENSORS;

/// Method of computing the wrench.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[expect(clippy::large_enum_variant, reason = "a finger holds a single one, and there is no heap")]
pub enum WrenchMethod {
    /// 0: sum of the sensors' forces and moments, F = Σ f_i, M = Σ r_i × f_i.
    Sum(SensorPlaces),
    /// 1: full calibration matrix, 6×3n.
    Matrix(WrenchMatrix),
}

impl Default for WrenchMethod {
    fn default() -> Self {
        Self::Sum(SensorPlaces::default())
    }
}

/// Coefficients of the array of force sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Array {
    /// Method of computing the wrench.
    pub method: WrenchMethod,
    /// Standard deviation of F's components in newtons, the residual of the calibration.
    pub residual: [f32; 3],
    /// Standard deviation of M_x and M_y in newton millimetres.
    pub moment_residual: f32,
    /// Surface of the finger.
    pub surface: Surface,
}

impl Array {
    /// Returns the wrench from every sensor's `signals` u − b and `forces` in newtons.
    #[must_use]
    pub fn wrench(
        &self,
        signals: &[Option<[f32; 3]>; SENSORS],
        forces: &[[f32; 3]; SENSORS],
    ) -> Wrench {
        match &self.method {
            WrenchMethod::Sum(places) => places.wrench(forces),
            WrenchMethod::Matrix(matrix) => matrix.wrench(&signals.map(Option::unwrap_or_default)),
        }
    }

    /// Returns the contact that causes `wrench`, and the standard deviation of its position in mm.
    ///
    /// # Errors
    /// Those of [`Surface::contact`], which also rejects a position not known to a millimetre.
    pub fn contact(&self, wrench: &Wrench) -> Measured<(Contact, f32)> {
        // M = r × F: along the surface, a position is a moment over the normal force.
        let contact = self.surface.contact(wrench, self.moment_residual)?;
        Ok((contact, self.moment_residual / contact.normal))
    }
}

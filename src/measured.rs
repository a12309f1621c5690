//! Measured values that may be missing, with the reason.

use serde::{Deserialize, Serialize};

/// Reason for a missing value. The numbers are those of the wire and frozen: append, never
/// renumber.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NoValue {
    /// 0: no calibration (or no bias) covers this quantity.
    Uncalibrated,
    /// 1: nothing touches the finger, so the quantity does not exist.
    NoContact,
    /// 2: a required channel is clipped.
    Saturated,
    /// 3: a required channel does not respond.
    DeadChannel,
    /// 4: an input lies outside the calibrated range.
    OutOfTrainedRange,
    /// 5: the signals do not determine the quantity (a division by nearly zero).
    IllConditioned,
    /// 6: this finger has no such channel.
    Absent,
    /// 7: the calibration, or this build, has no estimator for the quantity.
    NotEstimated,
}

impl NoValue {
    /// Every reason, in the order of the wire's numbers.
    pub const ALL: [Self; 8] = [
        Self::Uncalibrated,
        Self::NoContact,
        Self::Saturated,
        Self::DeadChannel,
        Self::OutOfTrainedRange,
        Self::IllConditioned,
        Self::Absent,
        Self::NotEstimated,
    ];
}

/// A value, or the reason for its absence.
pub type Measured<T> = Result<T, NoValue>;

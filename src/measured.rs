//! A measurement that may be missing, and the reason why.

use serde::{Deserialize, Serialize};

/// Why there is no value. The numbers are the wire's and are frozen: append, never renumber.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NoValue {
    /// 0: no calibration (or no bias) covers this quantity.
    Uncalibrated,
    /// 1: nothing touches the finger, so the quantity does not exist.
    NoContact,
    /// 2: a channel it needs is clipped.
    Saturated,
    /// 3: a channel it needs does not respond.
    DeadChannel,
    /// 4: an input lies outside what the calibration has seen.
    OutOfTrainedRange,
    /// 5: the signals do not determine it (a division by nearly nothing).
    IllConditioned,
    /// 6: this finger has no such channel.
    Absent,
    /// 7: the calibration, or this build, has no estimator for it.
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

//! Calibration: from recordings to a calibration record, and what the record is worth.
//!
//! - [`finger::fit`] makes the record of a finger from traces: S and b of its force sensors by least
//!   squares (003), the force net by Levenberg–Marquardt (002). [`evaluate::finger`] judges it on a
//!   recording that it has not seen, through the very arithmetic of the chip.
//! - [`table`] does the same for anybody's sensor that comes as a CSV of N channels.

mod correlation;
pub mod error;
pub mod evaluate;
pub mod finger;
pub mod least_squares;
mod levenberg;
pub mod limit_surface;
pub mod metrics;
mod mlp;
pub mod network;
mod prepared;
mod range;
pub mod recording;
pub mod table;

pub use error::FitError;

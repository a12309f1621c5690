//! Calibration: from a finger's recordings to its calibration record, and what the record is worth.
//!
//! - [`finger::fit`] makes the record from traces: S and b of the force sensors by least squares ([Ospina2017]),
//!   the force net by Levenberg–Marquardt ([DeMaria2011]). Where the recordings tell contact points, the model of
//!   the skin ([TactileEnc]), the wrench of the sensors' array and the [`limit_surface`] come with it.
//! - [`evaluate::finger`] judges a record on a recording that it has not seen, by the arithmetic of the chip;
//!   [`report`] writes that down for people.
//! - [`adjust`] corrects a record in place, from a few presses with known weights.
//!
//! Tables of other sensors are fitted by [`taxel_regress`].

pub mod adjust;
pub mod array;
mod augment;
pub mod evaluate;
pub mod finger;
pub mod inverse;
pub mod limit_surface;
mod prepared;
mod quantise;
pub mod recording;
pub mod report;
pub mod shear;
mod skin;
mod warmth;

pub use quantise::Form;

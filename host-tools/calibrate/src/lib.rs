//! Calibration: from a finger's recordings to its calibration record and the record's errors.
//!
//! - [`finger::fit`] makes the record from traces: S and b of the force sensors by least squares
//!   ([Ospina2017]), and the force net by Levenberg–Marquardt ([DeMaria2011]). Recordings with
//!   contact points add the skin model ([TactileEnc]), the wrench of the sensors' array and the
//!   [`limit_surface`].
//! - [`evaluate::finger`] judges a record on an unseen recording, by the arithmetic of the chip;
//!   [`report`] presents the result.
//! - [`guide`] tells the person who presses what a recording still lacks.
//! - [`adjust`] corrects a record in place, from a few presses with known weights.
//!
//! Tables of other sensors are fitted by [`taxel_regress`].

pub mod adjust;
pub mod array;
mod augment;
pub mod coverage;
pub mod evaluate;
pub mod finger;
pub mod guide;
pub mod inverse;
mod lag;
pub mod limit_surface;
pub mod moments;
mod prepared;
mod quantise;
pub mod recording;
pub mod reference;
pub mod report;
pub mod shear;
mod skin;
mod warmth;

pub use quantise::Form;

//! Calibration: from recordings to a calibration record, and what the record is worth.
//!
//! - [`finger::fit`] makes the record of a finger from traces: S and b of its force sensors by least
//!   squares (003), the force net by Levenberg–Marquardt (002). [`evaluate::finger`] judges it on a
//!   recording that it has not seen, through the very arithmetic of the chip.
//!   Where the recordings tell contact points, the model of the skin (004's inverse problem) and the wrench
//!   of the sensors' array come with it, and what a contact holds ([`limit_surface`]).
//! - [`table`] does the same for anybody's sensor that comes as a CSV of N channels.

pub mod adjust;
pub mod align;
pub mod array;
mod auto;
mod checks;
mod correlation;
mod distil;
pub mod error;
pub mod evaluate;
mod expansion;
pub mod finger;
mod gaussian;
pub mod inverse;
mod laws;
pub mod least_squares;
mod levenberg;
pub mod limit_surface;
mod line;
pub mod metrics;
mod mlp;
pub mod model;
pub mod network;
mod outliers;
mod prepared;
mod quantile;
mod quantise;
pub mod range;
pub mod recording;
mod scaling;
pub mod shear;
mod sign;
mod skin;
mod stretches;
pub mod table;
mod taught;
mod warmth;
mod width;

pub use auto::Chosen;
pub use error::FitError;
pub use expansion::Expansion;
pub use laws::Law;
pub use quantise::Form;
pub use scaling::Inputs;
pub use stretches::LeftOut;
pub use width::Tried;

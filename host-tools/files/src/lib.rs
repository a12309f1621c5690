//! Files of `taxel`: traces, frames, calibrations and tables.
//!
//! Every error is one line with the file, the line, the column and the mend.

pub mod bench;
pub mod calibration;
pub mod error;
pub mod frames;
pub mod lines;
mod number;
pub mod point_method;
pub mod recording;
mod save;
pub mod stretch;
pub mod table;
pub mod trace;

pub use error::FileError;
pub use save::{Pending, discard_pending, save};

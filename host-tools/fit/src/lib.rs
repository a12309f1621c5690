//! Calibration: from recordings to a calibration record.
#![allow(missing_docs)]
pub mod levenberg;
pub mod mlp;

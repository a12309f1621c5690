//! The report of a calibration: figures, coverage and warnings for people to read.
//!
//! ```text
//! recordings ─▶ Series ─▶ figures, coverage, warnings ─▶ Report ─▶ JSON, or a page with plots
//! ```
//! [`judge`] makes a [`Report`] of recordings that the calibration has not seen, and of those that it was
//! fitted to; [`html::page`] draws it. [`drift::compare`] tells how far two calibrations of one finger lie
//! apart. [`table`] and [`drift::compare_tables`] do the same for somebody else's sensor.

mod coverage;
mod doubts;
pub mod drift;
mod figures;
pub mod html;
mod judge;
mod papers;
mod plots;
mod series;
pub mod table;

pub use coverage::Coverage;
pub use figures::Figures;
pub use judge::{About, Report, Trial, judge};
pub use series::{Kind, Series};

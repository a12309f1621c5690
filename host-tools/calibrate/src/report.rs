//! Report of a calibration: figures, coverage and warnings for people to read.
//!
//! ```text
//! recordings ─▶ Series ─▶ verdict, figures, maps, warnings ─▶ Report ─▶ JSON, or a page with plots
//! ```
//! [`judge`] makes a [`Report`] from unseen recordings and those of the fit; [`html::page`] draws
//! it. [`drift::compare`] measures the difference between two calibrations of one finger. [`table`]
//! and [`drift::compare_tables`] do both for any other sensor.

mod channels;
mod coverage;
mod doubts;
pub mod drift;
mod figures;
pub mod html;
mod judge;
mod map;
mod papers;
mod plots;
mod series;
mod stated;
pub mod table;
mod verdict;

pub use coverage::Coverage;
pub use figures::Figures;
pub use judge::{About, Report, Trial, judge};
pub use map::{ErrorMap, Region};
pub use series::{Kind, Series};
pub use stated::Stated;
pub use verdict::{Judged, Verdict};

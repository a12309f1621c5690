//! Tests of the calibration on simulated fingers.
//!
//! The quick profile of nextest leaves out modules `endurance`; it and `ci` leave out modules
//! `nightly`.

mod accuracy;
mod adjust;
mod finger;
mod fixtures;
mod ill_posed;
mod judge;
mod limit_surface;
mod report;
mod total_force;
mod uncertainty;
mod warmth;

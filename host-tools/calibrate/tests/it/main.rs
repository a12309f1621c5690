//! Tests of the calibration on simulated fingers. Slow ones are in modules `nightly`, which the nextest profiles
//! `quick` and `ci` leave out.

mod accuracy;
mod adjust;
mod finger;
mod fixtures;
mod ill_posed;
mod judge;
mod limit_surface;
mod report;
mod uncertainty;
mod warmth;

//! Regression on tables of N channels: from recordings to a small model and its error figures.
//!
//! - [`table`] fits a model to any sensor's CSV and evaluates it.
//! - [`training::Training`] fits one to rows in memory; [`model::Family`] lists the families:
//!   ridge, polynomials, a tanh net by Levenberg–Marquardt with evidence ([DeMaria2011]), a
//!   Gaussian process distilled to a net.
//! - [`outliers`], [`sign_check`], [`duplicate_channels`] and [`align`] find faults of the
//!   recordings.

pub mod align;
mod auto;
mod correlation;
mod distil;
pub mod duplicate_channels;
pub mod error;
pub mod evidence;
pub mod folds;
mod gaussian;
pub mod least_squares;
mod levenberg;
pub mod metrics;
mod mlp;
pub mod model;
pub mod network;
pub mod outliers;
pub mod paper_models;
pub mod polynomial;
pub mod quantile;
pub mod range;
mod ridge;
pub mod scaling;
mod select_model;
mod select_width;
pub mod shear;
pub mod sign_check;
pub mod table;
pub mod training;

pub use error::FitError;
pub use folds::LeftOut;
pub use paper_models::Law;
pub use polynomial::Expansion;
pub use scaling::Inputs;
pub use training::{Chosen, Tried};

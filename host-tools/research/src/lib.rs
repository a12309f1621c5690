//! Charts of cost against accuracy and failure maps, written by `taxel chart`.
//!
//! ```text
//! simulator ─▶ Device ─▶ methods, each fitted ─▶ estimators.csv ─▶ SVG, HTML
//!              costs: the counting emulator's committed table ─┘
//! ```
//! Every figure comes from held-out devices. Each is calibrated on its own recordings and judged on
//! held-out runs with noise.

mod accuracy;
mod bars;
mod collinear;
mod convergence;
pub mod costs;
mod counts;
pub mod coverage;
pub mod detection;
pub mod device;
pub mod edge;
pub mod effects;
mod effort;
pub mod estimators;
pub mod failures;
mod faults;
pub mod idle;
mod ladder;
pub mod limit_surface;
mod map;
mod mapped;
mod methods;
mod papers;
pub mod peers;
mod picture;
mod reference;
pub mod results;
mod runs;
mod scatter;
pub mod simulator;
pub mod slip;
mod sweeps;
pub mod table;
pub mod throughput;
mod truth;

pub use effort::{Effort, Waiting};

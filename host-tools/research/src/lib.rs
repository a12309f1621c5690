//! Charts of cost against accuracy and failure maps, as `taxel chart` writes them.
//!
//! ```text
//! simulator ─▶ Device ─▶ methods, each fitted ─▶ estimators.csv ─▶ SVG, HTML
//!              costs: the counting emulator's committed table ─┘
//! ```
//! Every figure is of held-out devices, calibrated on their own recordings and judged on held-out runs, noise on.

mod accuracy;
mod bars;
mod collinear;
mod convergence;
pub mod costs;
mod counts;
pub mod device;
pub mod edge;
mod effort;
pub mod estimators;
pub mod failures;
mod ladder;
pub mod limit_surface;
mod map;
mod mapped;
mod methods;
mod papers;
pub mod peers;
mod picture;
pub mod results;
mod runs;
mod scatter;
pub mod simulator;
mod sweeps;
pub mod throughput;
mod truth;

pub use effort::{Effort, Waiting};

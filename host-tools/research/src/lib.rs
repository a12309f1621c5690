//! Speed charted against accuracy, and where each method fails: what `taxel chart` writes.
//!
//! ```text
//! simulator ─▶ Device ─▶ methods, each fitted ─▶ estimators.csv ─▶ SVG, HTML
//!              costs: the counting emulator's committed table ─┘
//! ```
//! Every figure is of devices that nothing was developed on, calibrated on their own recordings and judged
//! on runs that their fits have not seen, noise on.

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

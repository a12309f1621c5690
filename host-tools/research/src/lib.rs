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
pub mod device;
pub mod edge;
pub mod estimators;
pub mod failures;
mod ladder;
pub mod limit_surface;
mod map;
mod mapped;
mod methods;
mod page;
mod papers;
pub mod peers;
mod runs;
mod scatter;
pub mod simulator;
mod style;
mod sweeps;
pub mod throughput;
mod truth;

use std::sync::atomic::AtomicBool;

/// How thoroughly to judge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Seeds of the devices that figures are means over.
    pub devices: Vec<u64>,
    /// Steps of a net's training.
    pub steps: usize,
    /// Widths of the nets.
    pub widths: Vec<usize>,
}

impl Effort {
    /// What the documentation shows: five devices.
    #[must_use]
    pub fn full() -> Self {
        Self { devices: (11..16).collect(), steps: 100, widths: vec![2, 4, 6, 8, 16, 32] }
    }

    /// What a test can wait for: one device, and few widths of nets.
    #[must_use]
    pub fn quick() -> Self {
        Self { devices: vec![11], steps: 40, widths: vec![4, 8, 16] }
    }
}

/// Who waits: is told how far it is, and may stop it.
#[derive(Clone, Copy)]
pub struct Waiting<'w> {
    /// Called with what has been done, as a share of all.
    pub progress: &'w (dyn Fn(f64, &str) + Sync),
    /// Set to stop.
    pub stop: &'w AtomicBool,
}

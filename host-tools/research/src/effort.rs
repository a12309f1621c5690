//! Thoroughness of a measurement, its progress and its cancellation.

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

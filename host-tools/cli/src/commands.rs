//! Commands, one file each.

#[cfg(feature = "full")]
pub mod bench_report;
pub mod bias;
#[cfg(feature = "full")]
pub mod bridge;
#[cfg(feature = "full")]
pub mod calibrate;
#[cfg(feature = "full")]
pub mod chart;
#[cfg(feature = "full")]
pub mod completions;
pub mod demo;
pub mod dfu;
pub mod export;
pub mod info;
#[cfg(feature = "full")]
pub mod man;
pub mod ports;
pub mod record;
pub mod replay;
pub mod self_test;
pub mod serve;
pub mod set;
pub mod simulate;
pub mod udev;
pub mod view;

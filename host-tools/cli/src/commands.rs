//! Commands, one file each.

pub mod bias;
pub mod bridge;
pub mod calibrate;
pub mod chart;
pub mod completions;
pub mod demo;
pub mod dfu;
pub mod export;
pub mod info;
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

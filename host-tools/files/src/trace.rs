//! Trace CSV: ADC codes, one line a scan, with the truth in extra columns where it is known.
//!
//! The header is required; columns may stand in any order; a sensor that is not there has no columns. A
//! line sensor has those of row 0 alone: its other rows have no LEDs, so that a scan finds the dark there.
//! Codes are 12 bits unless a first line `# full_scale=65535` says otherwise.

mod read;
mod write;

pub use read::{Channels, TraceReader, cut, is_trace};
pub use write::{TraceHeader, TraceWriter};

use taxel::scan::{COLS, SENSORS, Scan};

/// What really happened, where it is known. NaN never stands for "unknown": absence does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Force on the finger in newtons, z into the skin.
    pub force: [Option<f64>; 3],
    /// Contact point in millimetres.
    pub point: [Option<f64>; 2],
    /// Torsion about the contact normal in newton millimetres.
    pub torsion: Option<f64>,
    /// Something touches the finger.
    pub contact: Option<bool>,
    /// It slips.
    pub slip: Option<bool>,
    /// Force on each MEMS sensor in newtons.
    pub sensors: [[Option<f64>; 3]; SENSORS],
}

/// One line of a trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The codes.
    pub scan: Scan,
    /// The truth.
    pub truth: Truth,
}

/// Names of the truth columns of the finger, in the order they are written.
pub const TRUTH_COLUMNS: [&str; 8] =
    ["fx_n", "fy_n", "fz_n", "x_mm", "y_mm", "torsion_nmm", "contact", "slip"];

/// `lit_r0c0` … `lit_r3c3`, as many rows as there are, then `dark_c0` … `dark_c3`.
pub(crate) fn taxel_names(rows: usize) -> Vec<String> {
    let lit = (0..rows).flat_map(|r| (0..COLS).map(move |c| format!("lit_r{r}c{c}")));
    lit.chain((0..COLS).map(|c| format!("dark_c{c}"))).collect()
}

/// True for the name of a column of codes.
#[must_use]
pub fn is_code(name: &str) -> bool {
    ["lit_r", "dark_c", "bridge_s", "aux_"].iter().any(|prefix| name.starts_with(prefix))
}

pub(crate) fn bridge_names(sensor: usize) -> Vec<String> {
    ["a", "b", "c", "d"].iter().map(|arm| format!("bridge_s{sensor}_{arm}")).collect()
}

/// `s0_fx_n`, `s0_fy_n`, `s0_fz_n`: the same names in traces (truth) and frames (estimate).
pub fn sensor_truth_names(sensor: usize) -> [String; 3] {
    ["x", "y", "z"].map(|axis| format!("s{sensor}_f{axis}_n"))
}

//! Traces: CSV files of ADC codes, a line for each scan, with optional columns of truth.
//!
//! The header is required and its columns may come in any order. A missing sensor has no columns. A
//! line sensor has only the columns of row 0: its other rows have no LEDs, so their codes are the
//! dark codes. Codes have 12 bits unless the first line is a comment such as `# full_scale=65535`.
//! A simulated trace says so in a comment, `# simulated=press; ideal finger; seed 1`.

mod read;
mod write;

pub use read::{Channels, Others, TraceReader, cut, is_trace, other_columns, simulated};
pub use write::{TraceHeader, TraceWriter};

use taxel::scan::{COLS, SENSORS, Scan};

/// Key of the comment line that says how a trace was simulated, and of that fact of its frames.
pub(crate) const SIMULATED_KEY: &str = "simulated";

/// Truth of a sample where it is known; an unknown value is `None`, never NaN.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Force on the finger in newtons, z into the skin.
    pub force: [Option<f64>; 3],
    /// Contact point in millimetres.
    pub point: [Option<f64>; 2],
    /// Standard deviation of the contact point in millimetres, if it was estimated; never in files.
    pub point_sigma: Option<f64>,
    /// Torsion about the contact normal in newton millimetres.
    pub torsion: Option<f64>,
    /// True in contact.
    pub contact: Option<bool>,
    /// True in gross slip.
    pub slip: Option<bool>,
    /// Force on each MEMS sensor in newtons.
    pub sensors: [[Option<f64>; 3]; SENSORS],
}

/// Scan of a trace with its truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Codes of the scan.
    pub scan: Scan,
    /// Truth of the scan.
    pub truth: Truth,
}

/// Names of the finger's truth columns, in the order of writing.
pub const TRUTH_COLUMNS: [&str; 8] =
    ["fx_n", "fy_n", "fz_n", "x_mm", "y_mm", "torsion_nmm", "contact", "slip"];

/// Lists `lit_r0c0` … `lit_r3c3` for `rows` rows, then `dark_c0` … `dark_c3`.
pub(crate) fn taxel_names(rows: usize) -> Vec<String> {
    let lit = (0..rows).flat_map(|r| (0..COLS).map(move |c| format!("lit_r{r}c{c}")));
    lit.chain((0..COLS).map(|c| format!("dark_c{c}"))).collect()
}

/// Returns whether a column holds codes.
#[must_use]
pub fn is_code(name: &str) -> bool {
    ["lit_r", "dark_c", "bridge_s", "aux_"].iter().any(|prefix| name.starts_with(prefix))
}

pub(crate) fn bridge_names(sensor: usize) -> Vec<String> {
    ["a", "b", "c", "d"].iter().map(|arm| format!("bridge_s{sensor}_{arm}")).collect()
}

/// Lists `s0_fx_n`, `s0_fy_n`, `s0_fz_n`: truth in traces, estimates in frames.
pub fn sensor_truth_names(sensor: usize) -> [String; 3] {
    ["x", "y", "z"].map(|axis| format!("s{sensor}_f{axis}_n"))
}

//! One frame of ADC codes, as the timer-driven scan delivers it, and where its channels sit.
//!
//! A frame is five steps: every LED off (dark), then row 0 … row 3 lit. The four columns are read at
//! each step; the bridge midpoints ride along behind a multiplexer, one sensor a row.

use serde::{Deserialize, Serialize};

use crate::units::{Code, FullScale, Micros, Millimetres};

/// Rows of the taxel matrix (y), each with its own LED driver.
pub const ROWS: usize = 4;
/// Columns of the taxel matrix (x), each with its own ADC input.
pub const COLS: usize = 4;
/// Taxels in row-major order: taxel k sits at row k / 4, column k % 4.
pub const TAXELS: usize = ROWS * COLS;
/// Most three-axis force sensors one finger carries.
pub const SENSORS: usize = 4;

/// Taxel spacing of the 4×4 finger.
pub const PITCH: Millimetres = Millimetres(2.5);

/// Centres of the columns along x, and of the rows along y: the matrix is square, and centred.
pub const CENTRES: [Millimetres; COLS] = [centre(0), centre(1), centre(2), centre(3)];

const fn centre(i: usize) -> Millimetres {
    Millimetres((i as f32 - 1.5) * PITCH.0)
}

/// Centre of each taxel in the finger's frame: x to the right along a row, y along the columns, the
/// origin in the middle of the matrix.
#[expect(clippy::indexing_slicing, reason = "evaluated at compile time")]
pub const TAXEL_CENTRES: [[Millimetres; 2]; TAXELS] = {
    let mut centres = [[Millimetres(0.0); 2]; TAXELS];
    let mut k = 0;
    while k < TAXELS {
        centres[k] = [centre(k % COLS), centre(k / COLS)];
        k += 1;
    }
    centres
};

/// How a board scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ScanSettings {
    /// Scans a second.
    pub scan_hz: u16,
    /// Samples added up for one reading; a power of two.
    pub oversampling: u16,
    /// From the change of row to the first sample of a column, in nanoseconds.
    pub settle_ns: u32,
}

/// One of [`ScanSettings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ScanSetting {
    /// 0: `scan_hz`.
    ScanHz,
    /// 1: `oversampling`.
    Oversampling,
    /// 2: `settle_ns`.
    SettleNs,
}

/// Phototransistor codes of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TaxelCodes {
    /// `lit[row][column]`: the column's reading while that row's LEDs are on.
    pub lit: [[Code; COLS]; ROWS],
    /// The column's reading with every LED off: ambient light and leakage.
    pub dark: [Code; COLS],
}

/// The midpoint voltages of one sensor's two half-bridge pairs (Ospina Triviño 2017, fig. 1.7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Midpoints {
    /// V_A.
    pub a: Code,
    /// V_B.
    pub b: Code,
    /// V_C.
    pub c: Code,
    /// V_D.
    pub d: Code,
}

/// Every code of one frame. A channel that the finger does not have is `None`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Codes {
    /// What all these codes are fractions of.
    pub full_scale: FullScale,
    /// The optical matrix.
    pub taxels: Option<TaxelCodes>,
    /// The force sensors' bridges.
    pub bridges: [Option<Midpoints>; SENSORS],
    /// The reference channel.
    pub reference: Option<Code>,
    /// The temperature channel.
    pub temperature: Option<Code>,
}

/// One frame of the scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Scan {
    /// When the dark step began.
    pub time: Micros,
    /// Scans that were lost between the previous one and this.
    pub lost: u32,
    /// What was read.
    pub codes: Codes,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_is_y_and_column_is_x_and_the_matrix_is_centred() {
        assert_eq!(TAXEL_CENTRES[0], [Millimetres(-3.75), Millimetres(-3.75)]);
        assert_eq!(TAXEL_CENTRES[1], [Millimetres(-1.25), Millimetres(-3.75)]);
        assert_eq!(TAXEL_CENTRES[4], [Millimetres(-3.75), Millimetres(-1.25)]);
        let sum = TAXEL_CENTRES.iter().fold([0.0, 0.0], |s, c| [s[0] + c[0].0, s[1] + c[1].0]);
        assert_eq!(sum, [0.0, 0.0]);
    }
}

//! ADC codes of one scan, and the geometry of its channels.
//!
//! A scan has five steps: every LED off (dark), then row 0 … row 3 lit. Each step reads the four
//! columns. A multiplexer adds the bridge midpoints, one sensor per row.

use serde::{Deserialize, Serialize};

use crate::units::{Code, FullScale, Micros, Millimetres};

/// Rows of the taxel matrix (y), each with its own LED driver.
pub const ROWS: usize = 4;
/// Columns of the taxel matrix (x), each with its own ADC input.
pub const COLS: usize = 4;
/// Taxels in row-major order: taxel k sits at row k / 4, column k % 4.
pub const TAXELS: usize = ROWS * COLS;
/// Largest number of three-axis force sensors in a finger.
pub const SENSORS: usize = 4;

/// Taxel spacing of the 4×4 finger, in millimetres.
pub const PITCH: Millimetres = Millimetres(2.5);

/// Centres of the columns along x, and of the rows along y. The matrix is square and centred.
pub const CENTRES: [Millimetres; COLS] = [centre(0), centre(1), centre(2), centre(3)];

const fn centre(i: usize) -> Millimetres {
    Millimetres((i as f32 - 1.5) * PITCH.0)
}

/// Centre of each taxel: x to the right along a row, y along the columns. The origin is the middle
/// of the matrix.
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

/// Settings of a board's scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ScanSettings {
    /// Scans a second.
    pub scan_hz: u16,
    /// Samples summed for one reading; a power of two.
    pub oversampling: u16,
    /// Time from the change of row to the first sample of a column, in nanoseconds.
    pub settle_ns: u32,
}

/// Name of one of the [`ScanSettings`].
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

/// Phototransistor codes of one scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TaxelCodes {
    /// Reading of each column while the row's LEDs are on: `lit[row][column]`.
    pub lit: [[Code; COLS]; ROWS],
    /// Reading of each column with every LED off: ambient light and leakage.
    pub dark: [Code; COLS],
}

impl TaxelCodes {
    /// Makes the codes those of a scan with the LEDs of `row` on in every step.
    ///
    /// For boards that are simulated: each step has the same reading, noise included.
    pub fn hold(&mut self, row: u8) {
        if let Some(lit) = self.lit.get(usize::from(row)).copied() {
            *self = Self { lit: [lit; ROWS], dark: lit };
        }
    }
}

/// Midpoint codes of one sensor's two half-bridge pairs ([Ospina2017] fig. 1.7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Midpoints {
    /// Midpoint A, V_A.
    pub a: Code,
    /// Midpoint B, V_B.
    pub b: Code,
    /// Midpoint C, V_C.
    pub c: Code,
    /// Midpoint D, V_D.
    pub d: Code,
}

/// All codes of one scan; `None` for channels that the finger does not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Codes {
    /// Full scale of all codes.
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

/// One scan with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Scan {
    /// Start of the dark step.
    pub time: Micros,
    /// Number of scans lost between the previous one and this.
    pub lost: u32,
    /// Codes of all channels.
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

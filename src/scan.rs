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

impl Midpoints {
    /// Codes of A to D.
    #[inline(always)]
    pub(crate) fn codes(&self) -> [Code; 4] {
        [self.a, self.b, self.c, self.d]
    }
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

impl Codes {
    /// Returns the codes of a converter with another full scale at the same voltages, each rounded
    /// to the nearest.
    #[must_use]
    pub fn rescaled(mut self, full_scale: FullScale) -> Self {
        let [old, new] = [self.full_scale, full_scale].map(|scale| u64::from(scale.top().0));
        let rescale = |code: &mut Code| {
            let rounded = (u64::from(code.0) * new + old / 2) / old.max(1);
            code.0 = rounded.min(new) as u16;
        };
        if let Some(TaxelCodes { lit, dark }) = &mut self.taxels {
            lit.as_flattened_mut().iter_mut().chain(dark).for_each(rescale);
        }
        for Midpoints { a, b, c, d } in self.bridges.iter_mut().flatten() {
            [a, b, c, d].into_iter().for_each(rescale);
        }
        self.reference.iter_mut().chain(&mut self.temperature).for_each(rescale);
        Self { full_scale, ..self }
    }
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

    #[test]
    fn rescaled_codes_are_rounded_to_the_nearest() {
        let code = Some(Code(40_000));
        let taxels = TaxelCodes { lit: [[Code(65_535); COLS]; ROWS], dark: [Code(7); COLS] };
        let midpoints = Midpoints { a: Code(0), b: Code(8), c: Code(9), d: Code(24) };
        let codes = Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(taxels),
            bridges: [Some(midpoints), None, None, None],
            reference: code,
            temperature: code,
        };
        let rescaled = codes.rescaled(FullScale::BITS_12);
        assert_eq!(rescaled.full_scale, FullScale::BITS_12);
        let taxels = rescaled.taxels.unwrap();
        assert_eq!((taxels.lit[3][3], taxels.dark[0]), (Code(4095), Code(0)));
        // 8 / 16.004 is just below a half, 9 above.
        let Midpoints { a, b, c, d } = rescaled.bridges[0].unwrap();
        assert_eq!([a, b, c, d], [Code(0), Code(0), Code(1), Code(1)]);
        assert_eq!(
            (rescaled.reference, rescaled.temperature),
            (Some(Code(2499)), Some(Code(2499)))
        );
        // No rounding where each code has its own: a sum of eight conversions.
        let eight = FullScale::new(8 * 4095).unwrap();
        assert_eq!(rescaled.rescaled(eight).rescaled(FullScale::BITS_12), rescaled);
    }
}

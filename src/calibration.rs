//! The calibration record: what a finger must know to turn its signals into newtons.
//!
//! As bytes (flash, upload): version `u16` LE, the record in postcard, CRC-32/ISO-HDLC `u32` LE over all
//! before it. [`Calibration::from_bytes`] validates field by field, so that no accepted record can make
//! an estimator divide by zero, overflow or index past its weights.

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::condition::{Bias, BridgeBias, TaxelBias};
use crate::estimate::net::ForceNet;
use crate::estimate::sensitivity::Sensitivity;
use crate::scan::{SENSORS, TAXELS};
use crate::wire::crc32;

/// Version of the record this firmware reads and writes.
pub const VERSION: u16 = 1;
/// No record in bytes is longer: the largest net, every sensor, the longest serial number.
pub const MAX_BYTES: usize = 3584;

/// Numbers beyond this are no calibration of a fingertip; it keeps every product finite.
const HUGE: f32 = 1e30;

/// Lowest and highest signal seen in training, margin included.
pub type Range = [f32; 2];

/// One finger's calibration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Serial number of the finger this belongs to; empty if unknown.
    pub serial: String<32>,
    /// When it was made, seconds since 1970-01-01 UTC.
    pub date: u64,
    /// The optical matrix.
    pub taxels: Option<TaxelCalibration>,
    /// The force sensors.
    pub sensors: [Option<SensorCalibration>; SENSORS],
}

/// Calibration of the 4×4 optical matrix.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaxelCalibration {
    /// Levels and noise of the unloaded finger.
    pub bias: TaxelBias,
    /// Signal range of each taxel in training.
    pub range: [Range; TAXELS],
    /// Signals to forces, if fitted.
    pub net: Option<ForceNet>,
    /// RMS error of the fit in newtons per force component of the net (only the first for f_z alone).
    pub residual: [f32; 3],
}

/// Calibration of one three-axis force sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorCalibration {
    /// b and its noise.
    pub bias: BridgeBias,
    /// S.
    pub sensitivity: Sensitivity,
    /// Signal range of u_x, u_y, u_z in training.
    pub range: [Range; 3],
    /// RMS error of the fit in newtons: x, y, z.
    pub residual: [f32; 3],
}

/// Why bytes are not a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CalibrationError {
    /// 0: shorter than version and CRC, or longer than any record.
    Length,
    /// 1: the CRC does not match: damaged in storage or on the way.
    Crc,
    /// 2: made for another version of the record.
    Version {
        /// What the bytes say.
        found: u16,
    },
    /// 3: the CRC is right but the fields are not those of this version.
    Malformed,
    /// 4: a field's value makes no sense.
    Field(Field),
}

/// The field that was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Field {
    /// 0: a level must be a fraction of full scale in [−2, 2].
    TaxelBias,
    /// 1: the noise must be positive and below 1.
    TaxelNoise,
    /// 2: each range must have low < high, both finite.
    TaxelRange,
    /// 3: hidden × 16 finite weights and at most 32 units, at least one unless there is a skip path.
    NetHidden,
    /// 4: outputs × hidden finite weights, one or three outputs.
    NetOutput,
    /// 5: residuals must be finite and not negative.
    TaxelResidual,
    /// 6: a level of sensor `.0`.
    SensorBias(u8),
    /// 7: the noise of sensor `.0`.
    SensorNoise(u8),
    /// 8: the matrix of sensor `.0` must be finite.
    Sensitivity(u8),
    /// 9: a range of sensor `.0`.
    SensorRange(u8),
    /// 10: a residual of sensor `.0`.
    SensorResidual(u8),
    /// 11: outputs × 16 finite weights of the skip path, or none.
    NetSkip,
}

impl Calibration {
    /// The bias that the finger starts with.
    #[must_use]
    pub fn bias(&self) -> Bias {
        Bias {
            taxels: self.taxels.as_ref().map(|taxels| taxels.bias),
            bridges: self.sensors.each_ref().map(|s| s.as_ref().map(|sensor| sensor.bias)),
        }
    }

    /// Every field makes sense.
    ///
    /// # Errors
    /// The first field that does not.
    pub fn validate(&self) -> Result<(), Field> {
        if let Some(taxels) = &self.taxels {
            require(levels_fit(&taxels.bias.level), Field::TaxelBias)?;
            require(noise_fits(taxels.bias.noise), Field::TaxelNoise)?;
            require(ranges_fit(&taxels.range), Field::TaxelRange)?;
            require(residuals_fit(&taxels.residual), Field::TaxelResidual)?;
            if let Some(net) = &taxels.net {
                require(net.hidden_layer_fits(), Field::NetHidden)?;
                require(net.output_layer_fits(), Field::NetOutput)?;
                require(net.skip_fits(), Field::NetSkip)?;
            }
        }
        for (i, sensor) in (0u8..).zip(&self.sensors) {
            let Some(sensor) = sensor else { continue };
            require(levels_fit(&sensor.bias.level), Field::SensorBias(i))?;
            require(noise_fits(sensor.bias.noise), Field::SensorNoise(i))?;
            let weights = sensor.sensitivity.0.as_flattened();
            require(weights.iter().all(|w| w.abs() < HUGE), Field::Sensitivity(i))?;
            require(ranges_fit(&sensor.range), Field::SensorRange(i))?;
            require(residuals_fit(&sensor.residual), Field::SensorResidual(i))?;
        }
        Ok(())
    }

    /// The record as bytes, in `buffer`; [`MAX_BYTES`] always suffice.
    ///
    /// # Errors
    /// [`CalibrationError::Field`] for a record that would not be accepted back,
    /// [`CalibrationError::Length`] when `buffer` is too short.
    pub fn to_bytes<'b>(&self, buffer: &'b mut [u8]) -> Result<&'b [u8], CalibrationError> {
        self.validate().map_err(CalibrationError::Field)?;
        let (version, rest) =
            buffer.split_first_chunk_mut::<2>().ok_or(CalibrationError::Length)?;
        *version = VERSION.to_le_bytes();
        let record = postcard::to_slice(self, rest).map_err(|_| CalibrationError::Length)?.len();
        let body = buffer.get(..2 + record).ok_or(CalibrationError::Length)?;
        let crc = crc32(body).to_le_bytes();
        buffer
            .get_mut(2 + record..2 + record + 4)
            .ok_or(CalibrationError::Length)?
            .copy_from_slice(&crc);
        buffer.get(..2 + record + 4).ok_or(CalibrationError::Length)
    }

    /// Reads a record and validates every field.
    ///
    /// # Errors
    /// The first thing that is wrong, in the order length, CRC, version, shape, fields.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CalibrationError> {
        if bytes.len() > MAX_BYTES {
            return Err(CalibrationError::Length);
        }
        let (body, crc) = bytes.split_last_chunk::<4>().ok_or(CalibrationError::Length)?;
        let (version, record) = body.split_first_chunk::<2>().ok_or(CalibrationError::Length)?;
        if crc32(body) != u32::from_le_bytes(*crc) {
            return Err(CalibrationError::Crc);
        }
        let found = u16::from_le_bytes(*version);
        if found != VERSION {
            return Err(CalibrationError::Version { found });
        }
        let (calibration, rest) =
            postcard::take_from_bytes::<Self>(record).map_err(|_| CalibrationError::Malformed)?;
        if !rest.is_empty() {
            return Err(CalibrationError::Malformed);
        }
        calibration.validate().map_err(CalibrationError::Field)?;
        Ok(calibration)
    }
}

fn require(holds: bool, field: Field) -> Result<(), Field> {
    if holds { Ok(()) } else { Err(field) }
}

// Comparisons with a NaN are false, so each of these refuses NaN without naming it.

fn levels_fit(levels: &[f32]) -> bool {
    levels.iter().all(|level| level.abs() <= 2.0)
}

fn noise_fits(noise: f32) -> bool {
    (1e-9..1.0).contains(&noise)
}

fn ranges_fit(ranges: &[Range]) -> bool {
    ranges.iter().all(|[low, high]| low < high && low.abs() < HUGE && high.abs() < HUGE)
}

fn residuals_fit(residuals: &[f32]) -> bool {
    residuals.iter().all(|residual| (0.0..HUGE).contains(residual))
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn largest() -> Calibration {
        let bias = TaxelBias { level: [0.3; TAXELS], noise: 1e-4 };
        let net = ForceNet {
            hidden: core::iter::repeat_n(0.5, 32 * 16).collect(),
            hidden_bias: core::iter::repeat_n(0.1, 32).collect(),
            output: core::iter::repeat_n(0.25, 3 * 32).collect(),
            skip: core::iter::repeat_n(0.125, 3 * 16).collect(),
            output_bias: core::iter::repeat_n(0.0, 3).collect(),
        };
        let sensor = SensorCalibration {
            bias: BridgeBias { level: [0.01; 3], noise: 1e-4 },
            sensitivity: Sensitivity([[1.0; 3]; 3]),
            range: [[-0.1, 0.1]; 3],
            residual: [0.001; 3],
        };
        Calibration {
            serial: String::try_from("0123456789abcdef0123456789abcdef").unwrap(),
            date: u64::MAX,
            taxels: Some(TaxelCalibration {
                bias,
                range: [[-0.5, 0.1]; TAXELS],
                net: Some(net),
                residual: [0.01; 3],
            }),
            sensors: core::array::from_fn(|_| Some(sensor.clone())),
        }
    }

    #[test]
    fn the_largest_record_fits_and_comes_back_the_same() {
        let mut buffer = [0; MAX_BYTES];
        let bytes = largest().to_bytes(&mut buffer).unwrap();
        assert_eq!(Calibration::from_bytes(bytes), Ok(largest()));
    }

    #[test]
    fn a_single_flipped_bit_is_noticed_wherever_it_is() {
        let mut buffer = [0; MAX_BYTES];
        let length = largest().to_bytes(&mut buffer).unwrap().len();
        for bit in 0..length * 8 {
            buffer[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Calibration::from_bytes(&buffer[..length]), Err(CalibrationError::Crc));
            buffer[bit / 8] ^= 1 << (bit % 8);
        }
    }

    #[test]
    fn another_version_is_named() {
        let mut buffer = [0; MAX_BYTES];
        let length = largest().to_bytes(&mut buffer).unwrap().len();
        buffer[0] = 9;
        let crc = crc32(&buffer[..length - 4]).to_le_bytes();
        buffer[length - 4..length].copy_from_slice(&crc);
        assert_eq!(
            Calibration::from_bytes(&buffer[..length]),
            Err(CalibrationError::Version { found: 9 })
        );
    }

    #[test]
    fn every_senseless_field_is_refused_by_name() {
        let refused = |change: fn(&mut Calibration)| {
            let mut record = largest();
            change(&mut record);
            record.validate().unwrap_err()
        };
        assert_eq!(
            refused(|r| r.taxels.as_mut().unwrap().bias.level[3] = f32::NAN),
            Field::TaxelBias
        );
        assert_eq!(refused(|r| r.taxels.as_mut().unwrap().bias.noise = 0.0), Field::TaxelNoise);
        assert_eq!(
            refused(|r| r.taxels.as_mut().unwrap().range[0] = [1.0, 1.0]),
            Field::TaxelRange
        );
        assert_eq!(
            refused(|r| r.taxels.as_mut().unwrap().residual[1] = f32::INFINITY),
            Field::TaxelResidual
        );
        assert_eq!(
            refused(|r| {
                r.taxels.as_mut().unwrap().net.as_mut().unwrap().hidden.pop();
            }),
            Field::NetHidden
        );
        assert_eq!(
            refused(|r| {
                r.taxels.as_mut().unwrap().net.as_mut().unwrap().output_bias.pop();
            }),
            Field::NetOutput
        );
        assert_eq!(
            refused(|r| {
                r.taxels.as_mut().unwrap().net.as_mut().unwrap().skip.pop();
            }),
            Field::NetSkip
        );
        assert_eq!(
            refused(|r| {
                let net = r.taxels.as_mut().unwrap().net.as_mut().unwrap();
                net.hidden.clear();
                net.hidden_bias.clear();
                net.output.clear();
                net.skip.clear();
            }),
            Field::NetHidden
        );
        assert_eq!(
            refused(|r| r.sensors[2].as_mut().unwrap().sensitivity.0[1][1] = f32::NAN),
            Field::Sensitivity(2)
        );
        assert_eq!(
            refused(|r| r.sensors[3].as_mut().unwrap().range[0][1] = -9.0),
            Field::SensorRange(3)
        );
        assert_eq!(
            refused(|r| r.sensors[0].as_mut().unwrap().bias.noise = -1.0),
            Field::SensorNoise(0)
        );
        assert_eq!(
            refused(|r| r.sensors[0].as_mut().unwrap().bias.level[0] = 3.0),
            Field::SensorBias(0)
        );
        assert_eq!(
            refused(|r| r.sensors[1].as_mut().unwrap().residual[0] = -1.0),
            Field::SensorResidual(1)
        );
        let mut linear = largest();
        let net = linear.taxels.as_mut().unwrap().net.as_mut().unwrap();
        net.hidden.clear();
        net.hidden_bias.clear();
        net.output.clear();
        assert_eq!(linear.validate(), Ok(()));
        let mut empty = largest();
        empty.taxels = None;
        assert_eq!(empty.validate(), Ok(()));
    }
}

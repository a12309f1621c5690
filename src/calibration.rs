//! Calibration record: the coefficients that turn a finger's signals into newtons.
//!
//! ```text
//! version u16 LE │ serial, date │ section … │ CRC-32/ISO-HDLC u32 LE over all before it
//!                                 └─ number u8 │ length u16 LE │ one estimator, postcard
//! ```
//! Each estimator's coefficients are a section of their own, so that a record holds only the fitted
//! sections. The version of a record is that of its newest section: firmware reads records of older
//! tools and refuses newer versions.
//!
//! [`Calibration::read`] checks every field. No accepted record can make an estimator divide by
//! zero, overflow or index past its weights. The record is read in place, because a moved
//! calibration is copied over a small stack several times.
//!
//! **To add a section**: the struct with its estimator in [`crate::estimate`], its fields in
//! [`sections`], and one line in the list of `sections!` here.

mod rehearsal;
mod section;
mod sections;

use core::fmt;

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::condition::{
    Bias, BridgeBias, DriftCompensation, LagCompensation, TaxelBias, TemperatureCompensation,
};
use crate::crc32::crc32;
use crate::estimate::array::Array;
use crate::estimate::inverse::Inverse;
use crate::estimate::quantised::Net;
use crate::estimate::sensitivity::Sensitivity;
use crate::estimate::slip::Slip;
use crate::scan::{SENSORS, TAXELS};

use section::{Entry, entry};
pub use sections::bias_fits;

/// Newest version of the record that this firmware reads.
pub const VERSION: u16 = 2;
/// First version with sections. Nothing was released before it.
const OLDEST: u16 = 2;
/// Longest record in bytes, the size of a slot's content. Such a record holds a net of 24 units and
/// everything else, or of 32 units without a skin model.
pub const MAX_BYTES: usize = 4080;

/// Lowest and highest signal seen in training, margin included.
pub type Range = [f32; 2];

/// Makes [`Calibration`] and all that depends on its sections from one list. A line has the
/// section's number, the version of the record that introduced it, its name and its coefficients.
///
/// A `cfg` removes a section from builds without its estimator; they skip it when they read a
/// record.
macro_rules! sections {
    ($(
        $(#[doc = $doc:literal])+
        $(#[cfg($built:meta)])?
        $number:literal since $since:literal: $name:ident: $coefficients:ty;
    )+) => {
        /// One finger's calibration.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Calibration {
            /// Serial number of the calibrated finger; empty if unknown.
            pub serial: String<32>,
            /// Date in seconds since 1970-01-01 UTC.
            pub date: u64,
            $($(#[doc = $doc])+ $(#[cfg($built)])? pub $name: Option<$coefficients>,)+
            /// Net from taxel signals to forces: section 2 in f32, or section 5 in 16 bits. A
            /// record with both has it in f32.
            pub net: Option<Net>,
            /// The force sensors: sections 16 to 19.
            pub sensors: [Option<SensorCalibration>; SENSORS],
        }

        /// Every section that this build reads.
        const SECTIONS: &[Entry] = &[
            entry(section::FLOAT, 2, "force", |c| &c.net, |c| &mut c.net),
            #[cfg(feature = "quantised")]
            entry(section::QUANTISED, 2, "quantised", |c| &c.net, |c| &mut c.net),
            $(
                $(#[cfg($built)])?
                entry($number, $since, stringify!($name), |c| &c.$name, |c| &mut c.$name),
            )+
            entry(16, 2, "s0", |c| &c.sensors[0], |c| &mut c.sensors[0]),
            entry(17, 2, "s1", |c| &c.sensors[1], |c| &mut c.sensors[1]),
            entry(18, 2, "s2", |c| &c.sensors[2], |c| &mut c.sensors[2]),
            entry(19, 2, "s3", |c| &c.sensors[3], |c| &mut c.sensors[3]),
        ];

        /// Numbers of the sections that this build skips.
        const NOT_BUILT: &[u8] = &[
            $(#[cfg(not(all($($built)?)))] $number,)+
            #[cfg(not(feature = "quantised"))]
            section::QUANTISED,
        ];

        impl Calibration {
            /// A calibration without any section.
            pub const EMPTY: Self = Self {
                serial: String::new(),
                date: 0,
                $($(#[cfg($built)])? $name: None,)+
                net: None,
                sensors: [const { None }; SENSORS],
            };

            $(
                /// Returns the section if it is present and this build has its estimator.
                pub(crate) fn $name(&self) -> Option<&$coefficients> {
                    #[cfg(all($($built)?))]
                    return self.$name.as_ref();
                    #[cfg(not(all($($built)?)))]
                    return None;
                }
            )+

            /// Writes a present section and returns its length; `None` if it is absent or too long.
            /// The function is separate from [`SECTIONS`] to keep its code out of firmware, which
            /// only reads records.
            fn write_section(&self, number: u8, buffer: &mut [u8]) -> Option<usize> {
                match number {
                    $($(#[cfg($built)])? $number => section::write(self.$name.as_ref()?, buffer),)+
                    section::FLOAT => section::write(self.net.as_ref()?.float()?, buffer),
                    #[cfg(feature = "quantised")]
                    section::QUANTISED => section::write(self.net.as_ref()?.quantised()?, buffer),
                    16.. => section::write(self.sensors.get(usize::from(number - 16))?.as_ref()?, buffer),
                    _ => None,
                }
            }
        }
    };
}

sections! {
    /// Bias, range and residual of the optical matrix.
    1 since 2: taxels: TaxelCalibration;
    /// Skin model: displacements of a contact, and signals to displacements.
    #[cfg(feature = "model")]
    3 since 2: model: Inverse;
    /// Friction and limit surface of a contact.
    #[cfg(feature = "slip")]
    4 since 2: slip: Slip;
    /// Effect of temperature on the channels.
    #[cfg(feature = "warmth")]
    6 since 2: warmth: TemperatureCompensation;
    /// Lag of skin and force sensors.
    #[cfg(feature = "lag")]
    7 since 2: lag: LagCompensation;
    /// Drift of the light.
    #[cfg(feature = "drift")]
    8 since 2: drift: DriftCompensation;
    /// Force sensors together as one six-axis sensor.
    #[cfg(feature = "array")]
    20 since 2: array: Array;
}

/// Calibration of the 4×4 optical matrix.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TaxelCalibration {
    /// Levels and noise of the unloaded finger.
    pub bias: TaxelBias,
    /// Signal range of each taxel in training.
    pub range: [Range; TAXELS],
    /// RMS error in newtons, per force component of the net: on rows left out of the fit, of a net
    /// alone that of the fit. A net with f_z alone uses the first.
    pub residual: [f32; 3],
}

/// Calibration of one three-axis force sensor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorCalibration {
    /// Offsets b and their noise.
    pub bias: BridgeBias,
    /// Sensitivity matrix S.
    pub sensitivity: Sensitivity,
    /// Signal range of u_x, u_y, u_z in training.
    pub range: [Range; 3],
    /// RMS error of the fit in newtons: x, y, z.
    pub residual: [f32; 3],
}

/// Reasons for rejecting a calibration record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CalibrationError {
    /// 0: shorter than version and CRC, or longer than any record.
    Length,
    /// 1: the CRC does not match; the record was damaged in storage or in transmission.
    Crc,
    /// 2: another version of the record, which this firmware cannot read.
    Version {
        /// Version in the record.
        found: u16,
    },
    /// 3: the CRC is right, but a section is unknown, out of order or of wrong length.
    Malformed,
    /// 4: a field's value is out of range; [`names`] returns its name.
    Field {
        /// Number of the section.
        section: u8,
        /// Index of the field in its section, from 0.
        field: u8,
    },
    /// 5: a section needs the taxels' signals, but the section of the taxels is missing.
    WithoutTaxels {
        /// Number of the section.
        section: u8,
    },
    /// 6: [`Calibration::rehearse`] fails.
    Rehearsal {
        /// 2 if the net gives a force without a contact; 1 or 16 if the noise of the matrix or of
        /// the sensors hides contacts.
        section: u8,
    },
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Length => write!(f, "wrong length: a calibration has 6 to {MAX_BYTES} bytes"),
            Self::Crc => f.write_str("the calibration is damaged (its CRC does not match)"),
            Self::Version { found } => {
                write!(f, "the calibration has version {found}, this build reads up to {VERSION}")
            }
            Self::Malformed => f.write_str(
                "the calibration has a section that is unknown, out of order or of wrong length",
            ),
            Self::Field { section, field } => match names(section, field) {
                Some((section, field)) => write!(f, "{field} of {section} is out of range"),
                None => write!(f, "field {field} of section {section} is out of range"),
            },
            Self::WithoutTaxels { section } => {
                let name = names(section, 0).map_or("a section", |(name, _)| name);
                write!(f, "{name} needs the calibration of the taxels, which is missing")
            }
            Self::Rehearsal { section: section::FLOAT } => {
                f.write_str("the net gives 1 N or more without a contact; fit it again")
            }
            Self::Rehearsal { section } => {
                let part = if section == section::TAXELS { "matrix" } else { "force sensors" };
                write!(
                    f,
                    "the noise of the {part} hides every contact of less than 1 N; fit again with a still finger"
                )
            }
        }
    }
}

impl core::error::Error for CalibrationError {}

/// Returns the names of a section and of its field, as in files and messages.
#[must_use]
pub fn names(section: u8, field: u8) -> Option<(&'static str, &'static str)> {
    let entry = SECTIONS.iter().find(|entry| entry.number == section)?;
    Some((entry.name, (entry.get)(&Calibration::EMPTY).field_name(section, field)?))
}

impl Calibration {
    /// Returns the bias that the finger starts with.
    #[must_use]
    pub fn bias(&self) -> Bias {
        Bias {
            taxels: self.taxels().map(|taxels| taxels.bias),
            bridges: self.sensors.each_ref().map(|s| s.as_ref().map(|sensor| sensor.bias)),
        }
    }

    /// Checks every field of every section.
    ///
    /// # Errors
    /// The first field that is out of range, or a section that needs a missing calibration of the
    /// taxels.
    pub fn validate(&self) -> Result<(), CalibrationError> {
        for Entry { number, get, .. } in SECTIONS {
            let section = get(self);
            if let Some(field) = section.wrong_field(*number) {
                return Err(CalibrationError::Field { section: *number, field });
            }
            if section.present(*number) && section.needs_taxels() && self.taxels.is_none() {
                return Err(CalibrationError::WithoutTaxels { section: *number });
            }
        }
        Ok(())
    }

    /// Writes the record into `buffer`; [`MAX_BYTES`] suffice for all that a finger can store.
    ///
    /// # Errors
    /// Those of [`Self::validate`]; [`CalibrationError::Length`] if `buffer` is too short.
    pub fn to_bytes<'b>(&self, buffer: &'b mut [u8]) -> Result<&'b [u8], CalibrationError> {
        self.validate()?;
        let length = self.write(buffer).ok_or(CalibrationError::Length)?;
        buffer.get(..length).ok_or(CalibrationError::Length)
    }

    /// Writes the record and returns its length; `None` if it is too long.
    fn write(&self, buffer: &mut [u8]) -> Option<usize> {
        let present = || SECTIONS.iter().filter(|entry| (entry.get)(self).present(entry.number));
        let version = present().map(|entry| entry.since).max().unwrap_or(OLDEST);
        let (head, rest) = buffer.split_first_chunk_mut::<2>()?;
        *head = version.to_le_bytes();
        let mut end = 2 + postcard::to_slice(&(&self.serial, self.date), rest).ok()?.len();
        let mut last = 0;
        while let Some(entry) =
            present().filter(|entry| entry.number > last).min_by_key(|entry| entry.number)
        {
            last = entry.number;
            let (head, rest) = buffer.get_mut(end..)?.split_first_chunk_mut::<3>()?;
            let length = self.write_section(entry.number, rest)?;
            let [low, high] = u16::try_from(length).ok()?.to_le_bytes();
            *head = [entry.number, low, high];
            end += 3 + length;
        }
        let crc = crc32(buffer.get(..end)?).to_le_bytes();
        *buffer.get_mut(end..)?.first_chunk_mut()? = crc;
        Some(end + crc.len())
    }

    /// Reads a record, checks every field and rehearses it.
    ///
    /// # Errors
    /// Those of [`Self::read`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CalibrationError> {
        let mut calibration = Self::EMPTY;
        calibration.read(bytes)?;
        Ok(calibration)
    }

    /// Replaces the content by the record in `bytes`, in place, checks every field and rehearses.
    ///
    /// # Errors
    /// The first error in the order length, CRC, version, shape, fields, rehearsal. The old content
    /// is lost then; to restore it, read its record again.
    pub fn read(&mut self, bytes: &[u8]) -> Result<(), CalibrationError> {
        let (version, body) = opened(bytes)?;
        self.fill(version, body).ok_or(CalibrationError::Malformed)?;
        self.validate()?;
        self.rehearse()
    }

    fn fill(&mut self, version: u16, body: &[u8]) -> Option<()> {
        SECTIONS.iter().for_each(|entry| (entry.get_mut)(self).clear());
        let ((serial, date), mut rest) = postcard::take_from_bytes(body).ok()?;
        (self.serial, self.date) = (serial, date);
        let mut last = 0;
        while let Some(([number, low, high], tail)) = rest.split_first_chunk::<3>() {
            let length = usize::from(u16::from_le_bytes([*low, *high]));
            let (section, tail) = tail.split_at_checked(length)?;
            // Ascending numbers: no section twice, and only one way to write a record.
            if *number <= last {
                return None;
            }
            last = *number;
            if !NOT_BUILT.contains(number) {
                let known = |entry: &&Entry| entry.number == *number && entry.since <= version;
                let entry = SECTIONS.iter().find(known)?;
                (entry.get_mut)(self).read(*number, section)?;
            }
            rest = tail;
        }
        rest.is_empty().then_some(())
    }
}

/// Returns the version and the bytes between version and CRC.
fn opened(bytes: &[u8]) -> Result<(u16, &[u8]), CalibrationError> {
    if bytes.len() > MAX_BYTES {
        return Err(CalibrationError::Length);
    }
    let (body, crc) = bytes.split_last_chunk::<4>().ok_or(CalibrationError::Length)?;
    let (version, rest) = body.split_first_chunk::<2>().ok_or(CalibrationError::Length)?;
    if crc32(body) != u32::from_le_bytes(*crc) {
        return Err(CalibrationError::Crc);
    }
    match u16::from_le_bytes(*version) {
        version @ OLDEST..=VERSION => Ok((version, rest)),
        found => Err(CalibrationError::Version { found }),
    }
}

#[cfg(test)]
mod tests;

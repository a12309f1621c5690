//! The calibration record: what a finger must know to turn its signals into newtons.
//!
//! ```text
//! version u16 LE │ serial, date │ section … │ CRC-32/ISO-HDLC u32 LE over all before it
//!                                 └─ number u8 │ length u16 LE │ one estimator's coefficients in postcard
//! ```
//! Each estimator's coefficients are a section of their own, so that a record holds what was fitted and
//! nothing else. The version of a record is that of its newest section: firmware reads what older tools
//! wrote, and refuses by its version what it cannot know. [`Calibration::read`] checks every field, so
//! that no accepted record can make an estimator divide by zero, overflow or index past its weights; and
//! it reads in place, because a calibration that is moved crosses a small stack several times.
//!
//! **To add a section**: the struct with its estimator in [`crate::estimate`], its fields in
//! [`sections`], and one line in the list of `sections!` here.

mod section;
mod sections;

use core::fmt;

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::condition::{Bias, BridgeBias, TaxelBias, TemperatureCompensation};
use crate::crc32::crc32;
use crate::estimate::array::Array;
use crate::estimate::inverse::Inverse;
use crate::estimate::net::ForceNet;
use crate::estimate::quantised::{Net, QuantisedNet};
use crate::estimate::sensitivity::Sensitivity;
use crate::estimate::slip::Slip;
use crate::scan::{SENSORS, TAXELS};

use section::{Entry, entry};
pub(crate) use sections::bias_fits;

/// Newest version of the record that this firmware reads.
pub const VERSION: u16 = 2;
/// The first version that had sections. Nothing was released before it.
const OLDEST: u16 = 2;
/// Longest record in bytes: a net of 24 units next to everything else, of 32 without a model of the skin.
/// A slot of the store holds it.
pub const MAX_BYTES: usize = 4080;

/// Lowest and highest signal seen in training, margin included.
pub type Range = [f32; 2];

/// Makes [`Calibration`] and all that depends on its sections from one list: the number of each in a
/// record, the version of the record that brought it, its name, its coefficients.
///
/// A `cfg` takes a section out of builds without its estimator: they pass over it where a record has it.
macro_rules! sections {
    ($(
        $(#[doc = $doc:literal])+
        $(#[cfg($built:meta)])?
        $number:literal since $since:literal: $name:ident: $coefficients:ty;
    )+) => {
        /// One finger's calibration.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Calibration {
            /// Serial number of the finger this belongs to; empty if unknown.
            pub serial: String<32>,
            /// When it was made, seconds since 1970-01-01 UTC.
            pub date: u64,
            $($(#[doc = $doc])+ $(#[cfg($built)])? pub $name: Option<$coefficients>,)+
            /// The force sensors: sections 16 to 19.
            pub sensors: [Option<SensorCalibration>; SENSORS],
        }

        /// Every section that this build reads.
        const SECTIONS: &[Entry] = &[
            $(
                $(#[cfg($built)])?
                entry($number, $since, stringify!($name), |c| &c.$name, |c| &mut c.$name),
            )+
            entry(16, 2, "s0", |c| &c.sensors[0], |c| &mut c.sensors[0]),
            entry(17, 2, "s1", |c| &c.sensors[1], |c| &mut c.sensors[1]),
            entry(18, 2, "s2", |c| &c.sensors[2], |c| &mut c.sensors[2]),
            entry(19, 2, "s3", |c| &c.sensors[3], |c| &mut c.sensors[3]),
        ];

        /// Sections that this build passes over.
        const NOT_BUILT: &[u8] = &[$(#[cfg(not(all($($built)?)))] $number,)+];

        impl Calibration {
            /// Nothing is calibrated.
            pub const EMPTY: Self = Self {
                serial: String::new(),
                date: 0,
                $($(#[cfg($built)])? $name: None,)+
                sensors: [const { None }; SENSORS],
            };

            $(
                /// The section, where this build has its estimator.
                pub(crate) fn $name(&self) -> Option<&$coefficients> {
                    #[cfg(all($($built)?))]
                    return self.$name.as_ref();
                    #[cfg(not(all($($built)?)))]
                    return None;
                }
            )+

            /// Writes a section that is present; how long it has become, or `None` for too long.
            /// Apart from [`SECTIONS`], so that firmware, which only reads records, does not hold it.
            fn write_section(&self, number: u8, buffer: &mut [u8]) -> Option<usize> {
                match number {
                    $($(#[cfg($built)])? $number => section::write(&self.$name, buffer),)+
                    16.. => section::write(self.sensors.get(usize::from(number - 16))?, buffer),
                    _ => None,
                }
            }
        }
    };
}

sections! {
    /// The optical matrix.
    1 since 2: taxels: TaxelCalibration;
    /// Taxel signals to forces.
    2 since 2: force: ForceNet;
    /// The skin: displacements of a touch, and signals to displacements.
    #[cfg(feature = "model")]
    3 since 2: model: Inverse;
    /// Friction and the limit surface of a contact.
    #[cfg(feature = "slip")]
    4 since 2: slip: Slip;
    /// Taxel signals to forces in 16 bits. Where `force` is there too, that one is used.
    #[cfg(feature = "quantised")]
    5 since 2: quantised: QuantisedNet;
    /// Effect of temperature on the channels.
    #[cfg(feature = "warmth")]
    6 since 2: warmth: TemperatureCompensation;
    /// The force sensors as one.
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
    /// RMS error of the fit in newtons per force component of the net (only the first for f_z alone).
    pub residual: [f32; 3],
}

/// Calibration of one three-axis force sensor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// 2: made for another version of the record: it holds what this firmware cannot know.
    Version {
        /// What the bytes say.
        found: u16,
    },
    /// 3: the CRC is right but the sections are not those of this version.
    Malformed,
    /// 4: a field's value makes no sense; [`names`] tells which.
    Field {
        /// Number of the section.
        section: u8,
        /// Which of the section's fields, counted from 0.
        field: u8,
    },
    /// 5: a section that works on the taxels' signals, but no calibration of the taxels.
    WithoutTaxels {
        /// Number of the section.
        section: u8,
    },
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Length => write!(f, "no calibration has this length (at most {MAX_BYTES} bytes)"),
            Self::Crc => f.write_str("the calibration is damaged (its CRC does not match)"),
            Self::Version { found } => {
                write!(f, "the calibration has version {found}, this build reads up to {VERSION}")
            }
            Self::Malformed => {
                f.write_str("the calibration's sections are not those of its version")
            }
            Self::Field { section, field } => match names(section, field) {
                Some((section, field)) => write!(f, "{field} of {section} is out of range"),
                None => write!(f, "field {field} of section {section} is out of range"),
            },
            Self::WithoutTaxels { section } => {
                let name = names(section, 0).map_or("a section", |(name, _)| name);
                write!(f, "{name} needs the calibration of the taxels, which is missing")
            }
        }
    }
}

impl core::error::Error for CalibrationError {}

/// What section and field are called in files and messages.
#[must_use]
pub fn names(section: u8, field: u8) -> Option<(&'static str, &'static str)> {
    let entry = SECTIONS.iter().find(|entry| entry.number == section)?;
    Some((entry.name, (entry.get)(&Calibration::EMPTY).field_name(field)?))
}

impl Calibration {
    /// The net, in f32 where the record has it so.
    #[must_use]
    pub fn net(&self) -> Option<Net<'_>> {
        self.force().map(Net::Float).or(self.quantised().map(Net::Quantised))
    }

    /// The bias that the finger starts with.
    #[must_use]
    pub fn bias(&self) -> Bias {
        Bias {
            taxels: self.taxels().map(|taxels| taxels.bias),
            bridges: self.sensors.each_ref().map(|s| s.as_ref().map(|sensor| sensor.bias)),
        }
    }

    /// Every field makes sense.
    ///
    /// # Errors
    /// The first that does not.
    pub fn validate(&self) -> Result<(), CalibrationError> {
        for Entry { number, get, .. } in SECTIONS {
            let section = get(self);
            if let Some(field) = section.wrong_field() {
                return Err(CalibrationError::Field { section: *number, field });
            }
            if section.present() && section.needs_taxels() && self.taxels.is_none() {
                return Err(CalibrationError::WithoutTaxels { section: *number });
            }
        }
        Ok(())
    }

    /// The record as bytes, in `buffer`; [`MAX_BYTES`] suffice for all that a finger can store.
    ///
    /// # Errors
    /// What [`Self::validate`] says; [`CalibrationError::Length`] when `buffer` is too short.
    pub fn to_bytes<'b>(&self, buffer: &'b mut [u8]) -> Result<&'b [u8], CalibrationError> {
        self.validate()?;
        let length = self.write(buffer).ok_or(CalibrationError::Length)?;
        buffer.get(..length).ok_or(CalibrationError::Length)
    }

    /// How many bytes it took, or `None` for too many.
    fn write(&self, buffer: &mut [u8]) -> Option<usize> {
        let present = || SECTIONS.iter().filter(|entry| (entry.get)(self).present());
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

    /// Reads a record and checks every field.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CalibrationError> {
        let mut calibration = Self::EMPTY;
        calibration.read(bytes)?;
        Ok(calibration)
    }

    /// Becomes the record in `bytes`, section by section in place, every field checked.
    ///
    /// # Errors
    /// The first thing that is wrong, in the order length, CRC, version, shape, fields. What was here
    /// before is gone then; where it is still needed, read it again.
    pub fn read(&mut self, bytes: &[u8]) -> Result<(), CalibrationError> {
        let (version, body) = opened(bytes)?;
        self.fill(version, body).ok_or(CalibrationError::Malformed)?;
        self.validate()
    }

    fn fill(&mut self, version: u16, body: &[u8]) -> Option<()> {
        SECTIONS.iter().for_each(|entry| (entry.get_mut)(self).clear());
        let ((serial, date), mut rest) = postcard::take_from_bytes(body).ok()?;
        (self.serial, self.date) = (serial, date);
        let mut last = 0;
        while let Some(([number, low, high], tail)) = rest.split_first_chunk::<3>() {
            let length = usize::from(u16::from_le_bytes([*low, *high]));
            let (section, tail) = tail.split_at_checked(length)?;
            // In the order of their numbers: none twice, and one way to write a record.
            if *number <= last {
                return None;
            }
            last = *number;
            if !NOT_BUILT.contains(number) {
                let known = |entry: &&Entry| entry.number == *number && entry.since <= version;
                let entry = SECTIONS.iter().find(known)?;
                (entry.get_mut)(self).read(section)?;
            }
            rest = tail;
        }
        rest.is_empty().then_some(())
    }
}

/// The record's version and what stands between it and the CRC.
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

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
//! **To add a section**: the struct with its estimator in [`crate::estimate`], its checks in
//! [`sections`], a field here, and one line in [`SECTIONS`].

mod section;
mod sections;

use core::fmt;

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::condition::{Bias, BridgeBias, TaxelBias, Warmth};
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

/// One finger's calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Serial number of the finger this belongs to; empty if unknown.
    pub serial: String<32>,
    /// When it was made, seconds since 1970-01-01 UTC.
    pub date: u64,
    /// The optical matrix.
    pub taxels: Option<TaxelCalibration>,
    /// Taxel signals to forces.
    pub force: Option<ForceNet>,
    /// The same in 16 bits. Where both are there, the other one is used.
    #[cfg(feature = "quantised")]
    pub quantised: Option<QuantisedNet>,
    /// The skin: displacements of a touch, and signals to displacements.
    pub model: Option<Inverse>,
    /// What a contact holds before it slips.
    pub slip: Option<Slip>,
    /// What warmth does to it.
    pub warmth: Option<Warmth>,
    /// The force sensors.
    pub sensors: [Option<SensorCalibration>; SENSORS],
    /// The force sensors as one.
    pub array: Option<Array>,
}

/// Every section there is, in the order in which they stand in a record: its number, the version of the
/// record that brought it, its name in files and messages, and where it is kept.
const SECTIONS: &[Entry] = &[
    entry(1, 2, "taxels", |c| &c.taxels, |c| &mut c.taxels),
    entry(2, 2, "force", |c| &c.force, |c| &mut c.force),
    #[cfg(feature = "model")]
    entry(3, 2, "model", |c| &c.model, |c| &mut c.model),
    #[cfg(feature = "slip")]
    entry(4, 2, "slip", |c| &c.slip, |c| &mut c.slip),
    #[cfg(feature = "quantised")]
    entry(5, 2, "quantised", |c| &c.quantised, |c| &mut c.quantised),
    #[cfg(feature = "warmth")]
    entry(6, 2, "warmth", |c| &c.warmth, |c| &mut c.warmth),
    entry(16, 2, "s0", |c| &c.sensors[0], |c| &mut c.sensors[0]),
    entry(17, 2, "s1", |c| &c.sensors[1], |c| &mut c.sensors[1]),
    entry(18, 2, "s2", |c| &c.sensors[2], |c| &mut c.sensors[2]),
    entry(19, 2, "s3", |c| &c.sensors[3], |c| &mut c.sensors[3]),
    #[cfg(feature = "array")]
    entry(20, 2, "array", |c| &c.array, |c| &mut c.array),
];

/// Sections whose estimator this build goes without: they are passed over.
const NOT_BUILT: &[u8] = &[
    #[cfg(not(feature = "model"))]
    3,
    #[cfg(not(feature = "slip"))]
    4,
    #[cfg(not(feature = "quantised"))]
    5,
    #[cfg(not(feature = "warmth"))]
    6,
    #[cfg(not(feature = "array"))]
    20,
];

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
                Some((section, field)) => write!(f, "{field} of {section} makes no sense"),
                None => write!(f, "field {field} of section {section} makes no sense"),
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
    /// Nothing is calibrated.
    pub const EMPTY: Self = Self {
        serial: String::new(),
        date: 0,
        taxels: None,
        force: None,
        #[cfg(feature = "quantised")]
        quantised: None,
        model: None,
        slip: None,
        warmth: None,
        sensors: [const { None }; SENSORS],
        array: None,
    };

    /// The net, in f32 where the record has it so.
    #[must_use]
    pub fn net(&self) -> Option<Net<'_>> {
        self.force.as_ref().map(Net::Float).or(self.quantised().map(Net::Quantised))
    }

    #[cfg(feature = "quantised")]
    fn quantised(&self) -> Option<&QuantisedNet> {
        self.quantised.as_ref()
    }

    #[cfg(not(feature = "quantised"))]
    fn quantised(&self) -> Option<&QuantisedNet> {
        None
    }

    /// The model of the skin, where this build can use it.
    pub(crate) fn model(&self) -> Option<&Inverse> {
        self.model.as_ref().filter(|_| cfg!(feature = "model"))
    }

    /// What slip is judged by, where this build can.
    pub(crate) fn slip(&self) -> Option<&Slip> {
        self.slip.as_ref().filter(|_| cfg!(feature = "slip"))
    }

    /// What warmth does, where this build takes it off.
    pub(crate) fn warmth(&self) -> Option<&Warmth> {
        self.warmth.as_ref().filter(|_| cfg!(feature = "warmth"))
    }

    /// The force sensors as one, where this build can.
    pub(crate) fn array(&self) -> Option<&Array> {
        self.array.as_ref().filter(|_| cfg!(feature = "array"))
    }

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
    /// Apart from [`SECTIONS`], so that firmware, which only reads records, does not hold it.
    fn write_section(&self, number: u8, buffer: &mut [u8]) -> Option<usize> {
        let [s0, s1, s2, s3] = &self.sensors;
        match number {
            1 => section::write(&self.taxels, buffer),
            2 => section::write(&self.force, buffer),
            3 => section::write(&self.model, buffer),
            4 => section::write(&self.slip, buffer),
            #[cfg(feature = "quantised")]
            5 => section::write(&self.quantised, buffer),
            6 => section::write(&self.warmth, buffer),
            16 => section::write(s0, buffer),
            17 => section::write(s1, buffer),
            18 => section::write(s2, buffer),
            19 => section::write(s3, buffer),
            20 => section::write(&self.array, buffer),
            _ => None,
        }
    }

    fn write(&self, buffer: &mut [u8]) -> Option<usize> {
        let present = || SECTIONS.iter().filter(|entry| (entry.get)(self).present());
        let version = present().map(|entry| entry.since).max().unwrap_or(OLDEST);
        let (head, rest) = buffer.split_first_chunk_mut::<2>()?;
        *head = version.to_le_bytes();
        let mut end = 2 + postcard::to_slice(&(&self.serial, self.date), rest).ok()?.len();
        for entry in present() {
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
        let mut entries = SECTIONS.iter().filter(|entry| entry.since <= version);
        while let Some(([number, low, high], tail)) = rest.split_first_chunk::<3>() {
            // In their order: none twice, and one way to write a record.
            let length = usize::from(u16::from_le_bytes([*low, *high]));
            let (section, tail) = tail.split_at_checked(length)?;
            if !NOT_BUILT.contains(number) {
                let entry = entries.find(|entry| entry.number == *number)?;
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

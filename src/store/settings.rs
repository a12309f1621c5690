//! Settings and a bias taken on command, kept together: saving one writes both again.
//!
//! Each save of a change costs one erasure, and a page endures ten thousand (DS12589 table 45).
//! That is enough, because settings are saved only when a person asks for it.

use serde::{Deserialize, Serialize};

use super::{Flash, Store, StoreError};
use crate::condition::Bias;
use crate::crc32::crc32;
use crate::estimate::contact_point::PointMethod;
use crate::frame::Fields;
use crate::scan::ScanSettings;

/// Longest content in bytes: a bias of all channels with every setting takes 170 (asserted below).
const LONGEST: usize = 170;

/// Settings of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Frames a second.
    pub hz: u16,
    /// Fields of the frames.
    pub fields: Fields,
    /// Method of the contact point.
    pub point_method: PointMethod,
    /// Settings of the scan; `None` for the board's own.
    pub scan: Option<ScanSettings>,
    /// Corner of the low-pass in hertz; 0 for none.
    pub filter_hz: u16,
}

/// A bias taken on command, and the calibration that it was taken under.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredBias {
    /// CRC of the calibration; the bias is invalid under any other.
    pub calibration: u32,
    /// Reading of the unloaded finger; `None` for the calibration's own bias.
    pub bias: Option<Bias>,
}

/// Content of a settings page: postcard followed by its CRC-32. A content of another layout, as
/// another firmware may have written it, reads as none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Kept {
    settings: Option<Settings>,
    bias: Option<StoredBias>,
}

impl Kept {
    #[inline]
    pub(super) fn read(bytes: &[u8]) -> Option<Self> {
        let (body, crc) = bytes.split_last_chunk()?;
        let (kept, rest) = postcard::take_from_bytes(body).ok()?;
        (crc32(body) == u32::from_le_bytes(*crc) && rest.is_empty()).then_some(kept)
    }

    #[inline]
    fn write<'b>(&self, buffer: &'b mut [u8; LONGEST]) -> Option<&'b [u8]> {
        let length = postcard::to_slice(self, buffer).ok()?.len();
        let crc = crc32(buffer.get(..length)?).to_le_bytes();
        *buffer.get_mut(length..)?.first_chunk_mut()? = crc;
        buffer.get(..length + crc.len())
    }
}

impl<F: Flash> Store<F> {
    /// Returns the settings that were saved last.
    pub fn settings(&self) -> Option<Settings> {
        self.kept().settings
    }

    /// Saves settings.
    ///
    /// # Errors
    /// The flash failed.
    pub fn save_settings(&mut self, settings: &Settings) -> Result<(), StoreError> {
        self.keep(&Kept { settings: Some(*settings), ..self.kept() })
    }

    /// Returns the bias that was saved last.
    pub fn bias(&self) -> Option<StoredBias> {
        self.kept().bias
    }

    /// Saves a bias.
    ///
    /// # Errors
    /// The flash failed.
    pub fn save_bias(&mut self, bias: &StoredBias) -> Result<(), StoreError> {
        self.keep(&Kept { bias: Some(*bias), ..self.kept() })
    }

    fn kept(&self) -> Kept {
        self.settings.current(&self.flash).and_then(Kept::read).unwrap_or_default()
    }

    fn keep(&mut self, kept: &Kept) -> Result<(), StoreError> {
        let mut buffer = [0; LONGEST];
        let bytes = kept.write(&mut buffer).ok_or(StoreError::Flash)?;
        if self.settings.current(&self.flash) == Some(bytes) {
            return Ok(());
        }
        self.settings.begin(&mut self.flash, bytes.len())?;
        self.settings.write(&mut self.flash, 0, bytes)?;
        if self.settings.written(&self.flash)? != bytes {
            return Err(StoreError::Flash);
        }
        self.settings.commit(&mut self.flash)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::condition::{BridgeBias, TaxelBias};

    #[test]
    fn longest_content_fits() {
        let bias = Bias {
            taxels: Some(TaxelBias { level: [1.0; 16], noise: 1.0 }),
            bridges: [Some(BridgeBias { level: [1.0; 3], noise: 1.0 }); 4],
        };
        let scan =
            Some(ScanSettings { scan_hz: u16::MAX, oversampling: u16::MAX, settle_ns: u32::MAX });
        let point_method = PointMethod::ArgMin;
        let settings =
            Settings { hz: u16::MAX, fields: Fields::ALL, point_method, scan, filter_hz: u16::MAX };
        let stored = StoredBias { calibration: u32::MAX, bias: Some(bias) };
        let kept = Kept { settings: Some(settings), bias: Some(stored) };
        let mut buffer = [0; LONGEST];
        let bytes = kept.write(&mut buffer).unwrap();
        assert_eq!(bytes.len(), 170);
        assert_eq!(Kept::read(bytes), Some(kept));
    }

    #[test]
    fn damaged_or_overlong_content_is_none() {
        let mut buffer = [0; LONGEST];
        let bytes = Kept::default().write(&mut buffer).unwrap();
        for i in 0..bytes.len() {
            let mut damaged = bytes.to_vec();
            damaged[i] ^= 1;
            assert_eq!(Kept::read(&damaged), None, "byte {i}");
            assert_eq!(Kept::read(&bytes[..i]), None, "{i} bytes");
        }
    }
}

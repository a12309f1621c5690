//! Upload and download of calibration records in chunks.

use std::ops::ControlFlow;

use taxel::calibration::MAX_BYTES;
use taxel::wire::message::{CHUNK, Command, Refusal, Response};

use super::{Client, PATIENCE};
use crate::error::{ActiveCalibration, LinkError, Problem};

/// Attempts of an upload when a chunk or its reply was lost.
const UPLOADS: u32 = 3;

impl Client {
    /// Sends a calibration record, activates it, and reads it back. `progress` gets the bytes that
    /// have arrived, and may stop the upload until the record is complete.
    ///
    /// # Errors
    /// The finger refused the record and keeps the previous one, or the link broke:
    /// [`Problem::Upload`] states which calibration is active.
    pub fn upload_calibration(
        &self,
        record: &[u8],
        mut progress: impl FnMut(usize) -> ControlFlow<()>,
    ) -> Result<(), LinkError> {
        let mut active = ActiveCalibration::Previous;
        self.upload_and_read_back(record, &mut progress, &mut active).map_err(|error| {
            match error.problem() {
                // These name the active calibration themselves.
                None | Some(Problem::Refusal { .. } | Problem::ReadBack) => error,
                Some(why) => self.error(Problem::Upload { why: Box::new(why.clone()), active }),
            }
        })
    }

    fn upload_and_read_back(
        &self,
        record: &[u8],
        progress: &mut impl FnMut(usize) -> ControlFlow<()>,
        active: &mut ActiveCalibration,
    ) -> Result<(), LinkError> {
        let mut left = UPLOADS;
        loop {
            left -= 1;
            match self.upload(record, progress, active) {
                Err(error) if left > 0 && worth_repeating(&error) => {}
                Err(error) => return Err(error),
                Ok(()) => break,
            }
        }
        if self.download_calibration()? == record {
            Ok(())
        } else {
            Err(self.error(Problem::ReadBack))
        }
    }

    fn upload(
        &self,
        record: &[u8],
        progress: &mut impl FnMut(usize) -> ControlFlow<()>,
        active: &mut ActiveCalibration,
    ) -> Result<(), LinkError> {
        let mut progress = |sent: usize| match progress(sent) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(self.error(Problem::Stopped)),
        };
        progress(0)?;
        // A length beyond the field is refused by the finger as too long.
        let length = u16::try_from(record.len()).unwrap_or(u16::MAX);
        // The finger erases a slot of its flash first, which may take seconds (128 KB sectors of an
        // F4).
        self.erase(NAME, &Command::CalibrationBegin { length }, 8 * PATIENCE, 1)?;
        let mut offset = 0;
        for chunk in record.chunks(CHUNK) {
            let data = chunk.iter().copied().collect();
            // Sent once: a repeated chunk would be out of order.
            self.ask(NAME, Command::CalibrationChunk { offset, data }, PATIENCE, 1)?;
            offset += chunk.len() as u16;
            progress(offset.into())?;
        }
        *active = ActiveCalibration::Either;
        self.ask(NAME, Command::CalibrationCommit, 4 * PATIENCE, 1)?;
        *active = ActiveCalibration::New;
        Ok(())
    }

    /// Downloads the active record, byte for byte as it was uploaded.
    ///
    /// # Errors
    /// The finger has no record, or the link broke.
    pub fn download_calibration(&self) -> Result<Vec<u8>, LinkError> {
        let mut record = Vec::new();
        loop {
            let offset = record.len() as u16;
            match self.request(NAME, Command::CalibrationRead { offset })? {
                Response::Calibration { offset: at, data } if at == offset => {
                    record.extend_from_slice(&data);
                    if data.len() < CHUNK || record.len() > MAX_BYTES {
                        return Ok(record);
                    }
                }
                _ => return Err(self.unexpected(NAME)),
            }
        }
    }
}

const NAME: &str = "calibration";

fn worth_repeating(error: &LinkError) -> bool {
    matches!(
        error.problem(),
        Some(Problem::NoReply | Problem::Refusal { refusal: Refusal::OutOfOrder, .. })
    )
}

//! Calibrations on their way to the finger and back, in chunks.

use std::ops::ControlFlow;

use taxel::calibration::MAX_BYTES;
use taxel::wire::message::{CHUNK, Command, Refusal, Response};

use super::{Client, PATIENCE};
use crate::error::{InForce, LinkError, Problem};

/// How often an upload starts over when a chunk or its answer was lost.
const UPLOADS: u32 = 3;

impl Client {
    /// Sends a calibration record, puts it in force, and reads it back to be sure. `progress` hears how
    /// many bytes have arrived, and may end it as long as the record is not complete.
    ///
    /// # Errors
    /// Refused as it stands (the old one then stays), or the link broke: [`Problem::Upload`] tells which
    /// calibration is in force.
    pub fn upload_calibration(
        &self,
        record: &[u8],
        mut progress: impl FnMut(usize) -> ControlFlow<()>,
    ) -> Result<(), LinkError> {
        let mut in_force = InForce::Before;
        self.upload_and_read_back(record, &mut progress, &mut in_force).map_err(|error| {
            match error.problem() {
                // These say it themselves.
                None | Some(Problem::Refusal { .. } | Problem::ReadBack) => error,
                Some(why) => self.error(Problem::Upload { why: Box::new(why.clone()), in_force }),
            }
        })
    }

    fn upload_and_read_back(
        &self,
        record: &[u8],
        progress: &mut impl FnMut(usize) -> ControlFlow<()>,
        in_force: &mut InForce,
    ) -> Result<(), LinkError> {
        let mut left = UPLOADS;
        loop {
            left -= 1;
            match self.upload(record, progress, in_force) {
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
        in_force: &mut InForce,
    ) -> Result<(), LinkError> {
        let mut progress = |sent: usize| match progress(sent) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(self.error(Problem::Stopped)),
        };
        progress(0)?;
        // What does not fit the field is refused by the finger as too long.
        let length = u16::try_from(record.len()).unwrap_or(u16::MAX);
        // The finger erases a slot of its flash first, which may take seconds (128 KB sectors of an F4).
        self.ask(NAME, Command::CalibrationBegin { length }, 8 * PATIENCE, 1)?;
        let mut offset = 0;
        for chunk in record.chunks(CHUNK) {
            let data = chunk.iter().copied().collect();
            // Asked once: a repeated chunk would be out of order.
            self.ask(NAME, Command::CalibrationChunk { offset, data }, PATIENCE, 1)?;
            offset += chunk.len() as u16;
            progress(offset.into())?;
        }
        *in_force = InForce::Either;
        self.ask(NAME, Command::CalibrationCommit, 4 * PATIENCE, 1)?;
        *in_force = InForce::New;
        Ok(())
    }

    /// The record in force, byte by byte as it was uploaded.
    ///
    /// # Errors
    /// There is none, or the link broke.
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
                _ => return Err(self.confused(NAME)),
            }
        }
    }
}

const NAME: &str = "calibration";

fn worth_repeating(error: &LinkError) -> bool {
    matches!(
        error.problem(),
        Some(Problem::Silent | Problem::Refusal { refusal: Refusal::OutOfOrder, .. })
    )
}

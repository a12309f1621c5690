//! Errors of a fit, in one line: found and expected value, and remedy.

use taxel::calibration::CalibrationError;
use thiserror::Error;

/// Error of a fit or an alignment.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum FitError {
    /// No recording was given.
    #[error("no recording to fit to; give at least one")]
    NoRecording,
    /// A recording has no rows.
    #[error("{recording}: no rows to fit to; record for longer")]
    Empty {
        /// Name of the recording.
        recording: String,
    },
    /// A recording lacks an unloaded stretch.
    #[error(
        "{recording}: no unloaded stretch of at least {rows} rows; \
         begin the recording with half a second in which nothing touches the finger"
    )]
    NoUnloadedStretch {
        /// Name of the recording.
        recording: String,
        /// Expected least value.
        rows: usize,
    },
    /// A recording lacks a column or channel that the fit needs.
    #[error("{recording}: {missing} missing; {mend}")]
    Missing {
        /// Name of the recording.
        recording: String,
        /// Missing column or channel.
        missing: String,
        /// How to fix it.
        mend: String,
    },
    /// The recordings hold no load.
    #[error("{part}: the recordings hold no load; record presses over the range to be measured")]
    NoLoad {
        /// Part that was to be fitted.
        part: String,
    },
    /// A component of the reference never shows a load.
    #[error(
        "{part}: {columns}: the same throughout: an unloaded component cannot be fitted; record loads along it, \
         both ways, over the range to be measured, or leave the column out"
    )]
    AtRest {
        /// Part that was to be fitted.
        part: String,
        /// The columns of the reference.
        columns: String,
    },
    /// A force sensor has axes without any load.
    #[error(
        "{part}: {columns}: never loaded (less than a hundredth of the largest force), so that S is not determined; \
         load it in x, y and z independently of each other"
    )]
    NeverLoaded {
        /// Part that was to be fitted.
        part: String,
        /// The columns of the reference.
        columns: String,
    },
    /// The loads do not determine all unknowns.
    #[error(
        "{part}: the loads do not determine every axis (in one direction the signals stand only \
         {ratio:.1} times out of their noise, at least {least} are needed); \
         load it in x, y and z independently of each other"
    )]
    Collinear {
        /// Part that was to be fitted.
        part: String,
        /// Signal to noise of the weakest direction.
        ratio: f64,
        /// Expected least value.
        least: f64,
    },
    /// Not enough rows for the number of unknowns.
    #[error("{part}: {rows} usable rows where at least {least} are needed; record for longer")]
    TooFewRows {
        /// Part that was to be fitted.
        part: String,
        /// Usable rows.
        rows: usize,
        /// Expected least value.
        least: usize,
    },
    /// A shape that the calibration record cannot hold.
    #[error("{part}: {problem}")]
    Shape {
        /// Part that was to be fitted.
        part: String,
        /// Shape that was found, and the expected one.
        problem: String,
    },
    /// Recordings that do not match each other.
    #[error("{recording}: {problem}; {mend}")]
    Mismatch {
        /// Name of the recording.
        recording: String,
        /// Value that was found, and the expected one.
        problem: String,
        /// How to fix it.
        mend: String,
    },
    /// Sensor and reference cannot be aligned in time.
    #[error("{recording}: {problem}; {mend}")]
    Unaligned {
        /// Name of the reference.
        recording: String,
        /// The problem.
        problem: String,
        /// How to fix it.
        mend: String,
    },
    /// The fit was stopped before its first step.
    #[error("stopped before the first step; nothing was fitted")]
    Stopped,
    /// The fit gives an invalid calibration record.
    #[error(
        "the fit gives no valid record ({0}); look for a channel that jumps or is not connected"
    )]
    Record(CalibrationError),
}

impl FitError {
    /// Adds the names of the recordings to the part.
    #[must_use]
    pub(crate) fn of(mut self, recordings: &str) -> Self {
        if let Self::NoLoad { part }
        | Self::AtRest { part, .. }
        | Self::NeverLoaded { part, .. }
        | Self::Collinear { part, .. }
        | Self::TooFewRows { part, .. }
        | Self::Shape { part, .. } = &mut self
        {
            *part = format!("{recordings}: {part}");
        }
        self
    }
}

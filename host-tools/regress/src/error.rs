//! Why a fit is refused: what was found, what was expected, and how to mend it, in one line.

use taxel::calibration::CalibrationError;
use thiserror::Error;

/// Why recordings do not make a calibration.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum FitError {
    /// There is nothing to fit to.
    #[error("no recording to fit to; give at least one")]
    NoRecording,
    /// A recording has no rows.
    #[error("{recording}: no rows to fit to; record for longer")]
    Empty {
        /// Its name.
        recording: String,
    },
    /// The unloaded finger is nowhere to be seen.
    #[error(
        "{recording}: no unloaded stretch of at least {rows} rows; \
         begin the recording with half a second in which nothing touches the finger"
    )]
    NoUnloadedStretch {
        /// Where.
        recording: String,
        /// What was expected.
        rows: usize,
    },
    /// A recording lacks what to fit.
    #[error("{recording}: {missing} missing; {mend}")]
    Missing {
        /// Where.
        recording: String,
        /// Which column or channel.
        missing: String,
        /// How to mend it.
        mend: String,
    },
    /// Nothing presses.
    #[error("{part}: the recordings hold no load; record presses over the range to be measured")]
    NoLoad {
        /// What was to be fitted.
        part: String,
    },
    /// A component of the reference that never shows a load.
    #[error(
        "{part}: {columns}: the same throughout: what is never loaded cannot be fitted; record loads along it, \
         both ways, over the range to be measured, or leave the column out"
    )]
    AtRest {
        /// What was to be fitted.
        part: String,
        /// The columns of the reference.
        columns: String,
    },
    /// Axes of a force sensor along which there is no load.
    #[error(
        "{part}: {columns}: never loaded (less than a hundredth of the largest force), so that S is not determined; \
         load it in x, y and z independently of each other"
    )]
    NeverLoaded {
        /// What was to be fitted.
        part: String,
        /// The columns of the reference.
        columns: String,
    },
    /// The loads do not determine all of the unknowns.
    #[error(
        "{part}: the loads do not determine every axis (in one direction the signals stand only \
         {ratio:.1} times out of their noise, at least {least} are needed); \
         load it in x, y and z independently of each other"
    )]
    Collinear {
        /// What was to be fitted.
        part: String,
        /// Signal to noise of the weakest direction.
        ratio: f64,
        /// What was expected.
        least: f64,
    },
    /// Not enough rows for the number of unknowns.
    #[error("{part}: {rows} usable rows where at least {least} are needed; record for longer")]
    TooFewRows {
        /// What was to be fitted.
        part: String,
        /// What was found.
        rows: usize,
        /// What was expected.
        least: usize,
    },
    /// A shape that the record cannot hold.
    #[error("{part}: {problem}")]
    Shape {
        /// What was to be fitted.
        part: String,
        /// What was found and expected.
        problem: String,
    },
    /// Recordings that do not go together.
    #[error("{recording}: {problem}; {mend}")]
    Mismatch {
        /// Which one.
        recording: String,
        /// What was found and expected.
        problem: String,
        /// How to mend it.
        mend: String,
    },
    /// Sensor and reference cannot be brought onto one time.
    #[error("{recording}: {problem}; {mend}")]
    Unaligned {
        /// Which reference.
        recording: String,
        /// What was found.
        problem: String,
        /// How to mend it.
        mend: String,
    },
    /// It was stopped before there was anything to keep.
    #[error("stopped before the first step; nothing was fitted")]
    Stopped,
    /// The fit is not a valid record.
    #[error(
        "the fit gives no valid record ({0}); look for a channel that jumps or is not connected"
    )]
    Record(CalibrationError),
}

impl FitError {
    /// Of what was to be fitted, the recordings that it was to be fitted to.
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

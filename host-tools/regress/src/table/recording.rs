//! Rows of a table with their references, on one time base.

use std::borrow::Cow;

use taxel_files::FileError;
use taxel_files::stretch::Stretch;
use taxel_files::table::{self, Table};

use crate::align::{self, Alignment, Series};
use crate::error::FitError;
use crate::training::Recorded;

/// Rows of a table with their references.
#[derive(Clone, Debug, PartialEq)]
pub struct TableRecording {
    /// Channels of the sensor.
    pub inputs: Table,
    /// References, row for row.
    pub targets: Table,
}

impl TableRecording {
    /// Reads a stretch of a file; `*` in a pattern stands for any text.
    ///
    /// A pattern never matches a target or the time, because a net with the answer as input learns
    /// nothing.
    ///
    /// # Errors
    ///
    /// A fault of the file, or a column named as input and as target.
    pub fn read(stretch: &Stretch, inputs: &[&str], targets: &[&str]) -> Result<Self, FileError> {
        let targets = table::read(stretch, targets)?;
        if let Some(both) = inputs.iter().find(|name| targets.names.iter().any(|t| t == *name)) {
            return Err(FileError::new(&stretch.path, "a target cannot be an input as well")
                .line(1)
                .column(*both)
                .mend("take it out of --inputs or of --targets"));
        }
        let mut inputs_read = table::read(stretch, inputs)?;
        inputs_read.keep(|name| {
            inputs.contains(&name)
                || !(targets.names.iter().any(|t| t == name) || table::is_time(name))
        });
        if inputs_read.names.is_empty() {
            return Err(FileError::new(&stretch.path, "only targets and the time match")
                .line(1)
                .column(inputs.join(","))
                .mend("name columns of the sensor with --inputs"));
        }
        Ok(Self { inputs: inputs_read, targets })
    }

    /// Joins inputs with a reference from another clock.
    ///
    /// Targets and times in the sensor's own file are not used as inputs.
    ///
    /// # Errors
    ///
    /// No input is left, or the two cannot be aligned in time.
    pub fn aligned(mut inputs: Table, mut targets: Table) -> Result<(Self, Alignment), FitError> {
        let reference = targets.path.display().to_string();
        inputs.keep(|name| !table::is_time(name) && !targets.names.iter().any(|t| t == name));
        if inputs.names.is_empty() {
            return Err(FitError::Mismatch {
                recording: inputs.path.display().to_string(),
                problem: "only targets and the time match --inputs".into(),
                mend: "name columns of the sensor".into(),
            });
        }
        for table in [&mut inputs, &mut targets] {
            if let Ok(Cow::Owned(apart)) = align::told_apart(&table.times) {
                table.times = apart;
            }
        }
        let sensor = Series { times: &inputs.times, rows: &inputs.rows };
        let other = Series { times: &targets.times, rows: &targets.rows };
        let alignment =
            align::align([&inputs.path.display().to_string(), &reference], sensor, other)?;
        let times: Vec<f64> = inputs.times.iter().map(|t| alignment.time(*t)).collect();
        let mut found = align::resample(other, &times);
        let known: Vec<bool> = found.iter().map(Option::is_some).collect();
        let mut keep = known.iter();
        inputs.rows.retain(|_| keep.next() == Some(&true));
        let mut keep = known.iter();
        inputs.times.retain(|_| keep.next() == Some(&true));
        targets.rows = found.drain(..).flatten().collect();
        let referred = std::mem::replace(&mut targets.times, inputs.times.clone());
        if targets.rows.is_empty() {
            return Err(align::apart(&reference, &times, &referred));
        }
        Ok((Self { inputs, targets }, alignment))
    }

    /// Name of the recording in messages.
    #[must_use]
    pub fn name(&self) -> String {
        self.inputs.path.display().to_string()
    }
}

/// Realigns misaligned references in time and warns of them.
pub(super) fn put_on_time(recordings: &[TableRecording], rows: &mut [Recorded]) -> Vec<String> {
    let mut warnings = Vec::new();
    let mut unchecked: Vec<(String, Vec<String>)> = Vec::new();
    for (recording, (x, y)) in recordings.iter().zip(rows) {
        let times = match told_apart(&recording.inputs.times) {
            Ok(times) => times,
            Err(why) => {
                match unchecked.iter_mut().find(|(known, _)| *known == why) {
                    Some((_, names)) => names.push(recording.name()),
                    None => unchecked.push((why, vec![recording.name()])),
                }
                continue;
            }
        };
        let Some(off) = align::misaligned(Series { times: &times, rows: x }, y) else { continue };
        let read: Vec<f64> = times.iter().map(|t| off.time(*t)).collect();
        let found = align::resample(Series { times: &times, rows: y }, &read);
        let mut known = found.iter().map(Option::is_some);
        x.retain(|_| known.next() == Some(true));
        *y = found.into_iter().flatten().collect();
        warnings.push(align::off_time(&recording.name(), &off, times[0]));
    }
    warnings.extend(unchecked.into_iter().map(|(why, names)| {
        format!(
            "{}: {why}, so that it was not checked whether the reference is of the same moments as the inputs",
            names.join(", ")
        )
    }));
    warnings
}

/// Times that rise from row to row, or the reason why they are unknown.
fn told_apart(times: &[f64]) -> Result<Cow<'_, [f64]>, String> {
    if times.is_empty() {
        return Err("no time column (t_s or t_us)".into());
    }
    align::told_apart(times)
}

//! Presses with a known force: contacts that are felt or labelled, and the rows at rest.

use std::ops::Range;

use taxel::calibration::Calibration;
use taxel::condition::Bias;
use taxel::finger::Finger;
use taxel::frame::Status;
use taxel::scan::TAXELS;
use taxel_regress::error::FitError;

use super::limits::{HARDER, SETTLE_US};
use super::{faded, same_finger};
use crate::recording::Recording;

/// Presses of each recording, and whether each of its rows is loaded or at rest, if that is known.
pub(super) struct Presses {
    pub(super) presses: Vec<Vec<Range<usize>>>,
    pub(super) loaded: Vec<Vec<Option<bool>>>,
    /// Whether the presses are weights on a skin that was not pressed harder before.
    pub(super) unpressed: bool,
}

/// Finds the presses with a known force.
///
/// # Errors
///
/// There is no unloaded stretch, or a recording is of another finger.
pub(super) fn presses(
    calibration: &Calibration,
    recordings: &[Recording],
) -> Result<Presses, FitError> {
    let mut found = Presses { presses: Vec::new(), loaded: Vec::new(), unpressed: false };
    for recording in recordings {
        let bias = recording.bias(calibration.warmth.as_ref())?;
        if let Some(gains) = faded(calibration, &bias) {
            same_finger(&recording.name, &gains)?;
        }
        let own = renewed(calibration, &bias);
        let known = |rows: &Range<usize>| {
            recording.samples[rows.clone()].iter().any(|sample| {
                let sensors = &sample.truth.sensors;
                sample.truth.force[2].is_some() || sensors.iter().any(|force| force[2].is_some())
            })
        };
        let loaded = at_rest(recording);
        let felt = touched(&own, recording);
        let together = loaded.iter().zip(felt).map(|(loaded, felt)| felt || *loaded == Some(true));
        let runs = joined(runs(&together.collect::<Vec<_>>()), recording);
        let runs: Vec<_> = runs.into_iter().filter(known).collect();
        found.unpressed |= is_weighed(recording) && !is_pressed(&own, recording, &runs);
        found.presses.push(runs);
        found.loaded.push(loaded);
    }
    Ok(found)
}

/// Whether the labels are those of weights: one force throughout.
fn is_weighed(recording: &Recording) -> bool {
    let mut forces = recording.samples.iter().map(|sample| sample.truth.force);
    let mut known = forces.by_ref().filter(|force| force[2].is_some());
    known.next().is_some_and(|first| known.all(|force| force == first))
}

/// Whether most weights stand where the skin was pressed harder before, in the same recording.
///
/// The first loading of a skin is stiffer ([DeMaria2011] fig. 3), until it was pressed as hard.
fn is_pressed(own: &Calibration, recording: &Recording, weights: &[Range<usize>]) -> bool {
    let signals = recording.signals(&own.bias(), own.warmth.as_ref());
    let sizes = |row: usize| signals[row].taxels.unwrap_or_default().map(f32::abs);
    let (mut most, mut row, mut pressed) = ([0.0f32; TAXELS], 0, 0);
    for weight in weights {
        for size in (row..weight.start).map(sizes) {
            most.iter_mut().zip(size).for_each(|(most, size)| *most = most.max(size));
        }
        row = weight.start;
        let under = sizes(weight.start.midpoint(weight.end));
        let half = 0.5 * under.iter().copied().fold(0.0, f32::max);
        let mut bearing = under.iter().zip(most).filter(|(under, _)| **under >= half);
        pressed += usize::from(bearing.all(|(under, most)| most >= HARDER * under));
    }
    2 * pressed > weights.len()
}

/// Returns the calibration with another bias, for the parts that have one.
pub(super) fn renewed(calibration: &Calibration, bias: &Bias) -> Calibration {
    let mut calibration = calibration.clone();
    if let (Some(taxels), Some(bias)) = (&mut calibration.taxels, bias.taxels) {
        taxels.bias = bias;
    }
    for (sensor, bias) in calibration.sensors.iter_mut().zip(bias.bridges) {
        if let (Some(sensor), Some(bias)) = (sensor, bias) {
            sensor.bias = bias;
        }
    }
    calibration
}

/// Rows of each contact, found with the finger's own gate.
pub(super) fn contacts(calibration: &Calibration, recording: &Recording) -> Vec<Range<usize>> {
    runs(&touched(calibration, recording))
}

/// Whether the finger's own gate is open in each row.
fn touched(calibration: &Calibration, recording: &Recording) -> Vec<bool> {
    let (finger, mut state) = Finger::new(Some(calibration.clone()));
    let rows = recording.samples.iter();
    rows.map(|s| finger.estimate(&mut state, &s.scan).status.contains(Status::CONTACT)).collect()
}

/// Ranges of the true rows.
fn runs(rows: &[bool]) -> Vec<Range<usize>> {
    let mut begin = 0;
    let runs = rows.chunk_by(|a, b| a == b).filter_map(|run| {
        let rows = begin..begin + run.len();
        begin = rows.end;
        run[0].then_some(rows)
    });
    runs.collect()
}

/// Joins runs with a short gap: the label's noise parts the beginning and end of a touch.
fn joined(runs: Vec<Range<usize>>, recording: &Recording) -> Vec<Range<usize>> {
    let time = |row: usize| recording.samples[row].scan.time.0;
    let mut joined: Vec<Range<usize>> = Vec::new();
    for run in runs {
        match joined.last_mut() {
            Some(last) if time(run.start) < time(last.end - 1) + SETTLE_US => last.end = run.end,
            _ => joined.push(run),
        }
    }
    joined
}

/// Whether each row is loaded, or at rest; `None` without a label, and soon after a load.
fn at_rest(recording: &Recording) -> Vec<Option<bool>> {
    let mut settled = 0;
    let mut loaded = recording.loaded();
    loaded.resize(recording.samples.len(), None);
    for (loaded, sample) in loaded.iter_mut().zip(&recording.samples) {
        if *loaded == Some(true) {
            settled = sample.scan.time.0 + SETTLE_US;
        } else if sample.scan.time.0 < settled {
            *loaded = None;
        }
    }
    loaded
}

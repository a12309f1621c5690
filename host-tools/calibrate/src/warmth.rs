//! Fit of the temperature compensation to unloaded stretches at several temperatures.
//!
//! Record the finger at rest while it warms up. Light and offsets are linear in the thermometer's
//! reading, by least squares. Without a change of temperature their slopes stay zero.

use taxel::condition::{Levels, PER_KELVIN, TemperatureCompensation};
use taxel::scan::{SENSORS, TAXELS};

use taxel_files::trace::Sample;

use crate::recording::Recording;

/// Room temperature, kelvin.
///
/// The piezoresistive effect of lightly doped silicon is inversely proportional to the absolute
/// temperature (Kanda 1982); an assumed room temperature is accurate enough.
const ROOM_K: f64 = 298.0;
/// Margin in kelvin beyond the recorded temperatures in which the lines still hold.
///
/// Half a kelvin of an unknown offset is two to three times the noise of a bare sensor.
const MARGIN_K: f32 = 0.5;
/// Least temperature range that determines a slope, kelvin.
const LEAST_K: f64 = 2.0;
/// Most rows of a line; more do not improve it.
const MOST_ROWS: usize = 20_000;

/// Whether a recording shows only the warm-up: the finger at rest, with its thermometer.
pub(crate) fn is_warm_up(recording: &Recording) -> bool {
    let has = |sample: &Sample| sample.scan.codes.temperature.is_some();
    recording.samples.iter().all(has) && recording.is_unloaded()
}

/// Fits the compensation, if the recordings with loads have a thermometer.
pub(crate) fn fit(recordings: &[Recording]) -> Option<TemperatureCompensation> {
    let readings: Vec<Vec<(Levels, f64)>> = recordings.iter().map(warm).collect();
    let all: Vec<&(Levels, f64)> = readings.iter().flatten().collect();
    // The reference temperature is that of the loads, because the sensitivities are fitted to them.
    let loaded = |(recording, readings): (&Recording, &Vec<(Levels, f64)>)| {
        if is_warm_up(recording) { Vec::new() } else { readings.iter().map(|r| r.1).collect() }
    };
    let temperatures: Vec<f64> = recordings.iter().zip(&readings).flat_map(loaded).collect();
    if temperatures.is_empty() {
        return None;
    }
    let reference = temperatures.iter().sum::<f64>() / temperatures.len() as f64;
    let bounds = all.iter().map(|reading| reading.1);
    let low = bounds.clone().fold(f64::INFINITY, f64::min);
    let high = bounds.fold(f64::NEG_INFINITY, f64::max);
    let margin = MARGIN_K * PER_KELVIN;
    let mut warmth = TemperatureCompensation {
        reference: reference as f32,
        range: [low as f32 - margin, high as f32 + margin],
        light: 0.0,
        sensitivity: (-1.0 / (ROOM_K * f64::from(PER_KELVIN))) as f32,
        offset: Default::default(),
    };
    let still = |(recording, readings): (&Recording, &Vec<(Levels, f64)>)| -> Vec<(Levels, f64)> {
        let touched = recording.touched().unwrap_or_default();
        let rows = readings.iter().zip(touched);
        rows.filter(|(_, touched)| !touched).map(|(reading, _)| *reading).collect()
    };
    let still: Vec<(Levels, f64)> = recordings.iter().zip(&readings).flat_map(still).collect();
    let still: Vec<&(Levels, f64)> =
        still.iter().step_by(still.len().div_ceil(MOST_ROWS).max(1)).collect();
    let line = |level: &dyn Fn(&Levels) -> Option<f32>| {
        let rows = still
            .iter()
            .filter_map(|(levels, warm)| Some((warm - reference, f64::from(level(levels)?))));
        straight(&rows.collect::<Vec<_>>())
    };
    let taxels: Vec<(f64, f64)> =
        (0..TAXELS).filter_map(|k| line(&|levels| levels.taxels.map(|taxels| taxels[k]))).collect();
    let of = |f: fn(&(f64, f64)) -> f64| taxels.iter().map(f).sum::<f64>();
    if of(|(at, _)| at * at) > 0.0 {
        warmth.light = (of(|(at, slope)| at * slope) / of(|(at, _)| at * at)) as f32;
    }
    for i in 0..SENSORS {
        for axis in 0..3 {
            if let Some((_, slope)) = line(&|levels| levels.bridges[i].map(|u| u[axis])) {
                warmth.offset[i][axis] = slope as f32;
            }
        }
    }
    Some(warmth)
}

/// Levels and thermometer readings of every row; empty if a row lacks the thermometer.
fn warm(recording: &Recording) -> Vec<(Levels, f64)> {
    let mut thermometer = taxel::condition::Thermometer::default();
    let samples = recording.samples.iter();
    let readings = samples.map(|sample| {
        let warm = thermometer.read(&sample.scan.codes)?;
        Some((Levels::read(&sample.scan.codes), f64::from(warm)))
    });
    readings.collect::<Option<_>>().unwrap_or_default()
}

/// Value at zero and slope by least squares; `None` if the span is below [`LEAST_K`].
fn straight(rows: &[(f64, f64)]) -> Option<(f64, f64)> {
    let n = rows.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| rows.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(|r| r.0), mean(|r| r.1));
    let (xx, xy) = (mean(|r| r.0 * r.0) - x * x, mean(|r| r.0 * r.1) - x * y);
    let low = rows.iter().map(|r| r.0).fold(f64::INFINITY, f64::min);
    let high = rows.iter().map(|r| r.0).fold(f64::NEG_INFINITY, f64::max);
    (high - low > LEAST_K * f64::from(PER_KELVIN)).then(|| (y - xy / xx * x, xy / xx))
}

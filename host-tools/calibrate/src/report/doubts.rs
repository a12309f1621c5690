//! Warnings where the recordings cannot support the calibration.

use crate::recording::Recording;
use crate::shear;
use nalgebra::DMatrix;
use taxel::calibration::Calibration;
use taxel::condition::{Bias, Levels};
use taxel::scan::{SENSORS, TAXELS};
use taxel_files::trace::Sample;

/// Correlation above which two channels count as the same.
const SAME: f64 = 0.9999;
/// Largest share of a recording's loaded rows that one of the fit may have as well.
const SHARED: f64 = 0.01;
/// Fewest recordings for a model choice by whole held-out recordings, as in [Ospina2017].
const FEW: usize = 3;

/// Warnings about the recordings of the fit, in full sentences.
pub(crate) fn doubts(calibration: &Calibration, fitted: &[Recording]) -> Vec<String> {
    if fitted.is_empty() {
        return unknown();
    }
    let mut doubts = few(fitted.len());
    doubts.extend(shear::of_finger(calibration, fitted));
    doubts.extend(of_channels(calibration, fitted));
    doubts
}

/// Warning that the recordings of the fit were not given.
pub(crate) fn unknown() -> Vec<String> {
    vec![
        "the recordings that the calibration was fitted to were not given (--fitted-to): whether they \
         support it is not judged"
            .into(),
    ]
}

/// Warning about too few recordings.
pub(crate) fn few(recordings: usize) -> Vec<String> {
    let s = if recordings == 1 { "" } else { "s" };
    let doubt = format!(
        "fitted to {recordings} recording{s}: with {FEW} or more, mounted again each time, one can be left \
         out to see what a new mounting does"
    );
    if recordings < FEW { vec![doubt] } else { Vec::new() }
}

/// Warning that a judged recording was part of the fit.
pub(crate) fn no_forecast(recording: &str) -> String {
    format!(
        "{recording}: the calibration was fitted to these rows: its errors on them are no forecast"
    )
}

/// Warnings about the recordings among `judged` that were part of the fit.
pub(crate) fn not_held_out(judged: &[Recording], fitted: &[Recording]) -> Vec<String> {
    let known = |recording: &&Recording| {
        // Unloaded rows of simulations without noise are alike in every recording.
        let touched = recording.touched().unwrap_or_else(|| vec![true; recording.samples.len()]);
        let rows = recording.samples.iter().zip(touched).filter(|row| row.1);
        let (mut loaded, mut shared) = (0, 0);
        for (sample, _) in rows {
            loaded += 1;
            // Names and labels do not count: a copy may have another name or reference.
            shared += usize::from(fitted.iter().any(|fitted| {
                let at = fitted.samples.partition_point(|s| s.scan.time < sample.scan.time);
                let alike = |s: &Sample| {
                    (s.scan.time, &s.scan.codes) == (sample.scan.time, &sample.scan.codes)
                };
                fitted.samples.get(at).is_some_and(alike)
            }));
        }
        shared as f64 > SHARED * f64::from(loaded)
    };
    judged.iter().filter(known).map(|recording| no_forecast(&recording.name)).collect()
}

fn of_channels(calibration: &Calibration, fitted: &[Recording]) -> Vec<String> {
    let bias = calibration.bias();
    let mut doubts = Vec::new();
    if calibration.net.is_some() {
        let names: Vec<String> = (0..TAXELS).map(|k| format!("r{}c{}", k / 4, k % 4)).collect();
        doubts.extend(alike(&names, &taxels(&bias, fitted)));
    }
    for sensor in (0..SENSORS).filter(|i| calibration.sensors[*i].is_some()) {
        let names = ["x", "y", "z"].map(|axis| format!("u_{axis} of s{sensor}"));
        doubts.extend(alike(&names, &bridges(&bias, sensor, fitted)));
    }
    doubts
}

/// Warnings about channels that duplicate another one, or never change.
pub(crate) fn alike(names: &[String], rows: &[Vec<f64>]) -> Vec<String> {
    let n = rows.len() as f64;
    let channels: Vec<Vec<f64>> = (0..names.len())
        .map(|k| {
            let mean = rows.iter().map(|row| row[k]).sum::<f64>() / n;
            rows.iter().map(|row| row[k] - mean).collect()
        })
        .collect();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let power: Vec<f64> = channels.iter().map(|c| product(c, c)).collect();
    let mut doubts = Vec::new();
    for (k, name) in names.iter().enumerate() {
        if rows.is_empty() {
            break;
        }
        // Compare the values, not the power, because the mean of a constant channel is rounded.
        if rows.iter().all(|row| row[k] == rows[0][k]) {
            doubts.push(format!("{name} never changes: is it connected?"));
            continue;
        }
        for j in 0..k {
            let r = product(&channels[k], &channels[j]) / (power[k] * power[j]).sqrt();
            if r.abs() > SAME {
                doubts.push(format!(
                    "{name} duplicates {} (correlation {r:.5}): are two wires touching?",
                    names[j]
                ));
            }
        }
    }
    doubts
}

/// Signals of the taxels in contact, relative to the calibration's own bias.
pub(crate) fn taxels(bias: &Bias, recordings: &[Recording]) -> Vec<Vec<f64>> {
    signals(bias, recordings, |bias, levels| {
        let noise = f64::from(bias.taxels?.noise);
        let c = bias.apply(&levels, None).taxels?.map(f64::from).to_vec();
        Some((c, noise))
    })
}

/// Signals of a sensor under load.
pub(crate) fn bridges(bias: &Bias, sensor: usize, recordings: &[Recording]) -> Vec<Vec<f64>> {
    signals(bias, recordings, |bias, levels| {
        let noise = f64::from(bias.bridges[sensor]?.noise);
        let u = bias.apply(&levels, None).bridges[sensor]?.map(f64::from).to_vec();
        Some((u, noise))
    })
}

/// Signals of the rows that exceed ten times their noise.
fn signals(
    bias: &Bias,
    recordings: &[Recording],
    read: impl Fn(&Bias, Levels) -> Option<(Vec<f64>, f64)>,
) -> Vec<Vec<f64>> {
    recordings
        .iter()
        .flat_map(|recording| &recording.samples)
        .filter_map(|sample| read(bias, Levels::read(&sample.scan.codes)))
        .filter(|(row, noise)| {
            let square = row.iter().map(|x| x * x).sum::<f64>() / row.len() as f64;
            square.sqrt() > 10.0 * noise
        })
        .map(|(row, _)| row)
        .collect()
}

/// Ratio of the largest to the smallest singular value of the rows.
pub(crate) fn condition(rows: &[Vec<f64>]) -> Option<f64> {
    let columns = rows.first()?.len();
    let mut square = DMatrix::<f64>::zeros(columns, columns);
    for row in rows {
        for (i, a) in row.iter().enumerate() {
            for (j, b) in row.iter().enumerate() {
                square[(i, j)] += a * b;
            }
        }
    }
    let values = square.symmetric_eigenvalues();
    let (most, least) = (values.max(), values.min());
    (least > 0.0).then(|| (most / least).sqrt())
}

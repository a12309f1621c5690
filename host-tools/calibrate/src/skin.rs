//! Skin model of a finger, fitted to recordings with contact points, and its error.

use std::collections::HashSet;
use std::sync::atomic::AtomicBool;

use taxel::condition::Signals;
use taxel::estimate::gate::Gate;
use taxel::estimate::inverse::{Inverse, InverseState};
use taxel::scan::TAXELS;

use crate::inverse::{self, Row};
use crate::prepared::Prepared;
use taxel_regress::error::FitError;
use taxel_regress::network::Progress;

/// Least normal force for the friction ratio, newtons; below it the ratio is noise.
const FIRM: f64 = 0.2;
/// Least friction coefficient; recordings without shear show none.
const LEAST_FRICTION: f64 = 0.1;

/// A fitted skin model with its rows.
pub(crate) struct Skin {
    pub model: Inverse,
    /// Rows of the fit.
    pub rows: Vec<Row>,
    /// Number of rows left out: saturated or dead taxels, and outliers.
    pub left_out: usize,
    /// RMS error over the rows in f_x, f_y, f_z, newtons, with the model run as on the chip.
    pub residual: [f64; 3],
}

/// Fits the model to the recordings with force and contact point, without their wrong rows.
///
/// `None` if no recording has both.
///
/// # Errors Too few rows, or stopped.
pub(crate) fn fit(
    recordings: &[&Prepared<'_>],
    (wrong, noise): (&[HashSet<usize>], f32),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Option<Skin>, FitError> {
    let (runs, left_out): (Vec<Vec<Option<Row>>>, Vec<usize>) =
        recordings.iter().zip(wrong).map(|(r, wrong)| rows(r, wrong)).unzip();
    let loaded: Vec<Row> = runs.iter().flatten().flatten().cloned().collect();
    if loaded.is_empty() {
        return Ok(None);
    }
    let friction = friction(&loaded);
    let shear = friction > LEAST_FRICTION;
    let known = (friction.max(LEAST_FRICTION), f64::from(noise), shear);
    let model = inverse::fit("model of the skin", &loaded, known, progress, stop)?;
    let residual = residual(&model, &runs);
    Ok(Some(Skin { model, rows: loaded, left_out: left_out.iter().sum(), residual }))
}

/// Largest ratio of shear to normal force under a firm load.
pub(crate) fn friction(rows: &[Row]) -> f64 {
    rows.iter()
        .filter(|row| row.force[2] > FIRM)
        .map(|row| row.force[0].hypot(row.force[1]) / row.force[2])
        .fold(0.0, f64::max)
}

/// Touched, sound and fully known rows of a recording, and the number of unsound ones.
fn rows(prepared: &Prepared<'_>, wrong: &HashSet<usize>) -> (Vec<Option<Row>>, usize) {
    let gate = Gate::default();
    let samples = prepared.recording.samples.iter().zip(&prepared.signals);
    let mut left_out = 0;
    let rows = samples
        .enumerate()
        .map(|(at, (sample, signals))| {
            let ([fx, fy, fz], [x, y]) = (sample.truth.force, sample.truth.point);
            let c = signals.taxels?;
            let alone = Signals { taxels: Some(c), ..Signals::default() };
            let touched = prepared.bias.exceeded(&alone, gate.off * gate.off);
            let sound =
                signals.health.dead == 0 && signals.health.saturated == 0 && !wrong.contains(&at);
            let row = Row { signals: c.map(f64::from), force: [fx?, fy?, fz?], point: [x?, y?] };
            let load = touched && row.force[2] > 0.0;
            left_out += usize::from(load && !sound);
            (load && sound).then_some(row)
        })
        .collect();
    (rows, left_out)
}

/// RMS error of the forces as the chip would estimate them, row after row.
fn residual(model: &Inverse, runs: &[Vec<Option<Row>>]) -> [f64; 3] {
    let (mut squares, mut count) = ([0.0; 3], 0.0);
    for run in runs {
        let mut state = InverseState::default();
        for row in run {
            let Some(row) = row else {
                state.clear();
                continue;
            };
            let c: [f32; TAXELS] = row.signals.map(|c| c as f32);
            let u = model.curves.displacements(&c);
            let touch = if model.shear {
                model.sheared(&mut state, &u, None)
            } else {
                model.pressed(&mut state, &u)
            };
            // Without an estimate the error is the force itself.
            let found = touch.map_or([0.0; 3], |touch| touch.force());
            for ((sum, found), force) in squares.iter_mut().zip(found).zip(row.force) {
                *sum += (f64::from(found) - force).powi(2);
            }
            count += 1.0;
        }
    }
    squares.map(|sum| (sum / f64::max(count, 1.0)).sqrt())
}

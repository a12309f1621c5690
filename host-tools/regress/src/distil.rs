//! Distillation of a Gaussian process, too large for a finger, to a net with the same outputs.
//!
//! The process answers for any input, measured or not. The net is therefore taught on the recorded rows and
//! on rows between and beyond them; that is what keeps it from wild guesses where nothing was recorded.

use std::sync::atomic::AtomicBool;

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::error::FitError;
use crate::gaussian::Model;
use crate::network::{self, Build, Net, NetOptions, Progress};
use crate::scaling::{Inputs, Scale, Scaling};

/// Recorded rows that the net is taught; fewer are taught several times over, lest those between outweigh them.
const RECORDED: usize = 1024;
/// Rows between and beyond them.
const BETWEEN: usize = 3072;
/// One of so many nearest rows of other stretches is the other end of the line on which such a row lies, and
/// no more than this share of them: a dozen of a hundred rows would be other loads, not this one once more.
const NEIGHBOURS: usize = 12;
const NEIGHBOURHOOD: usize = 32;
/// The row lies this far along that line: 0 and 1 are recorded rows. Recordings of another day differ by
/// more than stretches of one do, hence as far again as twice the distance on either side.
const ALONG: std::ops::Range<f64> = -2.0..3.0;

/// Steps a pupil is given, from one start: what it is told is smooth and free of noise.
const STEPS: usize = 150;

/// Decay of its weights: below a thousandth of what any output says.
const DECAY: f64 = 1e-4;

/// Training data of the net: scaled recorded rows and their stretches.
pub(crate) struct Lesson<'r> {
    pub x: &'r DMatrix<f64>,
    pub stretch: &'r [usize],
    pub scaling: &'r Scaling,
}

/// A net, and how far it is from its teacher: RMS of each scaled target over rows it was not taught.
pub(crate) struct Pupil {
    pub net: Net,
    pub apart: Vec<f64>,
}

/// Teaches a net.
///
/// # Errors
/// Stopped before the first step.
pub(crate) fn distil(
    part: &str,
    teacher: &Model,
    lesson: &Lesson<'_>,
    (build, inputs, options): (Build, Inputs, NetOptions),
    progress: &mut dyn FnMut(Progress),
    stop: &AtomicBool,
) -> Result<Pupil, FitError> {
    let options = NetOptions { starts: 1, steps: STEPS.min(options.steps), ..options };
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let every = lesson.x.nrows().div_ceil(RECORDED).max(1);
    let recorded: Vec<usize> = (0..lesson.x.nrows()).step_by(every).collect();
    let recorded = recorded.repeat(RECORDED / recorded.len().max(1));
    let between = between(lesson, BETWEEN, &mut rng);
    let taught = stack(&lesson.x.select_rows(&recorded), &between);
    let unscaled = |x: &DMatrix<f64>, scales: &[Scale]| -> Vec<Vec<f64>> {
        let value =
            |v: &f64, s: &Scale| if s.spread > 0.0 { v * s.spread + s.mean } else { s.mean };
        x.row_iter().map(|row| row.iter().zip(scales).map(|(v, s)| value(v, s)).collect()).collect()
    };
    let x = unscaled(&taught, &lesson.scaling.inputs);
    let y = unscaled(&teacher.outputs(&taught), &lesson.scaling.targets);
    let net = network::imitate(part, (&x, &y), (build, DECAY), (inputs, options), progress, stop)?;

    let unseen = self::between(lesson, RECORDED, &mut rng);
    let wanted = teacher.outputs(&unseen);
    let x = unscaled(&unseen, &lesson.scaling.inputs);
    let mut squares = vec![0.0; wanted.ncols()];
    for (row, x) in x.iter().enumerate() {
        let x: Vec<f32> = x.iter().map(|x| *x as f32).collect();
        for (k, found) in net.outputs(&x).into_iter().enumerate() {
            let found = lesson.scaling.targets[k].scaled(f64::from(found));
            squares[k] += (found - wanted[(row, k)]).powi(2);
        }
    }
    let apart = squares.iter().map(|sum| (sum / x.len().max(1) as f64).sqrt()).collect();
    Ok(Pupil { net, apart })
}

fn stack(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = DMatrix::zeros(a.nrows() + b.nrows(), a.ncols());
    both.rows_mut(0, a.nrows()).copy_from(a);
    both.rows_mut(a.nrows(), b.nrows()).copy_from(b);
    both
}

/// Rows on lines through a recorded row and one of its nearest neighbours from other stretches: so, and in
/// these directions, recordings of one load differ.
fn between(lesson: &Lesson<'_>, count: usize, rng: &mut ChaCha8Rng) -> DMatrix<f64> {
    let Lesson { x, stretch, .. } = lesson;
    let mut rows = DMatrix::zeros(count, x.ncols());
    let transposed = x.transpose();
    for i in 0..count {
        let from = rng.random_range(0..x.nrows());
        let here = transposed.column(from);
        let mut others: Vec<(f64, usize)> = transposed
            .column_iter()
            .enumerate()
            .filter(|(other, _)| stretch[*other] != stretch[from])
            .map(|(other, there)| ((there - here).norm_squared(), other))
            .collect();
        if others.is_empty() {
            rows.row_mut(i).copy_from(&x.row(from));
            continue;
        }
        let near = (others.len() / NEIGHBOURHOOD).clamp(1, NEIGHBOURS);
        others.select_nth_unstable_by(near - 1, |a, b| a.0.total_cmp(&b.0));
        let (_, other) = others[rng.random_range(0..near)];
        let along = rng.random_range(ALONG);
        rows.row_mut(i).copy_from(&(x.row(from) + (x.row(other) - x.row(from)) * along));
    }
    rows
}

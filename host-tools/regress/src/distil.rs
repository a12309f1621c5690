//! Distillation of a Gaussian process, too large for a finger, to a net with the same outputs.
//!
//! The process answers for any input, measured or not. The net is therefore trained on the recorded
//! rows and on rows between and beyond them. These keep the net from wild guesses outside the
//! recordings.

use std::sync::atomic::AtomicBool;

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::error::FitError;
use crate::gaussian::Model;
use crate::network::{self, Build, Net, NetOptions, Progress};
use crate::scaling::{Inputs, Scale, Scaling};

/// Recorded rows in the net's training data; fewer are repeated up to this number.
///
/// Otherwise the rows between them would outweigh them.
const RECORDED: usize = 1024;
/// Synthetic rows between and beyond the recorded ones.
const BETWEEN: usize = 3072;
/// Most nearest rows of other stretches that may end the line on which a synthetic row lies.
///
/// At most this share of the rows is used, because a dozen of a hundred rows would be other loads.
const NEIGHBOURS: usize = 12;
const NEIGHBOURHOOD: usize = 32;
/// Range of positions along that line: 0 and 1 are recorded rows.
///
/// Recordings of another day differ by more than stretches of one do. The line therefore extends
/// twice the distance on either side.
const ALONG: std::ops::Range<f64> = -2.0..3.0;

/// Training steps of the net, from one start, because its data are smooth and free of noise.
const STEPS: usize = 150;

/// Weight decay of the net: below a thousandth of any output.
const DECAY: f64 = 1e-4;

/// Training data of the net: scaled recorded rows and their stretches.
pub(crate) struct Lesson<'r> {
    pub x: &'r DMatrix<f64>,
    pub stretch: &'r [usize],
    pub scaling: &'r Scaling,
}

/// A net, and its distance from its teacher: RMS of each scaled target over unseen rows.
pub(crate) struct Pupil {
    pub net: Net,
    pub apart: Vec<f64>,
}

/// Trains a net on the outputs of a Gaussian process.
///
/// # Errors
///
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
    let y = unscaled(&teacher.outputs_until(&taught, stop)?, &lesson.scaling.targets);
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

/// Draws rows on lines through a recorded row and a near neighbour from another stretch.
///
/// Recordings of one load differ in these directions and by such amounts.
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
